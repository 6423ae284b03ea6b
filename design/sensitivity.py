"""Error propagation from pattern coordinates to height, by the solver.

The bias (the part of the error that does not change sign with the noise) is propagated as decoded. The noise
is one draw for all sequences, scaled by the decoder's sigma and by the rms of error over sigma. A height
error consists mostly of low frequencies of the noise: it varies strongly between draws, but hardly between
sequences. The ratio of the rms over many draws to this draw is computed once.

Scaling from a thinned camera to the full one: height errors by independent noise scale with the pixel
distance, but not uniformly (most next to the pattern's edge, where they are largest). Error bars at full size
give the factor per pixel; one noise field on both cameras gives the overall factor.
"""

import math
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence, Decoder, Flag, Response, Settings
from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.projector import NOMINAL_SENSOR, ColourCapture, exact_response
from optolever.reconstruct import HeightMap, reconstruct
from optolever.samples import UserImages, levels_of, rms, sigma_ratio, with_noise
from optolever.scene import Scene, Surface
from optolever.timing import timed

from .candidates import Candidate
from .view import Prediction, View, stride_for, view_of

REFERENCE = 0.01  # cells of noise, for the comparison of draws and of both cameras
DRAWS = 24  # draws of noise, for the rms relative to the draw of all sequences
PAIRED = 6  # draws of noise on both cameras: the ratio of their errors varies by 2 to 3 % between draws


@dataclass(frozen=True, slots=True)
class HeightPrediction:
    """total: rms over the measured pixels by noise and bias, mm; spread: its relative standard error by the
    finite number of noise draws; share: share of the usable pixels with a height."""

    total: float
    spread: float
    share: float


@dataclass(frozen=True, slots=True)
class Simulation:
    """Of rendered, decoded, reconstructed frames over draws of noise, where the footprint is clear of the
    pattern's border: rms height error and its standard deviation, mm; rms(error / sigma); share of the pixels
    with a height; CPU seconds of decoding by a profile and solving one capture, median and half range."""

    error: float
    spread: float
    ratio: float
    share: float
    seconds: float
    seconds_spread: float


class Lever:
    """Error propagation of a scene with a dent (or at rest): height error of any sequence's prediction."""

    def __init__(
        self, scene: Scene, surface: Surface, *, stride: int | None = None, calibrated: bool = False
    ) -> None:
        """The numbers of the scene are taken as exact: errors by noise are the solver's alone. calibrated:
        the decoder knows the response of the scene's display."""
        self.response = None
        if calibrated and scene.display is not None:
            levels = np.arange(256.0)
            self.response = Response(levels, 255 * scene.display.light(levels), scene.pattern.blur_px)
        self.scene, self.surface = replace(scene, accuracy=None, covariance=None), surface
        self.view = view_of(self.scene, surface, stride_for(scene) if stride is None else stride)
        if not self.view.visible.any():
            raise InputError(
                f"scene {scene.name!r}: no pixel sees the pattern; check its poses and lengths (mm)"
            )

    def simulate(
        self, candidate: Candidate, noise: float, seeds: Many[int], renderer: str = "auto", lag: float = 0.0
    ) -> Simulation:
        """Frames of the full camera, a draw of noise per seed, by this package's decoder or the candidate's.
        InputError if the frames cannot be decoded or no anchor has valid pixels."""
        full, pattern, found = self.full, candidate.pattern, list[tuple[float, ...]]()
        levels = levels_of(self.scene, self.surface, full.truth, pattern, lag, renderer)
        decode = self._decoder(candidate)
        for seed in (seeds[0], *seeds):  # the first compiles, and estimates the profile
            frames = with_noise(levels, self.scene.sensor or NOMINAL_SENSOR, noise, seed)
            taken = timed(partial(_solved, decode, frames, self.scene))
            height, good = taken.value, taken.value.good & full.usable
            ratio = sigma_ratio(height.z, full.truth.z, height.sigma, good)
            share = float(good.sum() / full.usable.sum())
            found.append((rms((height.z - full.truth.z)[good]), ratio, share, taken.processor))
        errors, ratios, shares, seconds = np.array(found[1:]).T
        spread = float(np.std(errors)), float(np.ptp(seconds)) / 2
        return Simulation(
            rms(errors), spread[0], rms(ratios), float(shares.mean()), float(np.median(seconds)), spread[1]
        )

    def _decoder(self, candidate: Candidate) -> Callable[[NDArray[Any]], Correspondence]:
        """The candidate's decoder, or this package's."""
        own, pattern = candidate.decoder, candidate.pattern
        if own is None and candidate.sequence.packing is not None:
            return self._decoded_colours(candidate.sequence)
        if own is None:
            return Decoder(candidate.sequence, settings=Settings(response=self.response)).decode
        return lambda frames: own(frames, pattern.levels if isinstance(pattern, UserImages) else pattern)

    def _decoded_colours(self, sequence: Sequence) -> Callable[[NDArray[Any]], Correspondence]:
        """Of pictures in colour, by the exact mix."""
        colours, decoder = exact_response(self.view.sensor), cache(Decoder)

        def decode(images: NDArray[Any]) -> Correspondence:
            taken = ColourCapture(images, sequence).unmixed(colours)
            return decoder(taken.sequence).decode(taken.frames)

        return decode

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
        found = Correspondence(truth.u + shift[0], truth.v + shift[1], stated[0], stated[1], flags)
        return reconstruct(found, view.scene)

    def height(self, prediction: Prediction) -> HeightPrediction:
        """Rms height error by a prediction on `view` of one pair of draws; NaN without an anchor."""
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
            scale, scatter = self._typical
        except InputError:  # no anchor left
            return HeightPrediction(math.nan, math.nan, 0.0)
        reached = plus.good & minus.good & prediction.usable
        noise_mm = scale * rms((self._weighted * 0.5 * (plus.z - minus.z))[reached])
        bias_mm = rms((self._weighted * (0.5 * (plus.z + minus.z) - view.truth.z))[reached])
        total = math.hypot(noise_mm, bias_mm)
        share = float(np.mean([one.good[prediction.usable].mean() for one in (plus, minus)]))
        return HeightPrediction(total, scatter * (noise_mm / total) ** 2, share)

    def _unit_noise(self, number: int) -> Floats:
        """White noise (2, H, W) with `number` as seed."""
        return np.random.default_rng([number, 3]).standard_normal((2, *self.view.truth.u.shape))

    @cached_property
    def _typical(self) -> tuple[float, float]:
        """Rms height error over all draws of white noise, on the full camera, relative to that of the first
        draw on the view; relative standard error."""
        sizes = np.array([self._size(self._unit_noise(number)) for number in range(DRAWS)])
        typical = rms(sizes)
        scatter = float(np.std(sizes)) / typical / math.sqrt(DRAWS)
        return self._full_over_weighted * typical / float(sizes[0]), scatter

    @cached_property
    def _full_over_weighted(self) -> float:
        """Rms height error of the full camera over the view's, weighted, by the same white noise."""
        if self.view.stride == 1:
            return 1.0
        full, size = self.full, self.view.truth.u.shape[::-1]
        rng, squares = np.random.default_rng(5), np.zeros(2)
        for _ in range(PAIRED):
            noise = rng.standard_normal((2, *full.truth.u.shape))
            thin = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in noise])
            squares += _known_rms(_errors(full, noise)) ** 2, self._size(self.view.stride * thin) ** 2
        return float(np.sqrt(squares[0] / squares[1]))

    def _size(self, noise: Floats) -> float:
        """Weighted rms height error (mm) by noise in units of REFERENCE."""
        return _known_rms(self._weighted * _errors(self.view, noise))

    @cached_property
    def to_full(self) -> Floats:
        """Per pixel of the view: height error on the full camera over that on the view, for the same noise
        (cells)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.sqrt(np.divide(*self._blocks)) / _unit_sigma(self.view)
        return np.asarray(np.where(np.isfinite(factor), factor, np.nanmedian(factor)))

    @cached_property
    def _weighted(self) -> Floats:
        """`to_full`, weighted by the share of usable full-camera pixels inside each pixel of the view."""
        share = self._blocks[1]
        return np.asarray(self.to_full * np.sqrt(share / share[self.view.usable].mean()))

    @cached_property
    def _blocks(self) -> tuple[Floats, Floats]:
        """Over the full camera's pixels inside each pixel of the view: mean square of unit sigma (mm), 0 for
        unusable pixels, and the share of usable ones."""
        sigma = _unit_sigma(self.full)
        known = np.isfinite(sigma)
        size = self.view.truth.u.shape[::-1]
        square, share = (
            np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float64)
            for values in (np.where(known, sigma, 0.0) ** 2, known.astype(np.float64))
        )
        return square, share


def _solved(
    decode: Callable[[NDArray[Any]], Correspondence], frames: NDArray[Any], scene: Scene
) -> HeightMap:
    return reconstruct(decode(frames), scene)


def _errors(view: View, noise: Floats) -> Floats:
    """Height errors (mm) of a view by noise (2, H, W) of REFERENCE cells; NaN outside the usable pixels."""
    height = Lever.solve(view, REFERENCE * noise, np.full(noise.shape, REFERENCE), view.visible)
    return np.where(height.good & view.usable, height.z - view.truth.z, np.nan)


def _known_rms(values: Floats) -> float:
    return rms(values[np.isfinite(values)])


def _unit_sigma(view: View) -> Floats:
    """Error bars (mm) of a view's heights per cell of noise, NaN outside the usable pixels."""
    noise = np.full((2, *view.truth.u.shape), REFERENCE)
    height = Lever.solve(view, 0 * noise, noise, view.visible)
    return np.where(height.good & view.usable, height.sigma / REFERENCE, np.nan)
