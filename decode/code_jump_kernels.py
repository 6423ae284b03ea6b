"""Compiled: along lines of pixels, where decoded coordinates go on and where they jump."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import asked_by, leaf_kernel, outer_kernel
from .select_kernels import least

__all__ = ["CALM", "JUMP", "mark_lines"]

Array = NDArray[Any]

CALM, JUMP = 1, 2


@asked_by(
    "code",
    "float64[:, ::1], uint16[:, ::1], int64[::1], boolean, int64, float64, UniTuple(float64, 2), int64, "
    "float64[:, ::1], uint16[:, ::1], float64[::1], float32[:, ::1], uint8[:, ::1]",
)
@outer_kernel
def mark_lines(
    chart: Array,
    spoilt: Array,
    lines: Array,
    along: bool,
    blind: int,
    smooth: float,
    loose: tuple[float, float],
    every: int,
    coords: Array,
    flags: Array,
    usual: Array,
    room: Array,
    marks: Array,
) -> tuple[int, int, int]:
    """Of rows (along) or columns `lines` (L,) of coordinates and flags (H, W): pairs of neighbours without a
    `blind` flag, those more than `smooth` apart, and jumps.

    coords, flags (L, N): these lines; usual (2,): medians of the steps between neighbours and of their
    change, of one pixel of `every`; marks (L, N - 3): CALM at the second of four pixels that see, of which
    the outer two are each within loose[0] and two usual steps of the inner one beside them; JUMP if besides
    the inner two are loose[1] further apart; else 0. room: (2, K), float32, for what medians are taken of.
    """
    _take_lines(chart, lines, along, coords)
    _take_lines(spoilt, lines, along, flags)
    _usual_changes(coords, every, room, usual)
    near = loose[0] + 2 * usual[0]
    far = near + loose[1]
    pairs, rough, jumps = 0, 0, 0
    for line in range(coords.shape[0]):
        unseen = 4  # steps back to the last pixel that sees nothing, at most four
        for x in range(coords.shape[1]):
            unseen = 0 if flags[line, x] & blind else min(unseen + 1, 4) if x else 1
            if unseen >= 2:
                pairs += 1
                rough += abs(coords[line, x] - coords[line, x - 1]) > smooth
            if x < 3:
                continue
            before = abs(coords[line, x - 2] - coords[line, x - 3])
            after = abs(coords[line, x] - coords[line, x - 1])
            calm = unseen >= 4 and before <= near and after <= near
            jump = calm and abs(coords[line, x - 1] - coords[line, x - 2]) > far
            marks[line, x - 3] = JUMP if jump else CALM if calm else 0
            jumps += jump
    return pairs, rough, jumps


@leaf_kernel
def _take_lines(chart: Array, lines: Array, along: bool, taken: Array) -> None:
    """taken (L, N) = rows or columns of a chart (H, W)."""
    if along:
        for i in range(len(lines)):
            for x in range(chart.shape[1]):
                taken[i, x] = chart[lines[i], x]
    else:
        for y in range(chart.shape[0]):
            for i in range(len(lines)):
                taken[i, y] = chart[y, lines[i]]


@leaf_kernel
def _usual_changes(coords: Array, every: int, room: Array, usual: Array) -> None:
    """See mark_lines; what is no number does not count."""
    steps = bends = 0
    for line in range(coords.shape[0]):
        for x in range(1, coords.shape[1], every):
            step = abs(coords[line, x] - coords[line, x - 1])
            if step < np.inf:
                room[0, steps] = step
                steps += 1
            if x + 1 < coords.shape[1]:
                bend = abs(coords[line, x + 1] - 2 * coords[line, x] + coords[line, x - 1])
                if bend < np.inf:
                    room[1, bends] = bend
                    bends += 1
    usual[0], usual[1] = least(room[0], steps, 0.5), least(room[1], bends, 0.5)
