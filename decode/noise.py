"""Noise of the camera, from what the frames themselves cannot explain: variance = read^2 + gain * level."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .noise_kernels import (
    DISTANCE,
    LEVEL,
    LINES,
    MODULATION,
    MOST,
    clear_residuals,
    fringe_residuals,
    pair_residuals,
)
from .plan import Code, Fringe, Plan
from .sample import Sample, quantile
from .variance_kernels import variances_by_level

__all__ = ["QUANTISATION", "Noise", "estimate_noise"]

#: Variance of rounding to whole levels.
QUANTISATION = 1 / 12
Floats = NDArray[Any]
_BINS = 8
#: Levels that are told from each other when they are sorted.
_STEPS = 4096
#: Residuals of all codes or fringes that are used, about: 1 % of the noise.
_ENOUGH = 8192
#: Contrasts of a group of frames that are used at most.
_CONTRASTS = 6


@dataclass(frozen=True, slots=True)
class Noise:
    """variance = read2 + gain * level, camera levels (after the response, where one was given)."""

    read2: float
    gain: float = 0.0

    def variance(self, level: float) -> float:
        """Variance of one sample at a level."""
        return self.read2 + self.gain * max(level, 0.0)


def estimate_noise(
    frames: NDArray[Any],
    sample: Sample,
    lut: NDArray[np.float32],
    clip: float,
    plan: Plan,
    slope: NDArray[np.float32],
) -> Noise:
    """Pool the residuals of every model with degrees of freedom left, as a function of the level.

    Fringes of N >= 4 shifts: N - 3 contrasts that offset and fringe do not reach. Else bits with inverses:
    their sums are all the same level. Else the offsets of two fringes, which are the same. Else coarse bits
    against white and black. Where none of these was shown (N = 3 alone), the offset's second differences over
    neighbours (Immerkaer, doi:10.1006/cviu.1996.0060).

    With a response (lut): noise of linear levels, or with its slope (d raw / d linear at 0..255) of raw ones.
    """
    levels = lut[sample.levels] if len(lut) else sample.levels
    raw = sample.levels if len(slope) else levels
    limit = float(lut[min(len(lut) - 1, int(clip))]) if len(lut) else clip
    codes = [axis.code for axis in plan.axes if axis.code is not None]
    every = [fringe for axis in plan.axes for fringe in axis.fringes]
    over = [fringe for fringe in every if len(fringe.index) > 3]
    alike = [tuple(f for f in over if len(f.index) == count) for count in {len(f.index) for f in over}]
    pairs = [_of_fringes(levels, fringes, limit, slope, _ENOUGH // len(over)) for fringes in alike]
    if not _enough(pairs):
        pairs = [_of_pairs(raw, code, clip if len(slope) else limit, _ENOUGH // len(codes)) for code in codes]
    if not _enough(pairs) and not len(slope):
        pairs = [_of_offsets(levels, *two, limit) for two in pairwise(every)]
    if not _enough(pairs) and plan.white >= 0 and plan.black >= 0:
        pairs = [_of_flat_bits(raw, code, plan, clip if len(slope) else limit) for code in codes]
    if not _enough(pairs):
        pairs = [
            _of_neighbours(frames, slope[:0] if len(slope) else lut, index)
            for index in _offset_groups(plan, len(frames))
        ]
    level = np.concatenate([pair[0] for pair in pairs])
    residual = np.concatenate([pair[1] for pair in pairs])
    return _fit(level, residual, QUANTISATION if frames.dtype.kind == "u" else 1e-12)


def _enough(pairs: list[tuple[Floats, Floats]]) -> bool:
    return sum(len(level) for level, _ in pairs) >= 50


def _of_fringes(
    levels: NDArray[Any], fringes: tuple[Fringe, ...], limit: float, slope: NDArray[np.float32], enough: int
) -> tuple[Floats, Floats]:
    """Of fringes of the same number of samples, `enough` residuals of each."""
    index, *models = _together(fringes)
    count = models[-1].shape[1]
    own = levels[:, :: max(1, levels.shape[1] * count // enough)][index].astype(np.float32)
    pixels = own.shape[2]
    level, residual = np.empty((2, len(fringes) * count * pixels), np.float32)
    room, weights = np.empty((LINES, pixels), np.float32), np.empty((count, pixels), np.float32)
    used = fringe_residuals(own, *models, slope, limit, room, weights, level, residual)
    return level[:used], residual[:used]


@lru_cache(maxsize=16)
def _together(fringes: tuple[Fringe, ...]) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Of fringes of N samples each: frames (F, N), models (F, N, 3), their pseudo-inverses (F, 3, N) and some
    contrasts that they do not reach (F, C, N)."""
    matrices = zip(*((f.design(), f.solve(), f.contrasts()[:_CONTRASTS]) for f in fringes), strict=True)
    design, solve, contrasts = (np.stack(each).astype(np.float32) for each in matrices)
    return np.array([fringe.index for fringe in fringes]), design, solve, contrasts


def _of_offsets(levels: NDArray[Any], first: Fringe, second: Fringe, limit: float) -> tuple[Floats, Floats]:
    room = np.zeros((LINES, levels.shape[1]), np.float32)
    offsets, variance = [], 0.0
    room[DISTANCE], room[MODULATION] = np.inf, np.inf
    for fringe in (first, second):
        own, design = levels[list(fringe.index)].astype(np.float64), fringe.design()
        inverse = fringe.solve()
        parameters = inverse @ own
        fitted, seen = design @ parameters, np.hypot(parameters[1], parameters[2])
        far = np.minimum(fitted.min(axis=0), limit - fitted.max(axis=0))
        far[own.max(axis=0) >= limit] = -np.inf
        room[DISTANCE] = np.minimum(room[DISTANCE], far)
        # both are to see their fringe
        room[MODULATION] = np.minimum(room[MODULATION], seen / max(quantile(seen, MOST), 1e-9))
        offsets.append(parameters[0])
        variance += float(np.sum(inverse[0] ** 2))
    room[LEVEL] = 0.5 * (offsets[0] + offsets[1])
    difference = ((offsets[0] - offsets[1]) / np.sqrt(variance)).astype(np.float32)[None]
    weights, level, residual = np.empty_like(difference), *np.empty((2, difference.size), np.float32)
    used = clear_residuals(room, weights, difference, level, residual)
    return level[:used], residual[:used]


def _of_pairs(levels: NDArray[Any], code: Code, limit: float, enough: int) -> tuple[Floats, Floats]:
    both = (code.plain >= 0) & (code.inverse >= 0)
    bits = int(np.count_nonzero(both))
    if bits < 2:
        return np.zeros(0), np.zeros(0)
    contrasts = _against_the_mean(bits)
    count = len(contrasts)
    index = np.stack([code.plain[both], code.inverse[both]])
    own = levels[:, :: max(1, levels.shape[1] * count // enough)][index].astype(np.float32)
    pixels = own.shape[2]
    level, residual = np.empty((2, count * pixels), np.float32)
    room, weights = np.empty((LINES, pixels), np.float32), np.empty((count, pixels), np.float32)
    used = pair_residuals(own, contrasts, limit, room, weights, level, residual)
    return level[:used], residual[:used]


@lru_cache(maxsize=16)
def _against_the_mean(count: int) -> Floats:
    """Some contrasts (C, count) of sums of two samples, in deviations of one, that do not change if all of
    these do by the same."""
    basis = np.linalg.qr(np.ones((count, 1)), mode="complete")[0]
    return np.ascontiguousarray(0.5**0.5 * basis[:, 1:].T[:_CONTRASTS], np.float32)


def _of_flat_bits(levels: NDArray[Any], code: Code, plan: Plan, limit: float) -> tuple[Floats, Floats]:
    """The two coarsest bits read white or black nearly everywhere; the fit sorts out their edges."""
    levels = levels.astype(np.float64)
    white, black = levels[plan.white], levels[plan.black]
    level, residual = [], []
    for bit in range(max(0, len(code.plain) - 2), len(code.plain)):
        own = levels[max(code.plain[bit], code.inverse[bit])]
        for reference in (white, black):
            near = np.abs(own - reference) < 0.5 * np.abs(white - black)
            near &= (own < limit) & (reference < limit)
            # the sum is free of the difference's noise, as a bin's level must be
            level.append(0.5 * (own + reference)[near])
            residual.append((own - reference)[near] / np.sqrt(2.0))
    return np.concatenate(level), np.concatenate(residual)


def _offset_groups(plan: Plan, frames: int) -> list[list[int]]:
    groups = [list(fringe.index) for axis in plan.axes for fringe in axis.fringes]
    return groups or [[i] for i in range(min(frames, 8))]


def _of_neighbours(frames: NDArray[Any], lut: NDArray[np.float32], index: list[int]) -> tuple[Floats, Floats]:
    rows = frames.shape[1]
    top = max(0, rows // 2 - 128)
    raw = frames[index, top : top + 256]
    mean = (lut[raw] if len(lut) else raw).astype(np.float64).mean(axis=0)
    if min(mean.shape) < 3:
        return np.zeros(0), np.zeros(0)
    across = mean[:, :-2] - 2 * mean[:, 1:-1] + mean[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    around = mean[:, :-2] + mean[:, 1:-1] + mean[:, 2:]
    around = (around[:-2] + around[1:-1] + around[2:]) / 9
    return around.ravel(), second.ravel() * np.sqrt(len(index))


def _fit(level: Floats, residual: Floats, floor: float) -> Noise:
    """Robust variance per level bin, then a weighted straight line that is nowhere below the floor."""
    if len(level) == 0:
        return Noise(floor)
    bins = min(_BINS, max(1, len(level) // 200))
    x, y = _by_level(level, residual, bins, floor)
    # a variance from n values has the relative error sqrt(2 / n)
    weight = np.sqrt(len(level) // bins / 2) / y
    if bins < 3 or np.ptp(x) < 0.05 * max(x.max(), 1.0):
        return _even(level, residual, floor)
    slope, start, error = _line(x, y, weight**2)
    if slope < 3 * error:
        return _even(level, residual, floor)
    if start < floor:
        slope = max(0.0, np.sum(weight**2 * x * (y - floor)) / np.sum(weight**2 * x * x))
        return Noise(floor, float(slope))
    return Noise(start, slope)


def _line(x: Floats, y: Floats, weight: Floats) -> tuple[float, float, float]:
    """Slope and start of the straight line nearest to y, and the slope's standard error; weight: 1 / variance
    (np.polyfit takes five times as long)."""
    whole = float(weight.sum())
    middle_x, middle_y = float(weight @ x) / whole, float(weight @ y) / whole
    off = x - middle_x
    spread = float(weight @ (off * off))
    slope = float(weight @ (off * (y - middle_y))) / spread
    return slope, middle_y - slope * middle_x, spread**-0.5


def _even(level: Floats, residual: Floats, floor: float) -> Noise:
    """The same at all levels."""
    return Noise(float(_by_level(level, residual, 1, floor)[1][0]))


def _by_level(level: Floats, residual: Floats, bins: int, floor: float) -> tuple[Floats, Floats]:
    """Mean level (bins,) and robust variance (bins,), at least `floor`."""
    count, (mean, variance) = len(level), np.empty((2, bins))
    told = (numbers.astype(np.float32, copy=False) for numbers in (level, residual, _dither(count)))
    variances_by_level(*told, np.empty((3, count), np.float32), np.empty(_STEPS, np.int64), mean, variance)
    return mean, np.maximum(variance, floor)


@lru_cache(maxsize=4)
def _dither(count: int) -> Floats:
    """On whole grey values, sums and differences have the same parity, which a bin of one level would
    select."""
    return np.random.default_rng(0).uniform(-1, 1, count).astype(np.float32)
