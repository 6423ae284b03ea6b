"""From errors on the pattern to errors of height: the scene's lever, by the solver itself.

Noise: a solve with drawn noise on the thinned camera, the same draw for every sequence, and once for a
reference many of them: what one draw misses of the reference it misses of every sequence alike. To the full
camera: heights from independent noise scale with the distance of the pixels, but not equally everywhere (most
next to the pattern's edge, where they are largest); one reference solve at full size, by the solver's error
bars, measures it place by place.
Systematic errors: solved as they are, on the full camera, because how they alias depends on its pixels.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, Surface

from .prediction import Prediction, border_loss
from .view import Floats, View, stride_for, view_of

__all__ = ["HeightPrediction", "Lever", "rms_where"]

MANY = 8  # draws of the reference
#: Draws by which the solver's error bars are judged, pixels (rms) over which these are averaged.
CALIBRATED, SMOOTH = 24, 1.0
#: Cells of systematic error (rms) below which it is not worth a solve.
NEGLIGIBLE = 2e-4
REFERENCE = 0.01  # cells of noise
#: Light lost at the border: above the first a pixel is left out of every figure, above the second not solved.
BORDER, HALF_LOST = 0.01, 0.2


@dataclass(frozen=True, slots=True)
class HeightPrediction:
    """rms over the measured pixels, mm: of noise, of systematic errors, and of both; share: of the pixels
    that see the pattern in full, those that the decoder does not refuse and an anchor reaches."""

    noise: float
    bias: float
    share: float

    @property
    def total(self) -> float:
        """Root of the sum of both squares."""
        return math.hypot(self.noise, self.bias)


class Lever:
    """A scene with a dent (or at rest), ready to tell the height error of any sequence's prediction."""

    def __init__(self, scene: Scene, surface: Surface, *, stride: int | None = None, seed: int = 0) -> None:
        self.scene, self.surface = scene, surface
        self.view = view_of(scene, surface, stride_for(scene) if stride is None else stride)
        if not self.view.visible.any():
            raise InputError(f"scene {scene.name!r}: no pixel sees the pattern")
        rng = np.random.default_rng(seed)
        self._draws = rng.standard_normal((MANY, 2, *self.view.visible.shape))

    @cached_property
    def full(self) -> View:
        """The view of every pixel of the camera."""
        return self.view if self.view.stride == 1 else view_of(self.scene, self.surface)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Pixels of the full camera that the pattern's border does not touch: errors are told over these."""
        return np.asarray(self.full.visible & (_lost(self.full) < BORDER))

    def solve(
        self,
        view: View,
        stated: tuple[Floats, Floats],
        where: NDArray[np.bool_],
        shift: tuple[Floats | float, Floats | float] = (0.0, 0.0),
    ) -> HeightMap:
        """The solver on the true correspondence plus a shift (cells), with the sigma that will be stated."""
        flags = np.where(where, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
        su, sv = (np.where(where, np.maximum(sigma, 1e-6), np.inf) for sigma in stated)
        seen: Any = Correspondence(view.truth.u + shift[0], view.truth.v + shift[1], su, sv, flags)
        return reconstruct(seen, view.scene)

    def error(
        self,
        view: View,
        stated: tuple[Floats, Floats],
        solved: NDArray[np.bool_],
        usable: NDArray[np.bool_],
        shift: tuple[Floats | float, Floats | float],
        factor: Floats | float = 1.0,
    ) -> tuple[float, float]:
        """Rms height error (mm, times the factor) over the usable pixels that a shift of the correspondence
        causes, and the share of them that got a height; NaN and 0 where none did."""
        try:
            height = self.solve(view, stated, solved, shift)
        except InputError:  # no anchor left
            return math.nan, 0.0
        reached = height.good & usable
        return rms_where(factor * (height.z - view.truth.z), reached), reached.sum() / max(1, usable.sum())

    @cached_property
    def scale(self) -> float:
        """Factor from the rms of the first draw, taken to the full camera, to that of all noise there."""
        if self.view.stride == 1:
            return _mean_square(self._errors) / self._errors[0]
        sigma = self._sigma_view * self._weighed
        return rms_where(sigma, self.seen & np.isfinite(sigma)) / self._errors[0]

    @cached_property
    def scatter(self) -> float:
        """How much the rms error of one draw of noise scatters, as a share of it."""
        return float(np.std(self._errors, ddof=1) / np.mean(self._errors))

    @cached_property
    def _errors(self) -> list[float]:
        """Rms height error of the reference in every draw, mm."""
        noise, masks = self._reference
        return [
            self.error(self.view, (noise, noise), *masks, (noise * d[0], noise * d[1]), self._weighed)[0]
            for d in self._draws
        ]

    @cached_property
    def _reference(self) -> tuple[Floats, tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
        return self._usual(self.view)

    @staticmethod
    def _usual(view: View) -> tuple[Floats, tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
        """Noise (cells) of a usual fringe; the pixels that have it, and those that the border leaves
        alone.
        """
        lost = _lost(view)
        solved, usable = view.visible & (lost < HALF_LOST), view.visible & (lost < BORDER)
        levels = view.levels(1.0)
        with np.errstate(divide="ignore"):
            noise = np.sqrt(levels.variance(levels.half)) / levels.half
        reference = np.where(solved, REFERENCE * noise / np.median(noise[solved]), REFERENCE)
        return reference, (solved, usable)

    @cached_property
    def gains(self) -> tuple[float, float]:
        """Rms height error (mm) per cell of noise along u alone and along v alone."""
        reference, masks = self._reference
        draw, unit = self._draws[0], rms_where(reference, masks[1])
        both = reference, reference
        along_u = self.error(self.view, both, *masks, (reference * draw[0], 0.0), self._weighed)[0]
        along_v = self.error(self.view, both, *masks, (0.0, reference * draw[1]), self._weighed)[0]
        return self.scale * along_u / unit, self.scale * along_v / unit

    def quick(self, prediction: Prediction, biased: bool = False) -> float:
        """Rms height error of noise alone, mm, from the gains: no solve of its own; biased: and of
        systematic errors, as if they were noise."""
        sizes = [
            math.hypot(
                rms_where(axis.noise, prediction.usable),
                rms_where(axis.bias, prediction.usable) if biased else 0.0,
            )
            for axis in (prediction.u, prediction.v)
        ]
        return math.hypot(self.gains[0] * sizes[0], self.gains[1] * sizes[1])

    @cached_property
    def to_full(self) -> Floats:
        """Per pixel of the view: height error on the full camera over that on the view, for the same noise
        (cells)."""
        square, share = self._blocks
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.sqrt(square / share) / self._sigma_view
        usual = float(np.median(factor[np.isfinite(factor)]))
        return np.asarray(np.where(np.isfinite(factor), factor, usual))

    @cached_property
    def _weighed(self) -> Floats:
        """`to_full`, weighed by the full camera's pixels that stand behind one of the view."""
        if self.view.stride == 1:
            return np.ones(self.view.visible.shape)
        share = self._blocks[1]
        usable = self._reference[1][1]
        return np.asarray(self.to_full * np.sqrt(share / share[usable].mean()))

    @cached_property
    def _blocks(self) -> tuple[Floats, Floats]:
        """Over the full camera's pixels behind one of the view: mean square of sigma (mm), 0 where there is
        none, and the share that has one."""
        sigma = self._sigma(self.full)
        known = np.isfinite(sigma)
        size = self.view.visible.shape[::-1]
        square, share = (
            np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float64)
            for values in (np.where(known, sigma, 0.0) ** 2, known.astype(np.float64))
        )
        return square, share

    @cached_property
    def _sigma_view(self) -> Floats:
        return self._sigma(self.view)

    def _sigma(self, view: View) -> Floats:
        """Error bars (mm) of the height under the usual noise, NaN beside the inner pixels."""
        noise, (solved, usable) = self._usual(view)
        height = self.solve(view, (noise, noise), solved)
        return np.where(height.good & usable, height.sigma, np.nan)

    @cached_property
    def truth_of_sigma(self) -> Floats:
        """Rms error over the solver's error bars, per pixel of the full camera (averaged around it),
        by drawn noise: they are exact in the middle, wide next to the pattern's edge."""
        noise, (solved, usable) = self._usual(self.full)
        square, count = np.zeros(noise.shape), np.zeros(noise.shape)
        for seed in range(CALIBRATED):
            draw = noise * np.random.default_rng([seed, 1]).standard_normal((2, *noise.shape))
            height = self.solve(self.full, (noise, noise), solved, (draw[0], draw[1]))
            good = height.good & usable
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = (height.z - self.full.truth.z) / height.sigma
            square[good] += ratio[good] ** 2
            count[good] += 1
        around, there = (np.asarray(cv2.GaussianBlur(part, (0, 0), SMOOTH)) for part in (square, count))
        return np.asarray(np.sqrt(np.where(there > 1, around / np.maximum(there, 1e-9), 1.0)))

    @property
    def seen(self) -> NDArray[np.bool_]:
        """`inner` on the view."""
        return self._reference[1][1]

    @cached_property
    def usual_sigma(self) -> tuple[float, Floats]:
        """(rms height error of a usual fringe as `quick` tells it, its error bars (mm) on the full camera at
        the pixels of the view, NaN where there are none): another code's scale with the former."""
        noise, (_, usable) = self._reference
        size = math.hypot(*self.gains) * rms_where(noise, usable)
        return size, self._sigma_view if self.view.stride == 1 else self._sigma_view * self.to_full

    def height(self, prediction: Prediction, full: Prediction | None = None) -> HeightPrediction:
        """Rms height error that a prediction on `view` means.

        full: the same sequence predicted on the view `full`, for what is systematic.
        """
        u, v = prediction.u, prediction.v
        masks = prediction.solved, prediction.usable
        noise, share = 0.0, 1.0
        if not (masks[0] & masks[1]).any():
            return HeightPrediction(math.nan, math.nan, 0.0)
        if max(rms_where(axis.noise, masks[1]) for axis in (u, v)) > 0:
            draw = self._draws[0]
            found, share = self.error(
                self.view, (u.stated, v.stated), *masks, (u.noise * draw[0], v.noise * draw[1]), self._weighed
            )
            noise = self.scale * found
        wide, view = (prediction, self.view) if full is None else (full, self.full)
        if max(rms_where(axis.bias, wide.solved) for axis in (wide.u, wide.v)) < NEGLIGIBLE:
            return HeightPrediction(noise, 0.0, share)
        stated = wide.u.stated, wide.v.stated
        shift = wide.u.bias, wide.v.bias
        if noise > 0:
            # bare stairs look like creases to the solver; under noise, which is what it will see, they do not
            drawn = self._drawn(view, 0)
            both = (shift[0] + wide.u.noise * drawn[0], shift[1] + wide.v.noise * drawn[1])
            alone = (wide.u.noise * drawn[0], wide.v.noise * drawn[1])
            bias, reached = self._difference(view, stated, wide, both, alone)
            return HeightPrediction(noise, bias, min(share, reached))
        bias, reached = self.error(view, stated, wide.solved, wide.usable, shift)
        return HeightPrediction(noise, bias, reached)

    def _drawn(self, view: View, index: int) -> Floats:
        """A draw (2, H, W) of unit noise on a view."""
        if view is self.view:
            return np.asarray(self._draws[index])
        return np.random.default_rng(index).standard_normal((2, *view.visible.shape))

    def _difference(
        self,
        view: View,
        stated: tuple[Floats, Floats],
        there: Prediction,
        both: tuple[Floats, Floats],
        alone: tuple[Floats, Floats],
    ) -> tuple[float, float]:
        """Rms difference (mm) of the heights from two shifts, and the share of pixels that got the first."""
        try:
            first, second = (self.solve(view, stated, there.solved, shift) for shift in (both, alone))
        except InputError:
            return math.nan, 0.0
        reached = first.good & second.good & there.usable
        share = (first.good & there.usable).sum() / max(1, there.usable.sum())
        return rms_where(first.z - second.z, reached), float(share)


def _lost(view: View) -> Floats:
    """Share of light lost beyond the pattern's border."""
    return np.maximum(border_loss(view, "u"), border_loss(view, "v"))


def rms_where(values: Floats, where: NDArray[np.bool_]) -> float:
    """Root mean square of the values chosen; NaN of none."""
    chosen = values[where]
    return math.sqrt(float(np.mean(chosen**2))) if chosen.size else math.nan


def _mean_square(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
