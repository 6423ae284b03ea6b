"""How far what a pixel reads, a mean over its area, may be from what its centre sees.

Where the map bends or jumps inside of it the mean is not the centre's value. Neighbours show how much of that
there may be; as it is less than their noise but at edges, it is not taken off: it goes into the variance. (Of
light that falls or steps in it, see ends.)
"""

from typing import Any

import numpy as np

from optolever.kernels import inlined, kernel

from .pixelation import REACH

__all__ = ["BULK", "STEEP", "inside", "lesser", "windowed"]

#: Jumps and second differences are of the map from so many deviations on.
BULK = 2.5
#: Squared shares: of a second difference, what it shifts a mean; of a jump anywhere in the pixel.
_BEND, _JUMP = np.float32(1 / 24**2), np.float32(1 / 12)
#: Turns of a fringe in a pixel from which on it tells no place: a quarter of its contrast is left.
STEEP = 0.8


@kernel
def windowed(coord: Any, flags: Any, start: Any, stop: Any, out: Any) -> None:
    """Rows start..stop of a map (H, W) with REACH pixels on every side, (stop - start + 2 REACH,
    W + 2 REACH): NaN what is refused. Two pixels beyond the image are on the parabola through the last
    three."""
    rows, cols = coord.shape
    out[:] = np.float32(np.nan)
    first, left, right = start - REACH, REACH, REACH + cols - 1
    for y in range(max(first, 0), min(stop + REACH, rows)):
        _good_only(coord[y], flags[y], out[y - first, left : right + 1])
    top, end = -first, rows - 1 - first
    for k in (1, 2):
        for x in range(out.shape[1]):
            if rows > 2 and top >= k:
                out[top - k, x] = _parabola(out[top, x], out[top + 1, x], out[top + 2, x], k)
            if rows > 2 and end + k < len(out):
                out[end + k, x] = _parabola(out[end, x], out[end - 1, x], out[end - 2, x], k)
        for y in range(len(out) if cols > 2 else 0):
            out[y, left - k] = _parabola(out[y, left], out[y, left + 1], out[y, left + 2], k)
            out[y, right + k] = _parabola(out[y, right], out[y, right - 1], out[y, right - 2], k)


@kernel
def _good_only(line: Any, flags: Any, out: Any) -> None:
    for x in range(line.size):
        out[x] = line[x] if flags[x] == 0 else np.float32(np.nan)


@inlined
def _parabola(end: Any, next_: Any, third: Any, k: Any) -> Any:
    """k beyond the end of three values, 1 or 2."""
    one = np.float32(3) * (end - next_) + third
    return one if k == 1 else np.float32(3) * (one - end) + next_


@kernel
def inside(here: Any, window: Any, k: Any, stripe: Any, placed: Any, total: Any) -> None:
    """What may be inside of the pixels of a line (W,) joins their variance.

    Of u(s) = u + g s + s H s / 2 the mean over a pixel is u + (H_xx + H_yy) / 24; of a jump J anywhere in it
    the variance is J^2 / 12.
    here: the line. window: see `windowed`, k: the line's row in it. stripe: the finest one of a code
    (infinite: no code), as parts of others on a pixel move what it reads, px. placed: the line without
    pixelation, which its neighbours have, too.
    """
    zero, two = np.float32(0), np.float32(2)
    # of second differences along both axes, and of both jumps, over the variance of a place
    by_noise = np.float32(20 * BULK**2)
    size, at = total.size, REACH
    # views of one length: an index that only counts up is known not to wrap round
    line = window[k]
    left, right = line[at - 1 : at - 1 + size], line[at + 1 : at + 1 + size]
    left_2, right_2 = line[at - 2 : at - 2 + size], line[at + 2 : at + 2 + size]
    up, down = window[k - 1, at : at + size], window[k + 1, at : at + size]
    up_2, down_2 = window[k - 2, at : at + size], window[k + 2, at : at + size]
    for x in range(size):
        u = here[x]
        one_x, one_y = right[x] - left[x], down[x] - up[x]
        two_x, two_y = right_2[x] - left_2[x], down_2[x] - up_2[x]
        bend = left[x] + right[x] + up[x] + down[x] - two * two * u
        # J of g x + J sign(x) / 2, by differences over 2 and 4 pixels
        jump_x, jump_y = two * one_x - two_x, two * one_y - two_y
        # along either axis by itself: a pixel that is refused on one says nothing of the other
        jump_x, jump_y = jump_x if jump_x == jump_x else zero, jump_y if jump_y == jump_y else zero
        noise = by_noise * (total[x] + (placed[x] - u) * (placed[x] - u))
        jumps = max(jump_x * jump_x + jump_y * jump_y - noise, zero)
        bends = max(bend * bend - noise, zero)
        least_x, least_y = lesser(u - left[x], right[x] - u), lesser(u - up[x], down[x] - u)
        over = max(least_x + least_y - stripe, zero)
        total[x] += (bends * _BEND if bends == bends else zero) + (jumps + over * over) * _JUMP


@inlined
def lesser(one: Any, other: Any) -> Any:
    """The lesser size of two changes; of one where the other is refused (NaN), 0 of none."""
    one, other = abs(one), abs(other)
    least = one if (one < other) | (other != other) else other
    return least if least == least else np.float32(0)
