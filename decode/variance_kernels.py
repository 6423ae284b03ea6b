"""Compiled: variances that outliers do not move, by level."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, asked_by, fast_kernel, leaf_kernel, outer_kernel
from .select_kernels import least

__all__ = ["OF_MEDIAN", "variances_by_level"]

Array = NDArray[Any]

#: Deviations within which a residual counts, squared; rounds in which these are found.
_FAR, _ROUNDS = 16.0, 3
#: Deviation over median absolute value of a normal distribution; what a rounded median may lack, levels.
OF_MEDIAN, _HALF_A_LEVEL = 1.4826, 0.5
_ZERO, _ONE, _INF = np.float32(0), np.float32(1), np.float32(np.inf)


@asked_by(
    "all", "float32[::1], float32[::1], float32[::1], float32[:, ::1], int64[::1], float64[::1], float64[::1]"
)
@outer_kernel
def variances_by_level(
    level: Array, residual: Array, dither: Array, room: Array, counts: Array, mean: Array, variance: Array
) -> None:
    """Of residuals (K,) as many in each of L groups, from low to high level (K,): mean level (L,) and mean
    square (L,) of what lies within 4 robust deviations, from the median absolute value (and half a level)
    and then from itself.

    dither (K,) is added to levels before they are sorted, into `counts` steps. room: (3, K), all float32.
    """
    levels, residuals, square = room[0], room[1], room[2]
    if len(mean) > 1:
        _sort_by_level(level, residual, dither, square, counts, levels, residuals)
        _in_groups(levels, residuals, square, mean, variance)
    else:
        _in_groups(level, residual, square, mean, variance)


@leaf_kernel
def _in_groups(levels: Array, residuals: Array, square: Array, mean: Array, variance: Array) -> None:
    """Of residuals in the order of their levels."""
    each = len(levels) // len(mean)
    for i in range(len(mean)):
        total, start = 0.0, i * each
        for x in range(each):
            here = residuals[start + x]
            square[x] = here * here
            total += levels[start + x]
        mean[i], variance[i] = total / each, _robust(square[:each])


@leaf_kernel
def _sort_by_level(
    level: Array, residual: Array, dither: Array, place: Array, counts: Array, levels: Array, residuals: Array
) -> None:
    """levels, residuals (K,) = these from low to high level, of equal steps as they come."""
    steps, first = len(counts), 0
    _places(level, dither, np.float32(steps - 1), place)
    counts[:] = 0
    for x in range(len(level)):
        counts[int(place[x])] += 1
    for k in range(steps):
        count, counts[k] = counts[k], first
        first += count
    for x in range(len(level)):
        k = int(place[x])
        levels[counts[k]], residuals[counts[k]] = level[x], residual[x]
        counts[k] += 1


@apart_kernel
def _places(level: Array, dither: Array, last: Any, place: Array) -> None:
    """Dithered levels (K,), from 0 for the least to `last` for the largest."""
    low, high = _INF, -_INF
    for x in range(len(level)):
        here = level[x] + dither[x]
        low = here if here < low else low
        high = here if here > high else high
        place[x] = here
    scale = last / (high - low) if high > low else _ZERO
    for x in range(len(level)):
        here = (place[x] - low) * scale
        place[x] = here if here < last else last


@leaf_kernel
def _robust(square: Array) -> float:
    """Mean of squares (K,) but of outliers, see variances_by_level."""
    found = (OF_MEDIAN * math.sqrt(least(square, len(square), 0.5)) + _HALF_A_LEVEL) ** 2
    for _ in range(_ROUNDS):
        total, used = _sums(square, np.float32(_FAR * found))
        found = total / used if used > 0 else found
    return found


@fast_kernel
def _sums(square: Array, most: Any) -> tuple[float, float]:
    total = count = _ZERO
    for x in range(len(square)):
        within = _ONE if square[x] < most else _ZERO  # a factor: branches are not made vectors of
        total += within * square[x]
        count += within
    return float(total), float(count)
