"""Wrong frames by the decoder's score on small blocks of the image."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

__all__ = ["Repair", "Score", "find_order"]

#: Share of pixels of blocks (N, side, count * side) that are good on all axes and continue their neighbours,
#: decoded as `sequence` describes them.
Score = Callable[[NDArray[Any], Sequence], float]


class Repair(NamedTuple):
    """name: for the notice; order (N,): frame that holds image i (-1: none does); sequence: description that
    fits."""

    name: str
    order: NDArray[np.int64]
    sequence: Sequence


def find_order(frames: NDArray[Any], sequence: Sequence, score: Score) -> Repair | None:
    """None: the frames are as described, or no other order explains them better."""
    raise NotImplementedError
