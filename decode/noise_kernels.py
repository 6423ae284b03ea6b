"""Compiled: the variance that outliers do not move."""

from typing import Any

from numpy.typing import NDArray

from .jit import fast_kernel, outer_kernel

__all__ = ["sigma_clipped"]

Array = NDArray[Any]

#: Deviations within which a residual counts, squared; rounds in which these are found.
_FAR, _ROUNDS = 16.0, 3


@outer_kernel
def sigma_clipped(square: Array, variance: Array) -> None:
    """variance (L,) = mean of the squares (L, K) within 4 deviations, from a first guess, which is kept where
    there are none."""
    for i in range(len(variance)):
        for _ in range(_ROUNDS):
            total, count = _sums(square[i], _FAR * variance[i])
            if count > 0:
                variance[i] = total / count


@fast_kernel
def _sums(square: Array, most: float) -> tuple[float, float]:
    total = count = 0.0
    for x in range(len(square)):
        total += square[x] if square[x] < most else 0.0
        count += 1.0 if square[x] < most else 0.0
    return total, count
