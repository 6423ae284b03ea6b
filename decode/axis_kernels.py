"""Compiled decoding of one axis over a block of rows: code and fringes, tile by tile, into the maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .code_kernels import code_tile
from .display_kernels import take_off_tile
from .fit_kernels import TILE, fit_tile
from .flag_kernels import code_flags, common_tile, flag_finest, flag_fit
from .jit import apart_kernel, fast_kernel, kernel
from .refit_kernels import refit
from .unwrap_kernels import search_tile, sequential_tile

__all__ = ["CODE_GUIDED", "CODE_ONLY", "SEARCHED", "SPAN_GUIDED", "axis_rows"]

Array = NDArray[Any]

#: How the coarsest order is found: from a code, from a period that spans the surface, by search; no fringes.
CODE_GUIDED, SPAN_GUIDED, SEARCHED, CODE_ONLY = 0, 1, 2, 3
_FLAT = np.float32(1 / 12)


@kernel
def axis_rows(
    frames: Array,
    response: tuple[Array, Array, float],
    clip: float,
    noise: tuple[float, float, float],
    start: int,
    stop: int,
    mode: int,
    code: Any,
    fringes: Any,
    limits: tuple[float, float, float],
    shown: Any,
    extent: int,
    joined: bool,
    coord: Array,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """Decode pixels start..stop of one axis; frames (N, 1, pixels) and maps (1, pixels) are rows end to end.

    response = (raw level -> linear one, its slope, that at mid level squared), empty and 1 without one;
    noise = (read variance, gain, level that counts as dark); code = ((source, white, black, plain,
    inverse, gray, cells, number of cells, pitch, origin), (loose, beyond, read variance, gain)), see
    code_kernels; fringes = (count, index, solve, model, quad, even, quarters, periods, misfit), see
    arrays.fringe_arrays; limits = (distance from the code's cell, floor of sigma, chi squared of the
    periods); shown = what the display
    shifts, see display_kernels (empty: nothing);
    joined: flags, amplitude, offset and order_error already hold those of the other axis.
    """
    source, white, black, plain, inverse, gray, cells, cell_count, pitch, origin = code[0]
    loose, beyond, code_read2, code_gain = code[1]
    lut, slope, scale = response
    periods = fringes[7]
    groups = len(periods)
    coded = mode in (CODE_GUIDED, CODE_ONLY)
    read2, gain = np.float32(noise[0]), np.float32(noise[1])
    reach, floor, disagreement = np.float32(limits[0]), np.float32(limits[1]), np.float32(limits[2])
    linear = np.empty((fringes[1].shape[1], 1, TILE), np.float32)
    own = np.arange(fringes[1].shape[1])
    sums = np.empty((max(groups, 1), 3, TILE), np.float32)
    turns = np.empty((groups, TILE), np.float32)
    variance = np.empty((groups, TILE), np.float32)
    misfit = np.empty((groups, TILE), np.float32)
    room = np.zeros((14, TILE), np.float32)
    place, spread, gap, doubt, agreement, step, margin, guess = (
        room[0],
        room[1],
        room[2],
        room[3],
        room[4],
        room[5],
        room[6],
        room[7],
    )
    far, up, down, half, middle, spare = room[8], room[9], room[10], room[11], room[12], room[13]
    word, why = np.empty(TILE, np.int32), np.empty(TILE, np.int32)
    weak, clipped = np.empty(TILE, np.uint8), np.empty(TILE, np.uint8)
    row = 0
    for first in range(start, stop, TILE):
        n = min(TILE, stop - first)
        if coded:
            code_tile(
                frames,
                clip,
                row,
                first,
                n,
                source,
                white,
                black,
                plain,
                inverse,
                gray,
                cells,
                code_read2,
                code_gain,
                loose,
                beyond,
                (step, spare, place, spread, agreement),
                word,
                weak,
                far,
                up,
                down,
                half,
                middle,
                clipped,
            )
            _centres(n, np.float32(pitch), np.float32(origin), word, guess)
        if mode == CODE_ONLY:
            code_flags(
                n,
                code_read2,
                code_gain,
                np.float32(noise[2]),
                np.int32(cell_count),
                word,
                far,
                half,
                middle,
                clipped,
                why,
            )
            _flat(n, np.float32(pitch), far, up, down, doubt, spread)
            _write(n, floor, guess, spread, row, first, coord, sigma)
            common_tile(
                n,
                joined,
                why,
                half,
                middle,
                doubt,
                row,
                first,
                flags,
                amplitude,
                offset,
                order_error,
            )
            continue
        for g in range(groups):
            count, index, model = fringes[0][g], fringes[1][g], fringes[3][g]
            again = fit_tile(
                frames,
                lut,
                np.float32(clip),
                row,
                first,
                n,
                count,
                index,
                fringes[2][g],
                model,
                fringes[4][g],
                fringes[5][g],
                fringes[6][g],
                read2,
                gain,
                linear,
                own,
                sums[g],
                turns[g],
                variance[g],
                misfit[g],
            )
            if again or slope.size > 0:
                refit(
                    frames,
                    lut,
                    slope,
                    clip,
                    row,
                    first,
                    n,
                    count,
                    index,
                    model,
                    noise[0],
                    noise[1],
                    sums[g],
                    turns[g],
                    variance[g],
                    misfit[g],
                )
        if mode == SPAN_GUIDED:
            guess[:n] = np.float32(0.5 * (extent - 1))
        if mode == SEARCHED:
            search_tile(n, periods, turns, variance, -0.5, extent - 0.5, place, spread, agreement, gap, doubt)
        else:
            sequential_tile(
                n, periods, turns, variance, guess, place, spread, step, margin, agreement, gap, doubt
            )
        if mode == CODE_GUIDED:
            _code_doubt(n, place, guess, far, up, down, doubt)
        finest = sums[groups - 1]
        last, worst = groups - 1, fringes[8]
        flag_finest(
            *(n, read2, gain, np.float32(noise[2]), np.float32(scale), np.float32(worst[last])),
            *(disagreement, reach, np.float32(extent), finest[0], finest[1], finest[2]),
            *(variance[last], misfit[last], agreement, doubt, gap, place, spread, half, why),
        )
        for g in range(last):
            flag_fit(n, np.float32(worst[g]), read2, gain, sums[g, 0], variance[g], misfit[g], why)
        if shown[0].size:
            take_off_tile(n, shown, place, spread, step, word, why)
        _write(n, floor, place, spread, row, first, coord, sigma)
        common_tile(
            n,
            joined,
            why,
            half,
            finest[0],
            doubt,
            row,
            first,
            flags,
            amplitude,
            offset,
            order_error,
        )


@fast_kernel
def _centres(n: int, pitch: Any, origin: Any, cell: Array, centre: Array) -> None:
    for x in range(n):
        centre[x] = pitch * np.float32(cell[x]) + origin


@fast_kernel
def _flat(n: int, pitch: Any, far: Array, up: Array, down: Array, doubt: Array, spread: Array) -> None:
    """A code alone: a bit may be wrong anywhere, and within its cell every place is as likely."""
    for x in range(n):
        doubt[x] = far[x] + up[x] + down[x]
    for x in range(n):
        spread[x] = pitch * pitch * (_FLAT + up[x] + down[x])


@fast_kernel
def _code_doubt(n: int, place: Array, guess: Array, far: Array, up: Array, down: Array, doubt: Array) -> None:
    """A bit misread towards the side on which the fringe lies changes nothing."""
    for x in range(n):
        doubt[x] += far[x] + (up[x] if place[x] < guess[x] else down[x])


@apart_kernel
def _write(
    n: int, floor: Any, place: Array, spread: Array, row: int, first: int, coords: Array, sigmas: Array
) -> None:
    coord, sigma = coords[row, first : first + n], sigmas[row, first : first + n]
    for x in range(n):
        coord[x] = place[x]
        error = np.sqrt(spread[x])
        sigma[x] = error if error > floor else floor
