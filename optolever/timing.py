"""Processor time of calls, seconds of stages, peak memory."""

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from optolever.records import Progress


class Measured(NamedTuple):
    """Value of a call, its processor seconds."""

    value: Any
    processor: float


def timed(call: Callable[[], Any]) -> Measured:
    """Time a call."""
    start = time.process_time()
    return Measured(call(), time.process_time() - start)


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
