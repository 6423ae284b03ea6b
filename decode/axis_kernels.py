"""Compiled decoding of one axis over a run of pixels: code and fringes, tile by tile."""

from typing import Any

from numba.core import types

from optolever.linking import Part

from .cell_kernels import code_of_tile
from .flag_kernels import outlier_rows
from .fringe_kernels import fringes_of_tile
from .jit import leaf_kernel
from .records import TILE, AxisRecord, Camera, CodeRecord, FringeRecord, Scratch, Shared

__all__ = ["axis_parts", "axis_pixels"]

_of_code, _of_fringes = code_of_tile.call, fringes_of_tile.call


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


def axis_parts(camera: Any, axis: Any, shared: Any, scratch: Any) -> list[Part]:
    """What axis_pixels calls, for arguments of these types."""
    own = types.int64, types.int64, camera, axis, shared, scratch
    shown = {} if axis is types.none else dict(zip(axis.fields, axis.types, strict=True))
    parts = (fringes_of_tile, "fringes"), (code_of_tile, "code")
    return [(part, own) for part, what in parts if shown.get(what, types.none) is not types.none]
