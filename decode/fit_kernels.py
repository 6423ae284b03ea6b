"""Compiled fringe fit: frames of one period -> phase, its variance, offset, amplitude and misfit of a tile.

All kernels work on `n` pixels of one row at a time, so that what they hand on stays in the first cache. They
are plain loops over pixels in float32, with what does not change held in scalars, so that the compiler makes
vector instructions of them (an int or a float64 in between would halve their width).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, inline_kernel, kernel, leaf_kernel
from .unwrap_kernels import UNKNOWN

__all__ = ["TILE", "fit_tile", "refit"]

Array = NDArray[Any]

#: Pixels that are worked on at once.
TILE = 2048

_TURN = np.float32(1 / (2 * np.pi))
_TURN2 = np.float32(1 / (2 * np.pi) ** 2)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
_TINY = np.float32(1e-20)
#: Of the normal equations: that of three equal shifts is 27/4, with weights below 1 less.
_LEAST_DETERMINANT = 1e-6
_A16, _A14, _A12, _A10 = (np.float32(a) for a in (0.0028662257, -0.0161657367, 0.0429096138, -0.0752896400))
_A8, _A6, _A4, _A2 = (np.float32(a) for a in (0.1065626393, -0.1420889944, 0.1999355085, -0.3333314528))


@inline_kernel
def _arctangent(t: Any) -> Any:
    """arctan(t) / (2 pi) for t in [0, 1]; error below 5e-9 turns (Abramowitz & Stegun 4.4.49)."""
    q = t * t
    low = ((_A16 * q + _A14) * q + _A12) * q + _A10
    return ((((low * q + _A8) * q + _A6) * q + _A4) * q + _A2) * q * t * _TURN + t * _TURN


@fast_kernel
def _sum(
    n: int,
    fresh: bool,
    frames: Array,
    index: Array,
    k: int,
    row: int,
    first: int,
    solve: Array,
    j: int,
    total: Array,
) -> None:
    """total (+)= weighted sum of four lines. Lines are cut here, and not handed on as slices."""
    end = first + n
    i0, i1 = frames[index[k], row, first:end], frames[index[k + 1], row, first:end]
    i2, i3 = frames[index[k + 2], row, first:end], frames[index[k + 3], row, first:end]
    w0, w1, w2, w3 = solve[j, k], solve[j, k + 1], solve[j, k + 2], solve[j, k + 3]
    if fresh:
        for x in range(n):
            total[x] = (
                w0 * np.float32(i0[x])
                + w1 * np.float32(i1[x])
                + w2 * np.float32(i2[x])
                + w3 * np.float32(i3[x])
            )
        return
    for x in range(n):
        total[x] += (
            w0 * np.float32(i0[x]) + w1 * np.float32(i1[x]) + w2 * np.float32(i2[x]) + w3 * np.float32(i3[x])
        )


@fast_kernel
def _brightest(
    n: int, fresh: bool, frames: Array, index: Array, k: int, row: int, first: int, top: Array
) -> None:
    end = first + n
    i0, i1 = frames[index[k], row, first:end], frames[index[k + 1], row, first:end]
    i2, i3 = frames[index[k + 2], row, first:end], frames[index[k + 3], row, first:end]
    if fresh:
        for x in range(n):
            top[x] = np.float32(i0[x])
    for x in range(n):
        one = i0[x] if i0[x] > i1[x] else i1[x]
        other = i2[x] if i2[x] > i3[x] else i3[x]
        level = np.float32(one if one > other else other)
        top[x] = level if level > top[x] else top[x]


@fast_kernel
def _residual(
    n: int,
    frames: Array,
    at: int,
    row: int,
    first: int,
    model: Array,
    k: int,
    a: Array,
    c: Array,
    s: Array,
    misfit: Array,
) -> None:
    """misfit += squared residual of one line; model[k] = (weight, A, c, s).

    One line a loop: for more of them the compiler gives up on vector instructions (a factor of 15).
    """
    line = frames[at, row, first : first + n]
    w, of_a, of_c, of_s = model[k, 0], model[k, 1], model[k, 2], model[k, 3]
    for x in range(n):
        r = w * np.float32(line[x]) - of_a * a[x] - of_c * c[x] - of_s * s[x]
        misfit[x] += r * r


@fast_kernel
def _linearise(
    n: int, frames: Array, at: int, row: int, first: int, lut: Array, k: int, linear: Array
) -> None:
    line, out = frames[at, row, first : first + n], linear[k, 0, :n]
    for x in range(n):
        out[x] = lut[int(line[x])]


@fast_kernel
def _phases(
    n: int, a: Array, c: Array, s: Array, noise: Any, quad: Any, turns: Array, variance: Array
) -> None:
    """Phase and its variance (quad: see arrays.fringe_arrays). One division serves both: it is what costs."""
    read2, gain = noise
    (r11, r12, r22), (a11, a12, a22), (c11, c12, c22), (s11, s12, s22) = quad
    # one output a loop: more need more checks for overlap than the compiler is willing to make
    for x in range(n):
        cx, sx = c[x], s[x]
        power = cx * cx + sx * sx
        high = abs(sx) if abs(sx) > abs(cx) else abs(cx)
        turns[x] = _ONE / (power * high + _TINY)
    for x in range(n):
        ax, cx, sx = a[x], c[x], s[x]
        cc, ss, cs = cx * cx, sx * sx, _TWO * cx * sx
        of_read = cc * r22 + ss * r11 - cs * r12
        of_offset = cc * a22 + ss * a11 - cs * a12
        of_fringe = cx * (cc * c22 + ss * c11 - cs * c12) + sx * (cc * s22 + ss * s11 - cs * s12)
        spread = read2 * of_read + gain * (ax * of_offset + of_fringe)
        inverse = turns[x] * (abs(sx) if abs(sx) > abs(cx) else abs(cx))
        variance[x] = (spread * inverse * inverse + _TINY) * _TURN2
    for x in range(n):
        cx, sx = c[x], s[x]
        abs_c, abs_s = abs(cx), abs(sx)
        swap = abs_s > abs_c
        low = abs_c if swap else abs_s
        turn = _arctangent(low * (cx * cx + sx * sx) * turns[x])
        turn = _QUARTER - turn if swap else turn
        turn = _HALF - turn if cx < _ZERO else turn
        turns[x] = -turn if sx < _ZERO else turn


@leaf_kernel
def fit_tile(
    frames: Array,
    lut: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    count: int,
    index: Array,
    solve: Array,
    model: Array,
    quad: Array,
    read2: float,
    gain: float,
    linear: Array,
    own: Array,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
    top: Array,
) -> bool:
    """Least squares of I_i = model_i . (A, c, s) and the phase of (c, s).

    count samples; index (M,), solve (3, M), model (M, 4), quad (4, 3): see arrays.fringe_arrays, M = count
    padded to a multiple of 4; lut turns raw levels into linear ones unless empty (linear: room for (M, 1, n),
    own = 0, 1, ..., M - 1);
    raw levels >= clip are clipped.
    Out, (n,): sums[0..2] = A, c, s; turns = phase / 2 pi; variance of turns; misfit = sum of squares of the
    residuals; top = brightest raw level. True if any sample is clipped.
    """
    a, c, s = sums[0], sums[1], sums[2]
    for k in range(0, len(index), 4):
        _brightest(n, k == 0, frames, index, k, row, first, top)
        if lut.size:
            for j in range(k, k + 4):
                _linearise(n, frames, index[j], row, first, lut, j, linear)
            _sum(n, k == 0, linear, own, k, 0, 0, solve, 0, a)
            _sum(n, k == 0, linear, own, k, 0, 0, solve, 1, c)
            _sum(n, k == 0, linear, own, k, 0, 0, solve, 2, s)
        else:
            _sum(n, k == 0, frames, index, k, row, first, solve, 0, a)
            _sum(n, k == 0, frames, index, k, row, first, solve, 1, c)
            _sum(n, k == 0, frames, index, k, row, first, solve, 2, s)
    misfit[:n] = _ZERO
    if count > 3:
        for k in range(count):
            if lut.size:
                _residual(n, linear, k, 0, 0, model, k, a, c, s, misfit)
            else:
                _residual(n, frames, index[k], row, first, model, k, a, c, s, misfit)
    terms = (
        (quad[0, 0], quad[0, 1], quad[0, 2]),
        (quad[1, 0], quad[1, 1], quad[1, 2]),
        (quad[2, 0], quad[2, 1], quad[2, 2]),
        (quad[3, 0], quad[3, 1], quad[3, 2]),
    )
    _phases(n, a, c, s, (read2, gain), terms, turns, variance)
    return bool(_any_clipped(n, np.float32(clip), top))


@fast_kernel
def _any_clipped(n: int, clip: Any, top: Array) -> bool:
    count = 0
    for x in range(n):
        count += top[x] >= clip
    return count > 0


@kernel
def refit(
    frames: Array,
    lut: Array,
    slope: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    count: int,
    index: Array,
    model: Array,
    read2: float,
    gain: float,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
    top: Array,
) -> None:
    """Fit again what equal weights do not suit: pixels with clipped samples (left out), and with `slope` all.

    slope = d raw / d linear at linear levels 0..255, empty: 1; a sample's variance is (read2 + gain raw) /
    slope^2, taken at the level of the first fit, as weights from the samples would be biased. Where fewer
    than three samples are left, the variance is UNKNOWN. misfit is in raw levels, as the noise is.
    """
    normal = np.empty((3, 3), np.float64)
    right = np.empty(3, np.float64)
    for x in range(n):
        if top[x] < clip and slope.size == 0:
            continue
        normal[:] = 0
        right[:] = 0
        total = 0.0
        for i in range(count):
            raw = frames[index[i], row, first + x]
            if raw >= clip:
                continue
            level = np.float64(lut[int(raw)]) if lut.size else np.float64(raw)
            weight = _weight(slope, model, i, sums[0, x], sums[1, x], sums[2, x]) / (
                1 + gain / read2 * max(raw, 0)
            )
            total += weight * level * level
            for j in range(3):
                right[j] += weight * model[i, j + 1] * level
                for k in range(3):
                    normal[j, k] += weight * model[i, j + 1] * model[i, k + 1]
        misfit[x] = 0
        if _invert(normal) < _LEAST_DETERMINANT:
            variance[x] = UNKNOWN
            continue
        a = normal[0, 0] * right[0] + normal[0, 1] * right[1] + normal[0, 2] * right[2]
        c = normal[1, 0] * right[0] + normal[1, 1] * right[1] + normal[1, 2] * right[2]
        s = normal[2, 0] * right[0] + normal[2, 1] * right[1] + normal[2, 2] * right[2]
        power = max(c * c + s * s, 1e-12)
        spread = (c * c * normal[2, 2] + s * s * normal[1, 1] - 2 * c * s * normal[1, 2]) / (power * power)
        if top[x] < clip:
            misfit[x] = max(total - a * right[0] - c * right[1] - s * right[2], 0.0)
        sums[0, x], sums[1, x], sums[2, x] = a, c, s
        variance[x] = spread * read2 / (4 * math.pi * math.pi)
        turns[x] = math.atan2(s, c) / (2 * math.pi)


@kernel
def _weight(slope: Array, model: Array, i: int, a: float, c: float, s: float) -> float:
    """Squared slope at the fitted level of sample i; 1 without a response."""
    if slope.size == 0:
        return 1.0
    level = model[i, 1] * a + model[i, 2] * c + model[i, 3] * s
    here = slope[min(max(int(level + 0.5), 0), len(slope) - 1)]
    return float(here * here)


@kernel
def _invert(m: Array) -> float:
    """Invert a symmetric 3 x 3 matrix in place; its determinant (too small: left as it was)."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if determinant < _LEAST_DETERMINANT:
        return float(determinant)
    c11 = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    c12 = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    c22 = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    m[0, 0], m[1, 1], m[2, 2] = c00 / determinant, c11 / determinant, c22 / determinant
    m[0, 1] = m[1, 0] = c01 / determinant
    m[0, 2] = m[2, 0] = c02 / determinant
    m[1, 2] = m[2, 1] = c12 / determinant
    return float(determinant)
