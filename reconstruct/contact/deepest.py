"""The deepest point of a dent: where and how deep, by a paraboloid through the pixels around it."""

from dataclasses import dataclass, field

import numpy as np

from ..arrays import Floats
from .dent import Dent

__all__ = ["Deepest", "deepest"]

_RADII = (3.2, 2.3)  # pixels of the paraboloid; the smaller one bounds its shape error
_FEWEST = 12  # pixels
_FLATTENED = 0.8  # pixels around a tip whose heights are means over it
_CLEARLY = 0.25  # of the other's sum of squares: a cone fits clearly better
_BLUNT = 0.1  # pixels: what a tip may lack, times its slope
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
    """The top of a paraboloid or of a cone, whichever fits better; else the deepest pixel of a plateau."""
    at, place = dent.peak, (float(dent.x[dent.peak]), float(dent.y[dent.peak]))
    z, sigma = float(dent.z[at]), float(dent.sigma[at])
    tops = [_top(dent, radius * dent.pitch) for radius in _RADII]
    tips = [_tip(dent, radius * dent.pitch) for radius in _RADII]
    first, tip = tops[0], tips[0]
    moves = dent.moved(*place)
    if tip is not None and (first is None or tip.rss < _CLEARLY * first.rss):
        other = tips[1] or tip
        step = dent.pitch * _IN_PIXEL * np.ones(2)
        noise = float(np.linalg.norm([sigma, tip.depth - other.depth, tip.steepness * dent.pitch * _BLUNT]))
        return _deepest(dent, tip, np.hypot(step, np.subtract(tip.place, other.place)), moves, noise)
    if first is None:
        flat = _Top(z, (0.0, 0.0), 0.0)
        return _deepest(dent, flat, np.full(2, 0.5 * dent.radius), moves, sigma)
    other = tops[1] or _Top(z, (0.0, 0.0), 0.0)
    near = np.hypot(dent.x - place[0], dent.y - place[1]) < _RADII[0] * dent.pitch
    slope_modes = dent.slope_modes[:, :, near].mean(axis=2)
    moves[: len(slope_modes)] += slope_modes @ first.shift
    tilt = np.median(dent.slope_sigmas[:, near], axis=1) / np.sqrt(np.count_nonzero(near))
    spread = np.hypot(np.linalg.norm(first.shift * tilt, axis=1), np.subtract(first.place, other.place))
    noise = float(np.hypot(sigma, first.depth - other.depth))
    return _deepest(dent, first, np.minimum(spread, dent.radius), moves, noise)


@dataclass(frozen=True, slots=True)
class _Top:
    """Height and place (from the deepest pixel) of a fitted top, mm; rss: of the fit; shift (2, 2): of a
    paraboloid's top by slopes that are added; steepness: slope of a cone."""

    depth: float
    place: tuple[float, float]
    rss: float
    shift: Floats = field(default_factory=lambda: np.zeros((2, 2)))
    steepness: float = 0.0


def _deepest(dent: Dent, top: _Top, spread: Floats, moves: Floats, noise: float) -> Deepest:
    """spread (2,): of the place by noise and shape; moves (m, 2): by the errors of the rig."""
    x_sigma, y_sigma = (float(np.linalg.norm([spread[k], *moves[:, k]])) for k in (0, 1))
    x, y = dent.x[dent.peak] + top.place[0], dent.y[dent.peak] + top.place[1]
    sigma = float(np.linalg.norm([noise, *dent.modes[:, dent.peak]]))
    return Deepest(float(x), float(y), x_sigma, y_sigma, top.depth, sigma, noise)


def _around(dent: Dent, radius: float) -> tuple[Floats, Floats, Floats]:
    """Places from the deepest pixel and heights of the pixels within a radius (mm) of it."""
    dx, dy = dent.x - dent.x[dent.peak], dent.y - dent.y[dent.peak]
    near = np.hypot(dx, dy) < radius
    return dx[near], dy[near], dent.z[near]


def _top(dent: Dent, radius: float) -> _Top | None:
    """The top of a paraboloid through the pixels within a radius (mm); None where none fits."""
    dx, dy, heights = _around(dent, radius)
    if dx.size < _FEWEST:
        return None
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    c = np.linalg.lstsq(terms, heights, rcond=None)[0]
    bent = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    z = float(dent.z[dent.peak])
    limit = max(float(dent.sigma[dent.peak]), 1e-3 * z)
    if abs(c[0] - z) > limit or not np.all(np.linalg.eigvalsh(bent) < 0):
        return None
    top = -np.linalg.solve(bent, c[1:3])
    if np.hypot(*top) > radius:
        return None
    rss = float(np.sum((heights - terms @ c) ** 2))
    height = float(c[0] + 0.5 * c[1:3] @ top)
    return _Top(height, (float(top[0]), float(top[1])), rss, -np.linalg.inv(bent))


def _tip(dent: Dent, radius: float) -> _Top | None:
    """The tip of a cone with a curved flank through the pixels within a radius (mm), without those that the
    tip flattens; None where the flanks do not rise to it."""
    dx, dy, heights = _around(dent, radius)
    steps = np.linspace(-1.5, 1.5, 21) * dent.pitch
    best = None
    for x in steps:
        for y in steps:
            rho = np.hypot(dx - x, dy - y)
            use = rho > _FLATTENED * dent.pitch
            if np.count_nonzero(use) < _FEWEST:
                return None
            terms = np.stack([np.ones_like(rho), -rho, rho * rho], axis=1)[use]
            c = np.linalg.lstsq(terms, heights[use], rcond=None)[0]
            rss = float(np.sum((heights[use] - terms @ c) ** 2)) * rho.size / np.count_nonzero(use)
            if best is None or rss < best.rss:
                best = _Top(float(c[0]), (float(x), float(y)), rss, steepness=float(c[1]))
    return best if best is not None and best.steepness > 0 else None
