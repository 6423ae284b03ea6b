"""Compiled: coordinates and sigmas of a tile on their way into the maps, row by row."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import tile_lines as tile
from .display_kernels import take_off_run
from .jit import apart_kernel, leaf_kernel
from .pair_kernels import order_pair, pair_of
from .records import AxisRecord, Camera, Scratch, Shared
from .stream_kernels import stream_widened

__all__ = ["write"]

Array = NDArray[Any]


@leaf_kernel
def write(
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

    paired: by store_pair or merge_pair, orders are found here; otherwise places are in that line, and their
    variances in tile.SPREAD.
    """
    width, kept, lines = shared.flags.shape[1], scratch.kept[axis.number], scratch.lines
    as_they_are, done = _is_empty(shown), 0
    while done < n:
        row, col = (first + done) // width, (first + done) % width
        end = min(col + n - done, width)
        part, line, size = slice(done, done + end - col), kept[row % len(kept), col:end], end - col
        place, spread = lines[line_of_places, part], lines[tile.SPREAD, part]
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
    """order_pair of n pixels from place `at` of the tile on."""
    if pair is not None:
        fringes: Any = axis.fringes
        _, limits = pair_of(camera, fringes, axis)
        part = slice(at, at + n)
        about, before, turns = lines[tile.STEP, part], lines[tile.MARGIN, part], lines[tile.SPARE, part]
        spread = lines[tile.SPREAD, part]
        order_pair(n, limits, camera.floor, about, before, turns, spread, coord, sigma, flags, error)


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
