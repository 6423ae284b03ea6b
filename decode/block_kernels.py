"""Compiled decoding of blocks of rows: both axes, then neighbours, few rows at a time while in the cache."""

from typing import Any

from numpy.typing import NDArray

from .axis_kernels import axis_pixels
from .jit import leaf_kernel, outer_kernel
from .mixed_kernels import REACH
from .neighbour_kernels import near_block
from .records import ROWS_AROUND, AxisRecord, Camera, Near, Scratch, Shared
from .ticket_kernels import draw

__all__ = ["decode_blocks"]

Array = NDArray[Any]


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
    fresh = len(drawn) > 0  # as ever; by a word that is no constant, so that near_block is compiled once
    while True:
        block = draw(drawn, 0)
        if block >= last:
            return
        _decode(cuts[block], cuts[block + 1], compare, not fresh, near, camera, one, two, shared, scratch)
        # those beside a cut once what lies beyond is done
        for cut in range(max(block, 1), min(block + 2, last) if compare else 0):
            if draw(drawn, cut) == 1:
                start, stop = cuts[cut] - REACH, min(cuts[cut] + REACH, height)
                near_block(start, stop, near, fresh, shared, scratch)


@leaf_kernel
def _decode(
    start: int,
    stop: int,
    compare: bool,
    fresh: bool,
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
            near_block(done, ready, near, fresh, shared, scratch)
            done = ready
