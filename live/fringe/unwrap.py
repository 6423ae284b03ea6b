"""Spatial phase unwrapping of a displacement, where adjacent cells differ by nearly half a period.

Quality-guided flood fill, smoothest cells first, by second differences of the wrapped phase (Herraez et al.,
Applied Optics 41:7437, 2002): in plain order it would propagate a wrong period through a dent."""

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Cells, Mask
from optolever.kernels import exact, kernel

__all__ = ["TORN", "beside_tears", "torn", "unwrapped"]

TORN = 0.4  # turns between neighbouring cells
_BUCKETS = 64  # classes of roughness
_CALM = 15  # cells: the flood starts at the middle of the smoothest square of that side


def torn(displacement: Cells, good: Mask) -> bool:
    """Whether adjacent good cells differ by more than `TORN` turns; displacement (2, R, C), less that at
    rest."""
    return bool(_tears(displacement, good).any())


def beside_tears(displacement: Cells) -> Mask:
    """Cells within two cells of a tear."""
    found = _tears(displacement, np.ones(displacement.shape[1:], np.bool_))
    return np.asarray(cv2.dilate(found, np.ones((5, 5), np.uint8)) > 0)


def unwrapped(displacement: Cells, good: Mask, rim: Mask) -> tuple[Cells, Mask]:
    """The unwrapped displacement (2, R, C), its median along the rim within half a turn of rest, and the good
    cells reached by the flood. Other cells are unchanged."""
    if not (good & rim).any():
        return displacement, good
    rough = np.maximum(*(_roughness(one, good) for one in displacement))
    calm = cv2.blur(rough.astype(np.float32), (_CALM, _CALM))
    row, col = np.unravel_index(int(np.argmin(np.where(good, calm, np.inf))), good.shape)
    reached = np.zeros(good.shape, np.bool_)
    whole = displacement.copy()
    for one in whole:
        reached[:] = False
        _flood(one, good, rough, row, col, reached)
        if (reached & rim).any():
            one -= np.rint(np.median(one[reached & rim]))
    return np.where(reached, whole, displacement), good & reached


def _tears(displacement: Cells, good: Mask) -> NDArray[np.uint8]:
    """1 in the second cell of a tear."""
    found = np.zeros(good.shape, np.uint8)
    _torn(displacement, good, found)
    return found


@kernel
def _torn(displacement, good, found):  # type: ignore[no-untyped-def]
    """See `_tears`."""
    most = np.float32(TORN)
    for k in range(2):
        for i in range(good.shape[0]):
            for j in range(good.shape[1]):
                here, left, above = displacement[k, i, j], max(j - 1, 0), max(i - 1, 0)
                along = (abs(here - displacement[k, i, left]) > most) & good[i, left]
                down = (abs(here - displacement[k, above, j]) > most) & good[above, j]
                found[i, j] |= (along | down) & good[i, j]


def _roughness(d: Cells, good: Mask) -> NDArray[np.uint8]:
    """Second differences of the wrapped phase in classes; the last one: half a turn and more, or adjacent to
    a cell that is not good."""
    whole = cv2.erode(good.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
    bend = np.zeros(d.shape, np.float32)
    for axis, inner in ((1, np.s_[:, 1:-1]), (0, np.s_[1:-1])):
        step = np.diff(d, axis=axis)
        bend[inner] += np.abs(np.diff(step - np.rint(step), axis=axis))
    rank = np.where(whole, np.minimum(2 * bend, 1), 1) * (_BUCKETS - 1)
    return np.pad(rank[1:-1, 1:-1].astype(np.uint8), 1, mode="edge")


@exact
def _flood(d, good, rough, row, col, reached):  # type: ignore[no-untyped-def]
    """Unwraps d in place from a cell, the smoothest first: one linked list per class of roughness."""
    rows, cols = d.shape
    head, after = np.full(_BUCKETS, -1, np.int32), np.full(rows * cols, -1, np.int32)
    reached[row, col] = True
    head[0] = row * cols + col
    lowest = 0
    while lowest < _BUCKETS:
        at = head[lowest]
        if at < 0:
            lowest += 1
            continue
        head[lowest] = after[at]
        i, j = at // cols, at % cols
        for k in range(4):
            y, x = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
            if y < 0 or x < 0 or y >= rows or x >= cols or reached[y, x] or not good[y, x]:
                continue
            d[y, x] += np.rint(d[i, j] - d[y, x])
            reached[y, x] = True
            rank = rough[y, x]
            after[y * cols + x] = head[rank]
            head[rank] = y * cols + x
            lowest = min(lowest, rank)
