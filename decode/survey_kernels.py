"""Compiled: usual values of what a survey saw (see survey)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import asked_by, outer_kernel
from .select_kernels import least

__all__ = ["usual_steps"]

Array = NDArray[Any]


@asked_by(
    "all",
    "float64[:, ::1], float64[:, ::1], float32[:, ::1], float64, int64, int64, float32[:, ::1], float64[::1]",
)
@outer_kernel
def usual_steps(
    lines: Array, below: Array, sigma: Array, apart: float, every: int, few: int, room: Array, usual: Array
) -> None:
    """usual (5,) = medians of the change of coordinates (R, W) from column to column, and from row to row,
    `below` being `apart` rows further on, of every so many columns; of second differences along lines, of the
    gradient and of sigma, of every `few` columns. room: (3, K), float32, for as many as are looked at."""
    rows, cols = lines.shape
    for down in range(2):
        count, over = 0, apart if down else 1.0
        for row in range(rows):
            for x in range(0, cols if down else cols - 1, every):
                there = below[row, x] if down else lines[row, x + 1]
                size = abs(there - lines[row, x]) / over
                if size < np.inf:
                    room[0, count] = size
                    count += 1
        usual[down] = least(room[0], count, 0.5)
    count = 0
    for row in range(rows):
        for x in range(0, cols - 2, few):
            before, here, after = lines[row, x], lines[row, x + 1], lines[row, x + 2]
            room[0, count] = abs(before - 2 * here + after)
            room[1, count] = 0.5 * abs(after - before)
            room[2, count] = sigma[row, x]
            count += 1
    for k in range(3):
        usual[2 + k] = least(room[k], count, 0.5)
