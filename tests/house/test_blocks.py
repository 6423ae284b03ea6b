"""Row blocks on threads: everything is done once, whatever the number of threads; exceptions come through."""

import threading

import pytest

from optolever.blocks import THREADS_VARIABLE, on_cores, over_blocks, over_rows


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
    over_blocks(work, [*range(0, rows, block), rows], meanwhile=lambda: beside.append(threading.get_ident()))
    assert sorted(done) == sorted(2 * list(range(rows)))
    assert beside == [threading.get_ident()]


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
