"""Corners of the paper's lattice: sub-pixel in the rest frame, tracked into a deformed one.

Every crossing is looked at in its own lattice coordinates (s along u, t along v, pattern pixels), in which
its lines are nearly s = 0 and t = 0. A line's centre is the centroid of its darkness 1 - I/background, row by
row, outside the other line; parabolas carry the curvature that a dent gives to the lines.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.patterns import Sequence, lattice_lines
from optolever.records import Comparable

from .crossed import displaced
from .prior import PatternMap, frame_pair, prior_map

__all__ = ["Crossings", "lattice"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Change of the displacement in its last pass, cycles: a line's number needs no more.
_SETTLED = 0.1
#: From its expected place, periods: half a period away the next line is as near.
_FARTHEST = 0.25
#: Of a crossing: samples along either line, how far they reach (periods), rounds until it is found.
_SAMPLES = 41
_REACH = 0.47
_ROUNDS = 6
#: Darkness of a line's centre below which there is no line.
_LEAST_DARKNESS = 0.15
#: Neighbouring samples share camera pixels, so that their centroids' errors do.
_CORRELATED = 2.0


@dataclass(frozen=True, slots=True)
class Corners:
    """Places (..., 2) row, col, NaN where there is no crossing, and their sigma, camera pixels."""

    point: F64
    sigma: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """Where there is a crossing (...)."""
        return np.asarray(np.isfinite(self.point).all(axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class Crossings(Comparable):
    """K crossings found at rest; `now` is NaN and `sigma` inf where one was not found again.

    index  (K, 2) numbers of the lines along u and v      pattern  (K, 2) their u, v, pattern pixels
    rest   (K, 2) row, col at rest, camera pixels          now      (K, 2) row, col in the deformed frame
    sigma, sigma_rest  (K, 2) standard deviations of row, col, camera pixels
    """

    index: NDArray[np.int64]
    pattern: F64
    rest: F64
    now: F64
    sigma: F64
    sigma_rest: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where the crossing was found in both frames, (K,)."""
        return np.asarray(np.isfinite(self.now).all(axis=1))

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> "Crossings":
        """Read what save() wrote."""
        names = [field.name for field in fields(cls)]
        arrays = load_arrays(path, names)
        return cls(**{name: arrays[name] for name in names})


def lattice(
    frames: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Crossings:
    """Crossings of the lattice in `frames`, each matched to the same one in `rest`.

    frames, rest  (N, H, W) as the sequence describes them, or the lattice frame alone, (H, W)
    prior         where the camera looked at rest, to a quarter of the lattice's period (a trace, a decoded
                  capture); default: the surface fills the frame, u along columns, v along rows

    A crossing is matched by the displacement of the lattice's first harmonic, which is a crossed fringe: its
    median in each connected part of the mirror must be within half a period (see crossed).
    """
    frame, image, still = frame_pair(frames, rest, sequence, "lattice")
    lines = lattice_lines(frame, sequence.cols), lattice_lines(frame, sequence.rows)
    pattern = np.stack(np.meshgrid(*lines), axis=-1)
    period, width = frame.period_px or 1.0, frame.width_px or 1.0
    u, v = prior_map(prior, sequence, still.shape)
    at_rest = refined(still.astype(np.float32), *_inverse(u, v, pattern), period, width)
    if not at_rest.found.any():
        raise InputError("lattice: no crossing was found in the rest frame; is the prior that frame's?")
    moved = displaced(image, still, (u, v), (sequence.rows, sequence.cols), period, _SETTLED)
    du, dv = (np.where(moved.good, part, np.nan) for part in (moved.du, moved.dv))
    start, steps = _inverse(u + du, v + dv, pattern)
    now = refined(image.astype(np.float32), start, steps, period, width)
    size = period * np.sqrt(np.abs(np.linalg.det(np.where(now.found[..., None, None], steps, 0))))
    far = np.hypot(*np.moveaxis(now.point - start, -1, 0)) > _FARTHEST * size
    now.point[far], now.sigma[far] = np.nan, np.inf
    at_rest, now = (_without_curvature(corners, width / period) for corners in (at_rest, now))
    keep = at_rest.found
    index = np.argwhere(keep)[:, ::-1]
    return Crossings(
        index, pattern[keep], at_rest.point[keep], now.point[keep], now.sigma[keep], at_rest.sigma[keep]
    )


def _inverse(u: F64, v: F64, points: F64) -> tuple[F64, F64]:
    """Camera places (J, I, 2), row and column, of pattern coordinates (J, I, 2), and camera steps per pattern
    pixel of u, v there (J, I, 2, 2); NaN outside the map.

    From the nearest of about 40,000 pixels three Newton steps lead there: a map is smooth.
    """
    pattern = points.reshape(-1, 2)
    thin = max(2, int(np.sqrt(u.size / 40000)))
    gradient = np.stack([np.stack([*np.gradient(part)], axis=-1) for part in (u, v)], axis=-2)
    row, col = (axis.ravel() for axis in np.mgrid[1 : u.shape[0] - 1 : thin, 1 : u.shape[1] - 1 : thin])
    area = np.abs(np.linalg.det(np.nan_to_num(gradient[row, col])))
    good = np.isfinite(u[row, col] + v[row, col]) & (area > 1e-6)
    if not good.any():
        return np.full(points.shape, np.nan), np.full((*points.shape, 2), np.nan)
    row, col = row[good], col[good]
    nearest = cKDTree(np.stack([u[row, col], v[row, col]], axis=1)).query(pattern)[1]
    place = np.stack([row[nearest], col[nearest]], axis=1).astype(np.float64)
    for _ in range(3):
        at = tuple(np.clip(np.rint(place[:, k]), 0, u.shape[k] - 1).astype(int) for k in (0, 1))
        jacobian = gradient[at]
        usable = np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 1e-6
        inverse = np.full(jacobian.shape, np.nan)
        inverse[usable] = np.linalg.inv(jacobian[usable])
        missing = pattern - np.stack([u[at], v[at]], axis=1)
        place = np.stack(at, axis=1) + np.einsum("kij,kj->ki", inverse, missing)
        place[~np.isfinite(place)] = -1.0
    beside = np.abs(place - np.stack(at, axis=1)) > 1.5
    place[(beside | (place < 0) | (place > np.array(u.shape) - 1)).any(axis=1)] = np.nan
    return place.reshape(points.shape), inverse.transpose(0, 2, 1).reshape(*points.shape, 2)


def _without_curvature(corners: Corners, share: float) -> Corners:
    """Less the shift that the map's curvature gives to the centroid of a line that is `share` periods wide.

    Where the place x of pattern coordinate q curves, a line's darkness spreads as x'(q) dq, and its centroid
    lies at x + 3/2 x'' m2, m2 = width^2 / 12. x'' from the neighbours; a third of the shift goes into sigma.
    """
    point, sigma = corners.point.copy(), corners.sigma.copy()
    for axis in (0, 1):
        own, inner = (np.moveaxis(part, 1 - axis, 0)[1:-1] for part in (corners.point, point))
        ahead, behind = (np.moveaxis(corners.point, 1 - axis, 0)[cut] for cut in (np.s_[2:], np.s_[:-2]))
        along = ahead - behind
        along /= np.sqrt((along**2).sum(axis=-1, keepdims=True))
        bend = ((ahead - 2 * own + behind) * along).sum(axis=-1, keepdims=True)
        shift = np.nan_to_num(1.5 * share**2 / 12 * bend * along)
        inner -= shift
        spread = np.moveaxis(sigma, 1 - axis, 0)[1:-1]
        spread[:] = np.hypot(spread, shift / 3)
    return replace(corners, point=point, sigma=sigma)


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
