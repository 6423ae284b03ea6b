"""What is predicted of a sequence in a view, pixel by pixel."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .view import Floats

__all__ = ["AxisPrediction", "Prediction", "Steps"]


@dataclass(frozen=True, slots=True)
class Steps:
    """What noise does to a code alone, per pixel (H, W): probabilities that the cell above and the one below
    are read; their distance (cells), and the sigma that will be stated then (cells)."""

    up: Floats
    down: Floats
    pitch: float
    stated: Floats


@dataclass(frozen=True, slots=True)
class AxisPrediction:
    """Per pixel (H, W): noise (rms, cells), bias (cells), failure and refused (probabilities), stated (the
    sigma that the decoder will give, cells; where steps are known, to those that make none). flagged: which
    pixels are refused in some draws of noise (D, H, W), where these are known one by one."""

    noise: Floats
    bias: Floats
    failure: Floats
    refused: Floats
    stated: Floats
    steps: Steps | None = None
    flagged: NDArray[np.bool_] | None = None

    def drawn(self, unit: Floats) -> Floats:
        """An error (H, W) of mean 0 as the noise makes it, from Gaussian numbers of rms 1."""
        if self.steps is None:
            return self.noise * unit
        above, below = self._stepping(unit)
        mean = self.steps.up - self.steps.down
        return np.asarray(self.steps.pitch * (above.astype(float) - below - mean))

    def stated_for(self, unit: Floats) -> Floats:
        """The sigma (H, W) that the decoder will give with that error."""
        if self.steps is None:
            return self.stated
        return np.where(np.logical_or(*self._stepping(unit)), self.steps.stated, self.stated)

    def left(self, chance: Floats, index: int) -> NDArray[np.bool_]:
        """Pixels that are not refused in the draw of that number, for even numbers (H, W) of 0..1."""
        if self.flagged is None:
            return np.asarray(self.refused <= chance)
        return np.asarray(~self.flagged[index % len(self.flagged)])

    def _stepping(self, unit: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Where (H, W) the cell above, and where the one below is read."""
        if self.steps is None:
            return np.zeros(unit.shape, bool), np.zeros(unit.shape, bool)
        place = ndtr(unit)
        return place > 1 - self.steps.up, place < self.steps.down


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
        return np.asarray(self.lit & (self.u.refused <= 0.5) & (self.v.refused <= 0.5))

    def left(self, chance: Floats, index: int) -> NDArray[np.bool_]:
        """Pixels that the decoder does not refuse in the draw of that number, for even numbers (2, H, W) of
        0..1: the others are holes in the solver's grid."""
        return np.asarray(self.lit & self.u.left(chance[0], index) & self.v.left(chance[1], index))

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
