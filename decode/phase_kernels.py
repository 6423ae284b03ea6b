"""Compiled decoding of one axis of fringes over a block of rows, and the flags of all codes."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import TILE, fit_tile, refit_clipped
from .jit import kernel
from .unwrap_kernels import search_tile, sequential_tile

__all__ = ["CODE_GUIDED", "SEARCHED", "SPAN_GUIDED", "code_finish_rows", "outlier_rows", "phase_rows"]

Array = NDArray[Any]

#: How the coarsest order is found: from a code, from a period that spans the surface, by search.
CODE_GUIDED, SPAN_GUIDED, SEARCHED = 0, 1, 2

# Flag's values, as the kernels need plain numbers
_DARK, _SATURATED, _LOW, _ORDER, _OFF, _OUTLIER, _MOVED, _INVALID = 1, 2, 4, 8, 16, 32, 64, 128
#: Amplitude over noise below which a pixel is flagged.
_LEAST_CONTRAST = 4.0
#: Probability of a wrong order above which a pixel is flagged.
_DOUBT = 1e-4


@kernel
def phase_rows(
    frames: Array,
    lut: Array,
    clip: float,
    start: int,
    stop: int,
    mode: int,
    count: Array,
    index: Array,
    solve: Array,
    model: Array,
    quad: Array,
    periods: Array,
    worst: Array,
    limits: tuple[float, float, float],
    noise: tuple[float, float],
    centre: Array,
    far: Array,
    up: Array,
    down: Array,
    extent: int,
    joined: bool,
    coord: Array,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """Decode rows start..stop of one axis.

    count (G,) samples per period, index (G, N), solve (G, 3, N), model (G, N, 3), quad (G, 4, 3): see
    `arrays.fringe_arrays`; worst (G,) misfit limit;
    limits = (distance from guess, floor of sigma, chi squared of the periods);
    noise = (read variance, gain); centre, far, up, down: the code's answer, (stop - start, W) or empty;
    joined: flags, amplitude, offset and order_error already hold those of the other axis.
    """
    width = frames.shape[2]
    groups = len(periods)
    read2, gain = np.float32(noise[0]), np.float32(noise[1])
    sums = np.empty((groups, 3, TILE), np.float32)
    turns = np.empty((groups, TILE), np.float32)
    variance = np.empty((groups, TILE), np.float32)
    misfit = np.empty((groups, TILE), np.float32)
    clipped = np.empty((groups, TILE), np.uint8)
    spread, gap, doubt = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    agreement = np.empty(TILE)
    middle = np.full(TILE, np.float32(0.5 * (extent - 1)))
    for row in range(start, stop):
        at = row - start
        for first in range(0, width, TILE):
            n = min(TILE, width - first)
            end = first + n
            for g in range(groups):
                m = count[g]
                fit_tile(
                    frames,
                    lut,
                    clip,
                    row,
                    first,
                    n,
                    index[g, :m],
                    solve[g, :, :m],
                    model[g, :m],
                    quad[g],
                    read2,
                    gain,
                    sums[g],
                    turns[g],
                    variance[g],
                    misfit[g],
                    clipped[g],
                )
                refit_clipped(
                    frames,
                    lut,
                    clip,
                    row,
                    first,
                    n,
                    index[g, :m],
                    model[g, :m],
                    noise[0],
                    noise[1],
                    sums[g],
                    turns[g],
                    variance[g],
                    misfit[g],
                    clipped[g],
                )
            for x in range(n):
                agreement[x] = 0
                doubt[x] = 0
            guess = centre[at, first:end] if mode == CODE_GUIDED else middle[:n]
            if mode == SEARCHED:
                search_tile(
                    n,
                    periods,
                    turns,
                    variance,
                    -0.5,
                    extent - 0.5,
                    coord[row, first:end],
                    spread,
                    agreement,
                    gap,
                    doubt,
                )
            else:
                sequential_tile(
                    n, periods, turns, variance, guess, coord[row, first:end], spread, agreement, gap, doubt
                )
            if mode == CODE_GUIDED:
                for x in range(n):
                    side = up[at, first + x] if coord[row, first + x] < guess[x] else down[at, first + x]
                    doubt[x] += far[at, first + x] + side
            _finish(
                n,
                extent,
                worst,
                limits,
                read2,
                gain,
                coord[row, first:end],
                spread,
                agreement,
                gap,
                doubt,
                sums[groups - 1],
                variance,
                misfit,
                clipped,
                joined,
                sigma[row, first:end],
                flags[row, first:end],
                amplitude[row, first:end],
                offset[row, first:end],
                order_error[row, first:end],
            )


@kernel
def _finish(
    n: int,
    extent: int,
    worst: Array,
    limits: tuple[float, float, float],
    read2: float,
    gain: float,
    coord: Array,
    spread: Array,
    agreement: Array,
    gap: Array,
    doubt: Array,
    sums: Array,
    variance: Array,
    misfit: Array,
    clipped: Array,
    joined: bool,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """Sigma, flags and the common maps of a tile."""
    reach, floor, worst_agreement = limits
    for x in range(n):
        a, power = sums[0, x], sums[1, x] * sums[1, x] + sums[2, x] * sums[2, x]
        noise = read2 + gain * max(a, np.float32(0))
        error = math.sqrt(spread[x])
        why = 0
        if not power >= _LEAST_CONTRAST * _LEAST_CONTRAST * noise:
            why |= _LOW
            if a < 2 * _LEAST_CONTRAST * math.sqrt(noise):
                why |= _DARK
        for g in range(len(variance)):
            if not variance[g, x] < np.inf:
                why |= _SATURATED
            if misfit[g, x] > worst[g]:
                why |= _MOVED
        if agreement[x] > worst_agreement or doubt[x] > _DOUBT or gap[x] > reach:
            why |= _ORDER
        if coord[x] < -0.5 - max(0.5, 3 * error) or coord[x] > extent - 0.5 + max(0.5, 3 * error):
            why |= _OFF
        if not (abs(coord[x]) < np.inf and error < np.inf):
            why |= _INVALID
        sigma[x] = max(error, floor)
        height = math.sqrt(power)
        if joined:
            flags[x] |= why
            amplitude[x] = min(amplitude[x], height)
            offset[x] = 0.5 * (offset[x] + a)
            order_error[x] = 1 - (1 - order_error[x]) * (1 - min(doubt[x], 1.0))
        else:
            flags[x] = why
            amplitude[x] = height
            offset[x] = a
            order_error[x] = min(doubt[x], 1.0)


@kernel
def code_finish_rows(
    start: int,
    stop: int,
    extent: int,
    pitch: float,
    origin: float,
    cells: int,
    clip: float,
    noise: tuple[float, float],
    cell: Array,
    far: Array,
    up: Array,
    down: Array,
    half: Array,
    middle: Array,
    clipped: Array,
    joined: bool,
    coord: Array,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """The answer of a code alone: the centre of its cell of `pitch` pixels, flat within it."""
    for row in range(start, stop):
        at = row - start
        for x in range(coord.shape[1]):
            k = cell[at, x]
            noise2 = noise[0] + noise[1] * max(middle[at, x], 0.0)
            why = 0
            if not half[at, x] * half[at, x] >= _LEAST_CONTRAST * _LEAST_CONTRAST * noise2:
                why |= _LOW
                if middle[at, x] < 2 * _LEAST_CONTRAST * math.sqrt(noise2):
                    why |= _DARK
            if clipped[at, x] > 0:
                why |= _SATURATED
            if far[at, x] > _DOUBT:
                why |= _ORDER
            if k < 0 or k >= cells:
                why |= _OFF
            coord[row, x] = k * pitch + origin
            sigma[row, x] = pitch / math.sqrt(12.0)
            wrong = min(far[at, x] + up[at, x] + down[at, x], np.float32(1))
            if joined:
                flags[row, x] |= why
                amplitude[row, x] = min(amplitude[row, x], half[at, x])
                offset[row, x] = 0.5 * (offset[row, x] + middle[at, x])
                order_error[row, x] = 1 - (1 - order_error[row, x]) * (1 - wrong)
            else:
                flags[row, x] = why
                amplitude[row, x] = half[at, x]
                offset[row, x] = middle[at, x]
                order_error[row, x] = wrong


@kernel
def outlier_rows(start: int, stop: int, least: float, coord: Array, sigma: Array, flags: Array) -> None:
    """Flag a pixel that leaves a line on which its two neighbours on either side agree.

    Folds and edges pass: there the neighbours do not agree with each other.
    """
    width = coord.shape[1]
    for row in range(start, stop):
        for x in range(2, width - 2):
            left, right = coord[row, x - 1], coord[row, x + 1]
            jump = abs(coord[row, x] - 0.5 * (left + right))
            calm = (
                max(abs(right - left), max(abs(left - coord[row, x - 2]), abs(coord[row, x + 2] - right)))
                + 6 * sigma[row, x]
            )
            if jump > max(least, 3 * calm):
                flags[row, x] |= _OUTLIER
