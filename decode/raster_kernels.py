"""Compiled: sums of a raster of spots over rows and over columns around the brightest frame."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import inline_kernel, kernel

__all__ = ["raster_rows"]

Array = NDArray[Any]


@inline_kernel
def _linear(lut: Any, raw: Any) -> Any:
    """Level of a sample."""
    return lut[int(raw)] if len(lut) > 0 else np.float32(raw)


@kernel
def raster_rows(
    frames: Array,
    lut: Array,
    clip: float,
    full: float,
    start: int,
    stop: int,
    index: Array,
    half: int,
    away: int,
    along_u: Array,
    along_v: Array,
    rival: Array,
) -> None:
    """Sums over 2 half + 1 rows of index (R, C) into along_u (C, H, W), over as many columns into along_v
    (R, H, W); `full` where one of the samples is clipped. rival (H, W): brightest sample that is more than
    `away` places off along either axis.
    """
    cols = frames.shape[2]
    down, across = index.shape
    top, other = np.empty(cols, np.float32), np.empty(cols, np.float32)
    at_row, at_col = np.empty(cols, np.int32), np.empty(cols, np.int32)
    for row in range(start, stop):
        top[:], other[:], at_row[:], at_col[:] = -np.inf, -np.inf, 0, 0
        for r in range(down):
            for c in range(across):
                line = frames[index[r, c], row]
                for x in range(cols):
                    level = _linear(lut, line[x])
                    if level > top[x]:
                        top[x], at_row[x], at_col[x] = level, r, c
        for r in range(down):
            for c in range(across):
                line = frames[index[r, c], row]
                for x in range(cols):
                    level = _linear(lut, line[x])
                    if level > other[x] and max(abs(r - at_row[x]), abs(c - at_col[x])) > away:
                        other[x] = level
        for x in range(cols):
            rival[row, x] = other[x]
            # as many everywhere: the sum of what does not vary has to be the same
            low_row = min(max(at_row[x] - half, 0), down - 2 * half - 1)
            low_col = min(max(at_col[x] - half, 0), across - 2 * half - 1)
            for c in range(across):
                total, clipped = 0.0, False
                for r in range(low_row, low_row + 2 * half + 1):
                    raw = frames[index[r, c], row, x]
                    clipped |= raw >= clip
                    total += _linear(lut, raw)
                along_u[c, row, x] = full if clipped else total
            for r in range(down):
                total, clipped = 0.0, False
                for c in range(low_col, low_col + 2 * half + 1):
                    raw = frames[index[r, c], row, x]
                    clipped |= raw >= clip
                    total += _linear(lut, raw)
                along_v[r, row, x] = full if clipped else total
