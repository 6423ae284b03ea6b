"""Compiled: what blur has left of a fringe's contrast, pixel by pixel (see blur)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import linear_level
from .jit import apart_kernel, asked_by, inline_kernel, leaf_kernel, outer_kernel
from .phase_kernels import phase_of
from .select_kernels import least
from .wave_kernels import cosine_sine

__all__ = ["Looked", "Swing", "Wave", "contrasts", "digest", "sinc", "swing_sums"]

Array = NDArray[Any]
_ONE = np.float32(1)
#: Distance from the middle of its quartiles, in that between them, at which a contrast lies far from them.
_FAR, _SLIGHT = 3.0, 1e-3
Wave = tuple[float, Array, Array]
"""A fringe: its period, frames (N,) and what they weigh in offset, cosine and sine (3, N)."""
Swing = tuple[Any, Any, Any, Any, Any]
"""What blur leaves of a contrast, and sum and difference of both sidebands, of the fringe and of the one that
it is compared with (0: of none)."""


class Looked(NamedTuple):
    """Where contrasts are read: frames (N, R, W), through lut (if any), at cols; coord (R, W), `below`:
    `apart` rows further on; flags (R, W). Pixels with `spoilt` flags, samples of `clip` or more, a footprint
    of `wide` cells or more, or not within `reach` of the `middle` are left out. Lengths in pattern pixels."""

    frames: Array
    lut: Array | None
    cols: Array
    coord: Array
    below: Array
    apart: int
    flags: Array
    spoilt: int
    clip: float
    wide: float
    middle: float
    reach: float


@outer_kernel
def contrasts(
    at: Looked, fine: Wave, white: int, black: int, coarse: Wave | None, room: Array, seen: Array
) -> int:
    """Contrast of `fine` over that of `coarse` or of white - black (-1: not shown), each over what cells and
    footprint leave; and over its own offset.

    Into seen (7, K): the former (1 where nothing is compared), place, footprint down and along, the latter,
    where in the image, -1 to 1 along rows and columns. Returns of how many pixels. room: (2, 3).
    """
    count, found, fit = 0, room[0], room[1]
    rows, cols = at.coord.shape[0], len(at.cols)
    fine_cell = _sinc(1 / fine[0])
    coarse_cell = 1.0 if coarse is None else _sinc(1 / coarse[0])
    for row in range(rows):
        for i in range(cols):
            x = at.cols[i]
            if not _usable(at, row, x, found):
                continue
            top = _fit(at, row, x, fine, fit)
            height, offset = math.sqrt(fit[1] ** 2 + fit[2] ** 2), fit[0]
            part = height / (fine_cell * _sinc_near(found[1] / fine[0]) * _sinc_near(found[2] / fine[0]))
            whole = part
            if coarse is not None:
                top = max(top, _fit(at, row, x, coarse, fit))
                left = coarse_cell * _sinc_near(found[1] / coarse[0]) * _sinc_near(found[2] / coarse[0])
                whole = math.sqrt(fit[1] ** 2 + fit[2] ** 2) / left
            elif white >= 0:
                whole = 0.5 * (_level(at, white, row, x) - _level(at, black, row, x))
                top = max(top, float(at.frames[white, row, x]))
            if top >= at.clip or not whole > 0 or not offset > 0:
                continue
            seen[0, count] = part / whole
            seen[1, count], seen[2, count], seen[3, count] = found[0], found[1], found[2]
            seen[4, count] = height / offset
            seen[5, count], seen[6, count] = _from_end_to_end(row, rows), _from_end_to_end(i, cols)
            count += 1
    return count


@asked_by("fringes", "float64[:, :], float32[:, ::1], float64[::1]")
@outer_kernel
def digest(seen: Array, room: Array, usual: Array) -> int:
    """Of contrasts (4, K): medians of the footprint down and along, quartiles of what is left, and its mean
    without what lies far from these: usual (6,). Into room (2, K), float32: what is not left out, and its
    place in its cell; returns of how many pixels."""
    left, count, used, total = seen[0], seen.shape[1], 0, 0.0
    for k in range(5):
        line = 2 + k if k < 2 else 0
        for x in range(count):
            room[0, x] = seen[line, x]
        usual[k] = least(room[0], count, 0.5 if k < 2 else 0.25 * (k - 1))
    middle, far = 0.5 * (usual[2] + usual[4]), _FAR * (usual[4] - usual[2]) + _SLIGHT
    for x in range(count):
        if abs(left[x] - middle) <= far:
            room[0, used], room[1, used] = left[x], seen[1, x] - np.rint(seen[1, x])
            total += left[x]
            used += 1
    usual[5] = total / max(used, 1)
    return used


@leaf_kernel
def _from_end_to_end(i: int, count: int) -> float:
    return 2 * i / (count - 1) - 1 if count > 1 else -1.0


@leaf_kernel
def _usable(at: Looked, row: int, x: int, found: Array) -> bool:
    """found = place, footprint down and along."""
    place = at.coord[row, x]
    if at.flags[row, x] & at.spoilt or not abs(place - at.middle) < at.reach:
        return False
    down = abs(at.below[row, x] - place) / at.apart
    along = 0.25 * abs(at.coord[row, x + 2] - at.coord[row, x - 2])
    found[0], found[1], found[2] = place, down, along
    return bool(down + along < at.wide)


@leaf_kernel
def _fit(at: Looked, row: int, x: int, fringe: Wave, found: Array) -> float:
    """found = offset, cosine and sine; returns the brightest raw sample."""
    index, weights = fringe[1], fringe[2]
    a = c = s = top = 0.0
    for k in range(len(index)):
        level = _level(at, index[k], row, x)
        top = max(top, float(at.frames[index[k], row, x]))
        a += weights[0, k] * level
        c += weights[1, k] * level
        s += weights[2, k] * level
    found[0], found[1], found[2] = a, c, s
    return top


@leaf_kernel
def _level(at: Looked, i: int, row: int, x: int) -> float:
    return float(linear_level(at.frames[i, row, x], at.lut))


@leaf_kernel
def _sinc_near(x: float) -> float:
    """sinc(x) for |x| < 0.7, good to 2e-6."""
    q = (math.pi * x) ** 2
    return 1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72 * (1 - q / 110))))


def sinc(x: float) -> float:
    """np.sinc of one number, for which NumPy takes twenty times as long."""
    return math.sin(math.pi * x) / (math.pi * x) if x != 0 else 1.0


_sinc = inline_kernel(sinc)


@asked_by(
    "fringes",
    "float32[::1], float32[::1], float32[::1], float64, UniTuple(float32, 5), UniTuple(float32, 5)",
)
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
