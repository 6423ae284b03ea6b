"""Compiled: a code of one axis, tile by tile: its cells, and without fringes all of it, into the maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import tile_lines as tile
from .byte_kernels import byte_tile
from .code_kernels import code_tile
from .flag_kernels import code_tile_flags
from .jit import fast_kernel, inline_kernel, leaf_kernel, linked_kernel
from .records import AxisRecord, Camera, CellLines, CodeRecord, Scratch, Shared
from .write_kernels import write

__all__ = ["code_of_tile"]

Array = NDArray[Any]


@linked_kernel
def code_of_tile(
    first: int, n: int, camera: Camera, axis: AxisRecord, shared: Shared, scratch: Scratch
) -> None:
    """Cells of a code: their centres (tile.GUESS), how doubtful they are; of a code alone, into the maps."""
    code: Any = axis.code
    _of_bytes(first, n, camera, code.bytes, axis, shared, scratch)
    _of_levels(first, n, camera, code.bytes, axis, shared, scratch)


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
        _centres(n, code.pitch, code.origin, found.cell, scratch.lines[tile.GUESS])
        _alone(first, n, camera, axis.alone, axis, shared, scratch)


@inline_kernel
def _cell_lines(scratch: Scratch) -> CellLines:
    """The lines that a code's decoding fills."""
    lines = scratch.lines
    return CellLines(
        *(scratch.words[0], scratch.marks[0], lines[tile.FAR], lines[tile.UP], lines[tile.DOWN]),
        *(lines[tile.GAP], lines[tile.HALF], lines[tile.MIDDLE], scratch.marks[1]),
        *(lines[tile.STEP], lines[tile.SPARE], lines[tile.PLACE], lines[tile.SPREAD], lines[tile.AGREEMENT]),
    )


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
    spread = scratch.lines[tile.SPREAD]
    code_tile_flags(n, first, axis.joined, camera, code, _cell_lines(scratch), spread, shared)
    write(first, n, camera, None, None, False, tile.GUESS, axis, shared, scratch)


@fast_kernel
def _centres(n: int, pitch: Any, origin: Any, cell: Array, centre: Array) -> None:
    for x in range(n):
        centre[x] = pitch * np.float32(cell[x]) + origin
