"""Row blocks on threads: everything is done once, whatever the number of threads; exceptions come through."""

import threading
from itertools import pairwise

import pytest

from optolever.blocks import THREADS_VARIABLE, on_cores, over_blocks, over_rows, shrinking


@pytest.fixture(params=["1", "2", "5"])
def some_threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, request.param)


@pytest.mark.usefixtures("some_threads")
@pytest.mark.parametrize(("rows", "block"), [(1, 64), (64, 64), (65, 64), (1000, 7)])
def test_every_row_is_done_once(rows: int, block: int) -> None:
    done: list[int] = []
    beside: list[int] = []

    def work(start: int, stop: int) -> None:
        done.extend(range(start, stop))

    over_rows(work, rows, block)
    assert sorted(done) == list(range(rows))
    over_blocks(work, shrinking(rows, block), meanwhile=lambda: beside.append(threading.get_ident()))
    assert sorted(done) == sorted(2 * list(range(rows)))
    assert beside == [threading.get_ident()]


@pytest.mark.usefixtures("some_threads")
@pytest.mark.parametrize("rows", [1, 16, 17, 1080])
def test_blocks_shrink_to_the_least(rows: int) -> None:
    cuts = shrinking(rows, 16)
    sizes = [stop - start for start, stop in pairwise(cuts)]
    assert cuts[0] == 0
    assert cuts[-1] == rows
    assert sizes == sorted(sizes, reverse=True)
    assert all(size % 16 == 0 for size in sizes[:-1])
    assert sizes[-1] <= 16


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
