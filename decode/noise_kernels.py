"""Compiled: what fringes do not explain of a sample, and the variance that outliers do not move."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import asked_by, fast_kernel, leaf_kernel, outer_kernel
from .select_kernels import least

__all__ = [
    "CLEAR",
    "FEWEST",
    "LINES",
    "MOST",
    "OF_MEDIAN",
    "ROOMY",
    "SEEN",
    "fringe_residuals",
    "robust_variances",
]

Array = NDArray[Any]

#: Deviations within which a residual counts, squared; rounds in which these are found.
_FAR, _ROUNDS = 16.0, 3
#: Deviation over median absolute value of a normal distribution; what a rounded median may lack, levels.
OF_MEDIAN, _HALF_A_LEVEL = 1.4826, 0.5
#: Modulation, squared, over that which most pixels do not exceed, from which on a pixel sees the pattern; how
#: many do, at least; deviations that samples stay clear of black and clipping, and the share of the pixels
#: that may be left out for that.
SEEN, MOST, FEWEST = 0.25**2, 0.95, 50
CLEAR, ROOMY = 4.0, 0.65
#: Lines of room: offset, cosine, sine; least and largest fitted sample; largest sample; room to both ends;
#: one to select from.
_LOW, _HIGH, _TOP, _ROOM, _ANY = range(3, 8)
LINES = 8
_ZERO, _ONE, _INF = np.float32(0), np.float32(1), np.float32(np.inf)


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
        seen = _seen(room, SEEN * _power_of_most(room))
        if seen < FEWEST:
            seen = _seen(room, -1.0)
        if seen > 0:
            used += _clear(seen, room, weights, out, level[used:], residual[used:])
    return used


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
        room[0],
        room[1],
        room[2],
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
    low, high, top, far = room[_LOW], room[_HIGH], room[_TOP], room[_ROOM]
    for x in range(len(far)):
        above = limit - high[x]
        far[x] = (low[x] if low[x] < above else above) if top[x] < limit else -_INF


@leaf_kernel
def _power_of_most(room: Array) -> float:
    """Squared modulation that 95 % of the pixels do not exceed."""
    power, cosine, sine = room[_ANY], room[1], room[2]
    for x in range(len(power)):
        power[x] = cosine[x] * cosine[x] + sine[x] * sine[x]
    return float(least(power, len(power), MOST))


@leaf_kernel
def _seen(room: Array, power: float) -> int:
    """How many pixels have more than that, and no clipped sample: their numbers into line _TOP."""
    count = 0
    for x in range(room.shape[1]):
        if room[_ROOM, x] > -_INF and room[1, x] ** 2 + room[2, x] ** 2 > power:
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
        far = room[_ROOM, int(room[_TOP, i])]
        line[i] = far
        lowest = far if far < lowest else lowest
    for i in range(seen):
        line[i] -= lowest
    enough = min(CLEAR * rough - lowest, least(line, seen, ROOMY))
    kept = 0
    for i in range(seen):
        if line[i] >= enough:
            room[_TOP, kept] = room[_TOP, i]
            kept += 1
    for j in range(rest):  # into the same memory: what is written has been read
        for i in range(kept):
            x = int(room[_TOP, i])
            level[j * kept + i], residual[j * kept + i] = room[0, x], out[j, x]
    return rest * kept


@outer_kernel
def robust_variances(residual: Array, room: Array, variance: Array) -> None:
    """variance (L,) = mean squares of residuals (L, K) within 4 robust deviations, from the median absolute
    value (and half a level) and then from itself. room: (K,), float32."""
    count = residual.shape[1]
    for i in range(len(variance)):
        for x in range(count):
            room[x] = residual[i, x] * residual[i, x]
        found = (OF_MEDIAN * math.sqrt(least(room, count, 0.5)) + _HALF_A_LEVEL) ** 2
        for _ in range(_ROUNDS):
            total, used = _sums(room, np.float32(_FAR * found))
            found = total / used if used > 0 else found
        variance[i] = found


@fast_kernel
def _sums(square: Array, most: Any) -> tuple[float, float]:
    total = count = _ZERO
    for x in range(len(square)):
        within = _ONE if square[x] < most else _ZERO  # a factor: branches are not made vectors of
        total += within * square[x]
        count += within
    return float(total), float(count)
