"""Frames of a raster of spots that are lost, doubled, swapped or another's.

What a pixel sees of the spot around its brightest place is a product, a column times a row. From a lost frame
on all spots come a place early: where one row of the raster is right and the next one is not, the product
falls apart, all along the rows that a spot is high. A single wrong frame breaks it around its own place.
Where it breaks, every single fault is tried: the one that mends it is told.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["RasterFault", "raster_faults"]

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: Pixels looked at, about.
_PIXELS = 16384
#: What a product may be off by, rms, without a fault: of the noise, of the spot's light.
_NOISE, _UNEVEN = 3.0, 0.05
#: Share of the pixels at a row or place that no product explains above which something is wrong; fewest.
_SUSPECT, _FEWEST = 0.5, 12
#: Share of their misfit that a fault may leave and still explain them.
_LEFT = 0.25
#: Places tried around those that are suspect, at most.
_TRIALS = 1024


@dataclass(frozen=True, slots=True)
class RasterFault:
    """kind: lost | repeated | swapped | replaced; frames: the first from which on all are in wrong places, or
    those that are wrong; rows: first and last of the raster's in which pixels see them (None: all).
    """

    kind: str
    frames: tuple[int, ...]
    rows: tuple[int, int] | None


def raster_faults(stack: NDArray[Any], index: Ints, half: int) -> RasterFault | None:
    """The fault of frames (N, H, W) whose numbers at the places of the raster are index (R, C), if any.

    half: places on either side of the brightest that a spot lights.
    """
    every = max(1, round(np.sqrt(stack.shape[1] * stack.shape[2] / _PIXELS)))
    levels = stack[:, ::every, ::every].reshape(len(stack), -1)
    order = np.sort(index.ravel())
    dark = np.median(levels[order[:: max(1, len(order) // 64)]], axis=0)
    light = levels.astype(np.float32) - dark.astype(np.float32)
    peak = order[light[order].argmax(axis=0)]
    top = light[peak, np.arange(light.shape[1])]
    lit = top > 0.25 * np.percentile(top, 95)
    noise = 1.4826 * float(np.median(np.abs(light[order[:: max(1, len(order) // 64)]])))
    if np.count_nonzero(lit) < _FEWEST or np.percentile(top, 95) < 8 * max(noise, 0.3):
        return None
    sample = _Sample(light[:, lit], top[lit], half, max(noise, 0.3))
    misfit, row, col = sample.misfit(index)
    bad = misfit > 1
    if np.count_nonzero(bad) < _FEWEST:
        return None
    near = _around(row, bad, index.shape[0], half)
    suspects = np.unique(index[near].ravel()) if near.any() else _places(index, row, col, bad, half)
    if not 0 < len(suspects) <= _TRIALS:
        return None
    concerned = near[row] if near.any() else np.isin(index[row, col], suspects)
    some = sample.picked(concerned)
    before = float(np.maximum(misfit[concerned] - 0.5, 0).sum())
    tried = [
        (float(np.maximum(some.misfit(trial)[0] - 0.5, 0).sum()), kind, frames)
        for kind, frames, trial in _trials(index, order, suspects)
    ]
    left, kind, frames = min(tried, key=lambda trial: trial[0])
    if left > _LEFT * before:
        return None
    if kind in ("lost", "repeated"):
        return RasterFault(kind, frames, None)
    rows = np.nonzero(np.isin(index, frames))[0]
    return RasterFault(kind, frames, (max(int(rows.min()) - half - 1, 0), int(rows.max()) + half + 1))


@dataclass(frozen=True, slots=True)
class _Sample:
    """Light (N, K) of some pixels, their brightest (K,), how far a spot reaches, noise."""

    light: NDArray[np.float32]
    top: NDArray[np.float32]
    half: int
    noise: float

    def picked(self, which: Mask) -> "_Sample":
        return _Sample(self.light[:, which], self.top[which], self.half, self.noise)

    def misfit(self, index: Ints) -> tuple[F64, Ints, Ints]:
        """Rms of what no product explains over its limit (K,), and the brightest place: row, column.

        index (R, C): -1 where no frame is known.
        """
        rows, cols = index.shape
        known = index.ravel() >= 0
        seen = np.where(known[:, None], self.light[index.ravel()], -np.inf)
        row, col = np.divmod(seen.argmax(axis=0), cols)
        reach = np.arange(-self.half, self.half + 1)
        # at the raster's border the window moves inside
        r = np.clip(row, self.half, rows - 1 - self.half)[:, None] + reach
        c = np.clip(col, self.half, cols - 1 - self.half)[:, None] + reach
        at = index[r[:, :, None], c[:, None, :]]
        window = np.where(at >= 0, self.light[at, np.arange(len(row))[:, None, None]], np.nan)
        whole = np.isfinite(window).all(axis=(1, 2))
        window = np.nan_to_num(window).astype(np.float64)
        along, down = window.sum(axis=1), window.sum(axis=2)
        total = np.maximum(window.sum(axis=(1, 2)), 1e-9)
        rest = window - down[:, :, None] * along[:, None, :] / total[:, None, None]
        limit = np.hypot(_NOISE * self.noise, _UNEVEN * self.top)
        return np.where(whole, np.sqrt(np.mean(rest**2, axis=(1, 2))) / limit, 0.0), row, col


def _around(row: Ints, bad: Mask, rows: int, half: int) -> Mask:
    """Rows of the raster around those where most pixels are wrong, (R,)."""
    count, wrong = np.bincount(row, minlength=rows), np.bincount(row, bad, minlength=rows)
    most = (wrong > _SUSPECT * count) & (wrong >= _FEWEST)
    near = np.zeros(rows, np.bool_)
    for at in np.flatnonzero(most):
        near[max(at - half - 1, 0) : at + half + 2] = True
    return near


def _places(index: Ints, row: Ints, col: Ints, bad: Mask, half: int) -> Ints:
    """Frames around places where most pixels are wrong."""
    rows, cols = index.shape
    count, wrong = np.zeros((2, rows, cols))
    np.add.at(count, (row, col), 1)
    np.add.at(wrong, (row, col), bad)
    most = np.argwhere((wrong > _SUSPECT * count) & (wrong > 0))
    frames = [
        index[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1].ravel() for r, c in most
    ]
    return np.unique(np.concatenate(frames)) if frames else np.zeros(0, np.int64)


def _trials(index: Ints, order: Ints, suspects: Ints) -> Iterator[tuple[str, tuple[int, ...], Ints]]:
    """Single faults of the suspect frames, and which frame shows which place under each."""
    rank = np.empty(order.max() + 1, np.int64)
    rank[order] = np.arange(len(order))
    places = rank[index]

    def of(frames: Ints) -> Ints:
        return np.asarray(frames[places])

    for frame in suspects:
        k = int(rank[frame])
        yield "replaced", (int(frame),), of(np.where(np.arange(len(order)) == k, -1, order))
        yield "lost", (int(frame),), of(np.concatenate([order[:k], [-1], order[k:-1]]))
        if k + 1 < len(order):
            swapped = order.copy()
            swapped[[k, k + 1]] = order[[k + 1, k]]
            yield "swapped", (int(frame), int(order[k + 1])), of(swapped)
        if k > 0:
            yield "repeated", (int(frame),), of(np.concatenate([order[:k], order[k + 1 :], [-1]]))
