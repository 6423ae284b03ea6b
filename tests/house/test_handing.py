"""Records that kernels hand on by their address."""

import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError, TypingError
from numba.typed import List
from numpy.typing import NDArray

from optolever.compiling import Usual, Within, only_within
from optolever.handing import handed_by_address


@handed_by_address
class Inner(NamedTuple):
    flags: NDArray[np.bool_]
    share: np.float32
    nothing: None
    on: bool


@handed_by_address
class Outer(NamedTuple):
    on: bool
    line: NDArray[np.float64]
    inner: Inner
    number: int
    block: NDArray[np.uint8]
    missing: Inner | None


def record(*, start: int = 0, missing: Inner | None = None) -> Outer:
    inner = Inner(np.array([True, False, True]), np.float32(0.25), None, False)
    block = np.arange(start, start + 24, dtype=np.uint8).reshape(2, 3, 4)
    return Outer(True, np.arange(5.0), inner, -7, block[:, :, ::2] if start else block, missing)


def part(function: Any) -> Any:
    return only_within(njit(_nrt=False, pipeline_class=Within)(function))


@part
def _told(inner: Inner, of: NDArray[np.float64]) -> None:
    of[0], of[2] = inner.share, 10.0 if inner.on else 20.0
    for x in range(len(inner.flags)):
        of[1] += inner.flags[x]
    if inner.nothing is None:
        of[3] = 30.0


@part
def _told_if_any(inner: Inner | None, of: NDArray[np.float64]) -> None:
    if inner is not None:
        _told(inner, of)


@part
def _all_of(outer: Outer, of: NDArray[np.float64]) -> None:
    _told(outer.inner, of)
    _told_if_any(outer.missing, of[10:])
    of[4], of[5] = outer.number, outer.block[1, 2, 1]
    of[6], of[7] = outer.block.shape[2], 1.0 if outer.on else 2.0
    for x in range(len(outer.line)):
        outer.line[x] += 1


@njit(pipeline_class=Usual)
def everything(outer: Outer, of: NDArray[np.float64]) -> None:
    _all_of(outer, of)


@pytest.mark.parametrize("missing", [None, Inner(np.ones(4, bool), np.float32(-1.5), None, True)])
@pytest.mark.parametrize("start", [0, 100])  # arrays in order, and not
def test_fields_arrive_through_two_functions(start: int, missing: Inner | None) -> None:
    told, found = record(start=start, missing=missing), np.zeros(20)
    everything(told, found)
    wanted = np.zeros(20)
    wanted[:8] = [0.25, 2, 20, 30, -7, told.block[1, 2, 1], told.block.shape[2], 1]
    wanted[10:14] = 0 if missing is None else [-1.5, 4, 10, 30]
    assert np.array_equal(found, wanted)
    assert np.array_equal(told.line, np.arange(1.0, 6.0))  # the arrays themselves, and not copies


@njit(pipeline_class=Usual)
def with_the_run_time(outer: Outer) -> float:
    line, total = outer.line, 0.0
    for x in range(3):
        line = outer.line[x:]
        total += line.sum() + outer.inner.flags.sum()
    return float(total)


def test_arrays_are_given_back() -> None:
    told = record(missing=Inner(np.ones(4, bool), np.float32(0), None, True))
    arrays = told.line, told.block, told.inner.flags, told.missing.flags if told.missing else None
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(5):
        everything(told, np.zeros(20))
        line = told.line.copy()
        assert with_the_run_time(told) == sum(line.sum() - line[:x].sum() for x in range(3)) + 6
    assert [sys.getrefcount(array) for array in arrays] == before


def test_they_cannot_be_kept_beyond_the_call() -> None:
    @njit
    def steps(outer: Outer) -> Any:
        yield outer.line[0]
        yield outer.line[1]

    for keep in (steps, lambda outer: List([outer])):
        with pytest.raises((NumbaError, NotImplementedError), match="cannot be kept"):
            keep(record())


def test_one_argument_each() -> None:
    everything(record(), np.zeros(20))
    code = next(iter(everything.inspect_llvm().values()))
    head = next(line for line in code.splitlines() if line.startswith("define") and "everything" in line)
    assert head.count("%arg.outer") == 1
    assert head.count("%arg.of") == 7  # an array of one dimension as ever: its numbers one by one


def test_fields_are_read_by_their_names() -> None:
    with pytest.raises(TypingError, match="nobody"):
        njit(lambda outer: outer.nobody)(record())
