"""Phase shifting: least squares of N samples per period, I_i = A + c cos d_i + s sin d_i.

Phase = atan2(s, c); its variance follows from the covariance of c and s (for N equidistant steps 2 sigma^2 /
(N B^2), the Cramer-Rao bound). Combinations of the samples that vanish for every fringe are residuals: over
their noise they give chi2. A nonlinear display or camera has harmonics; N >= 4 steps see the second one in
the residuals, but shift no phase by it. So what residuals of a sample share with mean, amplitude and the
first three harmonics of the phase is regressed out of them; the rest of the bulk scales the phase's variance.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I64, inlined, kernel
from optolever.kernels import ONE as _ONE
from optolever.kernels import ZERO as _ZERO

from ..frames import RawFrames, Response, level_of
from ..noise import Noise, Sample
from ..plan import Fringe, harmonic_terms
from ..records import Flag

__all__ = [
    "Fit",
    "FringeTable",
    "Misfit",
    "bent",
    "fringe_rows",
    "fringe_tables",
    "measure_misfit",
    "straightened",
    "three_step_aliasing",
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
#: Fits of a clipped pixel.
_REFITS = 3
#: Phases of a bend; harmonics of a display's light; relative error of its blur.
_BEND, _HARMONICS, _BLUR = 4096, 16, 0.1
#: Terms of the harmonics: 1, offset, amplitude, cosine and sine of one to three times the phase.
_TERMS = 9


class Misfit(NamedTuple):
    """Of one fringe's residuals: scale of its variance (chi2 of the bulk, 1 or more), terms (N - 3, 9) to
    regress out, and variance (cycles^2) of the phase that no residual has (aliased harmonics, other periods).
    bend (2, B): correction of the phase by the display's response, cycles, and slope of the corrected phase
    at measured phases from -1/2 on; empty: without."""

    scale: float
    terms: F64
    variance: float = 0.0
    bend: F64 = np.zeros((2, 0))


class FringeTable(NamedTuple):
    """One fringe for kernels: N samples, rounded up to groups of four; M residuals, one at least.

    frames (N,); weights (3 + M, N) of offset, c, s, residuals; design (samples, 3);
    covariance (3,) of c and s; scale, more: of the variance, cycles^2; terms (M, 9), regressed out; bend (2,
    B): see Misfit
    """

    period: np.float32
    frames: I64
    weights: F32
    design: F64
    covariance: F32
    scale: np.float32
    more: np.float32
    terms: F32
    bend: F32


class Fit(NamedTuple):
    """Maps (n, W) of one fringe: offset, amplitude, levels; phase, cycles, its variance."""

    offset: F32
    amplitude: F32
    phase: F32
    variance: F32


def fringe_tables(
    axes: list[tuple[Fringe, ...]], misfits: list[tuple[Misfit, ...]], matrix: F64 | None = None
) -> tuple[tuple[FringeTable, ...], ...]:
    """matrix (F, F): levels of the frames are corrected by it (lag), None: not."""
    every = zip(axes, misfits, strict=True)
    return tuple(tuple(_table(*one, matrix) for one in zip(axis, own, strict=True)) for axis, own in every)


def _table(fringe: Fringe, misfit: Misfit, matrix: F64 | None) -> FringeTable:
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
        misfit.bend.astype(np.float32),
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
    residual, variance = (rows @ levels)[:, lit], variance[lit]
    model = fringe.harmonics(levels[:, lit])
    plain = float(np.median(residual**2 / variance)) / _MEDIAN
    weight = 1 / np.sqrt(variance)
    scaled = (model * weight).T
    norms = np.maximum(np.linalg.norm(scaled, axis=0), 1e-9)
    terms = (np.linalg.lstsq(scaled / norms, (residual * weight).T, rcond=_RANK)[0] / norms[:, None]).T
    rest = float(np.median((residual - terms @ model) ** 2 / variance)) / _MEDIAN
    aliased = _aliased(fringe, residual, phase[lit], amplitude[lit])
    if plain < _WORTH * max(rest, 1.0):
        return Misfit(max(plain, 1.0), nothing, aliased)
    return Misfit(max(rest, 1.0), terms, aliased)


def bent(fringe: Fringe, response: Response, blur: float, misfit: Misfit) -> Misfit:
    """The misfit with the correction of the phase by a display's response, and its variance by the blur's
    error; blur: rms, pattern px, of the light; NaN: unknown, then half a cell with an error of a quarter."""
    low, blur, high = (0.25, 0.5, 0.75) if np.isnan(blur) else (blur * k for k in (1 - _BLUR, 1, 1 + _BLUR))
    bend, less, more = (_bend(fringe, response.light(), one) for one in (blur, low, high))
    return misfit._replace(bend=bend, variance=float(np.mean(np.square(0.5 * (more[0] - less[0])))))


def _bend(fringe: Fringe, light: F64, blur: float) -> F64:
    """Misfit.bend: the fringe's light goes harmonic by harmonic through the blur into the samples."""
    true = np.arange(_BEND) / _BEND
    curve = np.interp(127.5 + 127.5 * np.cos(2 * np.pi * true), np.arange(256.0), light)
    k = np.arange(_HARMONICS)
    wave = np.fft.rfft(curve)[:_HARMONICS].real * np.exp(-2 * np.square(np.pi * k * blur / fringe.period))
    wave[0] /= 2
    angles = 2 * np.pi * true - fringe.shifts[:, None]
    _, c, s = fringe.inverse @ np.tensordot(wave, np.cos(k[:, None, None] * angles), 1)
    measured = np.unwrap(np.arctan2(s, c), period=2 * np.pi) / (2 * np.pi)
    at = np.arange(_BEND) / _BEND - 0.5
    away = np.interp(at, measured, true - measured, period=1)
    return np.stack([away, 1 + np.gradient(away, 1 / _BEND)])


def straightened(turn: F64, misfit: Misfit) -> F64:
    """Measured phases, cycles, corrected by the bend."""
    if not misfit.bend.size:
        return turn
    return np.asarray(turn + misfit.bend[0, ((turn + 0.5) * _BEND).astype(np.int64) % _BEND])


def _aliased(fringe: Fringe, residual: F64, phase: F64, amplitude: F64) -> float:
    """Bound on the variance (cycles^2) of a phase of N >= 4 steps by harmonics of a smooth curve.

    N equidistant steps alias those of N - 1 and N + 1 to the fundamental: a wave of N periods per cycle, up
    to h_(N-1) / h_1. Smooth curves have harmonics that fall off about as powers of h_2 / h_1: the bound is
    taken as (N - 2) (h_2 / h_1)^(N - 2), and a wave of that amplitude adds a third of its square."""
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
    mean level deviates from the middle of white and black, or of a bit and its inverse (ends), by h_2 for a
    quadratic curve, and within 1 % for x^2.2."""
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
    top = np.empty(width, light[0].dtype)
    _fit_rows(*light, noise, fringe[1:3], fringe[4:8], start, work, top, fit, chi2, clipped)
    if clipped.any():
        _refit(light, noise, fringe, start, fit, clipped, flags)
    if fringe.bend.size:
        phase, variance = fit.phase, fit.variance
        at = ((phase + np.float32(0.5)) * np.float32(_BEND)).astype(np.int32) % _BEND
        phase += fringe.bend[0, at]
        phase -= np.rint(phase)
        variance *= np.square(fringe.bend[1, at])


def _refit(
    light: tuple[RawFrames, F32 | None, np.float32],
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    start: int,
    fit: Fit,
    clipped: NDArray[np.bool_],
    flags: NDArray[np.int32],
) -> None:
    """Fit clipped pixels (K,) to the samples that are not saturated, less the harmonics of that fit."""
    (raw, table, clip), design, n = light, fringe.design, len(fringe.design)
    r, x = np.nonzero(clipped)
    some = raw[fringe.frames[:n], start + r[:, None], x[:, None]]  # (K, N)
    keep = (some < clip).astype(np.float64)
    level = some.astype(np.float64) if table is None else table[some].astype(np.float64)
    normal = np.einsum("kn,ni,nj->kij", keep, design, design)
    enough = np.linalg.det(normal) > _DEGENERATE * max(float(np.linalg.det(design.T @ design)), 1e-9)
    flags[r[~enough], x[~enough]] |= _SATURATED
    r, x, keep, level, normal = (one[enough] for one in (r, x, keep, level, normal))
    inverse, rows, harmonics = np.linalg.inv(normal), fringe.weights[3:, :n], np.zeros_like(level)
    o = c = s = np.zeros(len(r))
    for _ in range(_REFITS):
        o, c, s = np.einsum("kij,kj->ik", inverse, (keep * (level - harmonics)) @ design)
        harmonics = (fringe.terms @ harmonic_terms(o, c, s)).T @ rows
    power = np.maximum(c * c + s * s, 1e-6)
    across = inverse[:, 1, 1] * s * s - 2 * inverse[:, 1, 2] * c * s + inverse[:, 2, 2] * c * c
    own = noise[0] + noise[1] * np.maximum(o, 0.0)
    fit.offset[r, x], fit.amplitude[r, x], fit.phase[r, x] = o, np.sqrt(power), np.arctan2(s, c) / (2 * np.pi)
    fit.variance[r, x] = fringe.more + fringe.scale * own * across / (2 * np.pi * power) ** 2


@kernel
def _fit_rows(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    samples: tuple[I64, F32],
    numbers: tuple[F32, np.float32, np.float32, F32],
    start: int,
    work: F32,
    top: RawFrames,
    fit: Fit,
    chi2: F32,
    clipped: NDArray[np.bool_],
) -> None:
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
                    two = w0 * level_of(raw[i0, y, x], table) + w1 * level_of(raw[i1, y, x], table)
                    two += w2 * level_of(raw[i2, y, x], table) + w3 * level_of(raw[i3, y, x], table)
                    work[line, x] += two
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
