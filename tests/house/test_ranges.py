"""Counting in functions without numba's run time, against Python."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from numba import njit, types
from numpy.typing import NDArray

from optolever.compiling import Usual

Array = NDArray[Any]


def lean(function: Any) -> Any:
    return njit(_nrt=False, pipeline_class=Usual)(function)


@lean
def _count(start: int, stop: int, step: int, seen: Array) -> int:
    count = 0
    for x in range(start, stop, step):
        seen[count] = x
        count += 1
    return count


def test_as_python_counts() -> None:
    seen = np.zeros(64, np.int64)
    ends, steps = (-7, -3, -1, 0, 1, 2, 6, 11), (-12, -5, -2, -1, 1, 2, 3, 4, 19)
    for start, stop, step in product(ends, ends, steps):
        count = _count(start, stop, step, seen)
        assert seen[:count].tolist() == list(range(start, stop, step)), (start, stop, step)


def test_at_the_ends_of_what_whole_numbers_hold() -> None:
    seen, last = np.zeros(64, np.int64), np.iinfo(np.int64).max
    count = _count(last - 5, last, 2, seen)
    assert seen[:count].tolist() == [last - 5, last - 3, last - 1]
    count = _count(-last + 3, -last, -1, seen)
    assert seen[:count].tolist() == [-last + 3, -last + 2, -last + 1]


def test_no_step_is_an_error() -> None:
    with pytest.raises(ValueError, match="must not be zero"):
        _count(0, 5, 0, np.zeros(4, np.int64))


@lean
def _triangle(rows: int, seen: Array) -> int:
    total, x = 0, -1
    for y in range(rows):
        for x in range(1, y):
            if x == 5:
                break
            if (x + y) % 3 == 0:
                continue
            seen[y, x] += 1
            total += x
        total += 10 * x
    return total + len(range(rows, 0, -2))


@pytest.mark.parametrize("rows", [0, 1, 2, 9])
def test_loops_in_loops(rows: int) -> None:
    found, wanted = np.zeros((2, 10, 10), np.int64)
    assert _triangle(rows, found) == _triangle.py_func(rows, wanted)
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize("kind", [types.int32, types.uint64, types.int64])
def test_other_counts_and_functions_with_the_run_time_are_numbas(kind: types.Type) -> None:
    made = njit(lambda n: [2 * x for x in range(n)], pipeline_class=Usual)
    made.compile((kind,))
    assert made(5) == [0, 2, 4, 6, 8]
