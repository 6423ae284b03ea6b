"""Phase shifting: least squares of N samples per period, I_i = e_i (A + c cos d_i + s sin d_i).

Phase = atan2(s, c); its variance follows from the covariance of c and s (for N equidistant steps
2 sigma^2 / (N B^2), the Cramer-Rao bound). Saturated samples are excluded per pixel, as long as three others
determine the fit; if a response is inverted, every sample is weighted by its inverse variance.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from ..frames import KernelLight, RawFrames, level_of, variance_of
from ..plan import Fringe
from ..profile.noise import Numbers

__all__ = ["Periods", "fit_line", "periods_of", "turn_of"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
#: A row of each result of a fit, see fit_line; of a period its frames, design, weights, covariance, rounding.
_Fit = tuple[F32, F32, F32, F32, F32, F32]
_Samples = tuple[I64, F32, F32, F32, np.float32]
_TINY = np.float32(1e-12)
_TWO_PI = np.float32(2 * np.pi)
#: Determinant of a fit's normal matrix, relative to all samples, below which samples are too few.
_DEGENERATE = 1e-3


class Periods(NamedTuple):
    """Fringes of an axis in the form for kernels: K periods of N samples at most.

    period (K,): pattern px; number (K,) of samples; frame (K, N) of each; design (K, N, 3); weights (K, 4, N)
    of offset, c, s and, of four samples, the one combination orthogonal to the fringe; covariance (K, 3):
    variances and covariance of c and s; rounding (K,): variance (turns^2) by rounded grey values and misfit.
    """

    period: F32
    number: I64
    frame: I64
    design: F32
    weights: F32
    covariance: F32
    rounding: F32


@lru_cache(maxsize=16)
def periods_of(fringes: tuple[Fringe, ...], rounding: tuple[float, ...]) -> Periods:
    """Periods of an axis; rounding: variance (turns^2) of each fringe's phase by grey values and misfit."""
    most = max(len(fringe.index) for fringe in fringes)
    spread = [fringe.inverse @ fringe.inverse.T for fringe in fringes]
    padded = [most - len(fringe.index) for fringe in fringes]
    index = [np.pad(np.array(f.index), (0, n)) for f, n in zip(fringes, padded, strict=True)]
    weights = [np.pad(_weights(f), ((0, 0), (0, n))) for f, n in zip(fringes, padded, strict=True)]
    design = [np.pad(f.design, ((0, n), (0, 0))) for f, n in zip(fringes, padded, strict=True)]
    return Periods(
        np.array([fringe.period for fringe in fringes], np.float32),
        np.array([len(fringe.index) for fringe in fringes]),
        np.stack(index),
        np.stack(design).astype(np.float32),
        np.stack(weights).astype(np.float32),
        np.array([(c[1, 1], c[1, 2], c[2, 2]) for c in spread], np.float32),
        np.array(rounding, np.float32),
    )


def _weights(fringe: Fringe) -> NDArray[np.float64]:
    """Weights (4, N) of offset, c, s and the residual of four samples."""
    count = len(fringe.index)
    return np.concatenate([fringe.inverse, fringe.unlike if count == 4 else np.zeros((1, count))])


@inlined
def turn_of(s: np.float32, c: np.float32) -> np.float32:
    """atan2(s, c) / 2 pi in [-1/2, 1/2], float32, to 6e-9 turns: an odd polynomial on [0, 1] and
    symmetries."""
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


@exact
def fit_line(
    light: KernelLight, noise: Numbers, periods: Periods, k: int, row: int, work: F32, fit: _Fit
) -> None:
    """Fit the k-th period in a row; light: see `Light.numbers`; work: (2, W).

    fit, each (W,) float32: phase (turns), its variance (turns^2), amplitude, offset, squared residuals over
    the variance of a sample, number of saturated samples.
    """
    (raw, table, spread, (clip, white)), (turn, _, _, offset, chi2, clipped) = light, fit
    index = periods.frame[k, : periods.number[k]]
    fringe = index, periods.design[k], periods.weights[k], periods.covariance[k], periods.rounding[k]
    sums = offset, work[0], work[1], chi2
    _sums_of_three_or_four(raw, table, index, row, periods.weights[k], sums)
    for i in range(4, index.size):
        _add(raw[index[i], row], table, periods.weights[k, :, i], sums)
    for i in range(index.size if index.size > 4 else 0):
        _residual(raw[index[i], row], table, periods.design[k, i], sums, i == 0)
    clipped[:] = np.float32(0)
    bright = _phase_line(work[0], work[1], fringe, white, noise, fit)
    if (bright > 0) | (spread is not None):
        for x in range(turn.size):
            _refit(raw, table, spread, clip, row, x, fringe, noise, fit)


@kernel
def _sums_of_three_or_four(
    raw: RawFrames, table: F32 | None, index: I64, row: int, w: F32, sums: tuple[F32, F32, F32, F32]
) -> None:
    """Offset, c, s of the first frames of a line; squared combination of four orthogonal to the fringe."""
    a, b, d = raw[index[0], row], raw[index[1], row], raw[index[2], row]
    (mean, cosine, sine, square), four = sums, index.size > 3
    g = raw[index[3], row] if four else d
    m0, m1, m2, m3 = w[0, 0], w[0, 1], w[0, 2], w[0, 3] if four else np.float32(0)
    c0, c1, c2, c3 = w[1, 0], w[1, 1], w[1, 2], w[1, 3] if four else np.float32(0)
    s0, s1, s2, s3 = w[2, 0], w[2, 1], w[2, 2], w[2, 3] if four else np.float32(0)
    k0, k1, k2, k3 = w[3, 0], w[3, 1], w[3, 2], w[3, 3] if four else np.float32(0)
    for x in range(mean.size):
        va, vb = level_of(a[x], table), level_of(b[x], table)
        vd, vg = level_of(d[x], table), level_of(g[x], table)
        mean[x] = m0 * va + m1 * vb + m2 * vd + m3 * vg
        cosine[x] = c0 * va + c1 * vb + c2 * vd + c3 * vg
        sine[x] = s0 * va + s1 * vb + s2 * vd + s3 * vg
        left = k0 * va + k1 * vb + k2 * vd + k3 * vg
        square[x] = left * left


@kernel
def _add(line: RawFrames, table: F32 | None, w: F32, sums: tuple[F32, F32, F32, F32]) -> None:
    (mean, cosine, sine, _), (m, c, s) = sums, (w[0], w[1], w[2])
    for x in range(mean.size):
        value = level_of(line[x], table)
        mean[x] += m * value
        cosine[x] += c * value
        sine[x] += s * value


@kernel
def _residual(
    line: RawFrames, table: F32 | None, design: F32, sums: tuple[F32, F32, F32, F32], first: bool
) -> None:
    mean, cosine, sine, square = sums
    e, c, s, kept = design[0], design[1], design[2], np.float32(0) if first else np.float32(1)
    for x in range(mean.size):
        left = level_of(line[x], table) - e * mean[x] - c * cosine[x] - s * sine[x]
        square[x] = kept * square[x] + left * left


@kernel
def _phase_line(
    cosine: F32, sine: F32, fringe: _Samples, white: np.float32, noise: Numbers, fit: _Fit
) -> np.float32:
    """Phase, variance, amplitude and chi2 of a line (chi2 holds squared residuals); number of pixels with
    possible saturation: all but those whose fit stays below white by more than its residuals."""
    turn, variance, amplitude, mean, chi2, _ = fit
    _, _, _, covariance, rounding = fringe
    read2, gain, rounding2, misfit2 = noise
    cc, cs, ss = covariance[0], covariance[1], covariance[2]
    two, bright = np.float32(2), np.float32(0)
    for x in range(mean.size):
        c, s = cosine[x], sine[x]
        power = max(c * c + s * s, _TINY)
        height = np.sqrt(power)
        own = read2 + gain * max(mean[x], np.float32(0))
        unlike = own + rounding2 + misfit2 * power
        across = c * c * ss - two * c * s * cs + s * s * cc
        room = np.float32(0.999) * white - mean[x] - height
        bright += np.float32((room < np.float32(0)) | (room * room < chi2[x]))
        turn[x] = turn_of(s, c)
        # one division for both quotients
        square = power * power * (_TWO_PI * _TWO_PI)
        inverse = np.float32(1) / (square * unlike)
        variance[x] = rounding + own * across * unlike * inverse
        amplitude[x] = height
        chi2[x] = chi2[x] * square * inverse
    return bright


@exact
def _refit(
    raw: RawFrames,
    table: F32 | None,
    spread: F32 | None,
    clip: np.float32,
    row: int,
    x: int,
    fringe: _Samples,
    noise: Numbers,
    fit: _Fit,
) -> None:
    """Weighted normal equations of the unsaturated samples; variance 1e12 if they are too few.

    Under a response a sample's variance is its own plus the misfit, for the amplitude of the unweighted
    fit."""
    index, design, _, _, rounding = fringe
    read2, gain, rounding2, misfit2 = noise
    turn, variance, amplitude, offset, chi2, clipped = fit
    count = 0
    whole, normal, right = np.zeros(6), np.zeros(6), np.zeros(3)
    alike = misfit2 * amplitude[x] * amplitude[x]
    for i in range(index.size):
        sample = raw[index[i], row, x]
        weight, keep = 1.0 / variance_of(sample, spread, alike), sample < clip
        count += 0 if keep else 1
        _add_to(design[i], weight, whole)
        if keep:
            _add_to(design[i], weight, normal)
            for j in range(3):
                right[j] += weight * design[i, j] * level_of(sample, table)
    if count == 0 and spread is None:
        return
    clipped[x] = np.float32(count)
    inverse = np.empty(6)
    if _inverted(normal, inverse) < _DEGENERATE * _inverted(whole, np.empty(6)):
        variance[x] = np.float32(1e12)
        return
    mean = inverse[0] * right[0] + inverse[1] * right[1] + inverse[2] * right[2]
    c = inverse[1] * right[0] + inverse[3] * right[1] + inverse[4] * right[2]
    s = inverse[2] * right[0] + inverse[4] * right[1] + inverse[5] * right[2]
    power = max(c * c + s * s, 1e-12)
    own = read2 + gain * max(mean, 0.0) if spread is None else 1.0
    unlike, misfit = rounding2 + (misfit2 * power if spread is None else 0.0), 0.0
    for i in range(index.size):
        sample = raw[index[i], row, x]
        if sample < clip:
            left = level_of(sample, table) - design[i, 0] * mean - design[i, 1] * c - design[i, 2] * s
            misfit += left * left / (own * variance_of(sample, spread, alike) + unlike)
    across = c * c * inverse[5] - 2 * c * s * inverse[4] + s * s * inverse[3]
    turn[x] = np.float32(np.arctan2(s, c) / (2 * np.pi))
    variance[x] = np.float32(rounding + own * across / (2 * np.pi * power) ** 2)
    amplitude[x], offset[x] = np.float32(np.sqrt(power)), np.float32(mean)
    chi2[x] = np.float32(misfit)


@exact
def _add_to(d: F32, weight: float, sums: F64) -> None:
    """Add a sample to the upper triangle of the normal matrix."""
    sums[0] += weight * d[0] * d[0]
    sums[1] += weight * d[0] * d[1]
    sums[2] += weight * d[0] * d[2]
    sums[3] += weight * d[1] * d[1]
    sums[4] += weight * d[1] * d[2]
    sums[5] += weight * d[2] * d[2]


@exact
def _inverted(m: F64, out: F64) -> float:
    """Determinant of a symmetric matrix from its upper triangle, and the inverse's upper triangle."""
    out[0], out[1] = m[3] * m[5] - m[4] * m[4], m[2] * m[4] - m[1] * m[5]
    out[2], out[3] = m[1] * m[4] - m[2] * m[3], m[0] * m[5] - m[2] * m[2]
    out[4], out[5] = m[1] * m[2] - m[0] * m[4], m[0] * m[3] - m[1] * m[1]
    size: float = m[0] * out[0] + m[1] * out[1] + m[2] * out[2]
    for k in range(6):
        out[k] /= size if size > 0 else 1.0
    return size
