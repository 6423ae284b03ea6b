"""The deepest point of a dent: where and how deep, by a paraboloid through the pixels around it."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats
from .dent import Dent

__all__ = ["Deepest", "deepest"]

_RADII = (3.2, 2.3)  # pixels of the paraboloid; the smaller one bounds its shape error
_FEWEST = 12  # pixels
_PLATEAU = 0.93  # of the depth, at half the half-depth radius: above, the bottom is flat
_IN_PIXEL = 1 / np.sqrt(12)  # of a pixel's side: a point that may be anywhere in it


@dataclass(frozen=True, slots=True)
class Deepest:
    """x, y, depth in mm with standard deviations; depth_noise: the part that is noise."""

    x: float
    y: float
    x_sigma: float
    y_sigma: float
    depth: float
    depth_sigma: float
    depth_noise: float


def deepest(dent: Dent) -> Deepest:
    """The top of a paraboloid where one fits; else the deepest pixel, of a tip within the pixel, of a plateau
    anywhere on it."""
    at, place = dent.peak, (float(dent.x[dent.peak]), float(dent.y[dent.peak]))
    z = float(dent.z[at])
    modes = dent.modes[:, at]
    tops = [_top(dent, radius * dent.pitch) for radius in _RADII]
    first = tops[0]
    step = float(np.hypot(*dent.slopes[:, at])) * dent.pitch
    moves = dent.moved(*place)
    if first is None:
        shape = dent.pitch * _IN_PIXEL if _mid_share(dent, z) < _PLATEAU else 0.5 * dent.radius
        noise = float(np.hypot(dent.sigma[at], step * _IN_PIXEL))
        sigmas = [float(np.linalg.norm([shape, *moves[:, k]])) for k in (0, 1)]
        return Deepest(*place, *sigmas, z, float(np.linalg.norm([noise, *modes])), noise)
    depth, top, inverse, pixels = first
    second = tops[1] or (z, (0.0, 0.0), inverse, pixels)
    near = np.hypot(dent.x - place[0], dent.y - place[1]) < _RADII[0] * dent.pitch
    slope_modes = dent.slope_modes[:, :, near].mean(axis=2)
    moves[: len(slope_modes)] += slope_modes @ inverse
    tilt = np.median(dent.slope_sigmas[:, near], axis=1) / np.sqrt(pixels)
    noise_xy = np.linalg.norm(inverse * tilt, axis=1)
    sigmas = [
        float(np.linalg.norm([min(np.hypot(noise_xy[k], top[k] - second[1][k]), dent.radius), *moves[:, k]]))
        for k in (0, 1)
    ]
    noise = float(np.hypot(dent.sigma[at], depth - second[0]))
    sigma = float(np.linalg.norm([noise, *modes]))
    return Deepest(place[0] + top[0], place[1] + top[1], *sigmas, depth, sigma, noise)


def _top(dent: Dent, radius: float) -> tuple[float, tuple[float, float], Floats, int] | None:
    """Height of the top of a paraboloid through the pixels within a radius (mm), its place from the deepest
    pixel, the shift of the top per slope (2, 2), and of how many pixels; None where none fits."""
    z = float(dent.z[dent.peak])
    dx, dy = dent.x - dent.x[dent.peak], dent.y - dent.y[dent.peak]
    near = np.hypot(dx, dy) < radius
    if np.count_nonzero(near) < _FEWEST:
        return None
    dx, dy = dx[near], dy[near]
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    c = np.linalg.lstsq(terms, dent.z[near], rcond=None)[0]
    bent = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    limit = max(float(dent.sigma[dent.peak]), 1e-3 * z)
    if abs(c[0] - z) > limit or not np.all(np.linalg.eigvalsh(bent) < 0):
        return None
    top = -np.linalg.solve(bent, c[1:3])
    if np.hypot(*top) > radius:
        return None
    height = float(c[0] + 0.5 * c[1:3] @ top)
    return height, (float(top[0]), float(top[1])), -np.linalg.inv(bent), int(near.sum())


def _mid_share(dent: Dent, depth: float) -> float:
    """Height at half the half-depth radius from the deepest point over the depth."""
    r = np.hypot(dent.x - dent.x[dent.peak], dent.y - dent.y[dent.peak])
    ring = np.abs(r - 0.5 * dent.radius) <= dent.pitch
    return float(np.mean(dent.z[ring]) / depth) if ring.any() else 0.0
