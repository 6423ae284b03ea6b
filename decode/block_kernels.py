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
    """Rows start..stop of the maps. decode: False: that is done, and they are compared with those around;
    compare: so are, while they are decoded, those whose neighbours are in the block.
    """
    # what is fresh is told by words that are no constants, so that near_block is compiled once
    if not decode:
        near_block(start, stop, near, not decode, shared, scratch)
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
            near_block(done, ready, near, not compare, shared, scratch)
            done = ready
