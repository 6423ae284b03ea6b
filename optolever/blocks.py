"""Row blocks on threads: the one way in which work is spread over cores (kernels release the GIL)."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

__all__ = ["ONE_THREAD", "THREADS_VARIABLE", "over_rows", "threads"]

THREADS_VARIABLE = "OPTOLEVER_THREADS"
"""Environment variable: how many threads to use, instead of all cores that the process may use."""

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMBA", "LP")  # LP: Mesa's software rasteriser
ONE_THREAD = {THREADS_VARIABLE: "1"} | {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}
"""Environment of a process that shall use one thread, set before it loads NumPy: then sums are the same to
the last bit wherever they are made.
"""


def threads() -> int:
    """Cores that this process may use."""
    wanted = os.environ.get(THREADS_VARIABLE, "")
    if wanted.isdecimal() and int(wanted) > 0:
        return int(wanted)
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
