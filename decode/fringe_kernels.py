"""Compiled: fringes of one axis, tile by tile: fitted, unwrapped, flagged, into the maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import tile_lines as tile
from .fit_kernels import fit_tile
from .flag_kernels import finest_tile, flag_fit
from .jit import fast_kernel, inline_kernel, leaf_kernel, linked_kernel
from .pair_kernels import highest_of, merge_pair, pair_of, store_pair
from .records import AxisRecord, Camera, CodeRecord, FringeRecord, Scratch, Shared
from .refit_kernels import refit
from .unwrap_kernels import search_tile, sequential_tile
from .write_kernels import write

__all__ = ["fringes_of_tile"]

Array = NDArray[Any]


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
    write(first, n, camera, fringes.shown, fringes.pair, paired, tile.PLACE, axis, shared, scratch)


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
    rest = lines[tile.LINES + 3 * groups :]
    return lines[tile.LINES :], rest[:groups], rest[groups : 2 * groups], rest[2 * groups :]


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
    place, spread, gap, doubt = lines[tile.PLACE], lines[tile.SPREAD], lines[tile.GAP], lines[tile.DOUBT]
    guess, agreement = lines[tile.GUESS], lines[tile.AGREEMENT]
    if searched is not None:
        low, high = -0.5, axis.extent - 0.5
        search_tile(n, periods, turns, variance, low, high, place, spread, agreement, gap, doubt)
        return
    if code is None:
        guess[:n] = np.float32(0.5 * (axis.extent - 1))
    sequential_tile(
        *(n, periods, turns, variance, guess, place, spread, lines[tile.STEP], lines[tile.MARGIN]),
        *(agreement, gap, doubt),
    )
    if code is not None:
        _code_doubt(n, place, guess, lines[tile.FAR], lines[tile.UP], lines[tile.DOWN], doubt)


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
    """All of two periods but their orders, which `write` finds; False: there are others, or something is
    clipped."""
    if pair is not None:
        frames, index = camera.frames, fringes.frame
        if np.float32(highest_of(n, frames, index, first)) >= np.float32(camera.clip):
            return False
        lines, end = scratch.lines, first + n
        of_fit, _ = pair_of(camera, fringes, axis)
        flags, amplitude = shared.flat_flags[0, first:end], shared.flat_amplitude[0, first:end]
        offset, error = shared.flat_offset[0, first:end], shared.flat_error[0, first:end]
        about, before = lines[tile.STEP], lines[tile.MARGIN]
        turns, spread = lines[tile.SPARE], lines[tile.SPREAD]
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
        *(sums[3 * last :], variance[last], misfit[last]),
        *(lines[tile.AGREEMENT], lines[tile.DOUBT], lines[tile.GAP], lines[tile.PLACE], lines[tile.SPREAD]),
        *(scratch.words[1], first, shared),
    )


@fast_kernel
def _code_doubt(n: int, place: Array, guess: Array, far: Array, up: Array, down: Array, doubt: Array) -> None:
    """A bit misread towards the side on which the fringe lies changes nothing."""
    for x in range(n):
        doubt[x] += far[x] + (up[x] if place[x] < guess[x] else down[x])
