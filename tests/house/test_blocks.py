"""Row blocks on threads: everything is done once, whatever the number of threads; exceptions come through."""

import os
import subprocess
import sys

import pytest
from threadpoolctl import threadpool_info

from optolever.blocks import THREADS_VARIABLE, blas_on_one, on_cores, over_blocks, over_rows


@pytest.fixture(params=["1", "2", "5"])
def some_threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, request.param)


@pytest.mark.usefixtures("some_threads")
@pytest.mark.parametrize(("rows", "block"), [(1, 64), (64, 64), (65, 64), (1000, 7)])
def test_every_row_is_done_once(rows: int, block: int) -> None:
    done: list[int] = []

    def work(start: int, stop: int) -> None:
        done.extend(range(start, stop))

    over_rows(work, rows, block)
    assert sorted(done) == list(range(rows))
    over_blocks(work, [*range(0, rows, block), rows])
    assert sorted(done) == sorted(2 * list(range(rows)))


@pytest.mark.usefixtures("some_threads")
def test_answers_keep_the_order_of_their_items() -> None:
    assert on_cores(lambda word: word.upper(), ["u", "v", "w"]) == ["U", "V", "W"]
    assert on_cores(lambda word: word, ()) == []


@pytest.mark.usefixtures("some_threads")
def test_exceptions_come_through() -> None:
    def fail(start: int, stop: int) -> None:
        raise ValueError(f"{start} {stop}")

    with pytest.raises(ValueError, match=r"\d+ \d+"):
        over_rows(fail, 100, 10)
    with pytest.raises(ZeroDivisionError):
        on_cores(lambda n: 1 // n, [1, 0])


@pytest.mark.parametrize("before", ["", "import scipy.linalg"])
def test_blas_has_as_many_threads(before: str) -> None:
    """NumPy's and SciPy's, loaded before or after."""
    code = f"""{before}
import optolever.blocks, scipy.linalg
from threadpoolctl import threadpool_info
print({{one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}})"""
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    words, environment = [sys.executable, "-c", code], clean | {THREADS_VARIABLE: "1"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "{1}"


def test_blas_on_one_thread() -> None:
    with blas_on_one():
        assert {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"} == {1}
