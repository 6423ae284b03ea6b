"""Garbage while kernels compile."""

import gc
from typing import Any

import pytest

from optolever.compiling import uncollected


class Knot:
    def __init__(self) -> None:
        self.own = self


@pytest.fixture
def searches() -> Any:
    seen: list[str] = []

    def noted(phase: str, _info: Any) -> None:
        seen.append(phase)

    gc.collect()
    gc.callbacks.append(noted)
    yield seen
    gc.callbacks.remove(noted)


def test_many_new_objects_are_not_searched_at_once(searches: list[str]) -> None:
    with uncollected():
        assert not gc.isenabled()
        made = [Knot() for _ in range(150_000)]
    assert gc.isenabled()
    assert len([[] for _ in range(100)]) == 100
    assert not searches
    del made
    assert gc.collect() >= 150_000  # but they are found


def test_few_are_searched_as_ever(searches: list[str]) -> None:
    with uncollected():
        made = [Knot() for _ in range(3000)]
    assert len([[] for _ in range(3000)]) == len(made)
    assert searches


def test_what_a_program_froze_stays_frozen() -> None:
    gc.freeze()
    try:
        frozen = gc.get_freeze_count()
        with uncollected():
            made = [Knot() for _ in range(150_000)]
        assert len(made) == 150_000
        assert gc.get_freeze_count() == frozen > 0
    finally:
        gc.unfreeze()


def test_within_one_another_and_where_it_was_off() -> None:
    gc.disable()
    try:
        with uncollected(), uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
    finally:
        gc.enable()
