"""Estimate: what one axis tells of every pixel of a block of rows, on its way to a Correspondence; and small
probabilities."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import inlined

__all__ = ["Estimate", "less_likely", "vanishing"]

F32 = NDArray[np.float32]
_ONE = np.float32(1)


class Estimate(NamedTuple):
    """One axis over R rows of W pixels; every array is (R, W) float32, written in place by the steps.

    coordinate  pattern pixels, integer = pixel centre; NaN: nothing was decoded
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
        """Room for one, all 0: a look-up leaves out pixels that have no start."""
        return cls(*np.zeros((7, rows, cols), np.float32))


@inlined
def vanishing(x: Any) -> Any:
    """exp(-x) for x >= 0 from above, float32: (1 + x / 256)^-256 is 1.2 times that at x = 10."""
    return _ONE / _growing(x)


@inlined
def less_likely(x: Any) -> Any:
    """Probability of the one of two that is exp(-x) times as likely, x >= 0."""
    return _ONE / (_ONE + _growing(x))


@inlined
def _growing(x: Any) -> Any:
    """exp(x) from below, float32, infinite from x = 106 on."""
    y = _ONE + x * np.float32(1 / 256)
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y
