"""Noise of the camera, from constraints that no scene can violate: variance = read^2 + gain * level.

Photon transfer on the constraints of a sequence (plan.constraints): residuals of fringes with more than three
shifts, sums of bits and inverses, mean levels of fringes, else bits near the reference levels, else
differences of neighbours. Only illuminated, unclipped pixels count; scales are trimmed means, which are
robust to edges, reflections and some moving pixels. If a response is inverted, the noise is that of the
camera's levels: residuals are divided by the slope of the inverse (see under_response).
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..frames import Light, sample_levels, sample_places
from ..plan import Fringe, Plan, constraints

__all__ = [
    "Noise",
    "Sample",
    "bulk",
    "estimate_noise",
    "fitted_noise",
    "harmonics",
    "modulation",
    "product",
    "residuals",
    "sample_at",
    "sampled",
    "trimmed_variance",
    "under_response",
    "unexplained",
    "unsaturated",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Modulation over its noise from which on a pixel is illuminated: noise alone exceeds it once in 6e7.
_SURE = 6.0
#: Largest number of pixels, half of the residuals: variances to 1 %.
_MOST = 8192
#: Deviations of the trimming, and the remaining share of a normal variance.
_TRIM, _LEFT = 3.0, 0.9733
#: Deviations beyond which a residual is an outlier, and the median square of a standard normal.
_FAR, _MEDIAN = 4.0, 0.455
#: Fewest residuals for a variance (18 %); pixels that determine noise and map well; runs of 64 pixels of a
#: sample: 1000 and 8000 pixels on a mirror that fills 10 % of the image.
_FEWEST, _ENOUGH = 64, 1024
_FEW_RUNS, _MANY_RUNS = 128, 1024
#: Largest number of second differences: a sweep's many frames need fewer pixels.
_BENDS = 1 << 15
_BINS = 8
#: Share of the constraints, with the least slopes, that give the noise under a response.
_STRAIGHT = 0.25
#: Iterations of the noise and the spread of a response, which depend on each other.
_ROUNDS = 3
#: Share of a pixel's contrast from which on a bit is bright or dark, and not at an edge.
_FULL = 0.8
#: Smallest significant misfit, share of the noise's variance, and size of the sample: of 700 pixels with one
#: constraint each, the median has this chance error.
_UNLIKE, _ASKED = 0.2, 2048


class Numbers(NamedTuple):
    """Fields of Noise as float32, for kernels."""

    read2: np.float32
    gain: np.float32
    rounding2: np.float32
    misfit2: np.float32


@dataclass(frozen=True, slots=True)
class Noise:
    """variance = read2 + gain * level of one sample, linear camera levels; rounding is part of read2.

    The misfit variance is larger: it includes rounding2, as rounding is not a random error (all samples of a
    pixel may be rounded alike), and misfit2 times the squared amplitude: residuals of the constraints beyond
    noise in all pixels, by deviations of display or camera from the description.
    read2_sigma, gain_sigma: standard deviations, NaN: not estimated.
    """

    read2: float
    gain: float = 0.0
    rounding2: float = 0.0
    misfit2: float = 0.0
    read2_sigma: float = float("nan")
    gain_sigma: float = float("nan")

    def numbers(self) -> Numbers:
        """The first four fields as float32, for kernels."""
        return Numbers(*(np.float32(x) for x in (self.read2, self.gain, self.rounding2, self.misfit2)))

    def variance(self, level: Any) -> Any:
        """Variance of one sample at a level."""
        return self.read2 + self.gain * np.maximum(level, 0.0)


@dataclass(frozen=True, slots=True)
class Sample:
    """Pixels from all over the image: places (K, 2) row, column; linear levels (N, K); white: saturated.

    Under a response: the camera's levels (N, K), and the ratio of the linear levels' variance to theirs.
    """

    places: NDArray[np.int64]
    levels: F32
    white: float = float("inf")
    camera: F32 | None = None
    steep: F32 | None = None

    def only(self, keep: Any) -> "Sample":
        """Select pixels."""
        camera, steep = (one if one is None else one[:, keep] for one in (self.camera, self.steep))
        return replace(
            self, places=self.places[keep], levels=self.levels[:, keep], camera=camera, steep=steep
        )

    def variance(self, noise: Noise) -> Any:
        """Variance of a sample of each pixel (K,), linear levels^2; under a response their mean."""
        if self.steep is None:
            return noise.variance(self.levels.mean(axis=0))
        return (noise.variance(self.camera) * self.steep).mean(axis=0)

    def variances(self, rows: F32, noise: Noise) -> Any:
        """Variance (M, K) of orthonormal combinations (M, N) of the samples."""
        if self.steep is None:
            return np.broadcast_to(self.variance(noise), (len(rows), self.levels.shape[1]))
        return np.square(rows) @ (noise.variance(self.camera) * self.steep)

    def slopes(self, rows: Any) -> Any:
        """Deviation of combinations (M, N) of the samples over that of one camera level, (M, K) or (M, 1)."""
        square = np.square(rows)
        return np.sqrt(square.sum(axis=1, keepdims=True) if self.steep is None else square @ self.steep)


def sampled(light: Light, mask: NDArray[np.bool_] | None, runs: int) -> Sample:
    """A sample of pixels in runs along rows; mask (H, W): restricts it."""
    places = sample_places(light.raw.shape[1:], runs)
    if mask is not None:
        places = places[mask[places[:, 0], places[:, 1]]]
    return sample_at(light, places)


def sample_at(light: Light, places: NDArray[np.int64]) -> Sample:
    """Pixels at places (K, 2)."""
    levels = sample_levels(light, places)
    sample = Sample(places, np.where(np.isnan(levels), np.float32(light.white), levels), light.white)
    if not len(light.spread):
        return sample
    raw = light.raw[:, places[:, 0], places[:, 1]]
    return replace(sample, camera=raw.astype(np.float32), steep=light.steep[raw])


def modulation(plan: Plan, levels: F32) -> tuple[F32, float]:
    """Amplitude (K,) of the axis with the least, and its variance over that of a sample.

    Fringes: the finest of each axis; codes: half the difference of white and black or of the coarsest pair.
    """
    if not plan.axes:  # spots
        return np.ptp(levels, axis=0) / 2, 0.5 * float(np.log(max(len(levels), 3)))
    least, variance = np.full(levels.shape[1], np.inf, np.float32), 0.0
    for axis in plan.axes:
        if axis.fringes:
            fringe = axis.fringes[-1]
            inverse = fringe.inverse[1:].astype(np.float32)
            part, factor = np.hypot(*(inverse @ levels[list(fringe.index)])), float((inverse**2).sum() / 2)
        else:
            own = levels[list(axis.frames()) + [i for i in (plan.white, plan.black) if i >= 0]]
            part, factor = np.ptp(own, axis=0) / 2, 0.5 * np.log(max(len(own), 3))
        least, variance = np.minimum(least, part), max(variance, factor)
    return least, variance


def estimate_noise(light: Light, plan: Plan, mask: NDArray[np.bool_] | None = None) -> tuple[Noise, Sample]:
    """The camera's noise, and a sample of illuminated pixels; the sample is enlarged if they are few."""
    if light.response is not None and not len(light.spread):
        light = light.under(light.rounding, 0.0)
    for runs in (_FEW_RUNS, _MANY_RUNS):
        for _ in range(1 if light.response is None else _ROUNDS):
            noise, lit = _estimated(light, plan, sampled(light, mask, runs))
            light = light.under(noise.read2, noise.gain)
        if lit.levels.shape[1] >= _ENOUGH:
            break
    return noise, lit


def under_response(light: Light, noise: Noise, lit: Sample) -> tuple[Light, Noise, Sample]:
    """Invert a camera's response, given its noise: levels with their variances, mean noise of these levels,
    and the sample in these levels. Unchanged without a response."""
    if light.response is None:
        return light, noise, lit
    light = light.under(noise.read2, noise.gain)
    lit = sample_at(light, lit.places)  # with spread
    if not lit.levels.size:
        return light, noise, lit
    usual = float(lit.variance(noise).mean())
    rounding = noise.rounding2 * usual / float(noise.variance(lit.camera).mean())
    return light, Noise(usual, 0.0, rounding, noise.misfit2), lit


def _estimated(light: Light, plan: Plan, sample: Sample) -> tuple[Noise, Sample]:
    """From all pixels first, then from illuminated ones."""
    groups = constraints(plan, len(light.raw))
    floor = max(light.rounding, 1e-12)
    noise = fitted_noise(*residuals(plan, sample, groups), floor)
    amplitude, factor = modulation(plan, sample.levels)
    seen = amplitude**2 > _SURE**2 * factor * sample.variance(noise)
    if _FEWEST <= np.count_nonzero(seen) < len(seen):
        sample, amplitude = sample.only(seen), amplitude[seen]
        level, residual = residuals(plan, sample, groups)
        if len(residual) >= _FEWEST:  # single pixels have no neighbours
            noise = fitted_noise(level, residual, floor)
    return replace(noise, rounding2=light.rounding, misfit2=_misfit(sample, amplitude, groups, noise)), sample


def _misfit(sample: Sample, amplitude: F32, groups: tuple[F64, ...], noise: Noise) -> float:
    """Variance of the constraints' residuals beyond noise, of the bulk of pixels, over the amplitude^2."""
    if not groups or not sample.levels.size:
        return 0.0
    thin = max(1, sample.levels.shape[1] // _ASKED)
    rows, some = groups[-1].astype(np.float32), sample.only(slice(None, None, thin))
    whole = unsaturated(rows, some.levels, sample.white)
    told = whole.any(axis=0)
    if np.count_nonzero(told) < _FEWEST:  # the noise is less precise than the misfit
        return 0.0
    some, whole = some.only(told), whole[:, told]
    power = np.square(amplitude[::thin][told], dtype=np.float64)
    square = (np.square(product(rows, some.levels)) * whole).sum(axis=0) / whole.sum(axis=0)
    beyond = square - (some.variances(rows, noise) * whole).sum(axis=0) / whole.sum(axis=0)
    found = float(np.median(beyond / np.maximum(power, 1e-9)))
    # a mean square has the relative error sqrt(2 / n), a median sqrt(pi / 2) more
    chance = max(_UNLIKE, 3 * float(np.sqrt(np.pi / whole.sum())))
    least = chance * float(np.median(square - beyond)) / max(float(np.median(power)), 1e-9)
    return found if found > least else 0.0


def residuals(plan: Plan, sample: Sample, groups: tuple[F64, ...]) -> tuple[F32, F32]:
    """Level and residual (M,) of the most reliable constraints, or of second differences without any."""
    thin = max(1, sample.levels.shape[1] // _MOST)
    few = sample.only(slice(None, None, thin))
    levels, camera = few.levels, few.levels if few.camera is None else few.camera
    if groups:
        rows = groups[0]
        if not unsaturated(rows.astype(np.float32), levels, sample.white).any():
            rows = _of_four(plan, rows)
        every = [fringe for axis in plan.axes for fringe in axis.fringes]
        unlike = any(len(fringe.unlike) for fringe in every)
        pairs = np.empty((0, 2), np.int64) if unlike else _pairs(plan)
        if len(pairs) > 1:
            rows = _of_pairs(pairs, len(levels))
        part = slice(None, None, max(1, len(rows) * levels.shape[1] // (2 * _MOST)))
        some = rows[part].astype(np.float32)
        used = np.abs(some) > 0
        mean = product(used.astype(np.float32), camera) / used.sum(axis=1, keepdims=True)
        slopes = np.broadcast_to(few.slopes(some), mean.shape)
        residual, kept = product(some, levels), unsaturated(some, levels, sample.white)
        if few.steep is not None:  # where it is not steep, the inverse is linear over the noise
            kept &= slopes <= np.quantile(slopes, _STRAIGHT)
        if len(pairs) > 1:
            kept &= _at_the_ends(pairs, levels)[part]
        fringes = [(one, harmonics(one, levels)) for one in every]
        _explain(residual, kept, used, fringes)
        return mean[kept], (residual / slopes)[kept]
    return _neighbours(plan, sample.only(slice(_MOST)))


def _explain(
    residual: F32, kept: NDArray[np.bool_], used: NDArray[np.bool_], fringes: list[tuple[Fringe, F32]]
) -> None:
    """Subtract the part of residuals (M, K) of frames (M, N) that their fringes' waves (see harmonics)
    explain; it is fitted to kept pixels without outliers. Levels of several fringes count as one, weighted by
    their light, as their differences are residuals."""
    for row in np.flatnonzero(kept.any(axis=1)):
        own = [(one, waves) for one, waves in fringes if used[row, list(one.index)].any()]
        if not own:
            continue
        light = [float(np.square(one.exposure).sum()) for one, _ in own]
        level = np.average([waves[:1] for _, waves in own], axis=0, weights=light).astype(np.float32)
        waves = np.concatenate([level, *(waves[1:] for _, waves in own)])
        most = 4 * trimmed_variance(residual[row, kept[row]]) ** 0.5 + 1e-6
        usual = np.flatnonzero(kept[row] & (np.abs(residual[row]) < most))
        residual[row] = unexplained(residual[row, None], waves, usual[:: max(1, len(usual) // _ASKED)])[0]


def _of_four(plan: Plan, rows: F64) -> F64:
    """Combinations (M, N) of four neighbouring steps of a fringe that vanish: if every pixel is clipped in
    some frame, some of these combinations are not. `rows` if no fringe has more steps."""
    found = []
    for fringe in (one for axis in plan.axes for one in axis.fringes if len(one.index) > 4):
        order = np.argsort(np.mod(fringe.shifts, 2 * np.pi))
        for k in range(len(order)):
            four = np.roll(order, k)[:4]
            found.append(np.zeros(rows.shape[1]))
            found[-1][np.array(fringe.index)[four]] = np.linalg.svd(fringe.design[four])[0][:, 3]
    return np.stack(found) if found else rows


def _pairs(plan: Plan) -> NDArray[np.int64]:
    """Frames (P, 2) of bits and their inverses."""
    codes = [np.stack([axis.code.plain, axis.code.inverse], axis=1) for axis in plan.axes if axis.code]
    every = np.concatenate([np.empty((0, 2), np.int64), *codes])
    return np.asarray(every[(every >= 0).all(axis=1)])


def _of_pairs(pairs: NDArray[np.int64], count: int) -> F64:
    """Orthonormal combinations (P / 2, count): one pair's sum less the next one's."""
    rows = np.zeros((len(pairs) // 2, count))
    for row, pair, other in zip(rows, pairs[::2], pairs[1::2], strict=False):
        row[pair], row[other] = 0.5, -0.5
    return rows


def _at_the_ends(pairs: NDArray[np.int64], levels: F32) -> NDArray[np.bool_]:
    """Whether (P / 2, K) both pairs have a bright and a dark sample: a nonlinear response distorts the sums
    of levels between."""
    apart = np.abs(levels[pairs[:, 0]] - levels[pairs[:, 1]])
    full = apart >= _FULL * apart.max(axis=0)
    half = len(pairs) // 2
    return np.asarray(full[: 2 * half : 2] & full[1 : 2 * half : 2])


def unsaturated(rows: F32, levels: F32, white: float) -> NDArray[np.bool_]:
    """Constraints (M, K) none of whose samples is saturated; rows (M, N), levels (N, K)."""
    clipped = levels >= white
    if not clipped.any():
        return np.ones((len(rows), levels.shape[1]), np.bool_)
    return np.asarray(product((np.abs(rows) > 0).astype(np.float32), clipped.astype(np.float32)) == 0)


def harmonics(fringe: Fringe, levels: Any) -> Any:
    """Harmonics (7, K) of a fringe, from levels (N, K): offset; c and s; cosine and sine of two and three
    times the phase, times the amplitude."""
    offset, c, s = product(fringe.inverse.astype(levels.dtype), levels[list(fringe.index)])
    wave = c + 1j * s
    unit = wave / np.maximum(np.abs(wave), 1e-6)
    every = wave, wave * unit, wave * unit * unit
    return np.stack([offset, *(part for one in every for part in (one.real, one.imag))])


def unexplained(residuals: Any, waves: Any, kept: Any = slice(None)) -> Any:
    """Residuals (M, K) less their regression on waves (W, K) over the pixels to keep: a part that follows
    level and phase, as by a gain of single frames or by a response, is not noise."""
    some = waves[:, kept].astype(np.float64)
    both = product(residuals[:, kept].astype(np.float64), some.T)
    parts = np.linalg.lstsq(product(some, some.T), both.T)[0].T.astype(waves.dtype)
    return residuals - product(parts, waves)


def product(one: Any, other: Any) -> Any:
    """Matrix product by NumPy's loop: a library's threads would wait busily and occupy the cores."""
    return np.einsum("mn,nk->mk", one, other)


def _neighbours(plan: Plan, few: Sample) -> tuple[F32, F32]:
    """Second differences along runs of pixels, of every frame (J. Immerkaer, doi:10.1006/cviu.1996.0060).

    With white and black: of the difference from the nearer one, which cancels the scene's brightness. The
    difference itself is not noise: indirect light is less if half of the pattern is dark, and edges of bits
    are blurred.
    """
    places = few.places
    run = np.flatnonzero((places[2:, 0] == places[:-2, 0]) & (places[2:, 1] == places[:-2, 1] + 2))
    frames, off, steep, same = _off_references(plan, few)
    run = run[:: 1 + len(frames) * len(run) // _BENDS]
    camera = (few.levels if few.camera is None else few.camera)[frames]

    def three(of: Any) -> tuple[Any, Any, Any]:
        return of[:, run], of[:, run + 1], of[:, run + 2]

    (one, middle, other), spread = three(off), three(steep)
    bend = (one - 2 * middle + other) / np.sqrt(spread[0] + 4 * spread[1] + spread[2])
    a, b, c = three(same)
    kept = (a >= 0) & (a == b) & (b == c)
    return three(camera)[1][kept], bend[kept]


def _off_references(plan: Plan, few: Sample) -> tuple[list[int], F32, F32, NDArray[np.int8]]:
    """Frames (F,) of bits; per pixel (F, K) their difference from the nearer of white and black, its variance
    over that of a camera level, and index of the nearer one, -1: saturated. Without references, all frames
    unchanged."""
    levels, ends = few.levels, [plan.white, plan.black]
    steep = np.ones_like(levels) if few.steep is None else few.steep
    if min(ends) < 0:
        return list(range(len(levels))), levels, steep, -(levels >= few.white).astype(np.int8)
    frames = sorted({i for axis in plan.axes for i in axis.frames()})
    distance = np.abs(levels[frames, None] - levels[ends])
    nearer = (distance[:, 0] >= distance[:, 1]).astype(np.int8)
    reference = np.where(nearer == 0, levels[ends[0]], levels[ends[1]])
    more = steep[frames] + np.where(nearer == 0, steep[ends[0]], steep[ends[1]])
    nearer[np.maximum(levels[frames], reference) >= few.white] = -1
    return frames, levels[frames] - reference, more, nearer


def bulk(residual: F32) -> NDArray[np.bool_]:
    """Mask of residuals (M, K): True except for outliers of their row."""
    square = np.square(residual)
    usual = np.median(square[:, :: 1 + square.shape[1] // _ASKED], axis=1, keepdims=True)
    return np.asarray(square <= _FAR**2 / _MEDIAN * usual)


def trimmed_variance(residual: NDArray[np.floating[Any]]) -> float:
    """Variance of the bulk of residuals: mean square of those within _TRIM deviations of it, iterated."""
    square = np.square(residual)
    # start from above: with integer grey values more than half of the residuals may be 0; 1.15, 1.645: a
    # normal's 75th and 90th percentile; a fault in a part of the image is beyond the first
    at = [int(share * (len(square) - 1)) for share in (0.75, 0.9)]
    inner, outer = (float(one) for one in np.partition(square, at)[at])
    variance = 4 * (inner / 1.15**2 or outer / 1.645**2) + 1e-12
    for _ in range(30):
        kept = square[square <= _TRIM**2 * variance]
        found = float(kept.mean()) / _LEFT if len(kept) else variance
        if abs(found - variance) <= 1e-4 * variance:
            break
        variance = found
    return max(variance, 1e-12)


def fitted_noise(level: F32, residual: F32, floor: float) -> Noise:
    """Trimmed variance by level, and a weighted straight line through it that is limited by the floor."""
    whole = max(trimmed_variance(residual), floor) if len(residual) else floor
    # a variance of n values has the relative error sqrt(2 / n)
    sigma = whole * float(np.sqrt(2 / max(len(residual), 1)))
    if len(level) < 8 * _FEWEST:
        return Noise(whole, read2_sigma=sigma)
    edges = np.linspace(level.min(), level.max() + 1e-3, _BINS + 1)
    place = np.digitize(level, edges[1:-1])
    full = [k for k in range(_BINS) if np.count_nonzero(place == k) >= _FEWEST]
    if len(full) < 3 or np.ptp(edges) < 0.05 * max(float(edges[-1]), 1.0):
        return Noise(whole, read2_sigma=sigma)
    x = np.array([level[place == k].mean() for k in full], np.float64)
    y = np.array([max(trimmed_variance(residual[place == k]), floor) for k in full])
    weight = np.array([np.count_nonzero(place == k) / 2 for k in full]) / y**2
    design = np.stack([np.ones(len(x)), x], axis=1)
    covariance = np.linalg.inv(design.T @ (weight[:, None] * design))
    start, slope = covariance @ (design.T @ (weight * y))
    if slope < 3 * np.sqrt(covariance[1, 1]):
        return Noise(whole, read2_sigma=sigma)
    sigmas = {"read2_sigma": float(covariance[0, 0] ** 0.5), "gain_sigma": float(covariance[1, 1] ** 0.5)}
    if start < floor:
        gain = float(np.sum(weight * x * (y - floor)) / np.sum(weight * x * x))
        return Noise(floor, max(0.0, gain), **sigmas)
    return Noise(float(start), float(slope), **sigmas)
