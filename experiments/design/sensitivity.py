"""From errors on the pattern to errors of height: the scene's lever, by the solver itself.

What a sequence's decoded errors do is solved as it is. Most of a height error are low frequencies of the
noise, so that single draws differ much. The noise of a draw, each pixel over its local rms, is therefore
solved for a reference, too, whose mean over many draws is known (a control variate).
To a whole camera from a thinned one: heights from independent noise scale with the distance of the pixels,
but not equally everywhere (most next to the pattern's edge, where they are largest); one solve of the
reference at full size, by the solver's error bars, measures it place by place.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, Surface

from .prediction import BORDER, Prediction
from .view import Floats, Mask, View, stride_for, view_of

__all__ = ["HeightPrediction", "Lever", "rms_where"]

#: Draws of the reference: at least, at most, and the standard error of the rms from which on they are enough.
FEW, MANY, ENOUGH = 8, 40, 0.01
REFERENCE = 0.01  # cells of noise
#: Draws by which the solver's error bars are judged, pixels (rms) over which these are averaged.
CALIBRATED, SMOOTH = 24, 1.0
#: Light lost at the border above which a pixel of the reference is not solved.
HALF_LOST = 0.2
#: Standard error that a single pair of draws usually leaves, as a share.
UNSURE = 0.05
#: Pixels around one over which the rms of its noise is taken.
AROUND = 15


@dataclass(frozen=True, slots=True)
class HeightPrediction:
    """rms over the measured pixels, mm: of noise, of what does not change sign with it, of both; spread:
    their standard error, as a share; share: of the usable pixels, those with a height."""

    noise: float
    bias: float
    total: float
    spread: float
    share: float


class Lever:
    """A scene with a dent (or at rest), ready to tell the height error of any sequence's prediction."""

    def __init__(self, scene: Scene, surface: Surface, *, stride: int | None = None) -> None:
        self.scene, self.surface = scene, surface
        self.view = view_of(scene, surface, stride_for(scene) if stride is None else stride)
        if not self.view.visible.any():
            raise InputError(f"scene {scene.name!r}: no pixel sees the pattern")

    def measured(self, sequence: Sequence, noise: float, seed: int, renderer: str) -> HeightMap:
        """From frames of the whole camera. InputError if they cannot be decoded or leave no anchor."""
        seen = capture(self.scene, self.surface, sequence, noise=noise, seed=seed, renderer=renderer)
        return reconstruct(decode(seen.frames, sequence), self.scene)

    @cached_property
    def full(self) -> View:
        """The view of every pixel of the camera."""
        return self.view if self.view.stride == 1 else view_of(self.scene, self.surface)

    @cached_property
    def inner(self) -> Mask:
        """Pixels of the whole camera that the pattern's border does not touch: those that count."""
        return np.asarray(self.full.visible & (self.full.lost < BORDER))

    @cached_property
    def usable(self) -> Mask:
        """`inner` on the view."""
        return np.asarray(self.view.visible & (self.view.lost < BORDER))

    @staticmethod
    def solve(view: View, shift: Floats, sigma: Floats, where: Mask) -> HeightMap:
        """The solver on the true correspondence plus a shift, with a stated sigma (2, H, W; cells)."""
        flags = np.where(where, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
        stated = np.where(where, np.maximum(sigma, 1e-6), np.inf)
        truth = view.truth
        seen = Correspondence(truth.u + shift[0], truth.v + shift[1], stated[0], stated[1], flags)
        return reconstruct(seen, view.scene)

    def height(self, prediction: Prediction) -> HeightPrediction:
        """Rms height error that a prediction on `view` means; NaN where none of its draws gives a height."""
        return self.pooled(self.pairs(prediction))

    def pairs(self, prediction: Prediction) -> Floats:
        """(K, 3), see `_pair`, of its pairs of draws."""
        return np.array([self._pair(prediction, first) for first in range(0, len(prediction.error), 2)])

    def pooled(self, pairs: Floats) -> HeightPrediction:
        """What pairs of draws come to."""
        known = pairs[np.isfinite(pairs[:, 0])]
        if len(known) == 0:
            return HeightPrediction(math.nan, math.nan, math.nan, math.nan, 0.0)
        noise2, bias2, share = known.mean(axis=0)
        spread = self._spread(known[:, 0] + known[:, 1])
        share *= len(known) / len(pairs)
        if self.view.stride > 1:  # pixels are refused elsewhere than in the windows
            spread = math.hypot(spread, 1 - share)
        total = math.sqrt(noise2 + bias2)
        return HeightPrediction(math.sqrt(noise2), math.sqrt(bias2), total, spread, float(share))

    @staticmethod
    def _spread(squares: Floats) -> float:
        """Standard error of the root of the mean of squares; of few of them with what is usual."""
        prior2 = (2 * UNSURE) ** 2
        own2 = float(np.sum((squares / squares.mean() - 1) ** 2))
        count = len(squares)
        return 0.5 * math.sqrt((own2 + 2 * prior2) / (count + 1) / count)

    def _pair(self, prediction: Prediction, first: int) -> tuple[float, float, float]:
        """Of two draws of opposite noise: mean square of the height error (mm^2) from noise and from the
        rest, share of the usable pixels that got a height; NaN and 0 where none did."""
        pair = slice(first, first + 2)
        view, both = self.view, np.asarray(prediction.good[pair].all(axis=0))
        try:
            plus, minus = (
                self.solve(view, *drawn)
                for drawn in zip(
                    prediction.error[pair], prediction.sigma[pair], prediction.good[pair], strict=True
                )
            )
            factor = self._draw_factor(
                0.5 * (prediction.error[first] - prediction.error[first + 1]), both, first
            )
        except InputError:  # no anchor left
            return math.nan, math.nan, 0.0
        reached = plus.good & minus.good & prediction.usable
        noise, rest = 0.5 * (plus.z - minus.z), 0.5 * (plus.z + minus.z) - view.truth.z
        share = 0.5 * float(plus.good[prediction.usable].mean() + minus.good[prediction.usable].mean())
        weight = self._weighed
        return (
            (rms_where(weight * noise, reached) / factor) ** 2,
            rms_where(weight * rest, reached) ** 2,
            share,
        )

    def _draw_factor(self, noise: Floats, known: Mask, number: int) -> float:
        """What a draw of noise (2, H, W) does to the reference, over what all draws do on average."""
        unit = np.random.default_rng([number, 3]).standard_normal(noise.shape)
        count = cv2.blur(known.astype(np.float64), (AROUND, AROUND))
        for k in range(2):
            around = cv2.blur(np.where(known, noise[k] ** 2, 0.0), (AROUND, AROUND))
            local = np.sqrt(np.maximum(around, 0.0) / np.maximum(count, 1e-9))
            unit[k] = np.where(known & (local > 0), noise[k] / np.maximum(local, 1e-12), unit[k])
        return self._reference_error(unit) / self._mean_error

    @cached_property
    def scatter(self) -> float:
        """How much the rms error of one draw of noise scatters, as a share of it."""
        return float(np.std(self._errors, ddof=1) / np.mean(self._errors))

    @cached_property
    def _mean_error(self) -> float:
        """Rms height error of the reference over all draws, mm, on the whole camera."""
        if self.view.stride == 1:
            return math.sqrt(float(np.mean(np.square(self._errors))))
        square, share = self._blocks
        return math.sqrt(float(square.sum() / share.sum()))

    @cached_property
    def _errors(self) -> list[float]:
        """The same of draw by draw, by the view."""
        errors: list[float] = []
        while len(errors) < FEW or (len(errors) < MANY and _uncertain(errors) > ENOUGH):
            errors.append(self._reference_error(self._drawn(len(errors))))
        return errors

    def _reference_error(self, unit: Floats) -> float:
        """Rms height error (mm) of the reference under noise of rms 1 (2, H, W)."""
        noise, solved = _reference(self.view)
        height = self.solve(self.view, noise * unit, np.stack([noise, noise]), solved)
        return rms_where(self._weighed * (height.z - self.view.truth.z), height.good & self.usable)

    def _drawn(self, index: int) -> Floats:
        return np.random.default_rng([0, index]).standard_normal((2, *self.view.truth.u.shape))

    @cached_property
    def gains(self) -> tuple[float, float]:
        """Rms height error (mm) per cell of noise along u alone and along v alone."""
        draw, noise = self._drawn(0), _reference(self.view)[0]
        unit = rms_where(noise, self.usable) * self._errors[0] / self._mean_error
        along = (np.stack([draw[0], 0 * draw[1]]), np.stack([0 * draw[0], draw[1]]))
        u, v = (self._reference_error(one) / unit for one in along)
        return u, v

    def quick(self, prediction: Prediction) -> float:
        """Rms height error, mm, from the gains: no solve of its own; systematic errors as if they were
        noise."""
        return math.hypot(*(gain * prediction.rms(axis) for gain, axis in zip(self.gains, "uv", strict=True)))

    @cached_property
    def to_full(self) -> Floats:
        """Per pixel of the view: height error on the whole camera over that on the view, for the same noise
        (cells)."""
        square, share = self._blocks
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.sqrt(square / share) / self._sigma_view
        usual = float(np.median(factor[np.isfinite(factor)]))
        return np.asarray(np.where(np.isfinite(factor), factor, usual))

    @cached_property
    def _weighed(self) -> Floats:
        """`to_full`, weighed by the whole camera's pixels that stand behind one of the view."""
        if self.view.stride == 1:
            return np.ones(self.view.truth.u.shape)
        share = self._blocks[1]
        return np.asarray(self.to_full * np.sqrt(share / share[self.usable].mean()))

    @cached_property
    def _blocks(self) -> tuple[Floats, Floats]:
        """Over the whole camera's pixels behind one of the view: mean square of sigma (mm), 0 where there is
        none, and the share that has one."""
        sigma = _sigma(self.full, self.inner)
        known = np.isfinite(sigma)
        size = self.view.truth.u.shape[::-1]
        square, share = (
            np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float64)
            for values in (np.where(known, sigma, 0.0) ** 2, known.astype(np.float64))
        )
        return square, share

    @cached_property
    def _sigma_view(self) -> Floats:
        return _sigma(self.view, self.usable)

    @cached_property
    def sigma_factor(self) -> Floats:
        """Rms error over the solver's error bars, per pixel of the whole camera (averaged around it), by
        drawn noise: they are exact in the middle, wide next to the pattern's edge."""
        noise, solved = _reference(self.full)
        square, count = np.zeros(noise.shape), np.zeros(noise.shape)
        for seed in range(CALIBRATED):
            draw = noise * np.random.default_rng([seed, 1]).standard_normal((2, *noise.shape))
            height = self.solve(self.full, draw, np.stack([noise, noise]), solved)
            good = height.good & self.inner
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = (height.z - self.full.truth.z) / height.sigma
            square[good] += ratio[good] ** 2
            count[good] += 1
        around, there = (np.asarray(cv2.GaussianBlur(part, (0, 0), SMOOTH)) for part in (square, count))
        return np.asarray(np.sqrt(np.where(there > 1, around / np.maximum(there, 1e-9), 1.0)))

    @cached_property
    def reference_sigma(self) -> tuple[float, Floats]:
        """(rms height error of the reference as `quick` tells it, its error bars (mm) on the whole camera at
        the pixels of the view, NaN where there are none): another code's scale with the former."""
        size = math.hypot(*self.gains) * rms_where(_reference(self.view)[0], self.usable)
        return size, self._sigma_view if self.view.stride == 1 else self._sigma_view * self.to_full


def _reference(view: View) -> tuple[Floats, Mask]:
    """Noise (cells) as a fringe has it, the more the less light; pixels that are solved."""
    solved = view.visible & (view.lost < HALF_LOST)
    light = np.where(solved, view.light, 1.0)
    return np.where(solved, REFERENCE * np.median(light[solved]) / light, REFERENCE), solved


def _sigma(view: View, usable: Mask) -> Floats:
    """Error bars (mm) of the height under the reference's noise, NaN beside the usable pixels."""
    noise, solved = _reference(view)
    height = Lever.solve(view, np.zeros((2, *noise.shape)), np.stack([noise, noise]), solved)
    return np.where(height.good & usable, height.sigma, np.nan)


def rms_where(values: Floats, where: Mask) -> float:
    """Root mean square of the values chosen; NaN of none."""
    chosen = values[where]
    return math.sqrt(float(np.mean(chosen**2))) if chosen.size else math.nan


def _uncertain(errors: list[float]) -> float:
    """Standard error, as a share, of the rms of several draws."""
    return float(np.std(errors, ddof=1) / np.mean(errors)) / math.sqrt(len(errors))
