"""Zernike polynomials over a circular aperture, in the order of ISO 14999-2 / ANSI Z80.28: n, then m.

Z_n^m = N R_n^|m|(rho) (cos m theta for m >= 0, sin |m| theta for m < 0), N = sqrt((2 - [m = 0]) (n + 1)), so
that each has an rms of 1 over the full circle; R by Jacobi polynomials (Born and Wolf, Principles of Optics,
9.2.1).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import eval_jacobi

from optolever.errors import InputError
from optolever.reconstruct import HeightMap, SlopeMap

from .fit import Numbers, covariances_of, placed

__all__ = ["ZernikeFit", "fit_zernike", "zernike"]

Floats = NDArray[np.float64]
_MOST = 20  # maximum radial order


@dataclass(frozen=True, slots=True, eq=False)
class ZernikeFit:
    """Coefficients (mm, rms over the full circle), named Z(n,m); middle and radius of the circle, mm;
    residual (H, W), mm."""

    numbers: Numbers
    middle: tuple[float, float]
    radius: float
    residual: Floats


def zernike(n: int, m: int, rho: Floats, theta: Floats) -> Floats:
    """Z_n^m at rho (1 at the aperture's edge) and theta (from x to y). InputError for invalid n, m."""
    if n < 0 or abs(m) > n or (n - m) % 2:
        raise InputError(f"zernike: n = {n}, m = {m}, must be n >= |m| with n - m even")
    order, half = abs(m), (n - abs(m)) // 2
    radial = (-1) ** half * rho**order * eval_jacobi(half, order, 0, 1 - 2 * rho**2)
    turn = np.cos(order * theta) if m >= 0 else np.sin(order * theta)
    return np.asarray(np.sqrt((1 if m == 0 else 2) * (n + 1)) * radial * turn)


def fit_zernike(
    height: HeightMap, order: int = 4, slopes: SlopeMap | None = None, radius: float | None = None
) -> ZernikeFit:
    """Coefficients up to a radial order by unweighted least squares over the good pixels without their
    outermost ring.

    The circle is centred at the middle of these; radius (mm), default: encloses all of them.
    slopes: see `fit_form`.
    """
    if not 1 <= order <= _MOST:
        raise InputError(f"zernike: order is {order}, must be 1 to {_MOST}")
    pairs = [(n, m) for n in range(order + 1) for m in range(-n, n + 1, 2)]
    x, y, good, middle = placed(height, len(pairs))
    r, theta = np.hypot(x, y)[good], np.arctan2(y, x)[good]
    whole = float(r.max()) if radius is None else radius
    if not whole > 0:
        raise InputError(f"zernike: radius is {whole}, must be above 0 mm")
    terms = np.stack([zernike(n, m, r / whole, theta) for n, m in pairs], axis=1)
    values = np.asarray(np.linalg.lstsq(terms, height.z[good], rcond=None)[0], np.float64)
    covariances = covariances_of(terms, height, x, y, good, slopes)
    residual = np.full(height.z.shape, np.nan)
    residual[good] = height.z[good] - terms @ values
    names = tuple(f"Z({n},{m})" for n, m in pairs)
    noise, rig = (np.sqrt(np.diag(part)) for part in covariances)
    return ZernikeFit(Numbers(names, values, noise, rig), middle, whole, residual)
