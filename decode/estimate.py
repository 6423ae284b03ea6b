"""Estimate: intermediate result of one axis for a block of rows; and small probabilities."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import Real, inlined

__all__ = ["Estimate", "Line", "less_likely", "vanishing"]

F32 = NDArray[np.float32]
#: A row of each array of an `Estimate`, (W,).
Line = tuple[F32, F32, F32, F32, F32, F32, F32]
_ONE = np.float32(1)


class Estimate(NamedTuple):
    """One axis over R rows of W pixels; every array is (R, W) float32, written in place by the steps.

    coordinate  pattern pixels, integer = pixel centre; NaN: not decoded
    variance    of the coordinate, px^2
    error       probability that the fringe order or a bit is wrong, 0..1
    amplitude   of the modulation, camera levels (half of white minus black)
    offset      mean level
    chi2        squared residuals over their variance, summed over the degrees of freedom
    clipped     number of samples at the white level
    """

    coordinate: F32
    variance: F32
    error: F32
    amplitude: F32
    offset: F32
    chi2: F32
    clipped: F32

    @classmethod
    def empty(cls, rows: int, cols: int) -> "Estimate":
        """An Estimate of zeros: a look-up skips pixels without a start."""
        return cls(*np.zeros((7, rows, cols), np.float32))


@inlined
def vanishing(x: Real) -> Real:
    """Upper bound of exp(-x), x >= 0, float32: (1 + x / 256)^-256 is 1.2 times exp(-x) at x = 10."""
    return _ONE / _growing(x)


@inlined
def less_likely(x: Real) -> Real:
    """Posterior of the less likely of two hypotheses, with a likelihood ratio of exp(-x), x >= 0."""
    return _ONE / (_ONE + _growing(x))


@inlined
def _growing(x: Real) -> Real:
    """Lower bound of exp(x), float32, infinite from x = 106 on."""
    y = _ONE + x * np.float32(1 / 256)
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y
