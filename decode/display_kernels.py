"""Compiled: what the display shifts (see display) is taken off a tile of coordinates."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, leaf_kernel

__all__ = ["BEYOND", "BORDER", "MOST_LOST", "PER_CELL", "take_off_tile"]

Array = NDArray[Any]

#: Samples of the table per cell, cells that it reaches beyond the border.
PER_CELL = 8
BEYOND = 4
#: Share of the light lost beyond the border above which a pixel counts as off the pattern.
MOST_LOST = 0.03
#: Share of the border in a shift that sigma has to hold, pattern pixels.
BORDER = 1e-3
_OFF = np.int32(16)
_PER_CELL, _START = np.float32(PER_CELL), np.float32(BEYOND * PER_CELL)
_ZERO, _NEXT = np.float32(0), np.uint32(1)


@leaf_kernel
def take_off_tile(n: int, shown: Any, place: Array, spread: Array, at: Array, why: Array) -> None:
    """Take the shift off place (n,), add the border's part of it to the variance `spread`, flag lost light.

    shown = (shift, border, lost, low, high): tables (K,) float32 at coordinates -BEYOND + k / PER_CELL;
    between k = low and high the border does nothing. at: room for (n,).
    """
    shift, border, lost, low, high = shown
    last = len(shift) - 2
    if _near(n, np.float32(low), np.float32(high), place, at):
        for x in range(n):
            if at[x] >= 0 and at[x] <= last and not (low < at[x] < high):
                k = int(at[x])
                extra = border[k] + (at[x] - k) * (border[k + 1] - border[k])
                if abs(extra) > BORDER:
                    spread[x] += extra * extra
                if lost[k] > MOST_LOST:
                    why[x] |= _OFF
    _interpolate(n, np.float32(last), shift, place, at)


@fast_kernel
def _near(n: int, low: Any, high: Any, place: Array, at: Array) -> bool:
    """Place in the table; True if any is near the border."""
    for x in range(n):
        at[x] = place[x] * _PER_CELL + _START
    near = 0
    for x in range(n):
        near += (at[x] <= low) | (at[x] >= high)
    return near > 0


@fast_kernel
def _interpolate(n: int, last: Any, shift: Array, place: Array, at: Array) -> None:
    """Interpolated shift, 0 beyond the table; unsigned indices, as signed ones are checked."""
    for x in range(n):
        inside = (at[x] >= _ZERO) & (at[x] <= last)
        here = at[x] if inside else _ZERO
        k = np.uint32(here)
        change = shift[k] + (here - np.float32(k)) * (shift[k + _NEXT] - shift[k])
        place[x] -= change if inside else _ZERO
