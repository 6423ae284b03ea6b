"""Phase unwrapping by quality, and the connected parts that its whole periods hold for.

From any pixel the region grows over the smallest wrapped phase difference first (the quality-guided flood of
Herráez et al. 2002, doi:10.1364/AO.41.007437, with first differences as quality), so that steep places are
crossed last and pixels that see nothing after those.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact

__all__ = ["islands_of", "largest_parts", "unwrapped"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]
_BINS = 64  # of quality: speed against order of growth, 1/128 cycle each


def unwrapped(cycles: F64, usable: Mask) -> F64:
    """A phase (H, W) without jumps; the median of every connected usable part is within half a cycle of 0."""
    wrapped = cycles - np.rint(cycles)
    order = np.zeros(wrapped.shape, np.int32)
    _grow(wrapped, usable, order)
    turns = wrapped + order
    for part, cut in _parts(usable):
        turns[cut] -= np.where(part, np.rint(np.median(turns[cut][part])), 0.0)
    return turns


def islands_of(lit: Mask) -> Labels:
    """Labels (H, W) of the connected parts of lit, 0 elsewhere."""
    return np.asarray(cv2.connectedComponents(lit.astype(np.uint8), connectivity=4)[1])


def largest_parts(good: Mask, islands: Labels, least: float) -> Mask:
    """Of every island the largest connected part of good pixels, if it has `least` pixels."""
    parts = islands_of(good)
    area = np.bincount(parts.ravel())
    owner = np.zeros(len(area), np.int64)
    owner[parts[good]] = islands[good]
    ascending = np.lexsort((area, owner))
    last = np.flatnonzero(np.diff(owner[ascending], append=-1))
    keep = np.zeros(len(area), bool)
    keep[ascending[last]] = True
    keep &= (owner > 0) & (area >= least)
    return np.asarray(keep[parts])


def _parts(usable: Mask) -> list[tuple[Mask, tuple[slice, slice]]]:
    """Connected parts, each within its bounding box."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(usable.astype(np.uint8), connectivity=4)
    cuts = [(slice(y, y + h), slice(x, x + w)) for x, y, w, h, _ in boxes[1:count].tolist()]
    return [(np.asarray(labels[cut] == k), cut) for k, cut in enumerate(cuts, start=1)]


@exact
def _grow(phase, usable, order):  # type: ignore[no-untyped-def]
    """Whole cycles to add to phase (H, W), wrapped, by a flood in bins of quality."""
    rows, cols = phase.shape
    heads = np.full(_BINS + 2, -1, np.int32)
    chain = np.empty(4 * rows * cols, np.int32)  # of steps, 4 * pixel + direction, in the same bin
    done = np.zeros((rows, cols), np.bool_)
    lowest, row, col = 0, 0, 0
    while True:
        done[row, col] = True
        for side in range(4):
            y, x = row + (side == 0) - (side == 1), col + (side == 2) - (side == 3)
            if y < 0 or x < 0 or y >= rows or x >= cols or done[y, x]:
                continue
            step = phase[row, col] - phase[y, x]
            place = int(2 * _BINS * abs(step - np.rint(step)))
            if not (usable[row, col] and usable[y, x]):
                place = _BINS + 1
            number = 4 * (row * cols + col) + side
            chain[number], heads[place] = heads[place], number
            lowest = min(lowest, place)
        while True:
            while lowest < len(heads) and heads[lowest] < 0:
                lowest += 1
            if lowest == len(heads):
                return
            number = heads[lowest]
            heads[lowest] = chain[number]
            side, pixel = number % 4, number // 4
            above, left = pixel // cols, pixel % cols
            row, col = above + (side == 0) - (side == 1), left + (side == 2) - (side == 3)
            if not done[row, col]:
                break
        order[row, col] = order[above, left] + np.rint(phase[above, left] - phase[row, col])
