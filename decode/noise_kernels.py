"""Compiled: the variance that outliers do not move."""

import math
from typing import Any

from numpy.typing import NDArray

from .jit import fast_kernel, outer_kernel
from .select_kernels import least

__all__ = ["robust_variances"]

Array = NDArray[Any]

#: Deviations within which a residual counts, squared; rounds in which these are found.
_FAR, _ROUNDS = 16.0, 3
#: Deviation over median absolute value of a normal distribution; what a rounded median may lack, levels.
_OF_MEDIAN, _HALF_A_LEVEL = 1.4826, 0.5


@outer_kernel
def robust_variances(residual: Array, room: Array, variance: Array) -> None:
    """variance (L,) = mean squares of residuals (L, K) within 4 robust deviations, from the median absolute
    value (and half a level) and then from itself. room: (K,), float32."""
    count = residual.shape[1]
    for i in range(len(variance)):
        for x in range(count):
            room[x] = residual[i, x] * residual[i, x]
        found = (_OF_MEDIAN * math.sqrt(least(room, count, 0.5)) + _HALF_A_LEVEL) ** 2
        for _ in range(_ROUNDS):
            total, used = _sums(room, _FAR * found)
            found = total / used if used > 0 else found
        variance[i] = found


@fast_kernel
def _sums(square: Array, most: float) -> tuple[float, float]:
    total = count = 0.0
    for x in range(len(square)):
        total += square[x] if square[x] < most else 0.0
        count += 1.0 if square[x] < most else 0.0
    return total, count
