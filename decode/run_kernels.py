"""Compiled: runs of pixels, and how much each gathers at whole cells (see gathering)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, asked_by, fast_kernel, leaf_kernel, outer_kernel
from .select_kernels import least
from .wave_kernels import cosine_sine

__all__ = ["LINES", "RUN", "SOME", "changes_down", "gather_runs", "large_variance", "most_runs"]

Array = NDArray[Any]

#: Pixels of a run, lines of room for it.
RUN, LINES = 32, 6
#: Runs that are looked at, about, in groups side by side (down columns, a line of the cache holds pixels of
#: several); what spreads these evenly.
_RUNS, _BESIDE, _GOLDEN = 512, 8, 0.6180339887498949
#: Lines, about, pairs of neighbours on each and least distance of these that tell along which axis a map
#: changes; pixels of a line, about, that tell its gradients; of all lines, at most.
_FEW, _PAIRS, _APART, _PLACES = 8, 16, 8, 128
SOME = 2 * _FEW * 2 * _PLACES
#: Mean phasor up to which a run of pixels samples cells evenly; gradient below which it is flat.
_EVEN, _FLAT = 0.3, 0.05
#: By how much a run may leave its parabola besides noise, pattern pixels.
_ROUGH = 0.75
_ONE, _TWO, _HALF = np.float32(1), np.float32(2), np.float32(RUN // 2)


class _Lines(NamedTuple):
    """A map that lies flat, as `lines` lines of `length` pixels that begin `apart` pixels from each other and
    go in steps of `step`."""

    coord: Array
    lines: int
    length: int
    apart: int
    step: int


@leaf_kernel
def _lines_of(coord: Array, cols: int, down: bool) -> _Lines:
    """Rows, or (down) columns, of a map that lies flat (pixels,)."""
    rows = len(coord) // cols
    return _Lines(coord, cols, rows, 1, cols) if down else _Lines(coord, rows, cols, cols, 1)


@asked_by(
    "fringes",
    "float64[::1], float32[::1], uint16[::1], int64, boolean, float32[:, ::1], float32[:, ::1], "
    "float64[:, ::1]",
)
@outer_kernel
def gather_runs(
    coord: Array,
    sigma: Array,
    flags: Array,
    cols: int,
    down: bool,
    basis: Array,
    room: Array,
    told: Array,
) -> int:
    """How much runs of RUN pixels from all over maps that lie flat (pixels,), along rows or (down) columns,
    gather at whole cells, their gradients, and sinc of these: into told (3, K), see most_runs.

    All runs that there are, or groups of them side by side. Those with a flag, not smooth, or that do not
    sample the cells evenly are left out: the number of the rest is returned. basis: orthonormal, of the
    parabolas over a run (3, RUN); room: (LINES, RUN), all float32.
    """
    at, count = _lines_of(coord, cols, down), 0
    across = at.length // RUN
    if at.lines * across <= _RUNS:
        for i in range(at.lines * across):
            start = i // across * at.apart + i % across * RUN * at.step
            count += _gather(start, at.step, coord, sigma, flags, basis, room, told[:, count:])
        return count
    beside = min(_BESIDE, at.lines)
    for group in range(across * max(1, _RUNS // (across * beside))):
        line = int(group * _GOLDEN % 1.0 * (at.lines - beside + 1))
        for i in range(line, line + beside):
            start = i * at.apart + group % across * RUN * at.step
            count += _gather(start, at.step, coord, sigma, flags, basis, room, told[:, count:])
    return count


def most_runs(lines: int, length: int) -> int:
    """That gather_runs may look at."""
    across, beside = length // RUN, min(_BESIDE, lines)
    return max(_RUNS, across * max(1, _RUNS // max(across * beside, 1)) * beside)


@leaf_kernel
def _gather(
    start: int, step: int, coord: Array, sigma: Array, flags: Array, basis: Array, room: Array, told: Array
) -> int:
    """gather_runs of one, into told[:, 0]: 1, or 0 if it is left out."""
    run, fit, spread = room[0], room[1], room[2]
    if not _fetch(start, step, coord, sigma, flags, run, spread):
        return 0
    noise = _middle(spread, room[3])
    gradient, rough = _smooth(run, basis, fit)
    if gradient <= _FLAT or not rough < _ROUGH + 4 * noise:
        return 0
    cosine, sine, twice, twice_sine = _wave(fit, room[3], room[4])
    if math.hypot(cosine, sine) >= _EVEN or math.hypot(twice, twice_sine) >= _EVEN:
        return 0
    if not _like_stairs(run, fit, room[4], noise):
        return 0
    gathered = _wave(run, room[3], room[5])[0] - cosine
    told[0, 0] = gathered * math.exp(min(2 * (math.pi * noise) ** 2, 3.0))
    told[1, 0] = gradient
    told[2, 0] = math.sin(math.pi * gradient) / (math.pi * gradient)
    return 1


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


@apart_kernel
def _middle(values: Array, count: Array) -> float:
    """The upper one of the two in the middle, of RUN values: the least that half of them do not exceed.
    count: room."""
    for x in range(RUN):
        count[x] = np.float32(0)
    for y in range(RUN):
        one = values[y]
        for x in range(RUN):
            count[x] += _ONE if one <= values[x] else np.float32(0)
    middle = np.float32(np.inf)
    for x in range(RUN):
        value = values[x] if count[x] > _HALF else np.float32(np.inf)
        middle = value if value < middle else middle
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


@asked_by("fringes", "float64[::1], int64, float32[::1]")
@outer_kernel
def changes_down(coord: Array, cols: int, room: Array) -> bool:
    """Whether a map that lies flat changes more from row to row than from column to column: usual steps
    between neighbours on some lines. room: (SOME,), float32."""
    return bool(
        _usual_step(_lines_of(coord, cols, True), room) > _usual_step(_lines_of(coord, cols, False), room)
    )


@leaf_kernel
def _usual_step(at: _Lines, room: Array) -> float:
    """Of those that are known; 0 where there are none."""
    apart, every, count = max(_APART, at.length // _PAIRS), max(1, at.lines // _FEW), 0
    for line in range(0, at.lines, every):
        for x in range(apart, at.length, apart):
            here = line * at.apart + x * at.step
            size = abs(at.coord[here] - at.coord[here - at.step])
            if size < np.inf:
                room[count] = size
                count += 1
    return float(least(room, count, 0.5))


@asked_by("fringes", "float64[::1], int64, boolean, int64, float64[::1], float64, float64, float32[::1]")
@outer_kernel
def large_variance(
    coord: Array, cols: int, down: bool, reach: int, table: Array, per_cell: float, share: float, room: Array
) -> float:
    """The variance that this share of pixels on some lines does not exceed: table (K,), by the gradient in
    steps of 1 / per_cell, over `reach` pixels on that side where it is less, as pixels there may be wrong (0:
    none). room: (SOME,), float32."""
    at, count = _lines_of(coord, cols, down), 0
    last = len(table) - 1
    for line in range(0, at.lines, max(1, at.lines // _FEW)):
        for x in range(0, at.length, max(1, at.length // _PLACES)):
            here, gradient = line * at.apart + x * at.step, np.inf
            for far in (max(x - reach, 0), min(x + reach, at.length - 1)):
                apart = abs(far - x)
                if apart > reach // 2:
                    gradient = min(gradient, _size(coord[here + (far - x) * at.step] - coord[here]) / apart)
            gradient = gradient if gradient < np.inf else 0.0
            room[count] = table[int(min(gradient * per_cell, last))]
            count += 1
    return float(least(room, count, share))


@leaf_kernel
def _size(change: float) -> float:
    """Not a number: none."""
    return abs(change) if abs(change) < np.inf else np.inf
