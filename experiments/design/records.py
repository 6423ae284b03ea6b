"""What is predicted of a sequence in a view, pixel by pixel."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .view import Floats

__all__ = ["AxisPrediction", "Prediction"]


@dataclass(frozen=True, slots=True)
class AxisPrediction:
    """Per pixel (H, W): noise (rms, cells), bias (cells), failure and refused (probabilities), stated (the
    sigma that the decoder will give, cells). steps: of a code alone, whose noise is that it reads a
    neighbour: the probabilities of the one above and of the one below, and their distance (cells)."""

    noise: Floats
    bias: Floats
    failure: Floats
    refused: Floats
    stated: Floats
    steps: tuple[Floats, Floats, float] | None = None

    def drawn(self, unit: Floats) -> Floats:
        """An error (H, W) of mean 0 as the noise makes it, from Gaussian numbers of rms 1."""
        if self.steps is None:
            return self.noise * unit
        up, down, pitch = self.steps
        place = ndtr(unit)
        return np.asarray(pitch * ((place > 1 - up).astype(float) - (place < down) - (up - down)))


@dataclass(frozen=True, slots=True)
class Prediction:
    """Both axes of a sequence in a view; lit: pixels that see the pattern; usable: those that its border does
    not touch, over which errors are told."""

    u: AxisPrediction
    v: AxisPrediction
    lit: NDArray[np.bool_]
    usable: NDArray[np.bool_]

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Pixels that the decoder does not refuse outright."""
        return self.left(np.full((2, *self.lit.shape), 0.5))

    def left(self, chance: Floats) -> NDArray[np.bool_]:
        """Pixels that the decoder does not refuse, for even numbers (2, H, W) of 0..1: holes in the solver's
        grid."""
        return np.asarray(self.lit & (self.u.refused <= chance[0]) & (self.v.refused <= chance[1]))

    @property
    def failure(self) -> float:
        """Mean probability of a wrong order or bit over the usable pixels."""
        return self._mean(1 - (1 - self.u.failure) * (1 - self.v.failure))

    @property
    def measured_share(self) -> float:
        """Share of the usable pixels that are expected to pass the decoder's checks."""
        return self._mean((1 - self.u.refused) * (1 - self.v.refused))

    def _mean(self, values: Floats) -> float:
        return float(values[self.usable].mean()) if self.usable.any() else math.nan
