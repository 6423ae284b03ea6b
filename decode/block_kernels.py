"""Compiled decoding of blocks of rows: both axes, then neighbours, few rows at a time while in the cache."""

from typing import Any

from numba.core import types
from numpy.typing import NDArray

from optolever.linking import Part

from .axis_kernels import axis_parts, axis_pixels
from .jit import calling, leaf_kernel, outer_kernel
from .mixed_kernels import REACH
from .neighbour_kernels import call_near, near_block
from .records import ROWS_AROUND, AxisRecord, Camera, Near, Scratch, Shared
from .ticket_kernels import draw

__all__ = ["decode_blocks"]

Array = NDArray[Any]


def _parts(arguments: Any) -> list[Part]:
    """What decode_blocks calls, for arguments of these types."""
    _, _, _, near, camera, one, two, shared, scratch = arguments
    whole, flag = types.int64, types.boolean
    axes = [part for axis in (one, two) for part in axis_parts(camera, axis, shared, scratch)]
    return [*axes, (near_block, (whole, whole, near, flag, shared, scratch))]


@calling(_parts)
@outer_kernel
def decode_blocks(
    cuts: Array,
    drawn: Array,
    compare: bool,
    near: Near,
    camera: Camera,
    one: AxisRecord,
    two: AxisRecord | None,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Rows of the maps between cuts (K,), block by block; drawn (K,), 0 at first: how many blocks are begun,
    and how many of the two on either side of a cut are done, by all threads. compare: neighbours, too.
    """
    height, last = shared.flags.shape[0], len(cuts) - 1
    while True:
        block = draw(drawn, 0)
        if block >= last:
            return
        _decode(cuts[block], cuts[block + 1], compare, near, camera, one, two, shared, scratch)
        # those beside a cut once what lies beyond is done
        for cut in range(max(block, 1), min(block + 2, last) if compare else 0):
            if draw(drawn, cut) == 1:
                start, stop = cuts[cut] - REACH, min(cuts[cut] + REACH, height)
                call_near((start, stop, near, True, shared, scratch))


@leaf_kernel
def _decode(
    start: int,
    stop: int,
    compare: bool,
    near: Near,
    camera: Camera,
    one: AxisRecord,
    two: AxisRecord | None,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """Rows start..stop; those are compared, while they are decoded, whose neighbours are among them."""
    height, width = shared.flags.shape
    few = scratch.kept.shape[1] - ROWS_AROUND
    done = start + REACH if start else 0
    for row in range(start, stop, few):
        end = min(row + few, stop)
        first, last = row * width, end * width
        axis_pixels(first, last, camera, one, shared, scratch)
        axis_pixels(first, last, camera, two, shared, scratch)
        ready = end if end == height else end - REACH
        if compare and ready > done:
            call_near((done, ready, near, False, shared, scratch))
            done = ready
