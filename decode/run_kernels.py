"""Compiled: runs of pixels, and how much each gathers at whole cells (see gathering)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, leaf_kernel, outer_kernel
from .wave_kernels import cosine_sine

__all__ = ["LINES", "RUN", "gather_runs", "least_gradients", "steps_along"]

Array = NDArray[Any]

#: Pixels of a run, lines of room for it.
RUN, LINES = 32, 6
#: Mean phasor up to which a run of pixels samples cells evenly; gradient below which it is flat.
_EVEN, _FLAT = 0.3, 0.05
#: By how much a run may leave its parabola besides noise, pattern pixels.
_ROUGH = 0.75
_ONE, _TWO, _HALF = np.float32(1), np.float32(2), np.float32(RUN // 2)


@outer_kernel
def gather_runs(
    starts: Array,
    step: int,
    coord: Array,
    sigma: Array,
    flags: Array,
    basis: Array,
    room: Array,
    told: Array,
) -> int:
    """By how much each run of RUN pixels gathers at whole cells, and its gradient, into told (2, K).

    Runs of maps that lie flat (pixels,) begin at `starts` and go in steps of `step`; those with a flag, not
    smooth, or that do not sample the cells evenly are left out: the number of the rest is returned. basis:
    orthonormal, of the parabolas over a run (3, RUN); room: (LINES, RUN), all float32.
    """
    run, fit, spread = room[0], room[1], room[2]
    count = 0
    for start in starts:
        if not _fetch(start, step, coord, sigma, flags, run, spread):
            continue
        noise = _middle(spread)
        gradient, rough = _smooth(run, basis, fit)
        if gradient <= _FLAT or not rough < _ROUGH + 4 * noise:
            continue
        cosine, sine, twice, twice_sine = _wave(fit, room[3], room[4])
        if math.hypot(cosine, sine) >= _EVEN or math.hypot(twice, twice_sine) >= _EVEN:
            continue
        if not _like_stairs(run, fit, room[4], noise):
            continue
        gathered = _wave(run, room[3], room[5])[0] - cosine
        told[0, count] = gathered * math.exp(min(2 * (math.pi * noise) ** 2, 3.0))
        told[1, count] = gradient
        count += 1
    return count


@leaf_kernel
def _fetch(
    start: int, step: int, coord: Array, sigma: Array, flags: Array, run: Array, spread: Array
) -> bool:
    """Coordinates, less a whole number, and sigmas of a run; False if a pixel of it is flagged."""
    why = np.uint16(0)
    for x in range(RUN):
        why |= flags[start + x * step]
    if why != 0:
        return False
    whole = np.rint(coord[start])
    for x in range(RUN):
        run[x] = coord[start + x * step] - whole
        spread[x] = sigma[start + x * step]
    return True


@fast_kernel
def _middle(values: Array) -> float:
    """The upper one of the two in the middle, of RUN values: the least that half of them do not exceed."""
    middle = np.float32(np.inf)
    for x in range(RUN):
        value, count = values[x], np.float32(0)
        for y in range(RUN):
            count += _ONE if values[y] <= value else np.float32(0)
        if count > _HALF and value < middle:
            middle = value
    return float(middle)


@fast_kernel
def _smooth(run: Array, basis: Array, fit: Array) -> tuple[float, float]:
    """fit (RUN,) = the parabola nearest to the run; its mean gradient, and how far the run leaves it."""
    a = b = c = np.float32(0)
    for x in range(RUN):
        a += basis[0, x] * run[x]
        b += basis[1, x] * run[x]
        c += basis[2, x] * run[x]
    rough = total = np.float32(0)
    for x in range(RUN):
        fit[x] = a * basis[0, x] + b * basis[1, x] + c * basis[2, x]
        rough = max(rough, abs(run[x] - fit[x]))
    for x in range(RUN - 1):
        total += abs(fit[x + 1] - fit[x])
    return float(total) / (RUN - 1), float(rough)


@fast_kernel
def _wave(places: Array, cosines: Array, sines: Array) -> tuple[float, float, float, float]:
    """Cosines and sines of places, turns, and the means of both, and of those of twice the places."""
    for x in range(RUN):
        cosines[x], sines[x] = cosine_sine(places[x])
    real = imag = twice = twice_imag = np.float32(0)
    for x in range(RUN):
        real += cosines[x]
        imag += sines[x]
        twice += _ONE - _TWO * sines[x] * sines[x]
        twice_imag += _TWO * sines[x] * cosines[x]
    return float(real) / RUN, float(imag) / RUN, float(twice) / RUN, float(twice_imag) / RUN


@fast_kernel
def _like_stairs(run: Array, fit: Array, wave: Array, noise: float) -> bool:
    """Whether what a fit leaves is stairs and noise: of a sawtooth its cells' wave holds 61 %, of a bend
    less.
    """
    along = weight = square = np.float32(0)
    for x in range(RUN):
        rest = run[x] - fit[x]
        along += rest * wave[x]
        weight += wave[x] * wave[x]
        square += rest * rest
    stairs = float(along) * float(along) / float(weight)
    most = RUN * noise * noise * (1 + 5 * math.sqrt(2 / RUN))
    return bool(float(square) - stairs <= stairs + most)


@outer_kernel
def steps_along(coord: Array, starts: Array, step: int, length: int, apart: int, told: Array) -> int:
    """Sizes of steps between neighbours, every `apart` pixels of lines of `length` that begin at `starts` of
    a flat map and go in steps of `step`: into told (K,), the number of those that are known is returned."""
    count = 0
    for start in starts:
        for x in range(apart, length, apart):
            size = abs(coord[start + x * step] - coord[start + (x - 1) * step])
            if size < np.inf:
                told[count] = size
                count += 1
    return count


@outer_kernel
def least_gradients(
    coord: Array, starts: Array, step: int, length: int, every: int, reach: int, told: Array
) -> None:
    """Sizes of the gradient along such lines, every so many pixels, over `reach` pixels on that side where it
    is less, as pixels there may be wrong; 0: none. Into told (K,)."""
    count = 0
    for start in starts:
        for x in range(0, length, every):
            least = np.inf
            for far in (max(x - reach, 0), min(x + reach, length - 1)):
                apart = abs(far - x)
                if apart > reach // 2:
                    least = min(least, _size(coord[start + far * step] - coord[start + x * step]) / apart)
            told[count] = least if least < np.inf else 0.0
            count += 1


@leaf_kernel
def _size(change: float) -> float:
    """Not a number: none."""
    return abs(change) if abs(change) < np.inf else np.inf
