"""Compiled: runs of pixels from all over the frames, and how rough they are."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, asked_by, outer_kernel
from .select_kernels import least

__all__ = ["RUN", "fetch_runs", "least_rough"]

Array = NDArray[Any]
#: Pixels in a run, which costs as much to fetch as one pixel.
RUN = 8
_TWO, _INF = np.float32(2), np.float32(np.inf)


@asked_by("all", "float32[:, :, ::1], float32[::1]")
@outer_kernel
def least_rough(runs: Array, room: Array) -> float:
    """The least median, over frames, of the second differences' size within runs (N, K, pixels); room (K
    pixels,): all float32. 0 where runs are too short for any."""
    _, count, pixels = runs.shape
    found, used = np.inf, count * max(pixels - 2, 0)
    if used == 0:
        return 0.0
    # of what is beyond a run's ends nothing is known: it comes last
    share = (0.5 * (used - 1) + 0.25) / max(count * pixels - 1, 1)
    for i in range(len(runs)):
        _bends(runs[i].reshape(-1), room)
        for k in range(count):
            room[k * pixels] = room[(k + 1) * pixels - 1] = _INF
        found = min(found, least(room, count * pixels, share))
    return found


@apart_kernel
def _bends(line: Array, bend: Array) -> None:
    """Second differences' size (K,), as if all runs (K,) were one; not at its ends."""
    inner = len(line) - 2
    left, right, middle, out = line[:inner], line[2:], line[1:], bend[1:]
    for x in range(inner):
        out[x] = abs(left[x] + right[x] - _TWO * middle[x])


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
