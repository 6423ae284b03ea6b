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

from .border import border_loss
from .records import Prediction
from .view import Floats, View, stride_for, view_of

__all__ = ["HeightPrediction", "Lever", "rms_where"]

#: Draws of the reference: at least, at most, and the standard error of the rms from which on they are enough.
FEW, MANY, ENOUGH = 8, 40, 0.02
#: Draws by which the solver's error bars are judged, pixels (rms) over which these are averaged.
CALIBRATED, SMOOTH = 24, 1.0
#: Standard error that few draws may leave in the ratio to the reference; how many there are at most, and
#: where they are unlike any reference.
UNLIKE, DRAWS, MOST = 0.04, 6, 24
#: Cells of systematic error (rms) below which it is not worth a solve.
NEGLIGIBLE = 2e-4
#: What systematic errors do to the height, over what noise does, below which chance decides how both add up.
SLIGHT = 0.05
#: Mean variance of being refused, along a line, from which on chance decides what the solver has of it.
CHANCY = 0.02
REFERENCE = 0.01  # cells of noise
#: Light lost at the border: above the first a pixel is left out of every figure, above the second not solved.
BORDER, HALF_LOST = 0.01, 0.2


@dataclass(frozen=True, slots=True)
class HeightPrediction:
    """rms over the measured pixels, mm: of noise, of systematic errors, and of both; share: of the pixels
    that see the pattern in full, those that the decoder does not refuse and an anchor reaches; common: mean
    product (mm^2) of systematic errors and of what the solver makes of exact data."""

    noise: float
    bias: float
    share: float
    common: float = 0.0

    @property
    def total(self) -> float:
        """Root of the mean square of the sum of both."""
        return math.sqrt(max(self.noise**2 + self.bias**2 + 2 * self.common, 0.0))


class Lever:
    """A scene with a dent (or at rest), ready to tell the height error of any sequence's prediction."""

    def __init__(self, scene: Scene, surface: Surface, *, stride: int | None = None, seed: int = 0) -> None:
        self.scene, self.surface = scene, surface
        self.view = view_of(scene, surface, stride_for(scene) if stride is None else stride)
        if not self.view.visible.any():
            raise InputError(f"scene {scene.name!r}: no pixel sees the pattern")
        self._seed = seed

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
        square, share = self._blocks  # all of the full camera, also beside what the view sees
        return math.sqrt(float(square.sum() / share.sum())) / self._errors[0]

    @cached_property
    def scatter(self) -> float:
        """How much the rms error of one draw of noise scatters, as a share of it."""
        return float(np.std(self._errors, ddof=1) / np.mean(self._errors))

    @cached_property
    def _errors(self) -> list[float]:
        """Rms height error of the reference in every draw, mm."""
        noise, masks = self._reference
        errors: list[float] = []
        while len(errors) < FEW or (len(errors) < MANY and _uncertain(errors) > ENOUGH):
            d = self._drawn(self.view, len(errors))
            shift = noise * d[0], noise * d[1]
            errors.append(self.error(self.view, (noise, noise), *masks, shift, self._weighed)[0])
        return errors

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
        draw, unit = self._drawn(self.view, 0), rms_where(reference, masks[1])
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
        axes = prediction.u, prediction.v
        noise, share = 0.0, 1.0
        if not (prediction.left(self._chance(self.view, 0), 0) & prediction.usable).any():
            return HeightPrediction(math.nan, math.nan, 0.0)
        draws, found = self._draws_for(prediction), 0.0
        count = draws[0]
        if max(rms_where(axis.noise, prediction.usable) for axis in axes) > 0:
            found, share, count = self._pooled(self.view, prediction, draws, self._weighed)
            noise = self.scale * self._errors[0] * found / _mean_square(self._errors[:count])
        wide, view = (prediction, self.view) if full is None else (full, self.full)
        # a few pixels that are mostly refused may hold the anchor
        if (
            max(rms_where(axis.bias * np.sqrt(1 - axis.refused), wide.lit) for axis in (wide.u, wide.v))
            < NEGLIGIBLE
        ):
            return HeightPrediction(noise, 0.0, share)
        if noise == 0 or any(axis.steps is not None for axis in axes) or _by_chance(prediction):
            # whole steps, which the solver may take for creases, or other anchors in every draw: with and
            # without what is systematic
            whole, reached, _ = self._pooled(view, wide, (count, count), biased=True)
            alone = found
            if noise > 0 and self.view.stride > 1:
                alone = self._pooled(view, wide, (count, count))[0]
            return HeightPrediction(noise, math.sqrt(max(whole**2 - alone**2, 0.0)), reached)
        # bare stairs look like creases to the solver; under noise, which is what it will see, they do not
        drawn, left = self._drawn(view, 0), wide.left(self._chance(view, 0), 0)
        random = wide.u.drawn(drawn[0]), wide.v.drawn(drawn[1])
        both = wide.u.bias + random[0], wide.v.bias + random[1]
        bias, reached, common = self._difference(view, wide, left, both, random, SLIGHT * noise)
        return HeightPrediction(noise, bias, min(share, reached), common)

    def _draws_for(self, prediction: Prediction) -> tuple[int, int]:
        """How many draws a prediction needs at least and at most: one if its noise lies over the pixels as
        the reference's does, as then both are high or low alike; the less alike, the more. Where chance picks
        the anchors, and where steps look like creases to the solver, no reference is like it.
        """
        if _by_chance(prediction) or prediction.u.steps is not None or prediction.v.steps is not None:
            return DRAWS, MOST
        reference, (solved, _) = self._reference
        axes = prediction.u, prediction.v
        own = np.stack([np.where(prediction.lit, axis.noise * (1 - axis.refused), 0.0) for axis in axes])
        usual = np.stack([np.where(solved, reference, 0.0)] * 2)
        both = float(np.sum(own * usual))
        alike = both / math.sqrt(float(np.sum(own**2) * np.sum(usual**2))) if both > 0 else 1.0
        count = int(np.clip(math.ceil(2 * (1 - alike) * (self.scatter / UNLIKE) ** 2), 1, DRAWS))
        return count, count

    def _pooled(
        self,
        view: View,
        there: Prediction,
        draws: tuple[int, int],
        factor: Floats | float = 1.0,
        biased: bool = False,
    ) -> tuple[float, float, int]:
        """Rms height error (mm, times the factor) over draws of noise and refusals, biased: and of systematic
        errors; mean share of the usable pixels that get a height; draws: at least and at most so many, until
        the first is sure. NaN if no pixel gets one in any draw."""
        u, v, shares = there.u, there.v, []
        errors: list[float] = []
        for index in range(draws[1]):
            draw, left = self._drawn(view, index), there.left(self._chance(view, index), index)
            shift = u.drawn(draw[0]) + biased * u.bias, v.drawn(draw[1]) + biased * v.bias
            stated = u.stated_for(draw[0]), v.stated_for(draw[1])
            error, share = self.error(view, stated, left, there.usable, shift, factor)
            errors += [error] if share > 0 else []
            shares.append(share)
            if len(shares) >= draws[0] and len(errors) > 1 and _uncertain(errors) < UNLIKE:
                break
        return _mean_square(errors) if errors else math.nan, float(np.mean(shares)), len(shares)

    @staticmethod
    def _chance(view: View, index: int) -> Floats:
        """A draw (2, H, W) of even numbers on a view, by which pixels are refused."""
        shape = view.visible.shape
        return view.kept(("chance", index), lambda: np.random.default_rng([index, 2]).random((2, *shape)))

    def _drawn(self, view: View, index: int) -> Floats:
        """A draw (2, H, W) of unit noise on a view."""
        shape = view.visible.shape
        return view.kept(
            ("noise", self._seed, index),
            lambda: np.random.default_rng([self._seed, index]).standard_normal((2, *shape)),
        )

    def _difference(
        self,
        view: View,
        there: Prediction,
        left: NDArray[np.bool_],
        both: tuple[Floats, Floats],
        alone: tuple[Floats, Floats],
        slight: float,
    ) -> tuple[float, float, float]:
        """Rms difference (mm) of the heights from two shifts; the share of pixels that got the first; unless
        the difference is slight, its mean product with the error that no shift at all leaves."""
        stated = there.u.stated, there.v.stated
        try:
            first, second = (self.solve(view, stated, left, shift) for shift in (both, alone))
        except InputError:
            return math.nan, 0.0, 0.0
        reached = first.good & second.good & there.usable
        share = (first.good & there.usable).sum() / max(1, there.usable.sum())
        change = first.z - second.z
        size, common = rms_where(change, reached), 0.0
        if size > slight:
            exact = self.solve(view, stated, left)
            reached &= exact.good
            common = float(np.mean((change * (exact.z - view.truth.z))[reached])) if reached.any() else 0.0
        return size, float(share), common


def _lost(view: View) -> Floats:
    """Share of light lost beyond the pattern's border."""
    return np.maximum(border_loss(view, "u"), border_loss(view, "v"))


def _by_chance(prediction: Prediction) -> bool:
    """Whether it is chance which pixels are refused, of more than a few."""
    lines = [
        np.where(prediction.lit, axis.refused * (1 - axis.refused), 0.0)
        for axis in (prediction.u, prediction.v)
    ]
    return max(float(part.mean(axis=along).max()) for part in lines for along in (0, 1)) > CHANCY


def rms_where(values: Floats, where: NDArray[np.bool_]) -> float:
    """Root mean square of the values chosen; NaN of none."""
    chosen = values[where]
    return math.sqrt(float(np.mean(chosen**2))) if chosen.size else math.nan


def _uncertain(errors: list[float]) -> float:
    """Standard error, as a share, of the rms of several draws."""
    return float(np.std(errors, ddof=1) / np.mean(errors)) / math.sqrt(len(errors))


def _mean_square(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
