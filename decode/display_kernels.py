"""Compiled: what the display shifts (see display) is taken off a tile of coordinates."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel

__all__ = ["BEYOND", "BORDER", "MOST_LOST", "PER_CELL", "take_off_tile"]

Array = NDArray[Any]

#: Samples of the table per cell, cells that it reaches beyond the border.
PER_CELL = 16
BEYOND = 4
#: Share of the light lost beyond the border above which a pixel counts as off the pattern.
MOST_LOST = 0.03
#: Share of the border in a shift that sigma has to hold, pattern pixels.
BORDER = 1e-3
_OFF = np.int32(16)
_PER_CELL, _START = np.float32(PER_CELL), np.float32(BEYOND * PER_CELL)
_ZERO, _ONE = np.float32(0), np.float32(1)
_HALF_WORD = np.int32(16)


@leaf_kernel
def take_off_tile(
    n: int, shown: Any, place: Array, spread: Array, at: Array, word: Array, why: Array
) -> None:
    """Take the shift off place (n,), add the border's part of it to the variance `spread`, flag lost light.

    shown = (packed, unit, border, lost, low, high): tables at coordinates -BEYOND + k / PER_CELL; packed (K +
    1,) int32 = shift in the lower, its change up to k + 1 in the upper half word, both in `unit`, 0 at the
    end for what is beyond the table; border, lost (K,) float32; between k = low and high the border does
    nothing. at, word (int32): room for (n,).
    """
    packed, unit, border, lost, low, high = shown
    last = len(border) - 2
    if _look(n, np.float32(low), np.float32(high), np.float32(last), place, at, word):
        for x in range(n):
            if at[x] >= 0 and at[x] <= last and not (low < at[x] < high):
                k = int(at[x])
                extra = border[k] + (at[x] - k) * (border[k + 1] - border[k])
                if abs(extra) > BORDER:
                    spread[x] += extra * extra
                if lost[k] > MOST_LOST:
                    why[x] |= _OFF
    _interpolate(n, np.float32(unit), packed, word, at, place)


@apart_kernel
def _look(n: int, low: Any, high: Any, last: Any, place: Array, at: Array, word: Array) -> bool:
    """Place in the table, and the number of its entry; True if any is near the border."""
    near = _ZERO
    for x in range(n):
        here = place[x] * _PER_CELL + _START
        at[x] = here
        inside = (here >= _ZERO) & (here <= last)
        word[x] = np.int32(here if inside else last + _ONE + _ONE)
        near += _ONE if (here <= low) | (here >= high) else _ZERO
    return bool(near > _ZERO)


@apart_kernel
def _interpolate(n: int, unit: Any, packed: Array, entry: Array, at: Array, place: Array) -> None:
    for x in range(n):
        word = packed[np.uint32(entry[x])]  # unsigned, as signed indices are checked
        shift = np.float32(np.int32(word << _HALF_WORD) >> _HALF_WORD)
        change = np.float32(word >> _HALF_WORD)
        place[x] -= unit * (shift + (at[x] - np.floor(at[x])) * change)
