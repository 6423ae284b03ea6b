"""Compiled: what fringes and bits do not explain of a sample, where that tells the noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, asked_by, fast_kernel, leaf_kernel, outer_kernel
from .select_kernels import least
from .variance_kernels import OF_MEDIAN

__all__ = [
    "DISTANCE",
    "LEVEL",
    "LINES",
    "MODULATION",
    "MOST",
    "clear_residuals",
    "fringe_residuals",
    "pair_residuals",
]

Array = NDArray[Any]

#: Modulation, squared, over that which most pixels do not exceed, from which on a pixel sees the pattern; how
#: many do, at least; deviations that samples stay clear of black and clipping, and the share of the pixels
#: that may be left out for that.
_SEEN, MOST, _FEWEST = 0.25**2, 0.95, 50
_CLEAR, _ROOMY = 4.0, 0.65
#: Lines of room: offset; cosine and sine, whose root of squares is the modulation; least and largest fitted
#: sample; largest sample; distance from both ends, -inf if a sample is clipped; one to select from.
LEVEL, MODULATION, _SINE, _LOW, _HIGH, _TOP, DISTANCE, _ANY = range(8)
LINES = 8
_ZERO, _HALF, _INF = np.float32(0), np.float32(0.5), np.float32(np.inf)


@asked_by(
    "fringes",
    "float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1], float32[::1], float64, "
    "float32[:, ::1], float32[:, ::1], float32[::1], float32[::1]",
)
@outer_kernel
def fringe_residuals(
    own: Array,
    design: Array,
    solve: Array,
    contrasts: Array,
    slope: Array,
    limit: float,
    room: Array,
    weights: Array,
    level: Array,
    residual: Array,
) -> int:
    """What F fringes of N samples do not explain of pixels, own (F, N, K): residual (M,) and level (M,), one
    fringe after the other, one contrast after the other; M, at most F C K, is returned.

    design (F, N, 3), its inverse solve (F, 3, N), contrasts (F, C, N) that it does not reach; slope (256,) or
    empty: d raw / d linear, residuals are then of raw levels; limit: level at which samples clip; room
    (LINES, K), weights (C, K).

    Used are pixels without clipped samples that see the pattern (a quarter of what others see of it, at
    least) and stay 4 deviations clear of black and clipping; if few do, the better third: noise that is cut
    off looks smaller than it is. What decides is the fit and not the samples: to leave out a pixel because of
    its noise would select small noise.
    """
    fringes, _, pixels = own.shape
    rest, used = contrasts.shape[1], 0
    for f in range(fringes):
        out = residual[used : used + rest * pixels].reshape(rest, pixels)
        _fit(own[f], design[f], solve[f], contrasts[f], slope, np.float32(limit), room, weights, out)
        used += _chosen(room, weights, out, level[used:], residual[used:])
    return used


@asked_by(
    "code alone",
    "float32[:, :, ::1], float32[:, ::1], float64, float32[:, ::1], float32[:, ::1], float32[::1], "
    "float32[::1]",
)
@outer_kernel
def pair_residuals(
    own: Array, contrasts: Array, limit: float, room: Array, weights: Array, level: Array, residual: Array
) -> int:
    """fringe_residuals of one code, own (2, B, K): B bits and their inverses, whose sums are all the same.

    contrasts (C, B): of numbers that do not change if all do by the same. What bits would be with neither
    blur nor noise lies half the median of their differences from the mid level. own is lost.
    """
    rest, pixels = len(contrasts), own.shape[2]
    out = residual[: rest * pixels].reshape(rest, pixels)
    sums, sizes = own[0], own[1]
    room[LEVEL], room[_TOP], room[_SINE] = _ZERO, -_INF, _ZERO
    for bit in range(len(sums)):
        _add_pair(sums[bit], sizes[bit], room[LEVEL], room[_TOP])
    _sort(sizes)
    _extremes_of_pairs(_HALF / np.float32(len(sums)), sizes[len(sizes) // 2], room)
    _rooms(np.float32(limit), room)
    for j in range(rest):
        _combine(contrasts[j], sums, out[j])
    return int(_chosen(room, weights, out, level, residual))


@outer_kernel
def clear_residuals(room: Array, weights: Array, out: Array, level: Array, residual: Array) -> int:
    """The choice of fringe_residuals among residuals (C, K), of what lines LEVEL, MODULATION and DISTANCE of
    room say of their pixels; line 2: 0."""
    return int(_chosen(room, weights, out, level, residual))


@leaf_kernel
def _chosen(room: Array, weights: Array, out: Array, level: Array, residual: Array) -> int:
    """Levels and residuals of the pixels that count; their number. out (C, K): all residuals."""
    seen = _seen(room, _SEEN * _power_of_most(room))
    if seen < _FEWEST:
        seen = _seen(room, -1.0)
    return _clear(seen, room, weights, out, level, residual) if seen > 0 else 0


@leaf_kernel
def _fit(
    own: Array,
    design: Array,
    solve: Array,
    contrasts: Array,
    slope: Array,
    limit: Any,
    room: Array,
    weights: Array,
    out: Array,
) -> None:
    """Fits and their extremes into room, residuals (C, K) into out."""
    count = len(own)
    for i in range(3):
        _combine(solve[i], own, room[i])
    for j in range(len(out)):
        _combine(contrasts[j], own, out[j])
    room[_TOP], room[_LOW], room[_HIGH], weights[:] = -_INF, _INF, -_INF, 0
    for k in range(count):
        _extremes(own[k], design[k], room)
        if slope.size > 0:
            for j in range(len(out)):
                _weigh(contrasts[j, k] ** 2, room[_ANY], slope, weights[j])
    if slope.size > 0:
        for j in range(len(out)):
            for x in range(out.shape[1]):
                out[j, x] /= np.sqrt(weights[j, x])
    _rooms(limit, room)


@fast_kernel
def _combine(shares: Array, lines: Array, total: Array) -> None:
    """total (K,) = sum of lines (N, K), each by its share."""
    for x in range(len(total)):
        total[x] = shares[0] * lines[0, x]
    for k in range(1, len(shares)):
        for x in range(len(total)):
            total[x] += shares[k] * lines[k, x]


@fast_kernel
def _extremes(sample: Array, model: Array, room: Array) -> None:
    """Of samples (K,) and of what is fitted to them."""
    a, c, s, low, high, top, fitted = (
        room[LEVEL],
        room[MODULATION],
        room[_SINE],
        room[_LOW],
        room[_HIGH],
        room[_TOP],
        room[_ANY],
    )
    for x in range(len(sample)):
        here = model[0] * a[x] + model[1] * c[x] + model[2] * s[x]
        fitted[x] = here
        low[x] = here if here < low[x] else low[x]
        high[x] = here if here > high[x] else high[x]
        top[x] = sample[x] if sample[x] > top[x] else top[x]


@apart_kernel
def _add_pair(one: Array, other: Array, total: Array, top: Array) -> None:
    """Of a bit's samples (K,) and its inverse's: their sum and the size of their difference, in place; sum of
    all, largest sample."""
    for x in range(len(one)):
        a, b = one[x], other[x]
        highest = a if a > b else b
        one[x], other[x] = a + b, abs(a - b)
        total[x] += a + b
        top[x] = highest if highest > top[x] else top[x]


@leaf_kernel
def _sort(lines: Array) -> None:
    """Of lines (B, K), every column: neighbours in turns, in whole vectors."""
    count = len(lines)
    for turn in range(count):
        for k in range(turn % 2, count - 1, 2):
            _swap(lines[k], lines[k + 1])


@apart_kernel
def _swap(one: Array, other: Array) -> None:
    for x in range(len(one)):
        a, b = one[x], other[x]
        one[x], other[x] = (a if a < b else b), (b if a < b else a)


@apart_kernel
def _extremes_of_pairs(share: Any, difference: Array, room: Array) -> None:
    """Mid level, from the sum of all samples and what a pair has of it; modulation, extremes."""
    level, half, low, high = room[LEVEL], room[MODULATION], room[_LOW], room[_HIGH]
    for x in range(len(difference)):
        middle, off = share * level[x], _HALF * difference[x]
        level[x], half[x] = middle, off
        low[x], high[x] = middle - off, middle + off


@leaf_kernel
def _weigh(share: Any, fitted: Array, slope: Array, weight: Array) -> None:
    """Noise of linear levels over that of raw ones goes with the slope."""
    last = np.float32(len(slope) - 1)
    for x in range(len(fitted)):
        at = np.rint(fitted[x])
        at = at if at > 0 else np.float32(0)
        here = slope[int(at if at < last else last)]
        weight[x] += share / (here * here)


@fast_kernel
def _rooms(limit: Any, room: Array) -> None:
    """Distance of a pixel's fitted samples from black and clipping; -inf if a sample is clipped."""
    low, high, top, far = room[_LOW], room[_HIGH], room[_TOP], room[DISTANCE]
    for x in range(len(far)):
        above = limit - high[x]
        far[x] = (low[x] if low[x] < above else above) if top[x] < limit else -_INF


@leaf_kernel
def _power_of_most(room: Array) -> float:
    """Squared modulation that 95 % of the pixels do not exceed."""
    power, cosine, sine = room[_ANY], room[MODULATION], room[_SINE]
    for x in range(len(power)):
        power[x] = cosine[x] * cosine[x] + sine[x] * sine[x]
    return float(least(power, len(power), MOST))


@leaf_kernel
def _seen(room: Array, power: float) -> int:
    """How many pixels have more than that, and no clipped sample: their numbers into line _TOP."""
    count = 0
    for x in range(room.shape[1]):
        if room[DISTANCE, x] > -_INF and room[MODULATION, x] ** 2 + room[_SINE, x] ** 2 > power:
            room[_TOP, count] = x
            count += 1
    return count


@leaf_kernel
def _clear(seen: int, room: Array, spare: Array, out: Array, level: Array, residual: Array) -> int:
    """Levels and residuals (C, K) of those of `seen` pixels that stay clear, into level and residual."""
    rest, every, line, lowest = len(out), spare.reshape(-1), room[_ANY], _INF
    for j in range(rest):
        for i in range(seen):
            every[j * seen + i] = abs(out[j, int(room[_TOP, i])])
    rough = OF_MEDIAN * least(every, rest * seen, 0.5)
    for i in range(seen):
        far = room[DISTANCE, int(room[_TOP, i])]
        line[i] = far
        lowest = far if far < lowest else lowest
    for i in range(seen):
        line[i] -= lowest
    enough = min(_CLEAR * rough - lowest, least(line, seen, _ROOMY))
    kept = 0
    for i in range(seen):
        if line[i] >= enough:
            room[_TOP, kept] = room[_TOP, i]
            kept += 1
    for j in range(rest):  # into the same memory: what is written has been read
        for i in range(kept):
            x = int(room[_TOP, i])
            level[j * kept + i], residual[j * kept + i] = room[LEVEL, x], out[j, x]
    return rest * kept
