"""Estimate: what one axis tells of every pixel of a block of rows, on its way to a Correspondence."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Estimate"]

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Estimate:
    """One axis over R rows of W pixels; every array is (R, W) float32, written in place by the steps.

    coordinate  pattern pixels, integer = pixel centre; NaN: nothing was decoded
    variance    of the coordinate, px^2
    error       probability that the fringe order or a bit is wrong, 0..1
    amplitude   of the modulation, camera levels (half of white minus black)
    offset      mean level
    chi2        squared residuals over their variance, summed over `freedom` degrees of freedom
    clipped     number of samples at the white level
    freedom     degrees of freedom of chi2
    """

    coordinate: F32
    variance: F32
    error: F32
    amplitude: F32
    offset: F32
    chi2: F32
    clipped: F32
    freedom: int

    @classmethod
    def empty(cls, rows: int, cols: int, freedom: int) -> "Estimate":
        """Room for one, all 0: a look-up leaves out pixels that have no start."""
        place, variance, error, amplitude, offset, chi2, clipped = np.zeros((7, rows, cols), np.float32)
        return cls(place, variance, error, amplitude, offset, chi2, clipped, freedom)

    def arrays(self) -> tuple[Any, ...]:
        """All arrays, in the order of the fields."""
        return (
            *(self.coordinate, self.variance, self.error, self.amplitude),
            *(self.offset, self.chi2, self.clipped),
        )
