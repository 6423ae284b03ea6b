"""Fringe orders: from coarse to fine, or of close periods by a table of candidates.

A rough place x selects the order of a finer period p with phase t: of the places p (t + k) the nearest to x,
at a distance d; the next one is p - |d| away. Where x has a variance s^2 (a coarser period),

    P(order is wrong) = 1 / (1 + exp(p (p / 2 - |d|) / (s^2 + p^2 v)));

where x lies anywhere in an interval (a code), the place must lie in it and no other one; of two that fit
(cells as large as a period) the neighbours choose.

If no period covers the surface, each place p (t + k) of the finest period predicts every other phase, so that
a quantised table over two of them lists the orders within the noise. All phases compare the orders that a
pixel finds in it: their posterior gives the probability of a wrong one, with those beyond the table's
tolerance.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from optolever.kernels import F32, HALF, I32, ONE, ZERO, inlined, inner

from ..correspondence import Flag

__all__ = ["Orders", "climb_row", "compare_row", "join_row", "order_table", "start_row"]

#: Entries of a table along each of its axes; deviations within which an order is listed; steps of its
#: tolerance.
_ENTRIES, _DEVIATIONS, _STEP = 64, 5.0, 2**0.5
#: No order, and the misfit of no order.
_NONE, _NEVER = np.float32(-20000), np.float32(1e30)
#: Variance of a place that is not known, px^2.
_FAR = np.float32(1e9)
#: Probability of a wrong order above which a pixel is flagged.
_DOUBT = np.float32(1e-4)
#: Shares of a period by which a place may lie outside of its interval, and by which another must stay
#: outside.
_OUTSIDE, _APART = np.float32(0.25), np.float32(0.04)
_ORDER = np.int32(Flag.ORDER_DOUBTFUL)


@inlined
def exp_neg(x: np.float32, over: np.float32) -> np.float32:
    """Upper bound of exp(-x / over), both >= 0: (1 + x / over / 64)^-64, twice the exponential of -10."""
    y = over / (over + x * np.float32(1 / 64))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return np.float32(y * y)


@inner
def start_row(
    phase: F32, phase_variance: F32, period: np.float32, extent: np.float32, place: F32, variance: F32
) -> None:
    """Place by the coarsest period: the one nearest to the middle of the surface."""
    middle, square = HALF * (extent - ONE) / period, period * period
    for x in range(place.size):
        t = phase[x]
        place[x] = period * (t + np.rint(middle - t))
        variance[x] = square * phase_variance[x]


@inner
def climb_row(
    phase: F32, phase_variance: F32, period: np.float32, place: F32, variance: F32, error: F32, flags: I32
) -> None:
    """Place by a finer period, its order by the place so far."""
    per_period, square, none = ONE / period, period * period, np.int32(0)
    for x in range(place.size):
        rough, own = place[x], square * phase_variance[x]
        away = period * (phase[x] + np.rint(rough * per_period - phase[x])) - rough
        room = max(HALF * period - abs(away), ZERO)
        e = exp_neg(period * room, own + variance[x])
        error[x] = max(error[x], e)
        flags[x] |= _ORDER if e > _DOUBT else none
        place[x] = rough + away
        variance[x] = own


@inner
def join_row(
    phase: F32,
    phase_variance: F32,
    period: np.float32,
    reach: F32,
    place: F32,
    variance: F32,
    error: F32,
    flags: I32,
    either: np.int32,
) -> None:
    """Place by a period within the interval of a code, place +- reach; either: flag where two orders fit."""
    per_period, square, none = ONE / period, period * period, np.int32(0)
    for x in range(place.size):
        rough = place[x]
        away = period * (phase[x] + np.rint(rough * per_period - phase[x])) - rough
        far = abs(away)
        outside, two = far > reach[x] + _OUTSIDE * period, period - far - reach[x] < _APART * period
        flags[x] |= _ORDER if outside else either if two else none
        error[x] = max(error[x], ONE if outside | two else ZERO)
        place[x] = rough + away
        variance[x] = square * phase_variance[x]


class Orders(NamedTuple):
    """A table of the orders of close periods.

    listed (most, cells): the nearest, the next, ... of a cell, then _NONE. tolerance: cycles within which
    they are listed; extent: of the surface, px, which emits all light: a place beyond it is as unlikely as
    the noise that would shift it there.
    """

    listed: F32
    tolerance: np.float32
    extent: np.float32


def order_table(periods: tuple[float, ...], extent: int, deviation: float) -> Orders:
    """Orders of the last period by the residues of the first two, t_j - t p / p_j modulo 1.

    deviation: of a residue, cycles; rounded up, as tables are cached by it.
    """
    tolerance = max(_DEVIATIONS * deviation, 1e-3)
    return _order_table(periods, extent, float(_STEP ** np.ceil(np.log(tolerance) / np.log(_STEP))))


@lru_cache(maxsize=16)
def _order_table(periods: tuple[float, ...], extent: int, tolerance: float) -> Orders:
    fine = periods[-1]
    order = np.arange(-1, int(np.ceil(extent / fine)) + 1)
    others = (*periods[:-1], periods[0])[:2]
    centre = (np.arange(_ENTRIES) + 0.5) / _ENTRIES
    residues = [order * fine / other - centre[:, None] for other in others]
    away = [residue - np.rint(residue) for residue in residues]
    near = [np.abs(part) < tolerance + 0.5 / _ENTRIES for part in away]
    one, other, number = np.nonzero(near[0][:, None] & near[1][None])
    distance = away[0][one, number] ** 2 + away[1][other, number] ** 2
    cell = one * _ENTRIES + other
    sort = np.lexsort((distance, cell))
    count = np.bincount(cell, minlength=_ENTRIES**2)
    rank = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    listed = np.full((max(count.max(), 1), len(count)), _NONE)
    listed[rank, cell[sort]] = order[number[sort]]
    return Orders(listed, np.float32(tolerance), np.float32(extent))


@inner
def compare_row(
    phase: F32,
    phase_variance: F32,
    period: F32,
    orders: Orders,
    work: F32,
    cell: I32,
    place: F32,
    variance: F32,
    error: F32,
    chi2: F32,
    flags: I32,
) -> None:
    """Place by all of K close periods; phase and its variance (K, W), work (6, W) is left at 0, cell (W,)."""
    count = period.size
    order, at, mean, score, least, weight = work[0], work[1], work[2], work[3], work[4], work[5]
    last = count - 1
    b = min(1, last - 1)
    r0, r1 = period[last] / period[0], period[last] / period[b]
    for x in range(place.size):
        weight[x], error[x], least[x], place[x] = ZERO, ZERO, _NEVER, ZERO
    for j in range(count):
        square, v = period[j] * period[j], phase_variance[j]
        for x in range(place.size):
            weight[x] += ONE / (square * v[x])
    t0, t1, t = phase[0], phase[b], phase[last]
    entries, none = np.float32(_ENTRIES), np.int32(0)
    for x in range(place.size):
        a, c = t0[x] - t[x] * r0, t1[x] - t[x] * r1
        a, c = a - np.floor(a), c - np.floor(c)
        # of a phase that is no number it is the least integer
        i = max(min(np.int32(a * entries), np.int32(_ENTRIES - 1)), none)
        k = max(min(np.int32(c * entries), np.int32(_ENTRIES - 1)), none)
        cell[x] = i * np.int32(_ENTRIES) + k
    for rank in range(len(orders.listed)):
        listed, some = orders.listed[rank], False
        for x in range(place.size):
            order[x] = listed[cell[x]]
            some |= order[x] > _NONE
        if not some:
            break
        _scores(phase, phase_variance, period, orders.extent, weight, order, at, mean, score)
        for x in range(place.size):
            rival = score[x] if order[x] > _NONE else _NEVER
            before = least[x]
            likely = exp_neg(min(HALF * abs(rival - before), np.float32(1e4)), ONE)
            better = rival < before
            error[x] = (error[x] + ONE) * likely if better else error[x] + likely
            place[x] = at[x] if better else place[x]
            least[x] = min(rival, before)
    half = HALF * orders.tolerance * orders.tolerance
    v0, v1, v = phase_variance[0], phase_variance[b], phase_variance[last]
    for x in range(place.size):
        wrong = error[x] / (ONE + error[x])
        wrong += exp_neg(half, v0[x] + r0 * r0 * v[x]) + exp_neg(half, v1[x] + r1 * r1 * v[x])
        found = least[x] < _NEVER
        error[x] = min(wrong, ONE) if found else ONE
        # a pixel without light has no phase, and a variance that is no number
        chi2[x] += min(least[x], np.float32(1e6)) if found else ZERO
        own = ONE / weight[x]
        variance[x] = own if own < _FAR else _FAR
        flags[x] |= _ORDER if error[x] > _DOUBT else none
    for line in work:
        for x in range(place.size):
            line[x] = ZERO  # the next fit multiplies them by 0: they must be finite


@inner
def _scores(
    phase: F32,
    phase_variance: F32,
    period: F32,
    extent: np.float32,
    weight: F32,
    order: F32,
    at: F32,
    mean: F32,
    score: F32,
) -> None:
    """Weighted mean of the places by all periods for an order, and misfit; weight: sum of weights."""
    last = period.size - 1
    fine, t = period[last], phase[last]
    for x in range(order.size):
        at[x] = fine * (order[x] + t[x])
        mean[x], score[x] = ZERO, ZERO
    for j in range(last):
        p, per_period = period[j], ONE / period[j]
        t, v = phase[j], phase_variance[j]
        for x in range(order.size):
            off = at[x] * per_period - t[x]
            off = p * (np.rint(off) - off)
            w = ONE / (p * p * v[x])
            mean[x] += w * off
            score[x] += w * off * off
    for x in range(order.size):
        off = mean[x] / weight[x]
        place = at[x] + off
        beyond = max(max(-HALF - place, place + HALF - extent), ZERO)
        score[x] += beyond * beyond * weight[x] - mean[x] * off
        at[x] = place
