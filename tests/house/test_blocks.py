"""Row blocks on threads: exceptions come through; one thread is one thread of BLAS, too."""

import os
import subprocess
import sys
import threading
import time

import pytest

from optolever.blocks import THREADS_VARIABLE, on_cores, over_rows


@pytest.mark.parametrize("threads", ["1", "5"])
def test_exceptions_come_through(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, threads)

    def fail(start: int, stop: int | str) -> None:
        raise ValueError(f"{start} {stop}")

    with pytest.raises(ValueError, match=r"\d+ \d+"):
        over_rows(fail, 100, 10)
    for _ in range(20):
        with pytest.raises(ValueError, match="2 first"):  # whichever thread is faster
            on_cores(lambda n: fail(n, "first" if n == 2 else "later") if n > 1 else n, range(40))


def test_nobody_begins_a_block_after_an_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, "2")
    interrupted, done = threading.Event(), list[int]()

    def work(start: int, stop: int) -> None:
        if threading.current_thread() is threading.main_thread():
            interrupted.set()
            raise KeyboardInterrupt
        interrupted.wait(60)
        done.append(start)
        time.sleep(0.001)

    with pytest.raises(KeyboardInterrupt):
        over_rows(work, 10_000, 1)
    assert len(done) < 9_000


def test_blas_has_as_many_threads() -> None:
    code = """import optolever.blocks, scipy.linalg
from threadpoolctl import threadpool_info
print({one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})"""
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    words, environment = [sys.executable, "-c", code], clean | {THREADS_VARIABLE: "1"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "{1}"
