"""Compiled: along lines of pixels, where decoded coordinates go on and where they jump."""

from typing import Any

from numpy.typing import NDArray

from .jit import kernel

__all__ = ["CALM", "JUMP", "mark_steps"]

Array = NDArray[Any]

CALM, JUMP = 1, 2


@kernel
def mark_steps(
    coords: Array, flags: Array, blind: int, smooth: float, near: float, far: float, marks: Array
) -> tuple[int, int, int]:
    """Of lines (L, N): pairs of neighbours without a `blind` flag, those more than `smooth` apart, and jumps.

    marks (L, N - 3): CALM at the second of four pixels that see, of which the outer two are each within
    `near` of the inner one beside them; JUMP if besides the inner two are more than `far` apart; else 0.
    """
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
