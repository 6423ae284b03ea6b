"""Noise of the camera, level by level: variance = read^2 + gain * level, from lit pixels.

Photon transfer on combinations of a pixel's samples of one level each that vanish at every place: residuals
of fringes and of pairs of a bit and its inverse (plan.constraints), at the mean level; differences of two
frames of a code in which a pixel is bright, or dark. Their second differences along a row are noise: a
deviation of display or camera from the description (gamma, lag, indirect light) is smooth over neighbours.
Without any combination, second differences of the frames (J. Immerkaer, doi:10.1006/cviu.1996.0060).
Variances are trimmed means in bins of equal width, which dark pixels do not fill.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64

from .plan import Fringe, Plan, constraints

__all__ = ["Noise", "Sample", "fit_noise", "noise_of", "quantile", "regression"]

Residuals = tuple[F64, F64]
#: Share of a pixel's half contrast from which on a bit is bright or dark, and not at an edge.
_FULL = 0.8
#: Deviations of the trimming, and the remaining share of a normal variance.
_TRIM, _REMAINING = 3.0, 0.9733
#: Bins by level; fewest residuals of a bin (18 %); largest number of residuals of a kind.
_BINS, _FEWEST, _MOST = 12, 64, 1 << 17
#: Fewest differences of codes, dark and bright, that make residuals of fringes unnecessary (4 %).
_ENOUGH = 2048
#: Values for a quantile.
_SOME = 1 << 14
#: Relative error of a bin's variance beyond chance, so that no bin decides alone.
_UNSURE = 0.03


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
    """Pixels in runs along rows: places (K, 2) row, column; linear levels (N, K) float32, NaN: saturated; raw
    ones (N, K)."""

    places: NDArray[np.int64]
    levels: F32
    raw: NDArray[Any]

    def only(self, keep: Any) -> "Sample":
        """Select pixels."""
        return Sample(self.places[keep], self.levels[:, keep], self.raw[:, keep])

    def adjacent(self, count: int) -> NDArray[np.int64]:
        """First pixels (T,) of so many adjacent ones in a row."""
        flat = self.places[:, 0] * (1 << 32) + self.places[:, 1]
        return np.flatnonzero(flat[count - 1 :] - flat[: max(len(flat) - count + 1, 0)] == count - 1)


def regression(waves: F64, of: F64, rank: float) -> F64:
    """Least squares (M, W) of maps (M, K) by waves (W, K), without directions whose singular value is less
    than `rank` of the largest."""
    square, direction = np.linalg.eigh(waves @ waves.T)
    kept = square > rank**2 * square[-1]
    some = direction[:, kept]
    return np.asarray((of @ waves.T @ some / square[kept]) @ some.T)


def quantile(values: NDArray[Any], share: float) -> float:
    """The finite value next below a quantile, of some of many: np.quantile takes five times as long."""
    some = values.ravel()[:: 1 + values.size // _SOME]
    number = int(share * (len(some) - 1))
    return float(np.partition(some, number)[number])


def fit_noise(plan: Plan, sample: Sample, rounding: float = 1 / 12) -> Noise:
    """Noise of the lit pixels of a sample; rounding: least variance, levels^2."""
    levels, first = sample.levels.astype(np.float64), sample.adjacent(3)
    groups = constraints(plan, len(levels))
    rows = np.concatenate(groups[:-1] or groups) if groups else np.zeros((0, len(levels)))
    kinds = [_of_codes(plan, levels, sample.adjacent(5))]
    if not _two_levels(kinds[0][0]):
        fringes = [f for axis in plan.axes for f in axis.fringes if len(groups) > 1]  # rows within a fringe
        kinds.append(_of_rows(rows, levels, first, fringes))
    if sum(len(one) for one, _ in kinds) < _FEWEST:
        kinds = [_of_rows(np.eye(len(levels)), levels, first)]
    return noise_of(kinds, rounding)


def _two_levels(level: F64) -> bool:
    """Both terms of a variance follow: enough levels in the lowest and in the highest third."""
    if not len(level):
        return False
    low, high = level.max() / 3, level.max() * 2 / 3
    return bool(min(np.count_nonzero(level < low), np.count_nonzero(level > high)) >= _ENOUGH)


def _of_rows(rows: F64, levels: F64, first: NDArray[np.int64], fringes: Sequence[Fringe] = ()) -> Residuals:
    """Levels and second differences of orthonormal combinations (M, N) of the samples (N, K), less
    the fringes' harmonics, which a gamma makes oscillate along a row."""
    first = first[:: 1 + len(rows) * len(first) // _MOST]
    nan = np.isnan(levels)
    levels = np.where(nan, np.fmax.reduce(levels, axis=None, initial=0.0), levels)  # saturated: about white
    saturated = np.asarray(nan.any(axis=0))
    lost = np.zeros((len(rows), len(saturated)), np.bool_)
    if saturated.any():
        lost[:, saturated] = (np.abs(rows) > 1e-9).astype(np.float64) @ nan[:, saturated] > 0
    level, residual = np.square(rows) @ levels, rows @ levels
    if fringes and residual.size:
        waves = np.concatenate([fringe.harmonics(levels[list(fringe.index)]) for fringe in fringes])
        known = ~saturated if len(saturated) - np.count_nonzero(saturated) >= _ENOUGH else slice(None)
        residual -= regression(waves[:, known], residual[:, known], 1e-3) @ waves
    kept = ~(lost[:, first] | lost[:, first + 1] | lost[:, first + 2])
    return _second(level, first)[1][kept], _second(residual, first)[0][kept]


def _second(of: F64, first: NDArray[np.int64]) -> tuple[F64, F64]:
    """Second difference over its noise, and weighted mean, (M, T) of three pixels of maps (M, K)."""
    a, b, c = of[:, first], of[:, first + 1], of[:, first + 2]
    return (a - 2 * b + c) / np.sqrt(6), (a + 4 * b + c) / 6


def _of_codes(plan: Plan, levels: F64, first: NDArray[np.int64]) -> Residuals:
    """Of differences of frames of the codes in which five adjacent pixels are bright, or dark: at `first` and
    after."""
    codes = [axis.code for axis in plan.axes if axis.code is not None]
    bits = [int(i) for code in codes for pair in (code.plain, code.inverse) for i in pair if i >= 0]
    frames = [i for i in (plan.white, plan.black) if i >= 0] + bits
    if len(bits) < 2:
        return np.zeros(0), np.zeros(0)
    seen, at, none = levels[frames], np.arange(len(frames), dtype=np.int16)[:, None], np.int16(-1)
    first = first[:: 1 + len(frames) * len(first) // _MOST]
    with np.errstate(invalid="ignore"):
        # a mean of the five selects without regard to their second differences
        sums = seen[:, :-4] + seen[:, 1:-3] + seen[:, 2:-2] + seen[:, 3:-1] + seen[:, 4:]
        mean, bend = sums[:, first] / 5, seen[:, 1:-3] - 2 * seen[:, 2:-2] + seen[:, 3:-1]
        low, high = np.fmin.reduce(mean), np.fmax.reduce(mean)
        share = (2 * mean - low - high) / np.maximum(high - low, 1e-6)
        found = []
        for full in (share > _FULL, share < -_FULL):
            before = np.maximum.accumulate(np.where(full, at, none), axis=0)
            # the nearest frame before of the same state; np.nonzero takes five times as long
            i, t = np.divmod(np.flatnonzero(full[1:] & (before[:-1] >= 0)), full.shape[1])
            j, i, k = before[i, t], i + 1, first[t]
            level = 0.5 * (seen[i, k + 2] + seen[j, k + 2])
            found.append((level, (bend[i, k] - bend[j, k]) / np.sqrt(12)))
    return np.concatenate([a for a, _ in found]), np.concatenate([b for _, b in found])


def _trimmed(residual: F64) -> float:
    """Variance of the bulk of residuals: mean square of those within _TRIM deviations of it, iterated."""
    square = np.square(residual)
    # start from above: of integer grey values more than half of the residuals may be 0
    most = 3 * len(square) // 4
    variance = 4 * float(np.partition(square, most)[most]) / 1.15**2 + 1e-9
    for _ in range(30):
        kept = square <= _TRIM**2 * variance
        number = np.count_nonzero(kept)
        found = float(square @ kept.astype(np.float64)) / number / _REMAINING if number else variance
        if abs(found - variance) <= 1e-4 * variance:
            break
        variance = found
    return max(variance, 1e-9)


def _bins(level: F64, residual: F64) -> list[tuple[float, float, float]]:
    """Level, variance, its relative error, of bins of equal width."""
    if len(level) < _FEWEST:
        return []
    edges = np.linspace(level.min(), level.max() + 1e-3, _BINS + 1)
    place, found = np.digitize(level, edges[1:-1]), []
    for k in range(_BINS):
        own = place == k
        if np.count_nonzero(own) >= _FEWEST:
            # neighbours' second differences overlap: 70 / 36 of the variance of independent ones
            error = float(np.sqrt(2 * 1.94 / np.count_nonzero(own) + _UNSURE**2))
            found.append((float(level[own].mean()), _trimmed(residual[own]), error))
    return found


def noise_of(kinds: list[Residuals], rounding: float) -> Noise:
    """Straight line through the variances of residuals by level, (n,) each, kind by kind; both terms limited
    from below; rounding: see fit_noise."""
    bins = [one for kind in kinds for one in _bins(*kind)]
    if not bins:
        return Noise(max(1.0, rounding))
    x, y, error = np.array(bins).T
    y = np.maximum(y, rounding)
    model = np.maximum(np.median(y), rounding)
    for _ in range(8):  # weights of the line itself: those of the bins favour low variances
        design = np.stack([np.ones_like(x), x], axis=1) / (error * model)[:, None]
        read2, gain = np.linalg.lstsq(design, y / (error * model), rcond=None)[0]
        if gain <= 0 or len(x) < 2:
            read2, gain = float(np.average(y, weights=error**-2.0)), 0.0
        elif read2 < rounding:
            read2 = rounding
            gain = float(np.average((y - rounding) / np.maximum(x, 1e-6), weights=(x / (error * model)) ** 2))
        model = read2 + gain * np.maximum(x, 0.0)
    sigma = np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    if len(x) < 2 or gain <= 0:  # one level only: the gain is not known
        sigma = np.array([read2 / np.sqrt((error**-2.0).sum()), np.nan])
    return Noise(max(float(read2), rounding), max(float(gain), 0.0), float(sigma[0]), float(sigma[1]))
