"""Compiled fringe fit: frames of one period -> phase, its variance, offset, amplitude and misfit of a tile.

All kernels work on `n` pixels of one row at a time, so that what they hand on stays in the cache. They are
plain loops over pixels in float32, with what does not change held in scalars, so that the compiler makes
vector instructions of them (an int64 or a float64 in between would halve their width).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel, pasted_kernel
from .phase_kernels import phase_of

__all__ = ["OF_QUARTERS", "TINY", "fit_tile", "highest", "linear_level", "quarter_sums"]

Array = NDArray[Any]

_TURN2 = np.float32(1 / (2 * np.pi) ** 2)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
TINY = np.float32(1e-20)
#: Variance of a phase, turns^2, of four samples a quarter apart: times a sample's over B^2.
OF_QUARTERS = _HALF * _TURN2


@leaf_kernel
def linear_level(raw: Any, lut: Array | None) -> float:
    """Level of a raw one, through lut unless that is None."""
    if lut is None:
        return float(raw)
    return float(lut[int(raw)])


@apart_kernel
def _add_four(
    n: int,
    fresh: bool,
    frames: Array,
    index: Array,
    k: int,
    row: int,
    first: int,
    solve: Array,
    clip: Any,
    a: Array,
    c: Array,
    s: Array,
) -> Any:
    """a, c, s (+)= weighted sums of four lines; returns how many pixels reach the clip level.

    Lines are cut here, and not handed on as slices.
    """
    end = first + n
    i0, i1 = frames[index[k], row, first:end], frames[index[k + 1], row, first:end]
    i2, i3 = frames[index[k + 2], row, first:end], frames[index[k + 3], row, first:end]
    a0, a1, a2, a3 = solve[0, k], solve[0, k + 1], solve[0, k + 2], solve[0, k + 3]
    c0, c1, c2, c3 = solve[1, k], solve[1, k + 1], solve[1, k + 2], solve[1, k + 3]
    s0, s1, s2, s3 = solve[2, k], solve[2, k + 1], solve[2, k + 2], solve[2, k + 3]
    if fresh:
        a[:n] = _ZERO
        c[:n] = _ZERO
        s[:n] = _ZERO
    clipped = _ZERO  # counted in float32, as numba's integer sums are int64
    for x in range(n):
        one = i0[x] if i0[x] > i1[x] else i1[x]
        other = i2[x] if i2[x] > i3[x] else i3[x]
        clipped += _ONE if np.float32(one if one > other else other) >= clip else _ZERO
        f0, f1, f2, f3 = np.float32(i0[x]), np.float32(i1[x]), np.float32(i2[x]), np.float32(i3[x])
        a[x] += a0 * f0 + a1 * f1 + a2 * f2 + a3 * f3
        c[x] += c0 * f0 + c1 * f1 + c2 * f2 + c3 * f3
        s[x] += s0 * f0 + s1 * f1 + s2 * f2 + s3 * f3
    return clipped


@apart_kernel
def _fit_four(
    n: int,
    fresh: bool,
    frames: Array,
    index: Array,
    k: int,
    row: int,
    first: int,
    solve: Array,
    clip: Any,
    of_read: Any,
    of_level: Any,
    a: Array,
    c: Array,
    s: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
) -> Any:
    """The last four lines, and all that follows: phase, its variance, squared contrast of the four.

    variance = (of_read + of_level A) / (c^2 + s^2).
    """
    end = first + n
    i0, i1 = frames[index[k], row, first:end], frames[index[k + 1], row, first:end]
    i2, i3 = frames[index[k + 2], row, first:end], frames[index[k + 3], row, first:end]
    a0, a1, a2, a3 = solve[0, k], solve[0, k + 1], solve[0, k + 2], solve[0, k + 3]
    c0, c1, c2, c3 = solve[1, k], solve[1, k + 1], solve[1, k + 2], solve[1, k + 3]
    s0, s1, s2, s3 = solve[2, k], solve[2, k + 1], solve[2, k + 2], solve[2, k + 3]
    q0, q1, q2, q3 = solve[3, k], solve[3, k + 1], solve[3, k + 2], solve[3, k + 3]
    clipped = _ZERO
    for x in range(n):
        one = i0[x] if i0[x] > i1[x] else i1[x]
        other = i2[x] if i2[x] > i3[x] else i3[x]
        clipped += _ONE if np.float32(one if one > other else other) >= clip else _ZERO
        f0, f1, f2, f3 = np.float32(i0[x]), np.float32(i1[x]), np.float32(i2[x]), np.float32(i3[x])
        ax = a0 * f0 + a1 * f1 + a2 * f2 + a3 * f3
        cx = c0 * f0 + c1 * f1 + c2 * f2 + c3 * f3
        sx = s0 * f0 + s1 * f1 + s2 * f2 + s3 * f3
        contrast = q0 * f0 + q1 * f1 + q2 * f2 + q3 * f3
        if not fresh:
            ax += a[x]
            cx += c[x]
            sx += s[x]
        turn, _, inverse = phase_of(cx, sx)
        level = ax if ax > _ZERO else _ZERO
        a[x] = ax
        c[x] = cx
        s[x] = sx
        turns[x] = turn
        variance[x] = (of_read + of_level * level) * inverse + TINY
        misfit[x] = contrast * contrast
    return clipped


@pasted_kernel
def quarter_sums(f0: Any, f1: Any, f2: Any, f3: Any) -> Any:
    """4 A, 2 c, 2 s and twice the contrast that these do not reach, of four samples a quarter apart:
    differences of two samples, in place of 16 products."""
    even, odd = f0 + f2, f1 + f3
    return even + odd, f0 - f2, f1 - f3, even - odd


@pasted_kernel
def _quarter_fit(f0: Any, f1: Any, f2: Any, f3: Any, read2: Any, gain: Any) -> Any:
    """A, c, s, phase in turns, its variance, squared contrast of quarter_sums."""
    total, twice_c, twice_s, both = quarter_sums(f0, f1, f2, f3)
    a, c, s = _QUARTER * total, _HALF * twice_c, _HALF * twice_s
    turn, _, inverse = phase_of(c, s)
    noise = read2 + gain * (a if a > _ZERO else _ZERO)
    return a, c, s, turn, noise * (OF_QUARTERS * inverse) + TINY, (_HALF * both) * (_HALF * both)


@pasted_kernel
def highest(i0: Any, i1: Any, i2: Any, i3: Any) -> Any:
    """Of four raw levels."""
    one, other = (i0 if i0 > i1 else i1), (i2 if i2 > i3 else i3)
    return one if one > other else other


@apart_kernel
def _fit_quarters(
    n: int,
    frames: Array,
    index: Array,
    row: int,
    first: int,
    clip: Any,
    read2: Any,
    gain: Any,
    a: Array,
    c: Array,
    s: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
) -> Any:
    """_fit_four for shifts of 0, 1, 2 and 3 quarters."""
    end = first + n
    i0, i1 = frames[index[0], row, first:end], frames[index[1], row, first:end]
    i2, i3 = frames[index[2], row, first:end], frames[index[3], row, first:end]
    top = i0[0]
    for x in range(n):
        most = highest(i0[x], i1[x], i2[x], i3[x])
        top = most if most > top else top
        f0, f1, f2, f3 = np.float32(i0[x]), np.float32(i1[x]), np.float32(i2[x]), np.float32(i3[x])
        a[x], c[x], s[x], turns[x], variance[x], misfit[x] = _quarter_fit(f0, f1, f2, f3, read2, gain)
    return np.float32(top) >= clip


@apart_kernel
def _residuals(
    n: int,
    frames: Array,
    index: Array,
    k: int,
    row: int,
    first: int,
    model: Array,
    a: Array,
    c: Array,
    s: Array,
    misfit: Array,
) -> None:
    """misfit (+)= squared residuals of four lines; model[k] = (weight, A, c, s)."""
    end = first + n
    i0, i1 = frames[index[k], row, first:end], frames[index[k + 1], row, first:end]
    i2, i3 = frames[index[k + 2], row, first:end], frames[index[k + 3], row, first:end]
    w0, a0, c0, s0 = model[k, 0], model[k, 1], model[k, 2], model[k, 3]
    w1, a1, c1, s1 = model[k + 1, 0], model[k + 1, 1], model[k + 1, 2], model[k + 1, 3]
    w2, a2, c2, s2 = model[k + 2, 0], model[k + 2, 1], model[k + 2, 2], model[k + 2, 3]
    w3, a3, c3, s3 = model[k + 3, 0], model[k + 3, 1], model[k + 3, 2], model[k + 3, 3]
    if k == 0:
        misfit[:n] = _ZERO
    for x in range(n):
        ax, cx, sx = a[x], c[x], s[x]
        r0 = w0 * np.float32(i0[x]) - a0 * ax - c0 * cx - s0 * sx
        r1 = w1 * np.float32(i1[x]) - a1 * ax - c1 * cx - s1 * sx
        r2 = w2 * np.float32(i2[x]) - a2 * ax - c2 * cx - s2 * sx
        r3 = w3 * np.float32(i3[x]) - a3 * ax - c3 * cx - s3 * sx
        misfit[x] += r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3


@apart_kernel
def _linearise(
    n: int, frames: Array, at: int, row: int, first: int, lut: Array, k: int, linear: Array
) -> None:
    line, out = frames[at, row, first : first + n], linear[k, 0, :n]
    for x in range(n):
        out[x] = lut[int(line[x])]


@apart_kernel
def _uneven_variance(
    n: int, read2: Any, gain: Any, quad: Array, a: Array, c: Array, s: Array, variance: Array
) -> None:
    """Variance of the phase for any shifts and exposures; quad: see arrays.fringe_arrays."""
    r11, r12, r22 = quad[0, 0], quad[0, 1], quad[0, 2]
    a11, a12, a22 = quad[1, 0], quad[1, 1], quad[1, 2]
    c11, c12, c22 = quad[2, 0], quad[2, 1], quad[2, 2]
    s11, s12, s22 = quad[3, 0], quad[3, 1], quad[3, 2]
    for x in range(n):
        ax, cx, sx = a[x], c[x], s[x]
        cc, ss, cs = cx * cx, sx * sx, _TWO * cx * sx
        of_read = cc * r22 + ss * r11 - cs * r12
        of_offset = cc * a22 + ss * a11 - cs * a12
        of_fringe = cx * (cc * c22 + ss * c11 - cs * c12) + sx * (cc * s22 + ss * s11 - cs * s12)
        inverse = _ONE / (cc + ss + TINY)
        spread = read2 * of_read + gain * (ax * of_offset + of_fringe)
        variance[x] = (spread * inverse * inverse + TINY) * _TURN2


@pasted_kernel
def _variance_of(quad: Array, read2: Any, gain: Any) -> Any:
    """of_read and of_level of _fit_four; quad: see arrays.fringe_arrays."""
    return read2 * quad[0, 0] * _TURN2, gain * quad[1, 0] * _TURN2


@leaf_kernel
def _fit_lines(
    n: int,
    frames: Array,
    index: Array,
    row: int,
    first: int,
    clip: Any,
    unlike: bool | None,
    period: tuple[Array, Array, Array, int, bool, bool],
    read2: Any,
    gain: Any,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
) -> bool:
    """fit_tile of linear levels."""
    quad, quarters = period[2], period[5]
    a, c, s = sums[0], sums[1], sums[2]
    if quarters:
        return bool(
            _fit_quarters(n, frames, index, row, first, clip, read2, gain, a, c, s, turns, variance, misfit)
        )
    if unlike is None:
        return False
    solve, model, _, count, even, _ = period
    of_read, of_level = _variance_of(quad, read2, gain)
    clipped, last = _ZERO, len(index) - 4
    for k in range(0, last, 4):
        clipped += _add_four(n, k == 0, frames, index, k, row, first, solve, clip, a, c, s)
    clipped += _fit_four(
        *(n, last == 0, frames, index, last, row, first, solve, clip),
        *(of_read, of_level, a, c, s, turns, variance, misfit),
    )
    if not even:
        _uneven_variance(n, read2, gain, quad, a, c, s, variance)
    if count > 4:
        for k in range(0, len(index), 4):
            _residuals(n, frames, index, k, row, first, model, a, c, s, misfit)
    return bool(clipped > _ZERO)


@leaf_kernel
def fit_tile(
    n: int,
    frames: Array,
    lut: Array | None,
    index: Array,
    first: int,
    clip: Any,
    unlike: bool | None,
    period: tuple[Array, Array, Array, int, bool, bool],
    read2: Any,
    gain: Any,
    linear: Array,
    own: Array,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
) -> bool:
    """Least squares of I_i = model_i . (A, c, s) and the phase of (c, s).

    index (M,); unlike: None if all periods are quarters; period = (solve (4, M), model (M, 4), quad (4, 3),
    count of samples, even, quarters): see arrays.fringe_arrays, M = count padded to a multiple of 4; lut
    turns raw levels into linear ones unless None (linear: room for (M, 1, n), own = 0, 1, ..., M - 1); raw
    levels >= clip are clipped.
    Out, (n,): sums[0..2] = A, c, s; turns = phase / 2 pi; variance of turns; misfit = sum of
    squares of the residuals. True if any sample is clipped.
    """
    if lut is None:
        return bool(
            _fit_lines(
                n, frames, index, 0, first, clip, unlike, period, read2, gain, sums, turns, variance, misfit
            )
        )
    for k in range(len(index)):
        _linearise(n, frames, index[k], 0, first, lut, k, linear)
    top = lut[int(min(clip, np.float32(len(lut) - 1)))]
    return bool(
        _fit_lines(n, linear, own, 0, 0, top, unlike, period, read2, gain, sums, turns, variance, misfit)
    )
