"""Tilt and principal radii of a contact: the second-order surface that fits its height best.

z(X) = z0 + g . X + X . H X / 2 by least squares over the cells deeper than half of the depth. Curvatures
are the eigenvalues of the shape operator (1 + g g^T)^-1 H / sqrt(1 + |g|^2) (M. P. do Carmo, Differential
Geometry of Curves and Surfaces, 1976, ch. 3.3). The fit is linear in the heights: frames of noise give the
sigmas. No dent is exactly of second order, and the window rounds the kink at the contact's edge: the change
that cells deeper than 0.6 of the depth alone make is added.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import Cells, Float, Mask

__all__ = ["Shape", "shape_of"]

_SHARES = 0.5, 0.6  # of the depth
_FEWEST = 24  # cells
_CURVED = 3.0  # sigma of a curvature, from which on its radius is finite


@dataclass(frozen=True, slots=True)
class Shape:
    """tilt: dz/dx, dz/dy at the centroid, rad, tilt_sigma: of either; radii, radii_sigma: the principal
    ones, mm, the smaller curvature's last; None: flat within three sigma, or bent the other way; axis: the
    last one's direction from x, rad."""

    tilt: tuple[float, float]
    tilt_sigma: float
    radii: tuple[float | None, float | None]
    radii_sigma: tuple[float | None, float | None]
    axis: float


@dataclass(frozen=True, slots=True)
class _Fit:
    """slope (2,), hessian (2, 2), and those of every frame of noise, (K, 2), (K, 2, 2)."""

    slope: Float
    hessian: Float
    slopes: Float
    hessians: Float


def shape_of(
    surface: tuple[Float, Float, Float], draws: Cells, inside: Mask, depth: float, off: float
) -> Shape | None:
    """surface: x, y from the centroid, and the height z (R, C), mm; draws (K, R, C): heights of noise; inside
    (R, C): the contact; off: the centroid's standard deviation. None: too few cells."""
    fits = [_fitted(surface, draws, inside & (surface[2] > share * depth)) for share in _SHARES]
    wide, narrow = fits
    if wide is None or narrow is None:
        return None
    curvature, ways = _principal(wide)
    metric = np.sqrt(1 + wide.slope @ wide.slope)
    noise = [np.sqrt(np.mean((wide.hessians @ way @ way) ** 2)) / metric for way in ways.T]
    change = np.abs(curvature - _principal(narrow)[0])
    sigma = np.hypot(noise, change)
    bent = curvature > _CURVED * sigma
    radii = [float(1 / one) if known else None for one, known in zip(curvature, bent, strict=True)]
    errors = [float(s / c**2) if known else None for s, c, known in zip(sigma, curvature, bent, strict=True)]
    tilts = np.hypot(np.sqrt(np.mean(wide.slopes**2, axis=0)), wide.slope - narrow.slope)
    return Shape(
        tilt=(float(wide.slope[0]), float(wide.slope[1])),
        tilt_sigma=float(np.hypot(np.sqrt(np.mean(tilts**2)), np.abs(curvature).max() * off)),
        radii=(radii[0], radii[1]),
        radii_sigma=(errors[0], errors[1]),
        axis=float(np.arctan2(ways[1, 1], ways[0, 1])),
    )


def _fitted(surface: tuple[Float, Float, Float], draws: Cells, used: Mask) -> _Fit | None:
    if np.count_nonzero(used) < _FEWEST:
        return None
    a, b, z = (part[used] for part in surface)
    size = float(np.hypot(a, b).max())
    a, b = a / size, b / size
    basis = np.stack([np.ones(a.size), a, b, a**2 / 2, a * b, b**2 / 2])
    heights = np.concatenate([z[None], draws[:, used]])
    found = np.linalg.solve(basis @ basis.T, basis @ heights.T).T
    slopes, hessians = found[:, 1:3] / size, found[:, [3, 4, 4, 5]].reshape(-1, 2, 2) / size**2
    return _Fit(slopes[0], hessians[0], slopes[1:], hessians[1:])


def _principal(fit: _Fit) -> tuple[Float, Float]:
    """Curvatures (2,), 1/mm, above 0 towards the medium, the larger one first; their directions (2, 2) as
    columns."""
    metric = np.eye(2) + np.outer(fit.slope, fit.slope)
    values, ways = np.linalg.eig(np.linalg.solve(metric, -fit.hessian / np.sqrt(np.linalg.det(metric))))
    order = np.argsort(-values.real)
    return values.real[order], ways.real[:, order]
