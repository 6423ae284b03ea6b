"""How kernels are compiled."""

import numpy as np
import pytest
from numba import njit

from optolever.decode.jit import apart_kernel, fast_kernel, leaf_kernel, outer_kernel


@pytest.mark.parametrize("decorate", [leaf_kernel, fast_kernel, apart_kernel])
def test_parts_of_kernels_run_in_their_callers_only(decorate):
    @decorate
    def double(values, out):
        for x in range(len(values)):
            out[x] = 2 * values[x]

    @njit
    def caller(values, out):
        double(values, out)

    out = np.zeros(40, np.float32)
    caller(np.arange(40, dtype=np.float32), out)
    assert np.array_equal(out, 2 * np.arange(40))
    # numba's C code would call what is not there
    for _ in range(2):
        with pytest.raises(TypeError, match="double is compiled into its callers"):
            double(out, out)


def test_outer_kernels_are_called_from_python():
    @outer_kernel
    def total(values):
        left = 0.0
        for x in values:
            left += x
        return left

    assert total(np.arange(4.0)) == 6
