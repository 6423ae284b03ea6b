"""Row blocks on threads: the one way in which work is spread over cores (kernels release the GIL)."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

__all__ = [
    "ONE_THREAD", "THREADS_VARIABLE", "Work", "at_once", "blas_on_one", "on_cores", "over_blocks",
    "over_image", "over_rows", "threads",
]  # fmt: skip

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[int, int], None]
"""What is done to rows start..stop."""

THREADS_VARIABLE = "OPTOLEVER_THREADS"
"""Environment variable: how many threads to use, instead of all cores that the process may use."""

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMBA", "LP")  # LP: Mesa's software rasteriser
ONE_THREAD = {THREADS_VARIABLE: "1"} | {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}
"""Environment of a process that shall use one thread, set before it loads NumPy: then sums are the same to
the last bit wherever they are made.
"""

_LARGEST = (1 << 25) - (1 << 13)  # bytes: the largest block whose release raises glibc's threshold
_SMALL = 1 << 15  # pixels that one thread has done before a second one is awake


def threads() -> int:
    """Cores that this process may use."""
    wanted = os.environ.get(THREADS_VARIABLE, "")
    if wanted.isdecimal() and int(wanted) > 0:
        return int(wanted)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@lru_cache(maxsize=2)
def _libraries(scipy: bool) -> ThreadpoolController:
    """NumPy's BLAS and, where it is loaded, SciPy's, which is another one."""
    return ThreadpoolController()


@contextmanager
def blas_on_one() -> Iterator[None]:
    """BLAS on one thread, for systems of some hundred unknowns: more threads mostly wait for each other, on a
    busy machine 100 ms at a time. Also a decorator."""
    with _libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
        yield


def _limit_blas() -> None:
    """`OPTOLEVER_THREADS` holds for BLAS too: for what is loaded, and for what is loaded later."""
    if os.environ.get(THREADS_VARIABLE):
        threadpool_limits(threads(), user_api="blas")
        for name in ("OPENBLAS", "MKL"):
            os.environ.setdefault(f"{name}_NUM_THREADS", str(threads()))


def over_rows(work: Work, rows: int, block: int = 64) -> None:
    """Call work(start, stop) for blocks that cover range(rows), on all cores; exceptions come through."""
    over_blocks(work, [*range(0, rows, block), rows])


def over_blocks(work: Work, cuts: Sequence[int]) -> None:
    """Call work(start, stop) for what lies between cuts, on all cores; exceptions come through.

    Threads that have not begun when the calling one is done are not waited for: work may call over_rows.
    """
    blocks = list(pairwise(cuts))
    count = min(threads(), len(blocks)) - 1
    if count < 1:
        for start, stop in blocks:
            work(start, stop)
        return
    left = iter(blocks)

    def share() -> None:
        for start, stop in left:  # next() of a list's iterator is one step under the GIL
            work(start, stop)

    helpers = [_pool(os.getpid(), threads()).submit(share) for _ in range(count)]
    try:
        share()
    finally:
        for _ in left:  # after an error or Ctrl-C nobody begins another block
            pass
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def on_cores(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """[work(item) for item in items], on all cores; of several errors the first item's comes through."""
    done = [Future[Result]() for _ in items]

    def one(start: int, _: int) -> None:
        try:
            done[start].set_result(work(items[start]))
        except Exception as error:
            done[start].set_exception(error)

    over_rows(one, len(items), 1)
    return [each.result() for each in done]


def at_once(*calls: Callable[[], Any]) -> list[Any]:
    """Results of different calls, on all cores."""
    return on_cores(lambda each: each(), calls)


def over_image(work: Work, shape: tuple[int, ...]) -> None:
    """over_rows for kernels of a few operations a pixel: small images stay on the calling thread."""
    rows, cols = shape[:2]
    block = max(16, -(-_SMALL // max(cols, 1)))
    if rows <= block:
        work(0, rows)
    else:
        over_rows(work, rows, block)


@lru_cache(maxsize=4)
def _pool(process: int, size: int) -> ThreadPoolExecutor:
    """Threads that stay: starting one costs as much as a small image. A forked process has none of them."""
    _keep_freed_memory()
    return ThreadPoolExecutor(size, thread_name_prefix="optolever")


def _keep_freed_memory() -> None:
    """glibc keeps freed memory for the next arrays, up to twice the largest block of at most 32 MiB that was
    freed (man mallopt, M_MMAP_THRESHOLD); until then each array is mapped and faulted in anew."""
    import numpy as np  # not for those who ask for ONE_THREAD alone

    np.empty(_LARGEST, np.uint8)


_limit_blas()
