"""Compiled: the value that a share of others does not exceed, for kernels that ask for it amid their work."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from .jit import called_kernel, fast_kernel

__all__ = ["least"]

Array = NDArray[Any]
_ZERO, _ONE, _INF = np.float32(0), np.float32(1), np.float32(np.inf)


def _float_of(typing: Any, bits: Any) -> Any:
    """The float32 of an integer's lower 32 bits."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], ir.IntType(32)), ir.FloatType())

    return types.float32(types.int64), generate


_of_bits: Any = intrinsic(_float_of)


@called_kernel
def least(values: Array, count: int, share: float) -> float:
    """The least of values[:count] >= 0 (float32) that this share of them does not exceed, as sample.quantile;
    0 of none.

    Bit by bit from the first, as such numbers are in the order of their bits: to count thirty times goes in
    whole vectors, while a processor guesses every comparison of a selection wrong half the time.
    """
    if count == 0:
        return 0.0
    wanted, found = np.float32(int(share * (count - 1))), 0
    for bit in range(30, -1, -1):
        limit = _of_bits(found + (1 << bit))
        if limit <= _INF and _below(values, count, limit) <= wanted:
            found += 1 << bit
    return float(_of_bits(found))


@fast_kernel
def _below(values: Array, count: int, limit: Any) -> Any:
    """How many of values[:count] are less; counted in float32, as numba's integer sums are int64."""
    some = _ZERO
    for x in range(count):
        some += _ONE if values[x] < limit else _ZERO
    return some
