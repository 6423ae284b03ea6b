"""Corner refinement: sub-pixel crossing of two dark lines by their centres, parabolas, intersection.

Every crossing is looked at in its own lattice coordinates (s along u, t along v, pattern pixels), in which
its lines are nearly s = 0 and t = 0. A line's centre is the centroid of its darkness 1 - I/background, row by
row, outside the other line; parabolas carry the curvature that a dent gives to the lines.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Corners", "refined"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
_SAMPLES = 41
_REACH = 0.47
_ROUNDS = 6
#: Darkness of a line's centre below which there is no line.
_LEAST_DARKNESS = 0.15


@dataclass(frozen=True, slots=True)
class Corners:
    """Places (..., 2) row, col, NaN where there is no crossing, and their sigma, camera pixels."""

    point: F64
    sigma: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """Where there is a crossing (...)."""
        return np.asarray(np.isfinite(self.point).all(axis=-1))


def refined(image: F32, start: F64, steps: F64, period: float, width: float) -> Corners:
    """Crossings near start (..., 2); steps (..., 2, 2): camera (row, col) per pattern pixel of u and v."""
    shape, steps = start.shape, steps.reshape(-1, 2, 2)
    point = start.reshape(-1, 2).copy()
    sigma = np.full(point.shape, np.inf)
    ok = np.asarray(np.isfinite(point).all(axis=1) & np.isfinite(steps).all(axis=(1, 2)))
    grid = np.linspace(-_REACH, _REACH, _SAMPLES) * period
    move = np.full(len(point), np.inf)
    for _ in range(_ROUNDS):
        active = np.flatnonzero(ok & (move > 1e-3))
        if len(active) == 0:
            break
        place, spread, good = _measure(image, point[active], steps[active], grid, width)
        ok[active] = good & (np.abs(place) < 0.5 * period).all(axis=1)
        point[active] += np.where(ok[active, None], np.einsum("ki,kij->kj", place, steps[active]), 0.0)
        sigma[active] = np.sqrt(np.einsum("ki,kij->kj", spread**2, steps[active] ** 2))
        move[active] = np.abs(place).max(axis=1)
    ok &= move < 0.1 * width
    point[~ok], sigma[~ok] = np.nan, np.inf
    return Corners(point.reshape(shape), sigma.reshape(shape))


def _measure(
    image: NDArray[np.float32], point: F64, steps: F64, grid: F64, width: float
) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Crossing relative to `point` in lattice coordinates (K, 2), its sigma, and whether it is there."""
    patch = _patches(image, point, steps, grid)
    along_t = _line(patch, grid, width)  # line of constant u: s as a parabola of t
    along_s = _line(patch.transpose(0, 2, 1), grid, width)
    s, t = np.zeros(len(point)), np.zeros(len(point))
    reach = 2 * grid[-1]  # where there is no crossing the iteration runs away
    for _ in range(8):
        s, t = (np.clip(_parabola(*line), -reach, reach) for line in ((along_t[0], t), (along_s[0], s)))
    good = along_t[2] & along_s[2] & np.isfinite(s) & np.isfinite(t)
    place = np.stack([np.where(good, s, 0.0), np.where(good, t, 0.0)], axis=1)
    return place, np.stack([along_t[1], along_s[1]], axis=1), good


def _patches(image: NDArray[np.float32], point: F64, steps: F64, grid: F64) -> F64:
    """Image at point + s steps[u] + t steps[v]: (K, t, s), NaN outside."""
    t, s = np.meshgrid(grid, grid, indexing="ij")
    offset = s[..., None] * steps[:, None, None, 0] + t[..., None] * steps[:, None, None, 1]
    place = point[:, None, None] + offset
    rows, cols = image.shape
    # cv2.remap takes at most 32767 lines at a time
    batch = 32000 // len(grid)
    parts = []
    for first in range(0, len(place), batch):
        part = place[first : first + batch].reshape(-1, len(grid), 2).astype(np.float32)
        parts.append(cv2.remap(image, part[..., 1], part[..., 0], cv2.INTER_CUBIC))
    patch = np.concatenate(parts).reshape(len(point), len(grid), len(grid)).astype(np.float64)
    row, col = place[..., 0], place[..., 1]
    patch[(row < 1) | (row > rows - 2) | (col < 1) | (col > cols - 2)] = np.nan
    return patch


def _line(patch: F64, grid: F64, width: float) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Centre of the dark line of each patch (K, t, s) as a parabola in t (K, 3), sigma at t = 0, presence."""
    half = grid[-1]
    clear = np.abs(grid) > 0.5 * width + 0.18 * half
    rows = patch[:, clear]
    level, slope = _background(rows, grid)
    darkness = 1 - rows / np.maximum(level[..., None] + slope[..., None] * grid, 1e-6)
    centre = _centroids(darkness, grid, width)
    peak = np.nanmax(np.where(np.isnan(darkness), -1.0, darkness), axis=2)
    # a frame that is black all over is no line
    peak = np.where(level > 0, peak, -1.0)
    usable = np.isfinite(centre) & (peak > _LEAST_DARKNESS) & (np.abs(centre) < 0.8 * half)
    design = np.stack([np.ones(clear.sum()), grid[clear], grid[clear] ** 2], axis=1)
    weight = usable.astype(np.float64)
    normal = np.einsum("kt,ti,tj->kij", weight, design, design)
    enough = weight.sum(axis=1) >= 8
    both = (weight * (grid[clear] > 0)).sum(axis=1) * (weight * (grid[clear] < 0)).sum(axis=1) > 0
    present = enough & both
    normal[~present] = np.eye(3)
    right = np.einsum("kt,ti,kt->ki", weight, design, np.where(usable, centre, 0.0))
    inverse = np.linalg.inv(normal)
    fit = np.einsum("kij,kj->ki", inverse, right)
    residual = weight * (np.where(usable, centre, 0.0) - fit @ design.T)
    variance = (residual**2).sum(axis=1) / np.maximum(weight.sum(axis=1) - 3, 1)
    present &= np.sqrt(variance) < 0.15 * half
    return fit, np.sqrt(variance * inverse[:, 0, 0] * _CORRELATED), present


#: Neighbouring samples share camera pixels, so that their centroids' errors do.
_CORRELATED = 2.0


def _background(rows: F64, grid: F64) -> tuple[F64, F64]:
    """Level at s = 0 and slope of a straight line through the bright ends of each row."""
    left, right = grid < 0.72 * grid[0], grid > 0.72 * grid[-1]
    low, high = np.median(rows[..., left], axis=-1), np.median(rows[..., right], axis=-1)
    distance = grid[right].mean() - grid[left].mean()
    return 0.5 * (low + high), (high - low) / distance


def _centroids(darkness: F64, grid: F64, width: float) -> F64:
    """Centroid of the darkness of each row, in a window that follows it."""
    reach = 0.5 * width + 0.3 * grid[-1]
    coarse = np.where(darkness > 0.3, darkness, 0.0)
    total = coarse.sum(axis=2)
    centre = (coarse * grid).sum(axis=2) / np.where(total > 0, total, np.nan)
    step = grid[1] - grid[0]
    for _ in range(3):
        # a window with soft ends: a sample on its end would make the centroid jump
        inside = np.clip((reach - np.abs(grid - centre[..., None])) / step + 0.5, 0.0, 1.0) * darkness
        total = inside.sum(axis=2)
        centre = (inside * grid).sum(axis=2) / np.where(np.abs(total) > 1e-9, total, np.nan)
    return np.asarray(centre)


def _parabola(fit: F64, at: F64) -> F64:
    value: Any = fit[:, 0] + fit[:, 1] * at + fit[:, 2] * at * at
    return np.asarray(value)
