"""Compiled: what blur has left of a fringe's contrast, pixel by pixel (see blur)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import linear_level, phase_of
from .jit import apart_kernel, inline_kernel, leaf_kernel, outer_kernel
from .wave_kernels import cosine_sine

__all__ = ["Swing", "Wave", "contrasts", "sinc", "swing_sums"]

Array = NDArray[Any]
_ONE = np.float32(1)
Wave = tuple[float, Array, Array]
"""A fringe: its period, frames (N,) and what they weigh in cosine and sine (2, N)."""
Swing = tuple[Any, Any, Any, Any, Any]
"""What blur leaves of a contrast, and sum and difference of both sidebands, of the fringe and of the one that
it is compared with (0: of none)."""


@outer_kernel
def contrasts(
    frames: Array,
    lut: Array | None,
    cols: Array,
    fine: Wave,
    white: int,
    black: int,
    coarse: Wave | None,
    coord: Array,
    below: Array,
    apart: int,
    flags: Array,
    spoilt: int,
    clip: float,
    wide: float,
    middle: float,
    reach: float,
    seen: Array,
) -> int:
    """Contrast of `fine` over that of `coarse` or of white - black, each over what cells and footprint leave.

    frames (N, R, W), through lut (if any); coord (R, W), `below`: `apart` rows further on. Into seen (4, K),
    for pixels at cols without `spoilt` flags and samples of `clip` or more, whose footprint is below `wide`
    periods and that lie within `reach` of the `middle`: what is left, place, footprint down and along.
    Returns how many. All lengths are pattern pixels.
    """
    count = 0
    for row in range(coord.shape[0]):
        for x in cols:
            place = coord[row, x]
            if flags[row, x] & spoilt or not abs(place - middle) < reach:
                continue
            down = abs(below[row, x] - place) / apart
            along = 0.25 * abs(coord[row, x + 2] - coord[row, x - 2])
            if not down + along < wide * fine[0]:
                continue
            top = _brightest(frames, row, x, fine[1])
            if coarse is None:
                top = max(top, float(frames[white, row, x]))
            else:
                top = max(top, _brightest(frames, row, x, coarse[1]))
            if top >= clip:
                continue
            whole = _whole(frames, lut, row, x, white, black, coarse, down, along)
            if not whole > 0:
                continue
            seen[0, count] = _contrast(frames, lut, row, x, fine, down, along) / whole
            seen[1, count], seen[2, count], seen[3, count] = place, down, along
            count += 1
    return count


@leaf_kernel
def _brightest(frames: Array, row: int, x: int, index: Array) -> float:
    top = 0.0
    for i in index:
        top = max(top, float(frames[i, row, x]))
    return top


@leaf_kernel
def _whole(
    frames: Array,
    lut: Array | None,
    row: int,
    x: int,
    white: int,
    black: int,
    coarse: Wave | None,
    down: float,
    along: float,
) -> float:
    if coarse is None:
        return 0.5 * float(
            linear_level(frames[white, row, x], lut) - linear_level(frames[black, row, x], lut)
        )
    return float(_contrast(frames, lut, row, x, coarse, down, along))


@leaf_kernel
def _contrast(
    frames: Array, lut: Array | None, row: int, x: int, fringe: Wave, down: float, along: float
) -> float:
    """Amplitude, over what cells and footprint leave of it."""
    period, index, weights = fringe
    c = s = 0.0
    for k in range(len(index)):
        level = linear_level(frames[index[k], row, x], lut)
        c += weights[0, k] * level
        s += weights[1, k] * level
    left = _sinc(1 / period) * _sinc(down / period) * _sinc(along / period)
    return math.hypot(c, s) / float(left)


def sinc(x: float) -> float:
    """np.sinc of one number, for which NumPy takes twenty times as long."""
    return math.sin(math.pi * x) / (math.pi * x) if x != 0 else 1.0


_sinc = inline_kernel(sinc)


@outer_kernel
def swing_sums(
    left: Array, place: Array, shift: Array, period: float, now: Swing, trial: Swing
) -> tuple[float, float]:
    """Least squares of contrasts `left` (K,) at places (K,), read with a `shift` (K,) that is set anew: sums
    of change * (left - model) and of change^2, the change being that from `now` to `trial`. All float32,
    lengths in pattern pixels.
    """
    along, square = _swing_sums(np.float32(period), left, place, shift, now, trial)
    return along, square


@apart_kernel
def _swing_sums(
    period: Any, left: Array, place: Array, shift: Array, now: Swing, trial: Swing
) -> tuple[float, float]:
    along = square = np.float32(0)
    for x in range(len(left)):
        cosine, sine = cosine_sine(place[x] - shift[x])
        shift[x] = period * phase_of(_ONE + now[1] * cosine, now[2] * sine)[0]
        cosine, sine = cosine_sine(place[x] - shift[x])
        model = _swung(now, cosine, sine)
        change = _swung(trial, cosine, sine) - model
        along += change * (left[x] - model)
        square += change * change
    return float(along), float(square)


@inline_kernel
def _swung(swing: Swing, cosine: Any, sine: Any) -> Any:
    fine = (_ONE + swing[1] * cosine) ** 2 + (swing[2] * sine) ** 2
    return swing[0] * np.sqrt(fine / ((_ONE + swing[3] * cosine) ** 2 + (swing[4] * sine) ** 2))
