"""What any sequence would bring where a scene's lever is known: the share of heights within a goal.

Axis by axis, so that thousands of sequences cost no more than their axes.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.errors import InputError
from optolever.patterns import Sequence

from .prediction import predict
from .sensitivity import Lever
from .view import Floats

__all__ = ["AxisOutlook", "Outlook"]

SIZES = np.geomspace(0.02, 50, 160)  # of the reference's error, for which shares are tabled


@dataclass(frozen=True, slots=True)
class AxisOutlook:
    """An axis of a sequence: rms height error (mm) that it brings, expected share of the pixels that pass the
    decoder's checks, and for each of them (None: all) the probability."""

    size: float
    share: float
    passed: NDArray[np.float32] | None


class Outlook:
    """A lever, the error that heights may have (mm), the camera's noise (rms, 8-bit levels); wide: what the
    solver's error bars have to be multiplied by, on the full camera (see Lever.sigma_factor)."""

    def __init__(self, lever: Lever, height: float, noise: float, wide: Floats) -> None:
        self.lever, self._height, self._noise = lever, height, noise
        shape = lever.view.visible.shape[::-1]
        self._wide = np.asarray(cv2.resize(wide, shape, interpolation=cv2.INTER_AREA))
        self._axes: dict[Any, AxisOutlook] = {}
        self._table: Floats | None = None

    def axis(self, axis: str, sequence: Sequence) -> AxisOutlook:
        """What one axis of a sequence brings; kept for the next that has the same."""
        key = axis, tuple(frame for frame in sequence.frames if frame.axis in (axis, None))
        if key not in self._axes:
            self._axes[key] = self._predicted(axis, sequence)
        return self._axes[key]

    def _predicted(self, axis: str, sequence: Sequence) -> AxisOutlook:
        usable = self.lever.usable
        try:
            prediction = predict(self.lever.view, sequence, self._noise, axes=axis)
        except InputError:
            return AxisOutlook(math.inf, 0.0, None)
        passed, size = prediction.passed[usable], prediction.rms(axis)
        return AxisOutlook(
            self.lever.gains["uv".index(axis)] * size if math.isfinite(size) else math.inf,
            float(passed.mean()),
            None if passed.all() else passed.astype(np.float32),
        )

    def share(self, sequence: Sequence) -> float:
        """Expected share of the pixels that see the pattern in full whose height is within the goal."""
        u, v = (self.axis(axis, sequence) for axis in "uv")
        size = math.hypot(u.size, v.size)
        if not math.isfinite(size):
            return 0.0
        each = self._each(size)
        for passed in (u.passed, v.passed):
            each = each if passed is None else each * passed
        return float(each.mean())

    def within_at(self, size: Floats) -> Floats:
        """That share at an rms height error (mm) of any code, were all pixels measured."""
        reference = self.lever.reference_sigma[0]
        if self._table is None:
            self._table = np.array([self._each(reference * ratio).mean() for ratio in SIZES])
        return np.asarray(np.interp(np.log(size / reference), np.log(SIZES), self._table))

    def _each(self, size: float) -> Floats:
        """Probability that a pixel is within the goal at that error, where the view sees the pattern."""
        reference, sigma = self.lever.reference_sigma
        mine = (sigma * self._wide)[self.lever.usable] * (size / reference)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.nan_to_num(erf(self._height / (math.sqrt(2) * mine))))
