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

from optolever.kernels import F32, F64, I64, exact, inlined, kernel
from optolever.kernels import ZERO as _ZERO

from ..frames import RawFrames, level_of
from ..noise import Noise, Sample
from ..plan import Fringe
from ..records import Flag

__all__ = [
    "Fit",
    "FringeTables",
    "Misfit",
    "fringe_row",
    "fringe_tables",
    "measure_misfit",
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
#: Terms of the harmonics: 1, offset, amplitude, cosine and sine of one to three times the phase.
_TERMS = 9


class Misfit(NamedTuple):
    """Of one fringe's residuals: scale of its variance (chi2 of the bulk, 1 or more), terms (N - 3, 9) to
    regress
    out, and variance (cycles^2) of the phase that no residual has (aliased harmonics, other periods)."""

    scale: float
    terms: F64
    variance: float = 0.0


class FringeTables(NamedTuple):
    """Fringes of the axes for kernels, padded: A axes, K fringes, N samples, M residuals.

    number (A,) of fringes; period (A, K); samples, residuals (A, K): numbers of them;
    frames (A, K, N); weights (A, K, 3 + M, N) of offset, c, s, residuals; design (A, K, N, 3); covariance
    (A, K, 3) of c and
    s; scale, more (A, K): of the variance, cycles^2; harmonic (A, K): whether terms (A, K, M, 9) are
    regressed out
    """

    number: I64
    period: F32
    samples: I64
    residuals: I64
    frames: I64
    weights: F32
    design: F32
    covariance: F32
    scale: F32
    more: F32
    harmonic: NDArray[np.bool_]
    terms: F32


class Fit(NamedTuple):
    """Lines (W,) of one fringe: offset, c, s (levels), residual, phase (cycles), its variance, amplitude;
    brightest
    raw level."""

    offset: F32
    cosine: F32
    sine: F32
    residual: F32
    phase: F32
    variance: F32
    amplitude: F32
    top: RawFrames


def fringe_tables(
    axes: list[tuple[Fringe, ...]], misfits: list[tuple[Misfit, ...]], matrix: F64 | None = None
) -> FringeTables:
    """matrix (F, F): levels of the frames are corrected by it (lag), None: not."""
    fringes = [fringe for axis in axes for fringe in axis]
    a, k = len(axes), max((len(axis) for axis in axes), default=0)
    inputs = [_samples(fringe, matrix) for fringe in fringes]
    n = max((len(index) for index, _ in inputs), default=1)
    m = max((len(fringe.unlike) for fringe in fringes), default=0)
    f32, i64 = np.float32, np.int64
    out = FringeTables(
        np.array([len(axis) for axis in axes], i64),
        np.ones((a, k), f32), np.zeros((a, k), i64), np.zeros((a, k), i64), np.zeros((a, k, n), i64),
        np.zeros((a, k, 3 + m, n), f32), np.zeros((a, k, n, 3), f32), np.zeros((a, k, 3), f32),
        np.ones((a, k), f32), np.zeros((a, k), f32), np.zeros((a, k), bool), np.zeros((a, k, m, _TERMS), f32),
    )  # fmt: skip
    flat = iter(inputs)
    for i, (axis, own) in enumerate(zip(axes, misfits, strict=True)):
        for j, (fringe, misfit) in enumerate(zip(axis, own, strict=True)):
            index, weights = next(flat)
            cov = weights[1:3] @ weights[1:3].T
            out.period[i, j], out.samples[i, j], out.residuals[i, j] = (
                fringe.period,
                len(index),
                len(weights) - 3,
            )
            out.frames[i, j, : len(index)] = index
            out.weights[i, j, : len(weights), : len(index)] = weights
            if matrix is None:
                out.design[i, j, : len(index)] = fringe.design
            out.covariance[i, j] = cov[0, 0], cov[0, 1], cov[1, 1]
            out.scale[i, j], out.more[i, j] = misfit.scale, misfit.variance
            out.harmonic[i, j] = bool(misfit.terms.any())
            out.terms[i, j, : len(misfit.terms)] = misfit.terms
    return out


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
    waves = [part(h * phase[lit]) for h in (1, 2, 3) for part in (np.cos, np.sin)]
    model = np.stack(
        [np.ones(len(variance)), offset[lit], amplitude[lit], *(amplitude[lit] * w for w in waves)]
    )
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


@kernel
def _sums(raw: RawFrames, table: F32 | None, y: int, index: I64, weights: F32, fit: Fit) -> None:
    """Offset, c, s and brightest raw level of a row."""
    o, c, s, _, _, _, _, top = fit
    g = raw[index[0], y]
    for x in range(o.size):
        o[x], c[x], s[x] = _ZERO, _ZERO, _ZERO
        top[x] = g[x]
    for i in range(index.size):
        f = raw[index[i], y]
        m0, m1, m2 = weights[0, i], weights[1, i], weights[2, i]
        for x in range(o.size):
            value = level_of(f[x], table)
            o[x] += m0 * value
            c[x] += m1 * value
            s[x] += m2 * value
        for x in range(o.size):
            top[x] = max(top[x], f[x])


@kernel
def _residuals(raw: RawFrames, table: F32 | None, y: int, index: I64, weights: F32, residual: F32) -> None:
    for x in range(residual.size):
        residual[x] = _ZERO
    for i in range(index.size):
        f, w = raw[index[i], y], weights[i]
        for x in range(residual.size):
            residual[x] += w * level_of(f[x], table)


@kernel
def _regress(terms: F32, fit: Fit) -> None:
    """Take the harmonics' terms off a residual."""
    o, c, s, residual, _, _, amplitude, _ = fit
    t0, t1, t2, t3, t4 = terms[0], terms[1], terms[2], terms[3], terms[4]
    t5, t6, t7, t8 = terms[5], terms[6], terms[7], terms[8]
    for x in range(o.size):
        a = amplitude[x]
        inverse = np.float32(1) / max(a, _TINY)
        cc, ss = c[x] * inverse, s[x] * inverse
        c2, s2 = cc * cc - ss * ss, _TWO * cc * ss
        c3, s3 = c2 * cc - s2 * ss, s2 * cc + c2 * ss
        wave = t2 + t3 * cc + t4 * ss + t5 * c2 + t6 * s2 + t7 * c3 + t8 * s3
        residual[x] -= t0 + t1 * o[x] + a * wave


@kernel
def _phases(
    noise: tuple[np.float32, np.float32], covariance: F32, scale: np.float32, more: np.float32, fit: Fit
) -> None:
    o, c, s, _, phase, variance, amplitude, _ = fit
    read2, gain = noise
    cc, cs, ss = (
        scale * covariance[0] * _CYCLES2,
        scale * covariance[1] * _CYCLES2,
        scale * covariance[2] * _CYCLES2,
    )
    for x in range(o.size):
        a, b = c[x], s[x]
        power = max(a * a + b * b, _TINY)
        across = cc * b * b - _TWO * cs * a * b + ss * a * a
        variance[x] = more + (read2 + gain * max(o[x], _ZERO)) * across / (power * power)
        amplitude[x] = np.sqrt(power)
    for x in range(o.size):
        phase[x] = cycles_of(s[x], c[x])


@kernel
def fringe_row(
    light: tuple[RawFrames, F32 | None, np.float32],
    noise: tuple[np.float32, np.float32],
    tables: FringeTables,
    a: int,
    k: int,
    y: int,
    fit: Fit,
    chi2: F32,
    flags: NDArray[np.int32],
) -> None:
    """Fit fringe k of axis a in row y of the frames; add its residuals to chi2."""
    raw, table, clip = light
    read2, gain = noise
    n = tables.samples[a, k]
    index, weights, scale = tables.frames[a, k, :n], tables.weights[a, k], tables.scale[a, k]
    _sums(raw, table, y, index, weights, fit)
    _phases(noise, tables.covariance[a, k], scale, tables.more[a, k], fit)
    offset, residual, top = fit.offset, fit.residual, fit.top
    for j in range(tables.residuals[a, k]):
        _residuals(raw, table, y, index, weights[3 + j], residual)
        if tables.harmonic[a, k]:
            _regress(tables.terms[a, k, j], fit)
        for x in range(offset.size):
            square = residual[x] * residual[x] / (scale * (read2 + gain * max(offset[x], _ZERO)))
            chi2[x] += square if top[x] < clip else _ZERO
    some = False
    for x in range(top.size):
        some |= top[x] >= clip
    if some:
        _refit(raw, table, clip, noise, index, tables.design[a, k], scale, y, fit, flags)


@exact
def _refit(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    index: I64,
    design: F32,
    scale: np.float32,
    y: int,
    fit: Fit,
    flags: NDArray[np.int32],
) -> None:
    """Fit of the unsaturated samples where some are saturated; flagged where too few stay."""
    m, whole, right = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for x in range(fit.top.size):
        if fit.top[x] < clip:
            continue
        for i in range(3):
            right[i] = 0.0
            for j in range(3):
                m[i, j], whole[i, j] = 0.0, 0.0
        for n in range(index.size):
            keep = raw[index[n], y, x] < clip
            value = level_of(raw[index[n], y, x], table)
            for i in range(3):
                right[i] += design[n, i] * value if keep else 0.0
                for j in range(3):
                    product = np.float64(design[n, i]) * design[n, j]
                    whole[i, j] += product
                    m[i, j] += product if keep else 0.0
        det = _adjugate(m, whole)
        if not det > 0.0:
            flags[x] |= _SATURATED
            continue
        o = (m[0, 0] * right[0] + m[0, 1] * right[1] + m[0, 2] * right[2]) / det
        c = (m[1, 0] * right[0] + m[1, 1] * right[1] + m[1, 2] * right[2]) / det
        s = (m[2, 0] * right[0] + m[2, 1] * right[1] + m[2, 2] * right[2]) / det
        power = max(c * c + s * s, 1e-6)
        across = (m[1, 1] * s * s - 2 * m[1, 2] * c * s + m[2, 2] * c * c) / det
        own = noise[0] + noise[1] * max(o, 0.0)
        fit.offset[x], fit.amplitude[x] = np.float32(o), np.float32(np.sqrt(power))
        fit.phase[x] = np.float32(np.arctan2(s, c) / (2 * np.pi))
        fit.variance[x] = np.float32(scale * own * across / (2 * np.pi * power) ** 2)


@exact
def _adjugate(m: F64, whole: F64) -> float:
    """Replace a symmetric matrix by its adjugate; its determinant, 0 where degenerate beside the whole
    one."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    det: float = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    most = whole[0, 0] * (whole[1, 1] * whole[2, 2] - whole[1, 2] ** 2)
    m[0, 0], m[0, 1], m[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    m[1, 0], m[1, 1], m[1, 2] = m[0, 1], a * f - c * c, b * c - a * e
    m[2, 0], m[2, 1], m[2, 2] = m[0, 2], m[1, 2], a * d - b * b
    return det if det > _DEGENERATE * most else 0.0
