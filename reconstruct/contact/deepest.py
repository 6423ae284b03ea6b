"""The deepest point of a dent: where and how deep, by a paraboloid through the pixels around it."""

from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .dent import Dent

__all__ = ["Deepest", "deepest"]

_RADII = (3.2, 2.3)  # pixels of the paraboloid; the smaller one bounds its shape error
_FEWEST = 12  # pixels


class Deepest(NamedTuple):
    """x, y, depth in mm with standard deviations; depth_noise: the part that is noise."""

    x: float
    y: float
    x_sigma: float
    y_sigma: float
    depth: float
    depth_sigma: float
    depth_noise: float


def deepest(dent: Dent) -> Deepest:
    """The top of a paraboloid; the deepest pixel of a plateau, or of a tip, in which it may be anywhere."""
    at, here = dent.peak, np.array([dent.x[dent.peak], dent.y[dent.peak]])
    away = np.hypot(dent.x - here[0], dent.y - here[1])
    near = away < _RADII[0] * dent.pitch
    first, other = (_top(dent, away < radius * dent.pitch) for radius in _RADII)
    z, sigma = float(dent.z[at]), float(dent.sigma[at])
    moves = dent.moved(*here)
    if first is None:
        steep = float(np.median(np.hypot(*dent.slopes[:, near])))
        top, noise = (here, z), float(np.hypot(sigma, 0.25 * steep * dent.pitch))
        spread = np.full(2, dent.pitch if steep * dent.radius > 0.3 * z else 0.5 * dent.radius)
    else:
        depth, place, shift = first
        lower, beside = (z, np.zeros(2)) if other is None else other[:2]
        tilt = np.median(dent.slope_sigmas[:, near], axis=1) / np.sqrt(np.count_nonzero(near))
        spread = np.minimum(np.hypot(np.linalg.norm(shift * tilt, axis=1), place - beside), dent.radius)
        moves[: len(dent.slope_modes)] += dent.slope_modes[:, :, near].mean(axis=2) @ shift
        top, noise = (here + place, depth), float(np.hypot(sigma, depth - lower))
    x_sigma, y_sigma = np.hypot(spread, np.linalg.norm(moves, axis=0)).tolist()
    (x, y), depth = top
    whole = float(np.linalg.norm([noise, *dent.modes[:, at]]))
    return Deepest(float(x), float(y), x_sigma, y_sigma, depth, whole, noise)


def _top(dent: Dent, near: Floats) -> tuple[float, Floats, Floats] | None:
    """Height of the top of a paraboloid through the pixels `near`, its place from the deepest pixel (mm) and
    its shift (2, 2) by slopes that are added; None where none fits."""
    dx, dy, heights = (part[near] - part[dent.peak] for part in (dent.x, dent.y, dent.z))
    if dx.size < _FEWEST:
        return None
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    c = np.linalg.lstsq(terms, heights, rcond=None)[0]
    bent = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    z = float(dent.z[dent.peak])
    if abs(c[0]) > max(float(dent.sigma[dent.peak]), 1e-3 * z) or not np.all(np.linalg.eigvalsh(bent) < 0):
        return None
    top = -np.linalg.solve(bent, c[1:3])
    if np.hypot(*top) > float(np.hypot(dx, dy).max()):
        return None
    return z + float(c[0] + 0.5 * c[1:3] @ top), top, -np.linalg.inv(bent)
