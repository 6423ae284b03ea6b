"""What any sequence would bring where a view's height errors are known: the share of heights within a goal.

Axis by axis, so that many sequences cost no more than their axes.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from scipy.special import erf

from optolever.errors import InputError
from optolever.patterns import Sequence

from .prediction import predict
from .sensitivity import Lever
from .view import Floats, Mask, View

__all__ = ["AxisOutlook", "Outlook"]


@dataclass(frozen=True, slots=True, eq=False)
class AxisOutlook:
    """An axis of a sequence: rms height error (mm) that it brings, share of the pixels that pass the
    decoder's checks, and for each of them (n,) the probability."""

    error: float
    share: float
    passed: Floats


@dataclass(frozen=True, eq=False)
class Outlook:
    """view; where (H, W): its pixels that count; gains: rms height error (mm) per cell of noise along u and
    v; goal: error that heights may have, mm; noise: of the camera, rms 8-bit levels; sigma (H, W): error bars
    of heights (mm, NaN without a height) whose rms error is `error`: another sequence's scale with it."""

    view: View
    where: Mask
    gains: tuple[float, float]
    goal: float
    noise: float
    sigma: Floats
    error: float
    _axes: dict[Any, AxisOutlook] = field(default_factory=dict)

    @classmethod
    def of(cls, lever: Lever, goal: float, noise: float, wide: Floats) -> "Outlook":
        """By a lever's reference; wide: what the solver's error bars have to be multiplied by, on the full
        camera (see Lever.sigma_factor)."""
        error, sigma = lever.reference_sigma
        factor = np.asarray(cv2.resize(wide, sigma.shape[::-1], interpolation=cv2.INTER_AREA))
        return cls(lever.view, lever.usable, lever.gains, goal, noise, sigma * factor, error)

    def axis(self, axis: str, sequence: Sequence) -> AxisOutlook:
        """What one axis of a sequence brings; kept for the next that has the same."""
        key = axis, tuple(frame for frame in sequence.frames if frame.axis in (axis, None))
        if key not in self._axes:
            self._axes[key] = self._predicted(axis, sequence)
        return self._axes[key]

    def _predicted(self, axis: str, sequence: Sequence) -> AxisOutlook:
        try:
            prediction = predict(self.view, sequence, self.noise, axes=axis)
        except InputError:
            return AxisOutlook(math.inf, 0.0, np.zeros(int(self.where.sum())))
        passed, rms = prediction.passed[self.where], prediction.rms(axis)
        error = self.gains["uv".index(axis)] * rms if math.isfinite(rms) else math.inf
        return AxisOutlook(error, float(passed.mean()), passed)

    def height_error(self, sequence: Sequence) -> float:
        """Rms height error (mm) that a sequence brings."""
        return math.hypot(*(self.axis(axis, sequence).error for axis in "uv"))

    def share(self, sequence: Sequence) -> float:
        """Expected share of the pixels that count whose height is within the goal."""
        error = self.height_error(sequence)
        if not math.isfinite(error):
            return 0.0
        u, v = (self.axis(axis, sequence).passed for axis in "uv")
        return float((self._within(error / self.error if self.error > 0 else 1.0) * u * v).mean())

    def _within(self, ratio: float) -> Floats:
        """Probability that a pixel is within the goal at so many times the known error."""
        with np.errstate(divide="ignore", invalid="ignore"):
            each = erf(self.goal / (math.sqrt(2) * ratio * self.sigma[self.where]))
        return np.asarray(np.nan_to_num(each))
