"""Fringe orders from periods none of which covers the surface: a table of the orders that fit.

One period is measured best (of several the finest; in micro phase shifting the only one with steps of its
own): its phase t leaves the places p (t + k), k = 0, 1, ... Every other observation at such a place is known,
so a table over a few of them, quantised, lists the orders that are within the noise. Each pixel looks up its
cell and compares the listed orders by what all observations say; the two that fit best tell the probability
of a wrong one, and an order that the table's tolerance leaves out adds to it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .estimate import Estimate
from .phase import Fit
from .unwrap import vanishing

__all__ = ["Orders", "order_table", "unwrap_close"]

#: Entries of a table along each of its axes, and deviations within which an order is listed.
_ENTRIES, _DEVIATIONS = 64, 5.0
#: Tables are kept by tolerances in steps of this factor.
_STEP = 2**0.5
_ONE, _HALF = np.float32(1), np.float32(0.5)


@dataclass(frozen=True, slots=True)
class Orders:
    """Orders by cell of a table: the nearest and the next one (none: a number below -10000), and all of them
    (`listed` from start[cell] to start[cell + 1]).

    tolerance: turns within which they are listed; extent: of the surface, px, from which all light comes: a
    place beyond it is as unlikely as the noise that carries it there.
    """

    first: NDArray[np.int16]
    second: NDArray[np.int16]
    start: NDArray[np.int32]
    listed: NDArray[np.int16]
    tolerance: float
    extent: float


def order_table(periods: tuple[float, ...], extent: int, deviation: float) -> Orders:
    """Orders of the last period by the residues of the first two, t_j - t p / p_j modulo 1.

    deviation: of a residue, turns, at the usual contrast.
    """
    wanted = max(_DEVIATIONS * deviation, 1e-3)
    return _order_table(periods, extent, _STEP ** np.ceil(np.log(wanted) / np.log(_STEP)))


@lru_cache(maxsize=16)
def _order_table(periods: tuple[float, ...], extent: int, tolerance: float) -> Orders:
    fine = periods[-1]
    order = np.arange(-1, int(np.ceil(extent / fine)) + 1)
    others = (*periods[:-1], periods[0])[:2]
    centre = (np.arange(_ENTRIES) + 0.5) / _ENTRIES
    away = [_wrapped(order * fine / other - centre[:, None]) for other in others]
    near = [np.abs(part) < tolerance + 0.5 / _ENTRIES for part in away]
    cell, column, number = np.nonzero(near[0][:, None] & near[1][None])
    distance = away[0][cell, number] ** 2 + away[1][column, number] ** 2
    place = cell * _ENTRIES + column
    sort = np.lexsort((distance, place))
    place, listed = place[sort], order[number[sort]].astype(np.int16)
    count = np.bincount(place, minlength=_ENTRIES**2)
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
    best = np.full((2, _ENTRIES**2), -20000, np.int16)
    for rank in range(2):
        has = count > rank
        best[rank, has] = listed[start[:-1][has] + rank]
    return Orders(best[0], best[1], start, listed, tolerance, float(extent))


def _wrapped(turns: Any) -> Any:
    return turns - np.rint(turns)


def unwrap_close(fits: list[Fit], periods: tuple[float, ...], orders: Orders, estimate: Estimate) -> None:
    """Coordinates from the phases of all periods, coarse to fine, in place."""
    turns, variances = (np.stack([getattr(f, n).ravel() for f in fits]) for n in ("turn", "variance"))
    _unwrap(
        *(turns, variances, np.array(periods, np.float32), np.float32(orders.extent)),
        *(orders.first, orders.second, orders.start, orders.listed, np.float32(orders.tolerance)),
        *(estimate.coordinate.ravel(), estimate.variance.ravel(), estimate.error.ravel()),
        estimate.chi2.ravel(),
    )
    for fit in fits:
        np.add(estimate.chi2, fit.chi2, out=estimate.chi2)
        np.maximum(estimate.clipped, fit.clipped, out=estimate.clipped)


@exact
def _unwrap(
    turns: Any,
    variances: Any,
    periods: Any,
    extent: Any,
    first: Any,
    second: Any,
    start: Any,
    listed: Any,
    tolerance: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    size, tile = place.size, 2048
    cell, one, other = np.empty(tile, np.int32), np.empty(tile, np.float32), np.empty(tile, np.float32)
    sums = np.empty((8, tile), np.float32)
    t, v = np.empty((turns.shape[0], tile), np.float32), np.empty((turns.shape[0], tile), np.float32)
    weights = np.empty((turns.shape[0], tile), np.float32)
    for begin in range(0, size, tile):
        end = min(begin + tile, size)
        n = end - begin
        for j in range(turns.shape[0]):  # contiguous lines: slices of many lines are read one by one
            t[j, :n], v[j, :n] = turns[j, begin:end], variances[j, begin:end]
            weights[j] = _ONE / (periods[j] * periods[j] * v[j])
        _cells(t, periods, cell[:n])
        for x in range(n):
            one[x], other[x] = np.float32(first[cell[x]]), np.float32(second[cell[x]])
        _scores(t, weights, periods, extent, one[:n], sums[:4])
        _scores(t, weights, periods, extent, other[:n], sums[4:])
        _better(
            *(t, v, periods, tolerance, one[:n], other[:n], sums),
            *(place[begin:end], var[begin:end], error[begin:end], chi2[begin:end]),
        )
        for x in range(n):
            low, high = start[cell[x]], start[cell[x] + 1]
            if high - low > 2:
                _compare_all(
                    *(t, v, periods, extent, tolerance, listed, low, high, x),
                    *(place[begin:end], var[begin:end], error[begin:end], chi2[begin:end]),
                )


@kernel
def _cells(turns: Any, periods: Any, cell: Any) -> None:
    last = periods.size - 1
    r0 = periods[last] / periods[0]
    b = min(1, last - 1)
    r1 = periods[last] / periods[b]
    t0, t1, t = turns[0], turns[b], turns[last]
    entries = np.float32(_ENTRIES)
    for x in range(cell.size):
        a, c = t0[x] - t[x] * r0, t1[x] - t[x] * r1
        a, c = a - np.floor(a), c - np.floor(c)
        i = min(np.int32(a * entries), np.int32(_ENTRIES - 1))
        j = min(np.int32(c * entries), np.int32(_ENTRIES - 1))
        cell[x] = i * np.int32(_ENTRIES) + j


@kernel
def _scores(turns: Any, weights: Any, periods: Any, extent: Any, order: Any, sums: Any) -> None:
    """Of an order: place, sum of weights, weighted mean and misfit of the places that all periods give."""
    last = periods.size - 1
    fine = periods[last]
    place, weight, mean, square = sums[0], sums[1], sums[2], sums[3]
    t, w = turns[last], weights[last]
    for x in range(order.size):
        place[x] = fine * (order[x] + t[x])
        weight[x], mean[x], square[x] = w[x], np.float32(0), np.float32(0)
    for j in range(last):
        p, per_period = periods[j], _ONE / periods[j]
        t, w = turns[j], weights[j]
        for x in range(order.size):
            off = place[x] * per_period - t[x]
            off = p * (np.rint(off) - off)
            weight[x] += w[x]
            mean[x] += w[x] * off
            square[x] += w[x] * off * off
    for x in range(order.size):
        off = mean[x] / weight[x]
        at = place[x] + off
        beyond = max(max(-_HALF - at, at + _HALF - extent), np.float32(0))
        square[x] += beyond * beyond * weight[x] - mean[x] * off
        mean[x] = off


@inlined
def _unlisted(tolerance: Any, variance: Any, other: Any) -> Any:
    """Probability that the true order's residues are beyond the tolerance."""
    half = _HALF * tolerance * tolerance
    return vanishing(half / variance) + vanishing(half / other)


@kernel
def _better(
    turns: Any,
    variances: Any,
    periods: Any,
    tolerance: Any,
    one: Any,
    other: Any,
    sums: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    """The order that fits better, and the probability that it is the other one or one that is not listed."""
    last = periods.size - 1
    b = min(1, last - 1)
    r0, r1 = periods[last] / periods[0], periods[last] / periods[b]
    v0, v1, v = variances[0], variances[b], variances[last]
    score, rival = sums[3], sums[7]
    for x in range(place.size):
        alone = other[x] < np.float32(-10000)
        gap = rival[x] - score[x]
        swap = (gap < np.float32(0)) & ~alone
        wrong = vanishing(_HALF * abs(gap))
        wrong = np.float32(0) if alone else wrong / (_ONE + wrong)
        wrong += _unlisted(tolerance, v0[x] + r0 * r0 * v[x], v1[x] + r1 * r1 * v[x])
        error[x] = _ONE if one[x] < np.float32(-10000) else min(wrong, _ONE)
        place[x] = sums[4, x] + sums[6, x] if swap else sums[0, x] + sums[2, x]
        var[x] = _ONE / (sums[5, x] if swap else sums[1, x])
        chi2[x] = rival[x] if swap else score[x]


@exact
def _compare_all(
    turns: Any,
    variances: Any,
    periods: Any,
    extent: Any,
    tolerance: Any,
    listed: Any,
    low: Any,
    high: Any,
    x: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    """As above, over all orders of a cell."""
    last = periods.size - 1
    fine = periods[last]
    best, total, found, weight = np.inf, 0.0, 0.0, 1.0
    for q in range(low, high):
        at = fine * (listed[q] + turns[last, x])
        w, m, s = 1.0 / (fine * fine * variances[last, x]), 0.0, 0.0
        for j in range(last):
            off = at / periods[j] - turns[j, x]
            away = periods[j] * (np.rint(off) - off)
            own = 1.0 / (periods[j] * periods[j] * variances[j, x])
            w += own
            m += own * away
            s += own * away * away
        beyond = max(-0.5 - at - m / w, at + m / w + 0.5 - extent, 0.0)
        rss = s - m * m / w + beyond * beyond * w
        if rss < best:
            total = total * np.exp(-0.5 * (best - rss)) + 1.0 if total > 0 else 1.0
            best, found, weight = rss, at + m / w, w
        else:
            total += np.exp(-0.5 * (rss - best))
    place[x], var[x], chi2[x] = np.float32(found), np.float32(1.0 / weight), np.float32(best)
    r0, r1 = fine / periods[0], fine / periods[min(1, last - 1)]
    v, v0, v1 = variances[last, x], variances[0, x], variances[min(1, last - 1), x]
    left = _unlisted(tolerance, v0 + r0 * r0 * v, v1 + r1 * r1 * v)
    error[x] = min(np.float32(1.0 - 1.0 / total) + left, _ONE)
