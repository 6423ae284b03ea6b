"""Compiled decoding of a block of rows: both axes, then neighbours, few rows at a time while in the cache."""

from .axis_kernels import axis_pixels
from .jit import outer_kernel
from .mixed_kernels import REACH
from .neighbour_kernels import near_block
from .records import TILE, AxisRecord, Camera, Near, Scratch, Shared

__all__ = ["block_rows"]


@outer_kernel
def block_rows(
    start: int,
    stop: int,
    near: Near,
    decode: bool,
    compare: bool,
    camera: Camera,
    one: AxisRecord,
    two: AxisRecord | None,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Rows start..stop of the maps; compare: those whose neighbours are in the block with these, too, or if
    these rows are not to be decoded, all of them.
    """
    if not decode:
        near_block(start, stop, near, compare, shared, scratch)
        return
    height, width = shared.flags.shape
    few = max(TILE // width, 1)
    done = start + REACH if start else 0
    for row in range(start, stop, few):
        end = min(row + few, stop)
        first, last = row * width, end * width
        axis_pixels(first, last, camera, one, shared, scratch)
        axis_pixels(first, last, camera, two, shared, scratch)
        ready = end if end == height else end - REACH
        if compare and ready > done:
            # not fresh; a word that is no constant, so that it is compiled once for all callers
            near_block(done, ready, near, not compare, shared, scratch)
            done = ready
