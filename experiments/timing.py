"""How long a call takes, by the clock and of the processor, and how much memory."""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

__all__ = ["Measured", "measured", "timed", "with_stage"]

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


def with_stage(seconds: dict[str, float], name: str, own: float) -> dict[str, float]:
    """Seconds of stages and of another one, `total` their sum."""
    stages = {each: value for each, value in seconds.items() if each not in (name, "total")} | {name: own}
    return stages | {"total": sum(stages.values())}


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
    runs: list[Measured] = []
    while len(runs) < RUNS and sum(run.seconds for run in runs) <= BUDGET:
        runs.append(timed(call))
    return replace(min(runs, key=lambda run: run.seconds), bytes=peak)
