"""Whole levels of a camera: their step and the largest."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import on_cores

__all__ = ["levels_of"]


def levels_of(stack: NDArray[Any]) -> tuple[int, float]:
    """Step of whole levels (0: they are not), and the largest: 255, or that of the fewest bits that hold all
    samples of 16-bit frames; a camera's bits may be the upper of 16, then the others are 0."""
    if stack.dtype == np.uint8:
        return 1, 255.0
    if stack.dtype.kind == "f":
        return 0, float("inf")
    used = int(np.bitwise_or.reduce(on_cores(_bits_used, list(stack))))
    step = min(used & -used, 256) if used > 16383 else 1  # 8 bits are the fewest
    return step, float(next(level for level in (255, 1023, 4095, 16383, 65536 - step) if level >= used))


def _bits_used(frame: NDArray[np.uint16]) -> int:
    return int(np.bitwise_or.reduce(frame, axis=None))
