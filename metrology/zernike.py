"""fit_zernike: coefficients of Zernike polynomials over a circle, with sigma."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, SlopeMap

from .apertures import inscribed_radius
from .filters import kept_variance
from .fit import FormFit, Numbers, covariances_of, placed
from .zernike_terms import ansi_index, fringe_index, norm, zernike, zernike_name

__all__ = ["ZernikeFit", "fit_zernike"]

_MOST = 20  # maximum radial order


@dataclass(frozen=True, slots=True, eq=False)
class ZernikeFit:
    """Coefficients (mm, rms over the full circle), named Z(n,m); middle and radius of the circle, mm;
    residual (H, W), mm, NaN outside the circle; pairs: (n, m) of each."""

    numbers: Numbers
    middle: tuple[float, float]
    radius: float
    residual: Floats
    pairs: tuple[tuple[int, int], ...]

    def listed(self, order: str = "ansi", amplitude: bool = False) -> Numbers:
        """The coefficients in ANSI or fringe order, named by place and prysm's name; amplitude: at the edge,
        not rms."""
        place = fringe_index if order == "fringe" else ansi_index
        rows = sorted(range(len(self.pairs)), key=lambda k: place(*self.pairs[k]))
        factor = np.array([norm(*self.pairs[k]) if amplitude else 1.0 for k in rows])
        names = tuple(f"Z{place(*self.pairs[k])} {zernike_name(*self.pairs[k])}" for k in rows)
        own = self.numbers
        return Numbers(names, *(factor * part[rows] for part in (own.values, own.noise, own.rig)))


def fit_zernike(
    height: HeightMap,
    order: int = 4,
    slopes: SlopeMap | None = None,
    radius: float | None = None,
    aperture: NDArray[np.bool_] | None = None,
    removed: FormFit | None = None,
    centre: tuple[float, float] | None = None,
) -> ZernikeFit:
    """Coefficients up to a radial order by unweighted least squares over the good pixels of a circle, without
    the map's outermost ring.

    centre (x, y, mm), default: the middle of these; radius (mm), default: inscribed in them. slopes: see
    `fit_form`; aperture (H, W): pixels to use; removed: the fit whose residual the heights are, without the
    ring already, which takes its part of their noise off, as its filters do.
    """
    if order not in range(1, _MOST + 1):
        raise InputError(f"zernike: order is {order}, must be 1 to {_MOST}, whole")
    pairs = [(n, m) for n in range(order + 1) for m in range(-n, n + 1, 2)]
    x, y, good, middle = placed(height, len(pairs), aperture, removed is None)
    if centre is not None:
        x, y, middle = x + middle[0] - centre[0], y + middle[1] - centre[1], centre
    whole = inscribed_radius(x, y, good, (0.0, 0.0)) if radius is None else radius
    if not whole > 0:
        raise InputError(f"zernike: radius is {whole}, must be above 0 mm")
    good &= np.hypot(x, y) <= whole * (1 + 1e-9)
    if (count := int(good.sum())) < 2 * len(pairs):
        few = f"{count} good pixels in the circle, must be at least {2 * len(pairs)}"
        raise InputError(f"zernike: {few}; lower the order, or widen the circle")
    r, theta = np.hypot(x, y)[good], np.arctan2(y, x)[good]
    terms = np.stack([zernike(n, m, r / whole, theta) for n, m in pairs], axis=1)
    values = np.asarray(np.linalg.lstsq(terms, height.z[good], rcond=None)[0], np.float64)
    covariances = covariances_of(terms, height, x, y, good, slopes)
    residual = np.full(height.z.shape, np.nan)
    residual[good] = height.z[good] - terms @ values
    names = tuple(f"Z({n},{m})" for n, m in pairs)
    noise, rig = (np.sqrt(np.diag(part)) for part in covariances)
    if removed is not None and removed.slope_noise is not None:
        known = np.isfinite(removed.residual)
        weights = np.zeros((len(removed.basis), len(pairs)))
        weights[good[known]] = terms @ np.linalg.inv(terms.T @ terms)
        noise = np.sqrt(kept_variance(removed, weights))
    return ZernikeFit(Numbers(names, values, noise, rig), middle, whole, residual, tuple(pairs))
