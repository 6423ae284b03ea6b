"""Variables in functions without numba's run time."""

from typing import Any

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from optolever.compiling import Usual

Array = NDArray[Any]


def _tangled(line: Array, limit: float, found: Array) -> int:
    """Variables set in some branches, that change places, that outlive their loop, that are parts."""
    before, here, count = 0.0, line[0], 0
    for x in range(len(line)):
        here, before = line[x], here
        if here > limit:
            width = x - count
            if before > limit:
                width = -width
            found[count] = width
            count += 1
        elif here < -limit:
            part = line[x:]
            found[count] = part[0] + len(part)
            count += 1
            if count > 7:
                break
        else:
            here = before
    return count if here > before else -count


@pytest.mark.parametrize("limit", [0.0, 0.4, 1.5, 9.0])
def test_as_python_does_it(limit: float) -> None:
    lean = njit(_nrt=False, pipeline_class=Usual)(_tangled)
    for seed in range(20):
        line = np.random.default_rng(seed).normal(size=17)
        found, wanted = np.zeros((2, 17))
        assert lean(line, limit, found) == _tangled(line, limit, wanted)
        assert np.array_equal(found, wanted)


def test_less_is_handed_to_llvm(handed_to_llvm: dict[str, str]) -> None:
    for way in ({"pipeline_class": Usual}, {}):
        njit(_nrt=False, **way)(_tangled).compile("(float64[::1], float64, float64[::1])")
    ours, theirs = (text.splitlines() for name, text in handed_to_llvm.items() if "_tangled$" in name)
    assert len(ours) < 0.8 * len(theirs)


def test_with_the_run_time_arrays_live_as_long_as_they_are_used() -> None:
    @njit(pipeline_class=Usual)
    def work(count: int) -> Array:
        kept = np.zeros(4)
        for x in range(count):
            fresh = np.full(4, x)
            if x % 3 == 1:
                kept = kept + fresh
        return kept

    assert work(50).tolist() == [sum(range(1, 50, 3))] * 4
