"""Numbers and parts of arrays in functions without numba's run time, against NumPy."""

from typing import Any

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from optolever.compiling import Usual

Array = NDArray[Any]
RNG = np.random.default_rng(7)


def lean(function: Any) -> Any:
    return njit(_nrt=False, error_model="numpy", pipeline_class=Usual)(function)


@lean
def _sum(line: Array) -> float:
    total = 0.0
    for x in range(len(line)):
        total = 1.5 * total + line[x]
    return total


@lean
def _read(block: Array, i: int, j: int, k: int, out: Array) -> None:
    out[0] = block[i, j, k]
    out[1] = _sum(block[i, j])
    out[2] = _sum(block[i][j, 1:])
    out[3] = _sum(block[i, :, k])
    out[4] = _sum(block[:, j, k][::-2])
    out[5] = _sum(block[i, -3:-1, 2:][1])
    out[6], out[7], out[8] = len(block), len(block[i]), len(block[i, j, 3:])
    out[9] = _sum(block[i, j, k:k])


def _by_numpy(block: Array, i: int, j: int, k: int) -> list[float]:
    parts = [
        block[i, j],
        block[i][j, 1:],
        block[i, :, k],
        block[:, j, k][::-2],
        block[i, -3:-1, 2:][1],
    ]
    sums = [_sum.py_func(part) for part in parts]
    return [float(block[i, j, k]), *sums, len(block), len(block[i]), len(block[i, j, 3:]), 0.0]


BLOCK = RNG.integers(-90, 90, (4, 5, 6))


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int8, np.uint16, np.bool_])
@pytest.mark.parametrize("order", ["C", "F", "apart", "backwards"])
@pytest.mark.parametrize("place", [(1, 2, 3), (-1, -5, -6), (0, 4, -1), (3, 0, 5)])
def test_reading(kind: Any, order: str, place: tuple[int, int, int]) -> None:
    block = np.array(abs(BLOCK) if kind is np.uint16 else BLOCK).astype(kind)
    if order == "F":
        block = np.asfortranarray(block)
    elif order == "apart":
        wide = np.zeros((4, 10, 18), kind)
        wide[:, ::2, ::3] = block
        block = wide[:, ::2, ::3]
    elif order == "backwards":
        block = block[::-1, :, ::-1]
    out = np.zeros(10)
    _read(block, *place, out)
    assert np.array_equal(out, _by_numpy(block, *place))


@pytest.mark.parametrize("index", [np.uint8, np.int16, np.uint64, np.int64])
def test_indices_of_all_kinds(index: Any) -> None:
    block, out = BLOCK.astype(np.float64), np.zeros(10)
    place = index(2), index(3), index(4)
    _read(block, *place, out)
    assert np.array_equal(out, _by_numpy(block, 2, 3, 4))


@pytest.mark.parametrize("run_time", [False, True])
def test_nothing_as_an_index_is_numbas(run_time: bool) -> None:
    number = njit(_nrt=run_time)(lambda array: array[()])
    assert number(np.array(3.0)) == 3.0


def test_a_constant_that_is_no_index_from_the_start() -> None:
    most = 2**64 - 1
    line = np.arange(10.0)
    assert njit(_nrt=False)(lambda array: array[np.int64(most)])(line[5:]) == 9.0
    assert njit(_nrt=False)(lambda array: array[-2])(line[5:]) == 8.0


@lean
def _put(block: Array, i: int, j: int, number: Any, line: Array, flag: Array) -> None:
    block[i, j] = number
    block[i + 1][j] = number + 1
    line[-1] = number
    line[j] = 3
    flag[i] = number > 0
    block[0, 1:3] = number  # numba's own
    block[i + 2] = 7


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int16, np.uint8])
@pytest.mark.parametrize("order", ["C", "F"])
def test_writing(kind: Any, order: str) -> None:
    told = [np.array(BLOCK[0], kind, order=order), np.zeros(5, kind), np.zeros(4, bool)]
    wanted = [each.copy(order="K") for each in told]
    _put(told[0], 1, 2, 41, told[1], told[2])
    _put.py_func(wanted[0], 1, 2, 41, wanted[1], wanted[2])
    assert all(np.array_equal(one, other) for one, other in zip(told, wanted, strict=True))
    _put(told[0], -4, -2, 9, told[1], told[2])
    _put.py_func(wanted[0], -4, -2, 9, wanted[1], wanted[2])
    assert all(np.array_equal(one, other) for one, other in zip(told, wanted, strict=True))


def test_with_the_run_time_numba_does_it() -> None:
    @njit(pipeline_class=Usual)
    def work(block: Array) -> Array:
        part = block[1]
        part[2] = -5.0
        return part[1:]

    block = BLOCK[0].astype(np.float64)
    part = work(block)
    assert np.array_equal(part, block[1, 1:])
    assert block[1, 2] == -5.0


def test_nothing_goes_through_memory(handed_to_llvm: dict[str, str]) -> None:
    """Of what is handed to LLVM, before anything is optimised."""

    def work(block: Array, i: int, j: int) -> float:
        return float(block[i, j] + block[i][j] + len(block))

    for run_time in (False, True):
        njit(_nrt=run_time)(work).compile("(float64[:, ::1], int64, int64)")
    ours, theirs = (text for name, text in handed_to_llvm.items() if "work$" in name)
    array = "alloca {i8*, i8*, i64, i64, double*, [2 x i64], [2 x i64]}"
    assert theirs.count(array) > ours.count(array) == 0
    assert len(ours.splitlines()) < 0.6 * len(theirs.splitlines())
