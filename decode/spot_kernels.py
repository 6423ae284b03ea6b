"""Compiled: sums of a raster of spots over rows and over columns around the brightest frame."""

from typing import Any

import numpy as np

from optolever.kernels import exact, inlined, kernel

__all__ = ["sum_rows"]


@inlined
def _linear(table: Any, value: Any) -> Any:
    return table[np.int64(value)] if table.size > 0 else np.float32(value)


@kernel
def _brightest(line: Any, place: Any, top: Any, at: Any) -> None:
    """Of a further frame: where it is the brightest so far."""
    for x in range(line.size):
        at[x] = place if line[x] > top[x] else at[x]
        top[x] = max(line[x], top[x])


@kernel
def _second(line: Any, r: Any, c: Any, away: Any, row: Any, col: Any, other: Any) -> None:
    """Of a further frame at (r, c): where it is the brightest of those more than `away` places off."""
    for x in range(line.size):
        far = (abs(row[x] - r) > away) | (abs(col[x] - c) > away)
        v = line[x] if far else line[x] * 0
        other[x] = max(v, other[x])


@exact
def sum_rows(
    raw: Any,
    table: Any,
    clip: Any,
    full: Any,
    start: Any,
    stop: Any,
    index: Any,
    half: Any,
    away: Any,
    sums: Any,
    rival: Any,
) -> None:
    """Sums over 2 half + 1 rows of index (R, C) into sums[:C], over as many columns into sums[C:]; `full`
    where one of the samples is saturated. rival: brightest sample that is more than `away` places off along
    either axis."""
    width, down, across = raw.shape[2], index.shape[0], index.shape[1]
    top, other = np.empty(width, raw.dtype), np.empty(width, raw.dtype)
    at, row_of, col_of = np.empty(width, np.int16), np.empty(width, np.int16), np.empty(width, np.int16)
    for row in range(start, stop):
        r = row - start
        top[:], at[:], other[:] = raw[index[0, 0], row], 0, 0
        for k in range(1, index.size):
            _brightest(raw[index[k // across, k % across], row], np.int16(k), top, at)
        for x in range(width):
            row_of[x], col_of[x] = at[x] // across, at[x] % across
        for k in range(index.size):
            i, j = k // across, k % across
            _second(raw[index[i, j], row], np.int16(i), np.int16(j), np.int16(away), row_of, col_of, other)
        for x in range(width):
            rival[r, x] = _linear(table, other[x])
            # as many everywhere: the sum of what does not vary has to be the same
            low_row = min(max(row_of[x] - half, 0), down - 2 * half - 1)
            low_col = min(max(col_of[x] - half, 0), across - 2 * half - 1)
            for c in range(across):
                total, over = np.float32(0), False
                for k in range(low_row, low_row + 2 * half + 1):
                    value = raw[index[k, c], row, x]
                    over |= value >= clip
                    total += _linear(table, value)
                sums[c, r, x] = full if over else total
            for k in range(down):
                total, over = np.float32(0), False
                for c in range(low_col, low_col + 2 * half + 1):
                    value = raw[index[k, c], row, x]
                    over |= value >= clip
                    total += _linear(table, value)
                sums[across + k, r, x] = full if over else total
