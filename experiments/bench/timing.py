"""How long a stage takes and how much memory: first traced, uncounted, then the best of a few runs."""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["Measured", "measured", "once"]

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


def once(call: Callable[[], Any]) -> Measured:
    """Run a stage and look at the clock."""
    start = time.perf_counter()
    value = call()
    return Measured(value, time.perf_counter() - start)


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
