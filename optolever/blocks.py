"""Row blocks on threads: the one way in which work is spread over cores (kernels release the GIL)."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

__all__ = ["over_rows", "threads"]


def threads() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def over_rows(work: Callable[[int, int], None], rows: int, block: int = 64) -> None:
    """Call work(start, stop) for blocks that cover range(rows), on all cores; exceptions come through."""
    starts = range(0, rows, block)
    if threads() == 1 or len(starts) == 1:
        for start in starts:
            work(start, min(start + block, rows))
        return
    with ThreadPoolExecutor(threads()) as pool:
        for future in [pool.submit(work, start, min(start + block, rows)) for start in starts]:
            future.result()
