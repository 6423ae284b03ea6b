"""Some pixels from all over the frames, fetched once: on them noise is measured, constraints are tested."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows, threads

from .sample_kernels import RUN, fetch_runs

__all__ = ["Sample", "quantile", "sampled"]

#: Lines, and runs on each of them, about.
_LINES, _ACROSS = 64, 16
#: Pixels of a frame from which on threads share the frames.
_LARGE = 1 << 18


@dataclass(frozen=True, slots=True)
class Sample:
    """Raw levels (N, lines, runs, pixels of a run) and rows (lines,)."""

    runs: NDArray[Any]
    rows: NDArray[np.int64]

    @property
    def levels(self) -> NDArray[Any]:
        """All pixels (N, K)."""
        return self.runs.reshape(len(self.runs), -1)

    @property
    def row(self) -> NDArray[np.int64]:
        """Row of each pixel (K,)."""
        return np.repeat(self.rows, self.runs[0, 0].size)


def sampled(frames: NDArray[Any]) -> Sample:
    """A sample of frames (N, H, W); of small ones whole lines."""
    _, rows, cols = frames.shape
    apart = max(1, rows // _LINES)
    at, lines = np.arange(0, rows, apart), frames[:, ::apart]
    across = min(_ACROSS, cols // RUN)
    if across < 2:
        return Sample(np.ascontiguousarray(lines)[:, :, None], at)
    # from one end of the lines to the other
    starts = np.arange(0, cols - RUN + 1, (cols - RUN) // (across - 1))
    runs = np.empty((len(frames), len(at), len(starts), RUN), frames.dtype)

    def fetch(first: int, last: int) -> None:
        fetch_runs(frames[first:last], at, starts, runs[first:last])

    # on small frames it takes less than waking a second thread
    over_rows(fetch, len(frames), -(-len(frames) // (threads() if frames[0].size > _LARGE else 1)))
    return Sample(runs, at)


def quantile(values: NDArray[Any], share: float) -> float:
    """The value that this share of the values does not exceed (np.quantile takes five times as long)."""
    at = int(share * (len(values) - 1))
    return float(np.partition(values, at)[at])
