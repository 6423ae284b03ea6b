"""How long a call takes, by the clock and of the processor, and how much memory."""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["Measured", "measured", "once", "timed", "with_stage"]

RUNS = 3  # timed runs of a short stage
BUDGET = 1.0  # s, that repeated runs may take together
LONG = 2.0  # s, from which a stage is not run again: tracing costs it a few per cent


@dataclass(frozen=True, slots=True)
class Measured:
    """What a stage gave, its seconds, and its peak memory above what was there before (bytes; None:
    unknown).
    """

    value: Any
    seconds: float
    bytes: int | None = None


def timed(call: Callable[[], Any]) -> tuple[Any, float, float]:
    """What a call gives, its seconds by the clock and of the processor."""
    start, processor = time.perf_counter(), time.process_time()
    value = call()
    return value, time.perf_counter() - start, time.process_time() - processor


def with_stage(seconds: dict[str, float], name: str, own: float) -> dict[str, float]:
    """Seconds of stages and of another one, `total` their sum."""
    stages = {each: value for each, value in seconds.items() if each not in (name, "total")} | {name: own}
    return stages | {"total": sum(stages.values())}


def once(call: Callable[[], Any]) -> Measured:
    """Run a stage and look at the clock."""
    value, seconds, _ = timed(call)
    return Measured(value, seconds)


def measured(call: Callable[[], Any]) -> Measured:
    """Memory from a first run under tracemalloc, which also warms caches and compiles; then the least of up
    to three timed runs. A stage of more than two seconds runs once.
    """
    tracemalloc.start()
    try:
        first = once(call)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    if first.seconds >= LONG:
        return Measured(first.value, first.seconds, peak)
    best, spent = float("inf"), 0.0
    for _ in range(RUNS):
        seconds = once(call).seconds
        best, spent = min(best, seconds), spent + seconds
        if spent > BUDGET:
            break
    return Measured(first.value, best, peak)
