"""Wall-clock and processor time of calls and stages, and peak memory."""

import resource
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.kernels import kernel
from optolever.records import Progress

RUNS = 3  # timed runs of a short stage
BUDGET = 1.0  # s, of all repeated runs
LONG = 2.0  # s, above which a stage is not run again: tracing costs some per cent of its time


@dataclass(frozen=True, slots=True)
class Measured:
    """Value of a call, its wall-clock and processor seconds, and its additional peak memory (bytes; None:
    unknown).
    """

    value: Any
    seconds: float
    processor: float
    bytes: int | None = None


def timed(call: Callable[[], Any]) -> Measured:
    """Time a call."""
    start, processor = time.perf_counter(), time.process_time()
    value = call()
    return Measured(value, time.perf_counter() - start, time.process_time() - processor)


def in_turn(*calls: Callable[[], Any], count: int) -> list[tuple[Measured, ...]]:
    """Time each of the calls `count` times, interleaved, so that all meet the same load."""
    return [tuple(timed(call) for call in calls) for _ in range(count)]


def fastest(call: Callable[[], Any], runs: int, budget: float) -> Measured:
    """The fastest of up to `runs` calls; no further call once their sum exceeds `budget` seconds."""
    taken = [timed(call)]
    while len(taken) < runs and sum(run.seconds for run in taken) <= budget:
        taken.append(timed(call))
    return min(taken, key=lambda run: run.seconds)


def measured(call: Callable[[], Any]) -> Measured:
    """Memory from a first run under tracemalloc, which also warms caches and compiles; time from the fastest
    of up to three further runs. A stage of more than two seconds runs once.
    """
    tracemalloc.start()
    try:
        first = timed(call)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    if first.seconds >= LONG:
        return replace(first, bytes=peak)
    return replace(fastest(call, RUNS, BUDGET), bytes=peak)


@kernel
def _touch(start: int, stop: int, frames: Any, maps: Any, flags: Any) -> None:
    """Read every frame, write outputs of the same size."""
    cols = frames.shape[2]
    total = np.empty(cols, np.float32)
    for row in range(start, stop):
        total[:] = 0
        for i in range(frames.shape[0]):
            for x in range(cols):
                total[x] += np.float32(frames[i, row, x])
        for chart in maps:
            for x in range(cols):
                chart[row, x] = total[x]
        for x in range(cols):
            flags[row, x] = np.uint16(total[x])


def toucher(frames: NDArray[Any]) -> Callable[[], None]:
    """The floor of a decoder's time: read all frames; write u, v, two sigmas, amplitude, offset, order error
    in float32, and flags. The outputs are reused: clearing new memory takes longer than writing to it.
    """
    size = frames.shape[1:]
    maps = tuple(np.empty(size, np.float32) for _ in range(7))
    flags = np.empty(size, np.uint16)

    def touch() -> None:
        over_rows(lambda start, stop: _touch(start, stop, frames, maps, flags), size[0], 32)

    return touch


def peak_bytes() -> int:
    """The largest resident memory of this process so far, in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


class Stages:
    """A clock for consecutive stages, with progress reports."""

    def __init__(self, count: int, progress: Progress) -> None:
        self._seconds: dict[str, float] = {}
        self._count, self._progress = count, progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under this name."""
        self._progress(name, len(self._seconds), self._count)
        start = time.perf_counter()
        yield
        self._seconds[name] = time.perf_counter() - start
        self._progress(name, len(self._seconds), self._count)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each stage, and `total`."""
        return self._seconds | {"total": sum(self._seconds.values())}


@dataclass(frozen=True)
class Run:
    """Record of a study's run: seconds of its stages and `total`, memory, settings (plain values)."""

    seconds: dict[str, float]
    peak_bytes: int
    settings: dict[str, Any]

    def run_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return {"seconds": self.seconds, "peak_bytes": self.peak_bytes, "settings": self.settings}

    def with_report(self, seconds: float) -> Self:
        """The run with `seconds` as the time of its report."""
        stages = {name: own for name, own in self.seconds.items() if name not in ("report", "total")}
        stages["report"] = seconds
        return replace(self, seconds=stages | {"total": sum(stages.values())}, peak_bytes=peak_bytes())
