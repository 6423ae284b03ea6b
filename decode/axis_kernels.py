"""Compiled decoding of one axis over a run of pixels: code and fringes, tile by tile, into the maps."""

from typing import Any

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from optolever.linking import Part

from .byte_kernels import byte_tile
from .code_kernels import code_tile
from .display_kernels import take_off_run
from .fit_kernels import fit_tile
from .flag_kernels import code_tile_flags, finest_tile, flag_fit, outlier_rows
from .jit import apart_kernel, fast_kernel, inline_kernel, leaf_kernel, linked_kernel
from .pair_kernels import highest_of, merge_pair, order_pair, pair_of, store_pair
from .records import (
    LINES,
    TILE,
    AxisRecord,
    Camera,
    CellLines,
    CodeRecord,
    FringeRecord,
    Scratch,
    Shared,
)
from .refit_kernels import refit
from .stream_kernels import stream_widened
from .unwrap_kernels import search_tile, sequential_tile

__all__ = ["axis_parts", "axis_pixels"]

Array = NDArray[Any]

# lines of Scratch.lines; behind them a, c, s of all periods, then their turns, variances and misfits
_PLACE, _SPREAD, _DOUBT, _GUESS, _HALF, _MIDDLE, _FAR, _UP, _DOWN = range(9)
_GAP, _AGREEMENT, _STEP, _MARGIN, _SPARE = range(9, LINES)


@leaf_kernel
def axis_pixels(
    start: int, stop: int, camera: Camera, axis: AxisRecord | None, shared: Shared, scratch: Scratch
) -> None:
    """Decode pixels start..stop, which are whole rows end to end."""
    if axis is None:
        return
    for first in range(start, stop, TILE):
        tile = first, min(TILE, stop - first), camera, axis, shared, scratch
        _call_code(axis.code, tile)
        _call_fringes(axis.fringes, tile)
    width = shared.flags.shape[1]
    outlier_rows(start // width, stop // width, axis.least, shared.flags, scratch.kept[axis.number])


@linked_kernel
def code_of_tile(
    first: int, n: int, camera: Camera, axis: AxisRecord, shared: Shared, scratch: Scratch
) -> None:
    """Cells of a code: their centres (line _GUESS), and how doubtful they are; of one without fringes, into
    the maps."""
    code: Any = axis.code
    _of_bytes(first, n, camera, code.bytes, axis, shared, scratch)
    _of_levels(first, n, camera, code.bytes, axis, shared, scratch)


@linked_kernel
def fringes_of_tile(
    first: int, n: int, camera: Camera, axis: AxisRecord, shared: Shared, scratch: Scratch
) -> None:
    """Phases of a tile, unwrapped, into the maps."""
    fringes: Any = axis.fringes
    paired = _pair(first, n, fringes.pair, camera, fringes, axis, shared, scratch)
    if not paired:
        _fit(first, n, camera, fringes, scratch)
        _unwrap(n, axis.code, fringes.searched, fringes, axis, scratch)
        _flag_others(n, camera, fringes, scratch)
        _flag_finest(first, n, camera, fringes, axis, shared, scratch)
    _write(first, n, camera, fringes.shown, fringes.pair, paired, _PLACE, axis, shared, scratch)


_of_code, _of_fringes = code_of_tile.call, fringes_of_tile.call


@leaf_kernel
def _call_code(code: CodeRecord | None, tile: Any) -> None:
    """code_of_tile, if there is one."""
    if code is not None:
        _of_code(tile)


@leaf_kernel
def _call_fringes(fringes: FringeRecord | None, tile: Any) -> None:
    """fringes_of_tile, if there are any."""
    if fringes is not None:
        _of_fringes(tile)


@inline_kernel
def _cell_lines(scratch: Scratch) -> CellLines:
    """The lines that a code's decoding fills."""
    lines = scratch.lines
    return CellLines(
        *(scratch.words[0], scratch.marks[0], lines[_FAR], lines[_UP], lines[_DOWN], lines[_GAP]),
        *(lines[_HALF], lines[_MIDDLE], scratch.marks[1]),
        *(lines[_STEP], lines[_SPARE], lines[_PLACE], lines[_SPREAD], lines[_AGREEMENT]),
    )


@leaf_kernel
def _of_bytes(
    first: int,
    n: int,
    camera: Camera,
    of_bytes: bool | None,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """code_of_tile where frames are bytes and all bits have inverses."""
    if of_bytes is not None:
        code: Any = axis.code
        byte_tile(first, n, camera, code, _cell_lines(scratch), axis, shared, scratch)


@leaf_kernel
def _of_levels(
    first: int,
    n: int,
    camera: Camera,
    of_bytes: bool | None,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """code_of_tile elsewhere."""
    if of_bytes is None:
        code: Any = axis.code
        found = _cell_lines(scratch)
        code_tile(n, first, camera, code, found)
        _centres(n, code.pitch, code.origin, found.cell, scratch.lines[_GUESS])
        _alone(first, n, camera, axis.alone, axis, shared, scratch)


@leaf_kernel
def _alone(
    first: int,
    n: int,
    camera: Camera,
    code: CodeRecord | None,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Cells of a code without fringes, into the maps."""
    if code is None:
        return
    spread = scratch.lines[_SPREAD]
    code_tile_flags(n, first, axis.joined, camera, code, _cell_lines(scratch), spread, shared)
    _write(first, n, camera, None, None, False, _GUESS, axis, shared, scratch)


@inline_kernel
def _fit(first: int, n: int, camera: Camera, fringes: FringeRecord, scratch: Scratch) -> None:
    """Phases of all periods, into their lines."""
    groups = len(fringes.periods)
    sums, turns, variance, misfit = _of_periods(groups, scratch.lines)
    for g in range(groups):
        count, index, model = fringes.samples[g], fringes.frame[g], fringes.model[g]
        again = fit_tile(
            *(n, camera.frames, camera.lut, index, first, np.float32(camera.clip)),
            fringes.unlike,
            (fringes.solve[g], model, fringes.quad[g], count, fringes.even[g], fringes.quarters[g]),
            *(camera.read2, camera.gain, scratch.linear, fringes.own),
            *(sums[3 * g : 3 * g + 3], turns[g], variance[g], misfit[g]),
        )
        if again or camera.slope.size > 0:
            refit(
                *(n, camera.frames, camera.lut, camera.slope, index, first, camera.clip, count, model),
                *(float(camera.read2), float(camera.gain), scratch.equations),
                *(sums[3 * g : 3 * g + 3], turns[g], variance[g], misfit[g]),
            )


@inline_kernel
def _of_periods(groups: int, lines: Array) -> tuple[Array, Array, Array, Array]:
    """Lines of the periods: A, c, s (3 G), turns, their variances, misfits (G each)."""
    rest = lines[LINES + 3 * groups :]
    return lines[LINES:], rest[:groups], rest[groups : 2 * groups], rest[2 * groups :]


@leaf_kernel
def _unwrap(
    n: int,
    code: CodeRecord | None,
    searched: bool | None,
    fringes: FringeRecord,
    axis: AxisRecord,
    scratch: Scratch,
) -> None:
    """Orders of all periods: from a code, from a period that spans the surface, or by search."""
    lines, periods = scratch.lines, fringes.periods
    _, turns, variance, _ = _of_periods(len(periods), lines)
    place, spread, gap, doubt = lines[_PLACE], lines[_SPREAD], lines[_GAP], lines[_DOUBT]
    guess, agreement = lines[_GUESS], lines[_AGREEMENT]
    if searched is not None:
        low, high = -0.5, axis.extent - 0.5
        search_tile(n, periods, turns, variance, low, high, place, spread, agreement, gap, doubt)
        return
    if code is None:
        guess[:n] = np.float32(0.5 * (axis.extent - 1))
    sequential_tile(
        *(n, periods, turns, variance, guess, place, spread, lines[_STEP], lines[_MARGIN]),
        *(agreement, gap, doubt),
    )
    if code is not None:
        _code_doubt(n, place, guess, lines[_FAR], lines[_UP], lines[_DOWN], doubt)


@leaf_kernel
def _pair(
    first: int,
    n: int,
    pair: bool | None,
    camera: Camera,
    fringes: FringeRecord,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> bool:
    """All of two periods but orders (see _ordered); False: there are others, or something is clipped."""
    if pair is not None:
        frames, index = camera.frames, fringes.frame
        if np.float32(highest_of(n, frames, index, first)) >= np.float32(camera.clip):
            return False
        lines, end = scratch.lines, first + n
        of_fit, _ = pair_of(camera, fringes, axis)
        flags, amplitude = shared.flat_flags[0, first:end], shared.flat_amplitude[0, first:end]
        offset, error = shared.flat_offset[0, first:end], shared.flat_error[0, first:end]
        about, before, turns, spread = lines[_STEP], lines[_MARGIN], lines[_SPARE], lines[_SPREAD]
        # two loops: one that asks within is stored by masks, which takes twice as long
        if axis.joined:
            merge_pair(
                n, frames, index, first, of_fit, about, before, turns, spread, flags, amplitude, offset
            )
        else:
            store_pair(
                *(n, frames, index, first, of_fit, about, before, turns, spread),
                *(flags, amplitude, offset, error),
            )
        return True
    return False


@leaf_kernel
def _ordered(
    pair: bool | None,
    at: int,
    n: int,
    camera: Camera,
    axis: AxisRecord,
    lines: Array,
    coord: Array,
    sigma: Array,
    flags: Array,
    error: Array,
) -> None:
    """What _pair leaves, of n pixels from place `at` of the tile on."""
    if pair is not None:
        fringes: Any = axis.fringes
        _, limits = pair_of(camera, fringes, axis)
        part = slice(at, at + n)
        about, before, turns = lines[_STEP, part], lines[_MARGIN, part], lines[_SPARE, part]
        spread = lines[_SPREAD, part]
        order_pair(n, limits, camera.floor, about, before, turns, spread, coord, sigma, flags, error)


@inline_kernel
def _flag_others(n: int, camera: Camera, fringes: FringeRecord, scratch: Scratch) -> None:
    """Flags of all periods but the finest one."""
    why, last = scratch.words[1], len(fringes.periods) - 1
    sums, _, variance, misfit = _of_periods(last + 1, scratch.lines)
    why[:n] = np.int32(0)
    for g in range(last):
        worst = fringes.misfit[g]
        flag_fit(n, worst, camera.read2, camera.gain, sums[3 * g], variance[g], misfit[g], why)


@inline_kernel
def _flag_finest(
    first: int,
    n: int,
    camera: Camera,
    fringes: FringeRecord,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Flags of unwrapped fringes, and the maps that both axes share."""
    lines, last = scratch.lines, len(fringes.periods) - 1
    sums, _, variance, misfit = _of_periods(last + 1, lines)
    worst = fringes.misfit[last]
    finest_tile(
        *(n, axis.joined, camera, worst, fringes.disagreement, fringes.reach, np.float32(axis.extent)),
        *(sums[3 * last :], variance[last], misfit[last], lines[_AGREEMENT], lines[_DOUBT], lines[_GAP]),
        *(lines[_PLACE], lines[_SPREAD], scratch.words[1], first, shared),
    )


def axis_parts(camera: Any, axis: Any, shared: Any, scratch: Any) -> list[Part]:
    """What axis_pixels calls, for arguments of these types."""
    own = types.int64, types.int64, camera, axis, shared, scratch
    shown = {} if axis is types.none else dict(zip(axis.fields, axis.types, strict=True))
    parts = (fringes_of_tile, "fringes"), (code_of_tile, "code")
    return [(part, own) for part, what in parts if shown.get(what, types.none) is not types.none]


@fast_kernel
def _centres(n: int, pitch: Any, origin: Any, cell: Array, centre: Array) -> None:
    for x in range(n):
        centre[x] = pitch * np.float32(cell[x]) + origin


@fast_kernel
def _code_doubt(n: int, place: Array, guess: Array, far: Array, up: Array, down: Array, doubt: Array) -> None:
    """A bit misread towards the side on which the fringe lies changes nothing."""
    for x in range(n):
        doubt[x] += far[x] + (up[x] if place[x] < guess[x] else down[x])


@leaf_kernel
def _write(
    first: int,
    n: int,
    camera: Camera,
    shown: Any,
    pair: bool | None,
    paired: bool,
    line_of_places: int,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Coordinates and sigmas of a tile into the maps, row by row, and the rows into scratch.kept.

    paired: by _pair; otherwise places are in that line, and their variances in _SPREAD.
    """
    width, kept, lines = shared.flags.shape[1], scratch.kept[axis.number], scratch.lines
    as_they_are, done = _is_empty(shown), 0
    while done < n:
        row, col = (first + done) // width, (first + done) % width
        end = min(col + n - done, width)
        part, line, size = slice(done, done + end - col), kept[row % len(kept), col:end], end - col
        place, spread = lines[line_of_places, part], lines[_SPREAD, part]
        sigma, flags = axis.sigma[row, col:end], shared.flags[row, col:end]
        if paired:
            error = shared.flat_error[0, first + done : first + done + size]
            target = line if as_they_are else place
            _ordered(pair, done, size, camera, axis, lines, target, sigma, flags, error)
        else:
            _roots(camera.floor, spread, sigma)
            if as_they_are:
                _copy(place, line)
        if not as_they_are:
            _take_off(size, shown, camera.floor, place, spread, line, sigma, flags)
        stream_widened(line, axis.coord[row, col:end])
        done += size


@leaf_kernel
def _is_empty(shown: Any) -> bool:
    """Whether there is nothing to take off."""
    if shown is None:
        return True
    return bool(shown[0].size == 0)


@leaf_kernel
def _take_off(
    n: int, shown: Any, floor: Any, place: Array, spread: Array, line: Array, sigma: Array, flags: Array
) -> None:
    """take_off_run, if there is something to take off."""
    if shown is not None:
        take_off_run(n, shown, floor, place, spread, line, sigma, flags)


@apart_kernel
def _roots(floor: Any, spread: Array, sigma: Array) -> None:
    for x in range(len(sigma)):
        error = np.sqrt(spread[x])
        sigma[x] = error if error > floor else floor


@apart_kernel
def _copy(place: Array, line: Array) -> None:
    for x in range(len(line)):
        line[x] = place[x]
