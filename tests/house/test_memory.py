"""Memory of large arrays: used again when nobody holds it, and not before."""

import gc
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from optolever import memory
from optolever.memory import roomy_empty

SHAPE = (1024, 1100)


def kept() -> int:
    return sum(size * len(rooms) for size, rooms in memory._kept.items())


def test_memory_of_a_dropped_array_is_used_again() -> None:
    first = roomy_empty(SHAPE, np.float32)
    first[...] = 1.0
    place = first.ctypes.data
    assert place % (1 << 21) == 0
    del first
    again = roomy_empty(SHAPE, np.float32)
    assert again.ctypes.data == place
    assert again.flags.writeable
    assert again.flags.c_contiguous


def test_memory_is_held_by_any_view() -> None:
    array = roomy_empty(SHAPE, np.float64)
    array[...] = 3.0
    view = array.reshape(-1)[5:500][::2]
    del array
    gc.collect()
    other = roomy_empty(SHAPE, np.float64)
    other[...] = 7.0
    assert (view == 3.0).all()
    assert not np.shares_memory(view, other)


def test_arrays_in_use_are_apart() -> None:
    with ThreadPoolExecutor(4) as pool:
        arrays = list(pool.map(lambda k: (k, roomy_empty(SHAPE, np.float32)), range(12)))
    for k, array in arrays:
        array[...] = k
    assert all((array == k).all() for k, array in arrays)


def test_no_more_than_a_quarter_gigabyte_is_kept() -> None:
    arrays = [roomy_empty((4096 + 64 * k, 4096), np.float32) for k in range(6)]
    assert len({array.ctypes.data for array in arrays}) == 6
    del arrays
    assert 0 < kept() <= 1 << 28
    huge = roomy_empty((9000, 9000), np.float32)
    before = kept()
    del huge
    assert kept() == before
