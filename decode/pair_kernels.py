"""Compiled: two periods of four quarter shifts, fitted and unwrapped in one go.

What fit_kernels, unwrap_kernels and flag_kernels hand to each other through the cache, a sixth of what all of
them take, stays in registers. The formulas are theirs.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import highest, quarter_fit
from .flag_kernels import MOVED
from .jit import apart_kernel
from .unwrap_kernels import CERTAIN, two_orders

__all__ = ["pair_tile"]

Array = NDArray[Any]
_ZERO, _ONE, _NONE = np.float32(0), np.float32(1), np.int32(0)


@apart_kernel
def pair_tile(
    n: int,
    frames: Array,
    index: Array,
    first: int,
    periods: Array,
    of_coarse: tuple[Any, Any],
    of_fine: tuple[Any, Any],
    blended: bool,
    guess: Any,
    limits: tuple[Any, Any, Any],
    a: Array,
    c: Array,
    s: Array,
    variance: Array,
    misfit: Array,
    coord: Array,
    spread: Array,
    agreement: Array,
    why: Array,
) -> tuple[Any, bool]:
    """fit_tile of the fine one of two periods, sequential_tile of both from one `guess` for all pixels (its
    misfit: agreement), and flag_fit of the coarse one. Returns the highest raw level, and whether any orders
    are close: few lines are written, and what these ask for is none of them.

    index (2, 4); of_coarse, of_fine: see fit_kernels.variance_of; limits: worst, read2, gain of flag_fit.
    """
    end = first + n
    i0, i1 = frames[index[0, 0], 0, first:end], frames[index[0, 1], 0, first:end]
    i2, i3 = frames[index[0, 2], 0, first:end], frames[index[0, 3], 0, first:end]
    k0, k1 = frames[index[1, 0], 0, first:end], frames[index[1, 1], 0, first:end]
    k2, k3 = frames[index[1, 2], 0, first:end], frames[index[1, 3], 0, first:end]
    coarse, fine, (worst, read2, gain) = periods[0], periods[1], limits
    slope = _ONE if blended else _ZERO
    top, close = i0[0], _ZERO
    for x in range(n):
        one, other = highest(i0[x], i1[x], i2[x], i3[x]), highest(k0[x], k1[x], k2[x], k3[x])
        most = one if one > other else other
        top = most if most > top else top
        f0, f1, f2, f3 = np.float32(i0[x]), np.float32(i1[x]), np.float32(i2[x]), np.float32(i3[x])
        level, _, _, about, before, left = quarter_fit(f0, f1, f2, f3, of_coarse[0], of_coarse[1])
        why[x] = MOVED if left > worst * (read2 + gain * (level if level > _ZERO else _ZERO)) else _NONE
        f0, f1, f2, f3 = np.float32(k0[x]), np.float32(k1[x]), np.float32(k2[x]), np.float32(k3[x])
        a[x], c[x], s[x], turn, own, misfit[x] = quarter_fit(f0, f1, f2, f3, of_fine[0], of_fine[1])
        variance[x] = own
        coord[x], spread[x], near, _, agreement[x], _ = two_orders(
            coarse, fine, slope, about, before, turn, own, guess
        )
        close += _ONE if near < CERTAIN else _ZERO
    return top, bool(close > _ZERO)
