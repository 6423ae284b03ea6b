"""Compiled: what the display shifts (see display) is taken off coordinates on their way into the maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel

__all__ = ["BEYOND", "BORDER", "MOST_LOST", "PER_CELL", "take_off_run"]

Array = NDArray[Any]

#: Samples of the table per cell, cells that it reaches beyond the border.
PER_CELL = 16
BEYOND = 4
#: Share of the light lost beyond the border above which a pixel counts as off the pattern.
MOST_LOST = 0.03
#: Share of the border in a shift that sigma has to hold, pattern pixels.
BORDER = 1e-3
_OFF = np.uint16(16)
_PER_CELL, _START = np.float32(PER_CELL), np.float32(BEYOND * PER_CELL)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF_WORD, _POSITIVE = np.int32(16), np.int32(0x7FFFFFFF)


@leaf_kernel
def take_off_run(
    n: int, shown: Any, floor: Any, place: Array, spread: Array, line: Array, sigma: Array, flags: Array
) -> None:
    """line = place less the shift; where the border adds to the variance `spread`, sigma, at least `floor`;
    lost light is flagged. All (n,).

    shown = (packed, unit, border, lost, low, high): tables at coordinates -BEYOND + k / PER_CELL; packed (K +
    1,) int32 = shift in the lower, its change up to k + 1 in the upper half word, both in `unit`, 0 at the
    end for what is beyond the table; border, lost (K,) float32; between k = low and high the border does
    nothing.
    """
    packed, unit, border, lost, low, high = shown
    last = len(border) - 2
    bounds = np.float32(low), np.float32(high), np.float32(last)
    if not _take_off(n, np.float32(unit), *bounds, packed, place, line):
        return
    for x in range(n):
        at = place[x] * _PER_CELL + _START
        if at >= 0 and at <= last and not (low < at < high):
            k = int(at)
            extra = border[k] + (at - k) * (border[k + 1] - border[k])
            if abs(extra) > BORDER:
                sigma[x] = max(np.sqrt(spread[x] + extra * extra), floor)
            if lost[k] > MOST_LOST:
                flags[x] |= _OFF


@apart_kernel
def _take_off(
    n: int, unit: Any, low: Any, high: Any, last: Any, packed: Array, place: Array, line: Array
) -> bool:
    """True if any pixel is near the border."""
    near = _ZERO
    for x in range(n):
        here = place[x] * _PER_CELL + _START
        near += _ONE if (here <= low) | (here >= high) else _ZERO
        here = here if (here >= _ZERO) & (here <= last) else last + _TWO
        entry = np.int32(here)
        # unsigned, as signed indices are checked; below 2^31, so that one instruction fetches a whole vector
        word = packed[np.uint32(entry & _POSITIVE)]
        shift, change = np.float32(np.int32(word << _HALF_WORD) >> _HALF_WORD), np.float32(word >> _HALF_WORD)
        line[x] = place[x] - unit * (shift + (here - np.float32(entry)) * change)
    return bool(near > _ZERO)
