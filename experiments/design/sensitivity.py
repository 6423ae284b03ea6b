"""From errors on the pattern to errors of height: the scene's lever, by the solver itself.

What does not change sign with the noise is solved as it was decoded. Noise is one draw, the same for all
sequences, in units of the decoder's sigma and of its rms error over it: most of a height error are low
frequencies of the noise, so that draws differ much from each other, but little between sequences. How much
that draw is off is told by others, once.

To a whole camera from a thinned one: heights from independent noise scale with the distance of the pixels,
but not equally everywhere (most next to the pattern's edge, where they are largest). Error bars at full size
tell it place by place, the same noise drawn on both cameras as a whole.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, Surface

from ..arrays import Floats, Mask
from ..faults import frames_of
from ..metrics import rms
from ..own_images import OwnDecoder, OwnImages, image_frames
from .view import Prediction, View, stride_for, view_of

REFERENCE = 0.01  # cells of noise by which draws and both cameras are compared
DRAWS = 96  # of noise, by which the one that all sequences get is put in relation to others
PAIRED = 6  # of noise, on both cameras: the ratio of their errors differs by 2 to 3 % from draw to draw


@dataclass(frozen=True, slots=True)
class HeightPrediction:
    """rms over the measured pixels, mm: of noise, of what does not change sign with it, of both; spread:
    standard error of the total by the draw of noise alone, as a share; share: of the usable pixels, those
    with a height."""

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

    def measured(
        self,
        shown: Sequence | OwnImages,
        noise: float,
        seed: int,
        renderer: str,
        lag: float = 0.0,
        decoder: OwnDecoder | None = None,
    ) -> HeightMap:
        """From frames of the whole camera, by our decoder or another one. InputError if they cannot be
        decoded or leave no anchor."""
        known = lag, noise, seed, renderer
        frames: NDArray[Any]
        if isinstance(shown, OwnImages):
            assert decoder is not None
            frames = image_frames(self.scene, self.surface, self.full.truth, shown, *known)
            seen = decoder(frames, shown.levels)
        else:
            frames = frames_of(self.scene, self.surface, shown, *known)
            seen = decode(frames, shown) if decoder is None else decoder(frames, shown)
        return reconstruct(seen, self.scene)

    @cached_property
    def full(self) -> View:
        """The view of every pixel of the camera."""
        return self.view if self.view.stride == 1 else view_of(self.scene, self.surface)

    @staticmethod
    def solve(view: View, shift: Floats, sigma: Floats, where: Mask) -> HeightMap:
        """The solver on the true correspondence plus a shift, with a stated sigma (2, H, W; cells)."""
        flags = np.where(where, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
        stated = np.where(where, np.maximum(sigma, 1e-6), np.inf)
        truth = view.truth
        seen = Correspondence(truth.u + shift[0], truth.v + shift[1], stated[0], stated[1], flags)
        return reconstruct(seen, view.scene)

    def height(self, prediction: Prediction) -> HeightPrediction:
        """Rms height error that a prediction on `view`, of one pair of draws, means; NaN where it gives no
        height."""
        view, (error, sigma, good) = self.view, (prediction.error, prediction.sigma, prediction.good)
        known = good.all(axis=0) & prediction.usable
        half = 0.5 * (error[0] - error[1])
        short = rms((half / sigma.mean(axis=0))[:, known])
        bias, noise = 0.5 * (error[0] + error[1]), short * sigma * self._unit_noise(0)
        try:
            plus, minus = (
                self.solve(view, bias + sign * one, stated, where)
                for sign, one, stated, where in zip((1, -1), noise, sigma, good, strict=True)
            )
            scale, scatter = self._usual
        except InputError:  # no anchor left
            return HeightPrediction(math.nan, math.nan, math.nan, math.nan, 0.0)
        reached = plus.good & minus.good & prediction.usable
        noise_mm = scale * rms((self._weighed * 0.5 * (plus.z - minus.z))[reached])
        bias_mm = rms((self._weighed * (0.5 * (plus.z + minus.z) - view.truth.z))[reached])
        total = math.hypot(noise_mm, bias_mm)
        share = float(np.mean([one.good[prediction.usable].mean() for one in (plus, minus)]))
        return HeightPrediction(noise_mm, bias_mm, total, scatter * (noise_mm / total) ** 2, share)

    def _unit_noise(self, number: int) -> Floats:
        """White noise (2, H, W), by number always the same."""
        return np.random.default_rng([number, 3]).standard_normal((2, *self.view.truth.u.shape))

    @cached_property
    def _usual(self) -> tuple[float, float]:
        """Rms height error from white noise over that from the first draw of it, and its standard error as a
        share."""
        sizes = np.array([self._size(self._unit_noise(number)) for number in range(DRAWS)])
        usual = rms(sizes)
        scatter = float(np.std(sizes)) / usual / math.sqrt(DRAWS)
        return self._whole_over_weighed * usual / float(sizes[0]), scatter

    @cached_property
    def _whole_over_weighed(self) -> float:
        """Rms height error of the whole camera over the view's, weighed, from the same white noise."""
        if self.view.stride == 1:
            return 1.0
        whole, size = self.full, self.view.truth.u.shape[::-1]
        rng, squares = np.random.default_rng(5), np.zeros(2)
        for _ in range(PAIRED):
            noise = rng.standard_normal((2, *whole.truth.u.shape))
            thin = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in noise])
            squares += _known_rms(_errors(whole, noise)) ** 2, self._size(self.view.stride * thin) ** 2
        return float(np.sqrt(squares[0] / squares[1]))

    def _size(self, noise: Floats) -> float:
        """Rms height error (mm) from so much noise, in units of REFERENCE, weighed."""
        return _known_rms(self._weighed * _errors(self.view, noise))

    @cached_property
    def unit_sigma(self) -> Floats:
        """Error bars (mm) of the whole camera's heights under noise of one cell along u and v, rms over its
        pixels behind one of the view; NaN where there are none."""
        square, share = self._blocks
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.sqrt(square / share))

    @cached_property
    def to_full(self) -> Floats:
        """Per pixel of the view: height error on the whole camera over that on the view, for the same noise
        (cells)."""
        factor = self.unit_sigma / _unit_sigma(self.view)
        return np.asarray(np.where(np.isfinite(factor), factor, np.nanmedian(factor)))

    @cached_property
    def _weighed(self) -> Floats:
        """`to_full`, weighed by the whole camera's pixels that stand behind one of the view."""
        share = self._blocks[1]
        return np.asarray(self.to_full * np.sqrt(share / share[self.view.usable].mean()))

    @cached_property
    def _blocks(self) -> tuple[Floats, Floats]:
        """Over the whole camera's pixels behind one of the view: mean square of unit sigma (mm), 0 where
        there is none, and the share with one."""
        sigma = _unit_sigma(self.full)
        known = np.isfinite(sigma)
        size = self.view.truth.u.shape[::-1]
        square, share = (
            np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float64)
            for values in (np.where(known, sigma, 0.0) ** 2, known.astype(np.float64))
        )
        return square, share


def _errors(view: View, noise: Floats) -> Floats:
    """Height errors (mm) of a view from noise (2, H, W) of REFERENCE cells; NaN beside the usable pixels."""
    height = Lever.solve(view, REFERENCE * noise, np.full(noise.shape, REFERENCE), view.visible)
    return np.where(height.good & view.usable, height.z - view.truth.z, np.nan)


def _known_rms(values: Floats) -> float:
    return rms(values[np.isfinite(values)])


def _unit_sigma(view: View) -> Floats:
    """Error bars (mm) of a view's heights per cell of noise, NaN beside the usable pixels."""
    noise = np.full((2, *view.truth.u.shape), REFERENCE)
    height = Lever.solve(view, 0 * noise, noise, view.visible)
    return np.where(height.good & view.usable, height.sigma / REFERENCE, np.nan)
