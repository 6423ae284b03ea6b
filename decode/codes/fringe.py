"""Phase shifting: least squares of N samples per period, I_i = A + c cos d_i + s sin d_i.

Phase = atan2(s, c); its variance follows from the covariance of c and s (for N equidistant steps 2 sigma^2 /
(N B^2), the Cramer-Rao bound). Combinations of the samples that vanish for every fringe are residuals: over
their noise they give chi2. A nonlinear display or camera has harmonics; N >= 4 steps see the second one in
the residuals, but shift no phase by it. So what residuals of a sample share with mean, amplitude and the
first three harmonics of the phase is regressed out of them; the rest of the bulk scales the phase's variance.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I32, I64, ONE, ZERO, inlined, kernel

from ..correspondence import Flag
from ..frames import RawFrames, Response, level_of
from ..noise import Noise, Sample, regression
from ..plan import Fringe, harmonics

__all__ = [
    "CLIPPED", "FringeTable", "Misfit", "bent", "fit_row", "fringe_table", "measure_misfit", "refitted",
    "straightened", "three_step_aliasing",
]  # fmt: skip

_SATURATED = np.int32(Flag.SATURATED)
#: Flag of a pixel with saturated samples that is to be fitted to the others; no place keeps it.
CLIPPED = np.int32(1 << 11)
_TWO = np.float32(2)
_TINY = np.float32(1e-6)
_CYCLES2 = np.float32(1 / (4 * np.pi**2))
#: Determinant of a fit's normal matrix, relative to all samples, below which samples are too few.
_DEGENERATE = 1e-3
#: Fewest and most pixels for a misfit; median of chi2 with one degree of freedom; ratio of chi2 without and
#: with harmonics from which on they are regressed out.
_FEWEST, _MOST, _MEDIAN, _WORTH = 64, 4096, 0.4549, 1.1
#: Deviations from which on a harmonic is significant; condition of the regression.
_SURE, _RANK = 4.0, 1e-2
#: Weight of a frame that is left out of a lag's correction, share of the noise that costs nothing.
_NEGLIGIBLE = 3e-4
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
    terms: Annotated[F64, "N 9"]
    variance: float = 0.0
    bend: Annotated[F64, "2 B"] = np.zeros((2, 0))


class FringeTable(NamedTuple):
    """K fringes of an axis for kernels, coarse to fine: N samples, rounded up to groups of four; M residuals,
    one at least.

    period (K,); frames (K, N); weights (K, 3 + M, N) of offset, c, s, residuals; numbers (K, 6): variances
    of c, covariance, of s, scale of the phase's variance, what adds to it, cycles^2, and whether harmonics
    are regressed out; terms (K, M, 9) of these; bend (K, 2, B): see Misfit
    """

    period: F32
    frames: I64
    weights: F32
    numbers: F32
    terms: F32
    bend: F32


def fringe_table(
    fringes: tuple[Fringe, ...], misfits: tuple[Misfit, ...], matrix: F64 | None
) -> tuple[FringeTable, F64]:
    """With the design (K, N, 3) of the samples; matrix (F, F): levels of the frames are corrected by it
    (lag), and have none; None: not."""
    count, samples = len(fringes), [_samples(fringe, matrix) for fringe in fringes]
    groups = max((len(index) + 3 for index, _ in samples), default=4) // 4 * 4
    most = max((len(weights) for _, weights in samples), default=4)
    frames, weights = np.zeros((count, groups), np.int64), np.zeros((count, max(most, 4), groups))
    design, numbers = np.zeros((count, groups, 3)), np.zeros((count, 6))
    terms = np.zeros((count, max(most, 4) - 3, _TERMS))
    for k, (fringe, (index, own), misfit) in enumerate(zip(fringes, samples, misfits, strict=True)):
        frames[k] = np.pad(index, (0, groups - len(index)), mode="edge")
        weights[k, : len(own), : len(index)] = own
        cov = own[1:3] @ own[1:3].T * _CYCLES2
        numbers[k] = cov[0, 0], cov[0, 1], cov[1, 1], misfit.scale, misfit.variance, misfit.terms.any()
        terms[k, : len(misfit.terms)] = misfit.terms
        if matrix is None:
            design[k, : len(index)] = fringe.design
    bend = np.stack([np.zeros((2, 0)), *(m.bend for m in misfits)][min(count, 1) :])[:count]
    period = np.array([fringe.period for fringe in fringes], np.float32)
    return FringeTable(
        period, frames, *(one.astype(np.float32) for one in (weights, numbers, terms, bend))
    ), design


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
    variance = noise.variance(o)
    lit = c * c + s * s > 50 / len(levels) * variance
    if np.count_nonzero(lit) < _FEWEST:
        return Misfit(1.0, nothing)
    residual, variance = (rows @ levels)[:, lit], variance[lit]
    model = fringe.harmonics(levels[:, lit])
    plain = float(np.median(residual**2 / variance)) / _MEDIAN
    weight = 1 / np.sqrt(variance)
    scaled = model * weight
    scaled /= (norms := np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-9))
    terms = regression(scaled, residual * weight, _RANK) / norms[:, 0]
    rest = float(np.median((residual - terms @ model) ** 2 / variance)) / _MEDIAN
    if plain < _WORTH * max(rest, 1.0):
        return Misfit(max(plain, 1.0), nothing)
    return Misfit(max(rest, 1.0), terms, _aliasing(fringe, terms))


def _aliasing(fringe: Fringe, terms: F64) -> float:
    """Variance (cycles^2) of the phase by harmonic N - 1 of a compressive curve, which no residual of N steps
    has: (a_2 / a_1)^(N - 2) of the amplitude. A curve of growing slope (gamma) has a_2 > 0 and hardly any."""
    seen = fringe.unlike @ np.stack([np.cos(2 * fringe.shifts), np.sin(2 * fringe.shifts)], axis=1)
    ratio = float(np.sum(seen * terms[:, 5:7])) / max(float(np.sum(seen**2)), 1e-9)
    return min(ratio, 0.0) ** (2 * len(fringe.index) - 4) / 2 / (2 * np.pi) ** 2


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


@kernel
def fit_row(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    at: tuple[int, int],
    known: F32,
    work: F32,
    top: RawFrames,
    offset: F32,
    amplitude: F32,
    phase: F32,
    variance: F32,
    chi2: F32,
    flags: I32,
) -> None:
    """Fit fringe k in row y of the frames, at = (k, y): offset, amplitude (levels), phase (cycles) and its
    variance; add its residuals to chi2. Where samples are saturated known (F, 4, W) of refitted() counts,
    without it (F, 4, 0) it is CLIPPED. work (4, W): c, s, residual, one over its variance; finite."""
    (read2, gain), (k, y), width, index, w = noise, at, chi2.size, fringe.frames, fringe.weights
    numbers, terms = fringe.numbers, fringe.terms
    cc, cs, ss = numbers[k, 0], _TWO * numbers[k, 1], numbers[k, 2]
    scale, more, harmonic = numbers[k, 3], numbers[k, 4], numbers[k, 5] > ZERO
    for x in range(width):
        top[x] = 0
    for g in range(0, index.shape[1], 4):
        i0, i1, i2, i3 = index[k, g], index[k, g + 1], index[k, g + 2], index[k, g + 3]
        before = ONE if g else ZERO
        o0, o1, o2, o3 = w[k, 0, g], w[k, 0, g + 1], w[k, 0, g + 2], w[k, 0, g + 3]
        c0, c1, c2, c3 = w[k, 1, g], w[k, 1, g + 1], w[k, 1, g + 2], w[k, 1, g + 3]
        s0, s1, s2, s3 = w[k, 2, g], w[k, 2, g + 1], w[k, 2, g + 2], w[k, 2, g + 3]
        r0, r1, r2, r3 = w[k, 3, g], w[k, 3, g + 1], w[k, 3, g + 2], w[k, 3, g + 3]
        for x in range(width):
            l0, l1 = level_of(raw[i0, y, x], table), level_of(raw[i1, y, x], table)
            l2, l3 = level_of(raw[i2, y, x], table), level_of(raw[i3, y, x], table)
            offset[x] = before * offset[x] + (o0 * l0 + o1 * l1 + (o2 * l2 + o3 * l3))
            work[0, x] = before * work[0, x] + (c0 * l0 + c1 * l1 + (c2 * l2 + c3 * l3))
            work[1, x] = before * work[1, x] + (s0 * l0 + s1 * l1 + (s2 * l2 + s3 * l3))
            work[2, x] = before * work[2, x] + (r0 * l0 + r1 * l1 + (r2 * l2 + r3 * l3))
        for x in range(width):
            brighter = max(max(raw[i0, y, x], raw[i1, y, x]), max(raw[i2, y, x], raw[i3, y, x]))
            top[x] = max(top[x], brighter)
    for x in range(width):
        a, b = work[0, x], work[1, x]
        power, own = max(a * a + b * b, _TINY), scale * (read2 + gain * max(offset[x], ZERO))
        variance[x] = more + own * (cc * b * b - cs * a * b + ss * a * a) / (power * power)
        amplitude[x] = np.sqrt(power)
        work[3, x] = ONE / own
    for x in range(width):
        phase[x] = cycles_of(work[1, x], work[0, x])
    brightest = top[0]
    for x in range(width):
        brightest = max(brightest, top[x])
    if brightest >= clip:
        for x in range(width):
            work[3, x] = ZERO if top[x] >= clip else work[3, x]
            if top[x] >= clip and known.shape[2] and known[k, 3, x] > ZERO:
                offset[x], amplitude[x] = known[k, 0, x], known[k, 1, x]
                phase[x], variance[x] = known[k, 2, x], known[k, 3, x]
            elif top[x] >= clip:
                flags[x] |= _SATURATED if known.shape[2] else CLIPPED
    for j in range(terms.shape[1]):
        for g in range(0, index.shape[1] if j else 0, 4):  # the first one is known
            i0, i1, i2, i3 = index[k, g], index[k, g + 1], index[k, g + 2], index[k, g + 3]
            w0, w1, w2, w3 = w[k, 3 + j, g], w[k, 3 + j, g + 1], w[k, 3 + j, g + 2], w[k, 3 + j, g + 3]
            before = ONE if g else ZERO
            for x in range(width):
                two = w0 * level_of(raw[i0, y, x], table) + w1 * level_of(raw[i1, y, x], table)
                two += w2 * level_of(raw[i2, y, x], table) + w3 * level_of(raw[i3, y, x], table)
                work[2, x] = before * work[2, x] + two
        if not harmonic:
            for x in range(width):
                chi2[x] += work[2, x] * work[2, x] * work[3, x]
        else:
            t = terms[k, j]
            for x in range(width):
                inverse = ONE / max(amplitude[x], _TINY)
                h1, g1 = work[0, x] * inverse, work[1, x] * inverse
                h2, g2 = h1 * h1 - g1 * g1, _TWO * h1 * g1
                h3, g3 = h2 * h1 - g2 * g1, g2 * h1 + h2 * g1
                wave = t[2] + t[3] * h1 + t[4] * g1 + t[5] * h2 + t[6] * g2 + t[7] * h3 + t[8] * g3
                rest = work[2, x] - (t[0] + t[1] * offset[x] + amplitude[x] * wave)
                chi2[x] += rest * rest * work[3, x]
    if fringe.bend.shape[2]:
        for x in range(width):
            i = np.int32((phase[x] + np.float32(0.5)) * np.float32(_BEND)) % np.int32(_BEND)
            turn, slope = phase[x] + fringe.bend[k, 0, i], fringe.bend[k, 1, i]
            phase[x] = turn - np.rint(turn)
            variance[x] *= slope * slope


def refitted(
    raw: NDArray[Any],
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    designs: F64,
) -> F32:
    """Fits (F, 4, K) of pixels (N, K) to the samples that are not saturated, less the harmonics of that fit:
    offset, amplitude, phase, variance; 0 where these are too few. designs (F, n, 3): of fringe_table()."""
    found = np.zeros((len(fringe.period), 4, raw.shape[1]), np.float32)
    for k, (index, design) in enumerate(zip(fringe.frames, designs, strict=True)):
        scale, more, harmonic = fringe.numbers[k, 3:].tolist()
        least = _DEGENERATE * max(float(np.linalg.det(design.T @ design)), 1e-9)
        known, level = raw[index] < clip, raw[index] if table is None else table[raw[index]]
        square = np.einsum("ni,nj,nk->kij", design, design, known)
        some = np.flatnonzero(np.linalg.det(square) > least)
        inverse, known = np.linalg.inv(square[some]), known[:, some]
        level, less = level[:, some].astype(np.float64), np.zeros((len(index), len(some)))
        for _ in range(3 if harmonic else 1):
            o, c, s = np.einsum("kij,nj,nk->ik", inverse, design, known * (level - less))
            less = fringe.weights[k, 3:].T @ (fringe.terms[k] @ harmonics(o, c, s))
        power = np.maximum(c * c + s * s, 1e-6)
        across = inverse[:, 1, 1] * s * s - 2 * inverse[:, 1, 2] * c * s + inverse[:, 2, 2] * c * c
        own = scale * (noise[0] + noise[1] * np.maximum(o, 0.0))
        variance = more + own * across / (2 * np.pi * power) ** 2
        found[k][:, some] = o, np.sqrt(power), np.arctan2(s, c) / (2 * np.pi), variance
    return found


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
