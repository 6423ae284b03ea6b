"""Some pixels from all over the frames, fetched once: on them noise is measured, constraints are tested."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from optolever.blocks import over_rows, threads
from optolever.memory import roomy_empty

__all__ = ["Sample", "quantile", "quantiles", "sampled"]

#: Lines and runs on each of them at most, pixels in a run: a run costs as much to fetch as one pixel.
_LINES, _ACROSS, _RUN = 64, 16, 8


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
    across = min(_ACROSS, cols // _RUN)
    if across < 2:
        return Sample(np.ascontiguousarray(lines)[:, :, None], at)
    # from one end of the lines to the other
    runs = sliding_window_view(lines, _RUN, axis=2)[:, :, :: (cols - _RUN) // (across - 1)]
    fetched = roomy_empty(runs.shape, runs.dtype)

    def fetch(start: int, stop: int) -> None:
        fetched[start:stop] = runs[start:stop]

    over_rows(fetch, len(runs), -(-len(runs) // threads()))  # it is memory that a fetch waits for
    return Sample(fetched, at)


def quantile(values: NDArray[Any], share: float) -> float:
    """The value that this share of the values does not exceed (np.quantile takes five times as long)."""
    at = int(share * (len(values) - 1))
    return float(np.partition(values, at)[at])


def quantiles(values: NDArray[Any], shares: Sequence[float]) -> list[float]:
    """quantile for several shares at once."""
    at = [int(share * (len(values) - 1)) for share in shares]
    sorted_there = np.partition(values, at)
    return [float(sorted_there[k]) for k in at]
