"""Compiled fringe fit: frames of one period -> phase, its variance, offset, amplitude and misfit of a tile.

All kernels work on `n` pixels of one row at a time, so that what they hand on stays in the first cache,
and are written as plain loops over pixels, which the compiler turns into vector instructions.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, inline_kernel, kernel

__all__ = ["TILE", "fit_tile", "refit_clipped"]

Array = NDArray[Any]

#: Pixels that are worked on at once.
TILE = 512

_TURN = np.float32(1 / (2 * np.pi))
_ONE, _HALF, _QUARTER = np.float32(1), np.float32(0.5), np.float32(0.25)
_TINY = np.float32(1e-12)


@inline_kernel
def _atan2_turns(s: Any, c: Any) -> Any:
    """atan2(s, c) / (2 pi) in [-0.5, 0.5]; error below 5e-8 turns (Abramowitz & Stegun 4.4.49)."""
    abs_s, abs_c = abs(s), abs(c)
    low, high = min(abs_s, abs_c), max(abs_s, abs_c)
    t = low / max(high, _TINY)
    q = t * t
    p = np.float32(0.0028662257)
    p = p * q - np.float32(0.0161657367)
    p = p * q + np.float32(0.0429096138)
    p = p * q - np.float32(0.0752896400)
    p = p * q + np.float32(0.1065626393)
    p = p * q - np.float32(0.1420889944)
    p = p * q + np.float32(0.1999355085)
    p = p * q - np.float32(0.3333314528)
    p = (p * q + _ONE) * t * _TURN
    p = _QUARTER - p if abs_s > abs_c else p
    p = _HALF - p if c < 0 else p
    return -p if s < 0 else p


@fast_kernel
def fit_tile(
    frames: Array,
    lut: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    index: Array,
    solve: Array,
    model: Array,
    quad: Array,
    read2: float,
    gain: float,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
    clipped: Array,
) -> None:
    """Least squares of I_i = model_i . (A, c, s) and the phase of (c, s).

    index (N,), solve (3, N) = pseudo-inverse of the design, model (N, 3) = design, quad (4, 3), see
    fringe_arrays; lut turns raw levels into linear ones unless empty; raw levels >= clip count as clipped.
    Out, (n,): sums[0..2] = A, c, s; turns = phase / 2 pi; variance of turns; misfit = sum of squares of the
    residuals over their variance; clipped = number of clipped samples.
    """
    a, c, s = sums[0], sums[1], sums[2]
    for x in range(n):
        a[x] = 0
        c[x] = 0
        s[x] = 0
        misfit[x] = 0
        clipped[x] = 0
    for i in range(len(index)):
        line = frames[index[i], row, first : first + n]
        to_a, to_c, to_s = solve[0, i], solve[1, i], solve[2, i]
        if lut.size:
            for x in range(n):
                level = lut[int(line[x])]
                a[x] += to_a * level
                c[x] += to_c * level
                s[x] += to_s * level
        else:
            for x in range(n):
                level = np.float32(line[x])
                a[x] += to_a * level
                c[x] += to_c * level
                s[x] += to_s * level
        for x in range(n):
            clipped[x] += np.uint8(line[x] >= clip)
    if len(index) > 3:
        _residuals(frames, lut, row, first, n, index, model, sums, misfit)
    for x in range(n):
        cc, ss, cs = c[x] * c[x], s[x] * s[x], c[x] * s[x]
        power = max(cc + ss, _TINY)
        shot = gain * a[x]
        q11 = read2 * quad[0, 0] + shot * quad[1, 0] + gain * (c[x] * quad[2, 0] + s[x] * quad[3, 0])
        q12 = read2 * quad[0, 1] + shot * quad[1, 1] + gain * (c[x] * quad[2, 1] + s[x] * quad[3, 1])
        q22 = read2 * quad[0, 2] + shot * quad[1, 2] + gain * (c[x] * quad[2, 2] + s[x] * quad[3, 2])
        spread = (cc * q22 + ss * q11 - 2 * cs * q12) / (power * power)
        variance[x] = max(spread, _TINY) * (_TURN * _TURN)
        misfit[x] /= read2 + shot
        turns[x] = _atan2_turns(s[x], c[x])


@fast_kernel
def _residuals(
    frames: Array,
    lut: Array,
    row: int,
    first: int,
    n: int,
    index: Array,
    model: Array,
    sums: Array,
    misfit: Array,
) -> None:
    a, c, s = sums[0], sums[1], sums[2]
    for i in range(len(index)):
        line = frames[index[i], row, first : first + n]
        of_a, of_c, of_s = model[i, 0], model[i, 1], model[i, 2]
        if lut.size:
            for x in range(n):
                residual = lut[int(line[x])] - of_a * a[x] - of_c * c[x] - of_s * s[x]
                misfit[x] += residual * residual
        else:
            for x in range(n):
                residual = np.float32(line[x]) - of_a * a[x] - of_c * c[x] - of_s * s[x]
                misfit[x] += residual * residual


@kernel
def refit_clipped(
    frames: Array,
    lut: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    index: Array,
    model: Array,
    read2: float,
    gain: float,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
    clipped: Array,
) -> None:
    """Fit pixels with clipped samples again without those; variance inf where too few are left."""
    normal = np.empty((3, 3), np.float64)
    right = np.empty(3, np.float64)
    for x in range(n):
        if clipped[x] == 0:
            continue
        normal[:] = 0
        right[:] = 0
        for i in range(len(index)):
            raw = frames[index[i], row, first + x]
            if raw >= clip:
                continue
            level = np.float64(lut[int(raw)]) if lut.size else np.float64(raw)
            for j in range(3):
                right[j] += model[i, j] * level
                for k in range(3):
                    normal[j, k] += model[i, j] * model[i, k]
        misfit[x] = 0
        determinant = _invert(normal)
        if determinant < 1e-3:
            variance[x] = np.inf
            continue
        a = normal[0, 0] * right[0] + normal[0, 1] * right[1] + normal[0, 2] * right[2]
        c = normal[1, 0] * right[0] + normal[1, 1] * right[1] + normal[1, 2] * right[2]
        s = normal[2, 0] * right[0] + normal[2, 1] * right[1] + normal[2, 2] * right[2]
        power = max(c * c + s * s, 1e-12)
        spread = (c * c * normal[2, 2] + s * s * normal[1, 1] - 2 * c * s * normal[1, 2]) / (power * power)
        sums[0, x], sums[1, x], sums[2, x] = a, c, s
        variance[x] = spread * (read2 + gain * max(a, 0.0)) / (4 * np.pi * np.pi)
        turns[x] = np.arctan2(s, c) / (2 * np.pi)


@kernel
def _invert(m: Array) -> float:
    """Invert a symmetric 3 x 3 matrix in place; returns its determinant (0: left as it was)."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if determinant < 1e-3:
        return float(determinant)
    c11 = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    c12 = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    c22 = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    m[0, 0], m[1, 1], m[2, 2] = c00 / determinant, c11 / determinant, c22 / determinant
    m[0, 1] = m[1, 0] = c01 / determinant
    m[0, 2] = m[2, 0] = c02 / determinant
    m[1, 2] = m[2, 1] = c12 / determinant
    return float(determinant)
