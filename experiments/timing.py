"""How long calls and stages take, by the clock and of the processor, and how much memory."""

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
BUDGET = 1.0  # s, that repeated runs may take together
LONG = 2.0  # s, from which a stage is not run again: tracing costs it a few per cent


@dataclass(frozen=True, slots=True)
class Measured:
    """What a call gave, its seconds by the clock and of the processor, and its peak memory above what was
    there before (bytes; None: unknown).
    """

    value: Any
    seconds: float
    processor: float
    bytes: int | None = None


def timed(call: Callable[[], Any]) -> Measured:
    """Make a call and look at the clocks."""
    start, processor = time.perf_counter(), time.process_time()
    value = call()
    return Measured(value, time.perf_counter() - start, time.process_time() - processor)


def in_turn(*calls: Callable[[], Any], count: int) -> list[tuple[Measured, ...]]:
    """Make each of the calls so many times, by turns, so that all meet the same load."""
    return [tuple(timed(call) for call in calls) for _ in range(count)]


def fastest(call: Callable[[], Any], runs: int, budget: float) -> Measured:
    """The fastest of so many calls, fewer once they took more seconds than a budget together."""
    taken = [timed(call)]
    while len(taken) < runs and sum(run.seconds for run in taken) <= budget:
        taken.append(timed(call))
    return min(taken, key=lambda run: run.seconds)


def measured(call: Callable[[], Any]) -> Measured:
    """Memory from a first run under tracemalloc, which also warms caches and compiles; then the least of up
    to three timed runs. A stage of more than two seconds runs once.
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
    """The floor: read all frames; write u, v, two sigmas, amplitude, offset, order error in float32, flags,
    as decode. Into the same memory every time: clearing what is new takes longer than writing it.
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
    """A clock for stages that run one after the other, and the word to whoever watches."""

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
        """Of every stage, and `total`."""
        return self._seconds | {"total": sum(self._seconds.values())}


@dataclass(frozen=True)
class Run:
    """What a study tells of itself: seconds of its stages and `total`, memory, what was asked for (plain
    values)."""

    seconds: dict[str, float]
    peak_bytes: int
    settings: dict[str, Any]

    def run_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return {"seconds": self.seconds, "peak_bytes": self.peak_bytes, "settings": self.settings}

    def with_report(self, seconds: float) -> Self:
        """The same run after its report was written, which took so long."""
        stages = {name: own for name, own in self.seconds.items() if name not in ("report", "total")}
        stages["report"] = seconds
        return replace(self, seconds=stages | {"total": sum(stages.values())}, peak_bytes=peak_bytes())
