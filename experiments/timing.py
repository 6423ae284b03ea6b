"""Wall-clock and processor time of calls and stages, and peak memory."""

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from optolever.records import Progress


@dataclass(frozen=True, slots=True)
class Measured:
    """Value of a call, its wall-clock and processor seconds."""

    value: Any
    seconds: float
    processor: float


def timed(call: Callable[[], Any]) -> Measured:
    """Time a call."""
    start, processor = time.perf_counter(), time.process_time()
    value = call()
    return Measured(value, time.perf_counter() - start, time.process_time() - processor)


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
