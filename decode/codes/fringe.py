"""Phase shifting: least squares of N samples per period, I_i = A + c cos d_i + s sin d_i.

Phase = atan2(s, c); its variance follows from the covariance of c and s (for N equidistant steps
2 sigma^2 / (N B^2), the Cramer-Rao bound). Combinations of the samples that vanish for every fringe are
residuals: over their noise they give chi2. A nonlinear display or camera has harmonics; N >= 4 steps see the
second
one in the residuals, but shift no phase by it. So what residuals of a sample share with mean, amplitude and
the
first three harmonics of the phase is regressed out of them; the rest of the bulk scales the phase's variance.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I64, inlined, kernel
from optolever.kernels import ONE as _ONE
from optolever.kernels import ZERO as _ZERO

from ..frames import RawFrames, level_of
from ..noise import Noise, Sample
from ..plan import Fringe
from ..records import Flag

__all__ = [
    "Fit",
    "FringeTable",
    "Misfit",
    "fringe_rows",
    "fringe_tables",
    "measure_misfit",
    "three_step_aliasing",
    "variance_of",
]

_SATURATED = np.int32(Flag.SATURATED)
_TWO = np.float32(2)
_TINY = np.float32(1e-6)
_CYCLES2 = np.float32(1 / (4 * np.pi**2))
#: Determinant of a fit's normal matrix, relative to all samples, below which samples are too few.
_DEGENERATE = 1e-3
#: Fewest and most pixels for a misfit; median of chi2 with one degree of freedom; ratio of chi2 without and
#: with harmonics
#: from which on they are regressed out.
_FEWEST, _MOST, _MEDIAN, _WORTH = 64, 4096, 0.4549, 1.1
#: Deviations from which on a harmonic is significant; condition of the regression.
_SURE, _RANK = 4.0, 1e-2
#: Weight of a frame that is left out of a lag's correction, share of the noise that costs nothing.
_NEGLIGIBLE = 3e-4
#: Entries of a table of variances by level.
_LEVELS = 256
#: Terms of the harmonics: 1, offset, amplitude, cosine and sine of one to three times the phase.
_TERMS = 9


class Misfit(NamedTuple):
    """Of one fringe's residuals: scale of its variance (chi2 of the bulk, 1 or more), terms (N - 3, 9) to
    regress
    out, and variance (cycles^2) of the phase that no residual has (aliased harmonics, other periods)."""

    scale: float
    terms: F64
    variance: float = 0.0


class FringeTable(NamedTuple):
    """One fringe for kernels: N samples, rounded up to groups of four; M residuals, one at least.

    frames (N,); weights (3 + M, N) of offset, c, s, residuals; design (samples, 3);
    covariance (3,) of c and s; scale, more: of the variance, cycles^2; terms (M, 9), regressed out
    spread (256,): variance of a sample by its linear level times step; empty: not by the level
    """

    period: np.float32
    frames: I64
    weights: F32
    design: F64
    covariance: F32
    scale: np.float32
    more: np.float32
    terms: F32
    spread: F32
    step: np.float32


class Fit(NamedTuple):
    """Maps (n, W) of one fringe: offset, amplitude, levels; phase, cycles, its variance."""

    offset: F32
    amplitude: F32
    phase: F32
    variance: F32


def fringe_tables(
    axes: list[tuple[Fringe, ...]], misfits: list[tuple[Misfit, ...]], noise: Noise, matrix: F64 | None = None
) -> tuple[tuple[FringeTable, ...], ...]:
    """matrix (F, F): levels of the frames are corrected by it (lag), None: not."""
    spread, step = np.zeros(0, np.float32), 0.0
    if noise.response is not None and matrix is None:
        level = np.linspace(0.0, noise.response.shown[-1], _LEVELS)
        spread, step = noise.variance(level).astype(np.float32), (_LEVELS - 1) / float(level[-1])
    by = matrix, spread, np.float32(step)
    every = zip(axes, misfits, strict=True)
    return tuple(tuple(_table(f, m, *by) for f, m in zip(axis, own, strict=True)) for axis, own in every)


def _table(fringe: Fringe, misfit: Misfit, matrix: F64 | None, spread: F32, step: np.float32) -> FringeTable:
    index, weights = _samples(fringe, matrix)
    cov, groups = weights[1:3] @ weights[1:3].T, -len(index) % 4
    padded = np.pad(weights, ((0, max(4 - len(weights), 0)), (0, groups)))
    terms = np.zeros((len(padded) - 3, _TERMS))
    terms[: len(misfit.terms)] = misfit.terms
    return FringeTable(
        np.float32(fringe.period),
        np.pad(index, (0, groups), mode="edge"),
        padded.astype(np.float32),
        fringe.design if matrix is None else np.zeros((len(index), 3)),
        np.array([cov[0, 0], cov[0, 1], cov[1, 1]], np.float32) * _CYCLES2,
        np.float32(misfit.scale),
        np.float32(misfit.variance),
        terms.astype(np.float32),
        spread,
        step,
    )


def _samples(fringe: Fringe, matrix: F64 | None) -> tuple[I64, F64]:
    """Frames and weights (3 + M, N) of offset, c, s and the normed residuals."""
    weights = np.concatenate([fringe.inverse, fringe.unlike])
    index = np.array(fringe.index, np.int64)
    if matrix is None:
        return index, weights
    whole = weights @ matrix[index]
    used = np.flatnonzero(np.abs(whole).max(axis=0) > _NEGLIGIBLE)
    whole = whole[:, used]
    whole[3:] /= np.maximum(np.linalg.norm(whole[3:], axis=1, keepdims=True), 1e-9)
    return used.astype(np.int64), whole


def measure_misfit(fringe: Fringe, sample: Sample, noise: Noise) -> Misfit:
    """Misfit of the bulk of a sample's pixels."""
    rows, nothing = fringe.unlike, np.zeros((len(fringe.unlike), _TERMS))
    levels = sample.levels[list(fringe.index)].astype(np.float64)
    levels = levels[:, np.isfinite(levels).all(axis=0)]
    levels = levels[:, :: 1 + levels.shape[1] // _MOST]
    if len(rows) == 0 or levels.shape[1] < _FEWEST:
        return Misfit(1.0, nothing)
    o, c, s = fringe.inverse @ levels
    phase, amplitude, offset = np.arctan2(s, c), np.hypot(c, s), o
    variance = noise.variance(offset)
    lit = amplitude**2 > 50 / len(levels) * variance
    if np.count_nonzero(lit) < _FEWEST:
        return Misfit(1.0, nothing)
    levels, variance = levels[:, lit], np.tile(variance[lit], (len(rows), 1))
    residual, model, expected = rows @ levels, fringe.harmonics(levels), levels - rows.T @ (rows @ levels)
    for _ in range(1 if noise.response is None else 2):
        if noise.response is not None:
            variance = np.square(rows) @ noise.variance(expected)
        terms = np.array([_coefficients(model, *one) for one in zip(residual, variance, strict=True)])
        expected = expected + rows.T @ terms @ model
    plain = float(np.median(residual**2 / variance)) / _MEDIAN
    rest = float(np.median((residual - terms @ model) ** 2 / variance)) / _MEDIAN
    aliased = _aliased(fringe, residual, phase[lit], amplitude[lit])
    if plain < _WORTH * max(rest, 1.0):
        return Misfit(max(plain, 1.0), nothing, aliased)
    return Misfit(max(rest, 1.0), terms, aliased)


def _coefficients(model: F64, residual: F64, variance: F64) -> F64:
    """Coefficients (9,) of the terms (9, K) in a residual (K,)."""
    scaled = (model / np.sqrt(variance)).T
    norms = np.maximum(np.linalg.norm(scaled, axis=0), 1e-9)
    return np.asarray(np.linalg.lstsq(scaled / norms, residual / np.sqrt(variance), rcond=_RANK)[0] / norms)


def variance_of(fringe: Fringe, rows: F64, levels: F64, noise: Noise) -> F64:
    """Variance (M, K) of combinations (M, N) of a fringe's samples (N, K), by their fitted levels."""
    fitted = levels - fringe.unlike.T @ (fringe.unlike @ levels)
    return np.asarray(np.square(rows) @ noise.variance(fitted))


def _aliased(fringe: Fringe, residual: F64, phase: F64, amplitude: F64) -> float:
    """Bound on the variance (cycles^2) of a phase of N >= 4 steps by harmonics of a smooth curve.

    N equidistant steps alias those of N - 1 and N + 1 to the fundamental: a wave of N periods per cycle, up
    to
    h_(N-1) / h_1. Smooth curves have harmonics that fall off about as powers of h_2 / h_1: the bound is
    taken as
    (N - 2) (h_2 / h_1)^(N - 2), and a wave of that amplitude adds a third of its square."""
    double = fringe.unlike @ np.stack([np.cos(2 * fringe.shifts), np.sin(2 * fringe.shifts)], axis=1)
    expected = double @ np.stack([np.cos(2 * phase), np.sin(2 * phase)]) * amplitude
    power = float(np.square(expected).sum())
    if power < residual.shape[1]:
        return 0.0
    second = abs(float((expected * residual).sum())) / power
    square = float(np.mean(residual**2))
    steps, chance = len(fringe.index) - 2, float(np.sqrt(square / power))
    bound = (steps * second**steps) ** 2 / 3
    real = second > _SURE * chance and bound > _NEGLIGIBLE * square / float(np.mean(amplitude**2))
    return float(bound / (2 * np.pi) ** 2) if real else 0.0


def three_step_aliasing(fringe: Fringe, ends: list[tuple[int, int]], sample: Sample, noise: Noise) -> float:
    """Bound on the variance (cycles^2) of a phase of three steps, whose residuals show no harmonic: their
    mean level
    deviates from the middle of white and black, or of a bit and its inverse (ends), by h_2 for a quadratic
    curve, and
    within 1 % for x^2.2."""
    if len(fringe.index) != 3 or not ends:
        return 0.0
    levels = sample.levels.astype(np.float64)
    levels = levels[:, np.isfinite(levels[[*fringe.index, *np.ravel(ends)]]).all(axis=0)]
    if levels.shape[1] < _FEWEST:
        return 0.0
    o, c, s = fringe.inverse @ levels[list(fringe.index)]
    half = np.mean([levels[list(pair)].mean(axis=0) for pair in ends], axis=0)
    power = np.maximum(c * c + s * s, 1.0)
    ratio = (o - half) / np.sqrt(power)
    chance = np.sqrt(np.median(noise.variance(o) / power) / len(ratio))
    bound = abs(float(np.median(ratio)))
    return bound**2 / 3 / (2 * np.pi) ** 2 if bound > _SURE * chance else 0.0


def fringe_rows(
    light: tuple[RawFrames, F32 | None, np.float32],
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    start: int,
    fit: Fit,
    chi2: F32,
    flags: NDArray[np.int32],
) -> None:
    """Fit a fringe in rows of the frames from `start` on; add its residuals to chi2. Where samples are
    saturated the others count, flagged where too few stay."""
    rows, width = chi2.shape
    clipped, work = np.empty((rows, width), np.bool_), np.empty((5, width), np.float32)
    top, weights = np.empty(width, light[0].dtype), fringe.weights
    uneven = len(fringe.spread) > 0
    samples = fringe.frames, weights[:3] if uneven else weights
    _fit_rows(*light, noise, samples, fringe[4:8], start, work, top, fit, chi2, clipped)
    if uneven or clipped.any():
        index = fringe.frames[: len(fringe.design)]
        least = _DEGENERATE * max(float(np.linalg.det(fringe.design.T @ fringe.design)), 1e-9)
        numbers = *noise, fringe.scale, fringe.more, fringe.step, least
        parts = index, fringe.design, weights, fringe.terms, fringe.spread
        _refit(*light, numbers, parts, start, fit, chi2, clipped, flags)


@kernel
def _refit(
    raw: RawFrames, table: F32 | None, clip: np.float32,
    numbers: tuple[np.float32, np.float32, np.float32, np.float32, np.float32, float],
    parts: tuple[I64, F64, F32, F32, F32], start: int, fit: Fit, chi2: F32,
    clipped: NDArray[np.bool_], flags: NDArray[np.int32],
) -> None:  # fmt: skip
    """Least squares of the samples that are not saturated. Where their variance depends on the level (spread)
    all pixels are fitted, weighted by that of the first fit's levels; the variance of the phase is that of
    the expected levels, the fit and its harmonics, under those weights."""
    (rows, width), (read2, gain, scale, more, step, least) = chi2.shape, numbers
    offset, amplitude, phase, variance = fit
    index, design, weights, terms, spread = parts
    uneven, last = spread.size > 0, np.int64(spread.size - 1)
    harmonic, weight = np.zeros((2, index.size))
    for r in range(rows):
        for x in range(width):
            lost = clipped[r, x]
            if not (uneven or lost):
                continue
            turn, a = 2 * np.pi * phase[r, x], float(amplitude[r, x])
            o, c, s = float(offset[r, x]), a * np.cos(turn), a * np.sin(turn)
            for i in range(index.size):
                harmonic[i] = 0.0
            if uneven and not lost:
                c1, s1 = np.cos(turn), np.sin(turn)
                c2, s2 = c1 * c1 - s1 * s1, 2 * c1 * s1
                c3, s3 = c2 * c1 - s2 * s1, s2 * c1 + c2 * s1
                for j in range(3, len(weights)):
                    t = terms[j - 3]
                    wave = t[2] + t[3] * c1 + t[4] * s1 + t[5] * c2 + t[6] * s2 + t[7] * c3 + t[8] * s3
                    wave = t[0] + t[1] * o + a * wave
                    for i in range(index.size):
                        harmonic[i] += weights[j, i] * wave
            i00 = i01 = i02 = i11 = i12 = i22 = b0 = bc = bs = h0 = hc = hs = det = 0.0
            for again in range(2 if lost and uneven else 1):
                even = not uneven or (lost and again == 0)
                n0 = nc = ns = ncc = ncs = nss = b0 = bc = bs = h0 = hc = hs = 0.0
                for i in range(index.size):
                    value = raw[index[i], start + r, x]
                    dc, ds, w = design[i, 1], design[i, 2], 1.0
                    if value >= clip:
                        w = 0.0
                    elif not even:
                        level = o + c * dc + s * ds
                        w = 1 / spread[min(max(np.int64(level * step), np.int64(0)), last)]
                    level, weight[i] = float(level_of(value, table)), w
                    n0, nc, ns = n0 + w, nc + w * dc, ns + w * ds
                    ncc, ncs, nss = ncc + w * dc * dc, ncs + w * dc * ds, nss + w * ds * ds
                    b0, bc, bs = b0 + w * level, bc + w * level * dc, bs + w * level * ds
                    level = w * harmonic[i]
                    h0, hc, hs = h0 + level, hc + level * dc, hs + level * ds
                i00, i01, i02 = ncc * nss - ncs * ncs, ns * ncs - nc * nss, nc * ncs - ns * ncc
                i11, i12, i22 = n0 * nss - ns * ns, nc * ns - n0 * ncs, n0 * ncc - nc * nc
                det = n0 * i00 + nc * i01 + ns * i02
                if even and det <= least:
                    flags[r, x] |= _SATURATED
                    break
                o = (i00 * b0 + i01 * bc + i02 * bs) / det
                c = (i01 * b0 + i11 * bc + i12 * bs) / det
                s = (i02 * b0 + i12 * bc + i22 * bs) / det
            if lost and det <= least:
                continue
            power, own = max(c * c + s * s, 1e-6), float(read2 + gain * max(o, 0.0))
            g0, gc, gs = (c * i02 - s * i01) / det, (c * i12 - s * i11) / det, (c * i22 - s * i12) / det
            # the harmonics' part that the weighted fit contains
            h0, hc, hs = (
                (i00 * h0 + i01 * hc + i02 * hs) / det,
                (i01 * h0 + i11 * hc + i12 * hs) / det,
                (i02 * h0 + i12 * hc + i22 * hs) / det,
            )
            across = square = 0.0
            for i in range(index.size):
                dc, ds = design[i, 1], design[i, 2]
                level = o - h0 + (c - hc) * dc + (s - hs) * ds + harmonic[i]
                if uneven:
                    own = float(spread[min(max(np.int64(level * step), np.int64(0)), last)])
                across += own * (weight[i] * (g0 + gc * dc + gs * ds)) ** 2
                square += (float(level_of(raw[index[i], start + r, x], table)) - level) ** 2 / own
            offset[r, x], amplitude[r, x] = o, np.sqrt(power)
            phase[r, x] = cycles_of(np.float32(s), np.float32(c))
            variance[r, x] = more + scale * across / (2 * np.pi * power) ** 2
            if uneven and not lost:
                chi2[r, x] += square / scale


@kernel
def _fit_rows(
    raw: RawFrames, table: F32 | None, clip: np.float32, noise: tuple[np.float32, np.float32],
    samples: tuple[I64, F32], numbers: tuple[F32, np.float32, np.float32, F32], start: int, work: F32,
    top: RawFrames, fit: Fit, chi2: F32, clipped: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Offset, c, s and a residual lie in work (5, W), with one over a residual's variance, 0: saturated."""
    (n, width), (read2, gain), (index, weights) = chi2.shape, noise, samples
    covariance, scale, more, terms = numbers
    offset, amplitude, phase, variance = fit
    cc, cs, ss = scale * covariance[0], _TWO * scale * covariance[1], scale * covariance[2]
    for r in range(n):
        y = start + r
        for x in range(width):
            top[x] = raw[index[0], y, x]
        for j in range(len(weights)):
            line = min(j, 3)
            for g in range(0, index.size, 4):
                i0, i1, i2, i3 = index[g], index[g + 1], index[g + 2], index[g + 3]
                w0, w1, w2, w3 = weights[j, g], weights[j, g + 1], weights[j, g + 2], weights[j, g + 3]
                if g == 0:
                    for x in range(width):
                        work[line, x] = _ZERO
                for x in range(width):
                    work[line, x] += (
                        w0 * level_of(raw[i0, y, x], table) + w1 * level_of(raw[i1, y, x], table)
                        + w2 * level_of(raw[i2, y, x], table) + w3 * level_of(raw[i3, y, x], table)
                    )  # fmt: skip
                if j == 0:
                    for x in range(width):
                        brighter = max(max(raw[i0, y, x], raw[i1, y, x]), max(raw[i2, y, x], raw[i3, y, x]))
                        top[x] = max(top[x], brighter)
            if j == 2:
                for x in range(width):
                    a, b = work[1, x], work[2, x]
                    power, own = max(a * a + b * b, _TINY), read2 + gain * max(work[0, x], _ZERO)
                    variance[r, x] = more + own * (cc * b * b - cs * a * b + ss * a * a) / (power * power)
                    amplitude[r, x] = np.sqrt(power)
                for x in range(width):
                    phase[r, x] = cycles_of(work[2, x], work[1, x])
                for x in range(width):
                    work[4, x] = _ONE / (scale * (read2 + gain * max(work[0, x], _ZERO)))
                    offset[r, x] = work[0, x]
                for x in range(width):
                    clipped[r, x] = top[x] >= clip
                    work[4, x] = _ZERO if top[x] >= clip else work[4, x]
            elif j > 2:
                t = terms[j - 3]
                if t[2] != _ZERO:  # take the harmonics off
                    for x in range(width):
                        a = amplitude[r, x]
                        inverse = _ONE / max(a, _TINY)
                        c1, s1 = work[1, x] * inverse, work[2, x] * inverse
                        c2, s2 = c1 * c1 - s1 * s1, _TWO * c1 * s1
                        c3, s3 = c2 * c1 - s2 * s1, s2 * c1 + c2 * s1
                        wave = t[2] + t[3] * c1 + t[4] * s1 + t[5] * c2 + t[6] * s2 + t[7] * c3 + t[8] * s3
                        work[3, x] -= t[0] + t[1] * work[0, x] + a * wave
                for x in range(width):
                    chi2[r, x] += work[3, x] * work[3, x] * work[4, x]


@inlined
def cycles_of(s: np.float32, c: np.float32) -> np.float32:
    """atan2(s, c) / 2 pi in [-1/2, 1/2], float32, to 6e-9: an odd polynomial on [0, 1] and symmetries."""
    far, near = max(abs(s), abs(c)), min(abs(s), abs(c))
    t = near / max(far, _TINY)
    z = t * t
    p = np.float32(-0.000645296093)
    p = p * z + np.float32(0.00347956692)
    p = p * z + np.float32(-0.00889867739)
    p = p * z + np.float32(0.0153459992)
    p = p * z + np.float32(-0.0221362576)
    p = p * z + np.float32(0.0317459424)
    p = p * z + np.float32(-0.0530461207)
    p = p * z + np.float32(0.159154837)
    turn = t * p
    turn = np.float32(0.25) - turn if abs(s) > abs(c) else turn
    turn = np.float32(0.5) - turn if c < np.float32(0) else turn
    return -turn if s < np.float32(0) else turn
