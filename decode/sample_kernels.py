"""Compiled: runs of pixels from all over the frames, and how rough they are."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import asked_by, outer_kernel
from .select_kernels import least

__all__ = ["RUN", "fetch_runs", "least_rough"]

Array = NDArray[Any]
#: Pixels in a run, which costs as much to fetch as one pixel.
RUN = 8


@asked_by("all", "float32[:, :, ::1], float32[::1]")
@outer_kernel
def least_rough(runs: Array, room: Array) -> float:
    """The least median, over frames, of the second differences' size within runs (N, K, pixels); room (K
    pixels,): all float32. 0 where runs are too short for any."""
    _, count, pixels = runs.shape
    found = np.inf
    for i in range(len(runs)):
        used = 0
        for k in range(count):
            run = runs[i, k]
            for x in range(1, pixels - 1):
                room[used] = abs(run[x - 1] + run[x + 1] - 2 * run[x])
                used += 1
        found = min(found, least(room, used, 0.5))
    return found


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
