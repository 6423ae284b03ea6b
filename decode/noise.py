"""Noise of the camera, level by level: variance = read^2 + gain * level, from lit pixels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .plan import Plan

__all__ = ["Noise", "Sample", "fit_noise"]

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Noise:
    """variance = read2 + gain * level of one sample, levels^2; rounding (1/12) is part of read2.

    read2_sigma, gain_sigma: standard deviations, NaN: given, not estimated.
    """

    read2: float
    gain: float = 0.0
    read2_sigma: float = float("nan")
    gain_sigma: float = float("nan")

    def variance(self, level: Any) -> Any:
        """Variance of one sample at a level."""
        return self.read2 + self.gain * np.maximum(level, 0.0)


@dataclass(frozen=True, slots=True)
class Sample:
    """Pixels in runs along rows: places (K, 2) row, column; linear levels (N, K) float32, NaN: saturated."""

    places: NDArray[np.int64]
    levels: F32

    def only(self, keep: Any) -> "Sample":
        """Select pixels."""
        return Sample(self.places[keep], self.levels[:, keep])


def fit_noise(plan: Plan, sample: Sample, rounding: float = 1 / 12) -> Noise:
    """Noise of the lit pixels of a sample; rounding: least variance, levels^2."""
    raise NotImplementedError
