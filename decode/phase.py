"""Phase shifting: least squares of N samples per period, I_i = e_i (A + c cos d_i + s sin d_i).

Phase = atan2(s, c); its variance follows from the covariance of c and s (for N even steps 2 sigma^2 / (N B^2), the
Cramer-Rao bound). Saturated samples leave the fit, pixel by pixel, as long as three others determine it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .frames import Light, fetch_rows
from .noise import Noise
from .plan import Fringe

__all__ = ["Fit", "fit_fringe", "turn_of"]

F32 = NDArray[np.float32]
_TINY = np.float32(1e-12)
_TWO_PI = np.float32(2 * np.pi)
#: Determinant of a fit's normal matrix, of the whole fit's, below which samples are too few.
_DEGENERATE = 1e-3


@dataclass(frozen=True, slots=True)
class Fit:
    """One period over a block, (R, W) float32: phase (turns), its variance (turns^2), amplitude, offset, squared
    residuals over the variance of a sample, number of saturated samples."""

    turn: F32
    variance: F32
    amplitude: F32
    offset: F32
    chi2: F32
    clipped: F32

    @classmethod
    def empty(cls, rows: int, cols: int) -> "Fit":
        """Room for one."""
        return cls(*(np.empty((rows, cols), np.float32) for _ in range(6)))


def fit_fringe(
    light: Light, noise: Noise, fringe: Fringe, rows: tuple[int, int], rounding: float, fit: Fit
) -> None:
    """Fit one period in rows start..stop, in place; rounding: variance (turns^2) that the shown grey values add."""
    design = fringe.design()
    covariance = np.linalg.inv(design.T @ design)
    _fit_rows(
        *(light.raw, np.array(fringe.index), light.table, np.float32(light.clip), *rows),
        *(design.astype(np.float32), np.linalg.pinv(design).astype(np.float32)),
        np.array([covariance[1, 1], covariance[1, 2], covariance[2, 2]], np.float32),
        *(*noise.numbers(), np.float32(rounding)),
        *(fit.turn, fit.variance, fit.amplitude, fit.offset, fit.chi2, fit.clipped),
    )


@inlined
def turn_of(s: Any, c: Any) -> Any:
    """atan2(s, c) / 2 pi in [-1/2, 1/2], float32, to 6e-9 turns: an odd polynomial on [0, 1] and symmetries."""
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
def _fit_rows(
    raw: Any,
    index: Any,
    table: Any,
    clip: Any,
    start: Any,
    stop: Any,
    design: Any,
    inverse: Any,
    covariance: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
    rounding: Any,
    turn: Any,
    variance: Any,
    amplitude: Any,
    offset: Any,
    chi2: Any,
    clipped: Any,
) -> None:
    width = raw.shape[2]
    light = np.empty((index.size, width), np.float32)
    cosine, sine = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(start, stop):
        r = row - start
        saturated = fetch_rows(raw, index, row, table, clip, light)
        combine(light, inverse[0], offset[r])
        combine(light, inverse[1], cosine)
        combine(light, inverse[2], sine)
        _residuals(light, design, offset[r], cosine, sine, chi2[r])
        clipped[r, :] = np.float32(0)
        _phase_line(
            *(offset[r], cosine, sine, covariance, read2, gain, rounding2, misfit2, rounding),
            *(turn[r], variance[r], amplitude[r], chi2[r]),
        )
        if saturated:
            for x in range(width):
                _refit(
                    *(raw, index, row, x, clip, light, design, read2, gain, rounding2, misfit2, rounding),
                    *(turn[r], variance[r], amplitude[r], offset[r], chi2[r], clipped[r]),
                )


@kernel
def combine(light: Any, weights: Any, out: Any) -> None:
    """Sum of light (N, W) by weights (N,) -> out (W,), N >= 3."""
    a, b, c = light[0], light[1], light[2]
    w0, w1, w2 = weights[0], weights[1], weights[2]
    for x in range(out.size):
        out[x] = w0 * a[x] + w1 * b[x] + w2 * c[x]
    for i in range(3, light.shape[0]):
        one, w = light[i], weights[i]
        for x in range(out.size):
            out[x] += w * one[x]


@kernel
def _residuals(light: Any, design: Any, mean: Any, cosine: Any, sine: Any, rss: Any) -> None:
    """Sum of squared residuals of a line; nought of three samples, which a fit passes through."""
    rss[:] = np.float32(0)
    if light.shape[0] > 3:
        for i in range(light.shape[0]):
            one, e, c, s = light[i], design[i, 0], design[i, 1], design[i, 2]
            for x in range(mean.size):
                left = one[x] - e * mean[x] - c * cosine[x] - s * sine[x]
                rss[x] += left * left


@kernel
def _phase_line(
    mean: Any,
    cosine: Any,
    sine: Any,
    covariance: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
    rounding: Any,
    turn: Any,
    variance: Any,
    amplitude: Any,
    chi2: Any,
) -> None:
    """Phase, amplitude, variance and chi2 of a line, one after the other."""
    cc, cs, ss = covariance[0], covariance[1], covariance[2]
    for x in range(mean.size):
        turn[x] = turn_of(sine[x], cosine[x])
    for x in range(mean.size):
        amplitude[x] = np.sqrt(max(cosine[x] * cosine[x] + sine[x] * sine[x], _TINY))
    for x in range(mean.size):
        c, s = cosine[x], sine[x]
        power = max(c * c + s * s, _TINY)
        across = c * c * ss - np.float32(2) * c * s * cs + s * s * cc
        noise = read2 + gain * max(mean[x], np.float32(0))
        variance[x] = rounding + noise * across / (power * power * _TWO_PI * _TWO_PI)
    for x in range(mean.size):
        noise = read2 + gain * max(mean[x], np.float32(0)) + rounding2
        chi2[x] = chi2[x] / (noise + misfit2 * amplitude[x] * amplitude[x])


@exact
def _refit(
    raw: Any,
    index: Any,
    row: Any,
    x: Any,
    clip: Any,
    light: Any,
    design: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
    rounding: Any,
    turn: Any,
    variance: Any,
    amplitude: Any,
    offset: Any,
    chi2: Any,
    clipped: Any,
) -> None:
    """Normal equations of the samples that are not saturated; variance 1e12 if they are too few."""
    count = 0
    whole, normal = np.zeros((3, 3)), np.zeros((3, 3))
    right = np.zeros(3)
    for i in range(index.size):
        keep = raw[index[i], row, x] < clip
        count += 0 if keep else 1
        for j in range(3):
            for k in range(3):
                whole[j, k] += design[i, j] * design[i, k]
                normal[j, k] += design[i, j] * design[i, k] if keep else 0.0
            right[j] += design[i, j] * light[i, x] if keep else 0.0
    if count == 0:
        return
    clipped[x] = np.float32(count)
    if np.linalg.det(normal) < _DEGENERATE * np.linalg.det(whole):
        variance[x] = np.float32(1e12)
        return
    inverse = np.linalg.inv(normal)
    mean = inverse[0, 0] * right[0] + inverse[0, 1] * right[1] + inverse[0, 2] * right[2]
    c = inverse[1, 0] * right[0] + inverse[1, 1] * right[1] + inverse[1, 2] * right[2]
    s = inverse[2, 0] * right[0] + inverse[2, 1] * right[1] + inverse[2, 2] * right[2]
    rss = 0.0
    for i in range(index.size):
        if raw[index[i], row, x] < clip:
            left = light[i, x] - design[i, 0] * mean - design[i, 1] * c - design[i, 2] * s
            rss += left * left
    power, noise = max(c * c + s * s, 1e-12), read2 + gain * max(mean, 0.0)
    across = c * c * inverse[2, 2] - 2 * c * s * inverse[1, 2] + s * s * inverse[1, 1]
    turn[x] = np.float32(np.arctan2(s, c) / (2 * np.pi))
    variance[x] = np.float32(rounding + noise * across / (2 * np.pi * power) ** 2)
    amplitude[x], offset[x] = np.float32(np.sqrt(power)), np.float32(mean)
    chi2[x] = np.float32(rss / (noise + rounding2 + misfit2 * power))
