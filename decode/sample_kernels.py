"""Compiled: runs of pixels from all over the frames."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import outer_kernel

__all__ = ["RUN", "fetch_runs"]

Array = NDArray[Any]
#: Pixels in a run, which costs as much to fetch as one pixel.
RUN = 8


@outer_kernel
def fetch_runs(frames: Array, rows: Array, starts: Array, runs: Array) -> None:
    """runs (N, lines, K, RUN) = pixels of frames (N, H, W) that begin at `starts` (K,) of the rows (lines,).

    It is memory that this waits for: the simpler the loop, the more of it is on its way at once.
    """
    for i in range(len(frames)):
        for line in range(len(rows)):
            row, own = frames[i, rows[line]], runs[i, line]
            for k in range(len(starts)):
                start = np.uint64(starts[k])  # unsigned, as signed indices are checked
                for x in range(RUN):
                    own[k, x] = row[start + np.uint64(x)]
