"""Memory of large arrays: used again when nobody holds it, and not before."""

import gc
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from optolever.memory import roomy_empty

SHAPE = (1024, 1100)


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
