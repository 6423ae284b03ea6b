"""Fringe orders: from coarse to fine, or of close periods by a table of those that fit.

A coordinate that is known roughly chooses the order of a finer period. The rough coordinate x has a variance
s^2 (a coarser period), or lies anywhere within half a cell of x (a code). A period p with phase t and
variance p^2 v puts the pixel at p (t + k). With d the distance of the nearest such place from x, the next one
is p - |d| away, so that with q(d) = max(|d| - half, 0)^2 / (s^2 + p^2 v)

    P(order is wrong) = 1 / (1 + exp((q(p - |d|) - q(d)) / 2)),

and q(d) is a misfit with one degree of freedom. The finer period's place stands: a coarser one would add
little to its precision and all of what is wrong with its grey values.

Where no period covers the surface the finest is measured best: its phase t leaves the places p (t + k),
k = 0, 1, ... Every other phase at such a place is known, so a table over two of them, quantised, lists the
orders that are within the noise. Each pixel looks up its cell and compares the listed orders by what all
phases say; the two that fit best tell the probability of a wrong one, and an order that the table's tolerance
leaves out adds to it.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .estimate import less_likely, vanishing
from .flags import Into, merge_line
from .frames import Light
from .gray import CodePlan, read_line, room_for
from .noise import Noise
from .phase import Periods, fit_line

__all__ = [
    "Orders",
    "climb",
    "order_table",
    "unwrap_close",
]

#: Entries of a table along each of its axes, and deviations within which an order is listed.
_ENTRIES, _DEVIATIONS = 64, 5.0
#: Tables are kept by tolerances in steps of this factor.
_STEP = 2**0.5
_ONE, _HALF = np.float32(1), np.float32(0.5)


def climb(
    light: Light,
    noise: Noise,
    periods: Periods,
    extent: int,
    code: CodePlan | None,
    rows: tuple[int, int],
    into: Into,
) -> None:
    """Rows start..stop from the coarsest period to the finest.

    code: what tells the cell; without one the coarsest period's order is that of the place nearest to the
    middle of the surface.
    """
    coarsest = float(periods.period[0])
    beyond = max(0.0, 1 - coarsest / extent)  # so much of the surface has another order
    numbers = np.float32((extent - 1) / 2), np.float32(beyond)
    _climb(light.numbers(), noise.numbers(), periods, rows, numbers, code, into)


@exact
def _climb(light: Any, noise: Any, periods: Any, rows: Any, numbers: Any, code: Any, into: Any) -> None:
    """A row at a time, so that what its fits tell is still in the cache."""
    place, var, width, (middle, beyond) = into.place, into.variance, into.place.shape[1], numbers
    work = np.empty((2 + periods.frame.shape[1], width), np.float32)
    own = np.empty((9, width), np.float32)
    turn, variance, chi2, clipped, amplitude, offset = own[0], own[1], own[2], own[3], own[4], own[5]
    error, misfit, lost = own[6], own[7], own[8]
    if code is not None:
        room, cells = room_for(code, width), np.empty((7, width), np.float32)
        read = cells[0], cells[1], cells[2], cells[3], cells[4], cells[5], cells[6]
    for row in range(rows[0], rows[1]):
        fit = turn, variance, amplitude, offset, chi2, clipped
        lines = place[row], var[row], error, misfit, lost
        for k in range(periods.number.size):
            fit_line(light, noise, periods, k, row, work, fit)
            told = turn, variance, chi2, clipped, periods.period[k]
            if k > 0:
                _refine(told, lines)
            elif code is None:
                _start(told, middle, beyond, lines)
            else:
                read_line(light, row, code, False, noise, room, read)
                _join(told, _HALF * code.cell, (cells[0], cells[1], cells[2], cells[5]), lines)
        found = place[row], var[row], error, amplitude, offset, misfit, lost
        merge_line(found, noise, row, into)


@kernel
def _start(told: Any, middle: Any, beyond: Any, lines: Any) -> None:
    turn, variance, chi2, clipped, period = told
    place, var, error, misfit, saturated = lines
    order, square = middle / period, period * period
    for x in range(turn.size):
        place[x] = period * (turn[x] + np.rint(order - turn[x]))
        var[x] = square * variance[x]
        error[x] = beyond
        misfit[x] = chi2[x]
        saturated[x] = clipped[x]


@kernel
def _refine(told: Any, lines: Any) -> None:
    turn, variance, chi2, clipped, period = told
    place, var, error, misfit, saturated = lines
    per_period, square = _ONE / period, period * period
    for x in range(turn.size):
        rough, own = place[x], square * variance[x]
        away = period * (turn[x] + np.rint(rough * per_period - turn[x])) - rough
        inverse = _ONE / (own + var[x])
        # ((p - |d|)^2 - d^2) / 2
        wrong = less_likely(period * (_HALF * period - abs(away)) * inverse)
        error[x] += wrong - wrong * error[x]
        misfit[x] += chi2[x] + away * away * inverse
        saturated[x] += clipped[x]
        place[x] = rough + away
        var[x] = own


@kernel
def _join(told: Any, half: Any, code: Any, lines: Any) -> None:
    turn, variance, chi2, clipped, period = told
    centre, centre_var, centre_error, centre_chi2 = code
    place, var, error, misfit, saturated = lines
    per_period, square, zero = _ONE / period, period * period, np.float32(0)
    for x in range(turn.size):
        new = period * (turn[x] + np.rint(centre[x] * per_period - turn[x]))
        own = square * variance[x]
        inverse = _ONE / (own + centre_var[x])
        away = abs(new - centre[x])
        over, other = max(away - half, zero), max(period - away - half, zero)
        wrong = less_likely(_HALF * max(other * other - over * over, zero) * inverse)
        error[x] = wrong + centre_error[x] - wrong * centre_error[x]
        misfit[x] = chi2[x] + centre_chi2[x] + over * over * inverse
        saturated[x] = clipped[x]
        place[x] = new
        var[x] = own


class _Candidates(NamedTuple):
    """Orders by cell of a table: the nearest and the next one (none: a number below -10000), and all of them
    (`listed` from start[cell] to start[cell + 1])."""

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    start: NDArray[np.int32]
    listed: NDArray[np.int16]


class Orders(NamedTuple):
    """A table of the orders of close periods; crowded: whether some cell lists more than two.

    tolerance: turns within which they are listed; extent: of the surface, px, from which all light comes: a
    place beyond it is as unlikely as the noise that carries it there.
    """

    listed: _Candidates
    crowded: bool
    tolerance: np.float32
    extent: np.float32


def _listed_by(cell: NDArray[Any], order: NDArray[Any], distance: NDArray[Any], cells: int) -> _Candidates:
    """The table of orders (M,) that are within the tolerance in cells (M,), at a distance there."""
    sort = np.lexsort((distance, cell))
    listed, count = order[sort].astype(np.int16), np.bincount(cell, minlength=cells)
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
    best = np.full((2, cells), -20000, np.float32)
    for rank in range(2):
        has = count > rank
        best[rank, has] = listed[start[:-1][has] + rank]
    return _Candidates(best[0], best[1], start, listed)


def _in_steps(tolerance: float) -> float:
    """A tolerance, rounded up: tables are kept by it."""
    return float(_STEP ** np.ceil(np.log(tolerance) / np.log(_STEP)))


def order_table(periods: tuple[float, ...], extent: int, deviation: float) -> Orders:
    """Orders of the last period by the residues of the first two, t_j - t p / p_j modulo 1.

    deviation: of a residue, turns, at the usual contrast.
    """
    return _order_table(periods, extent, _in_steps(max(_DEVIATIONS * deviation, 1e-3)))


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
    listed = _listed_by(cell * _ENTRIES + column, order[number], distance, _ENTRIES**2)
    crowded = bool(np.diff(listed.start).max() > 2)
    return Orders(listed, crowded, np.float32(tolerance), np.float32(extent))


def _wrapped(turns: Any) -> Any:
    return turns - np.rint(turns)


def unwrap_close(
    light: Light, noise: Noise, periods: Periods, orders: Orders, rows: tuple[int, int], into: Into
) -> None:
    """Coordinates of rows start..stop from all periods, coarse to fine."""
    _unwrap(light.numbers(), noise.numbers(), periods, rows, orders, into)


@exact
def _unwrap(light: Any, noise: Any, periods: Any, rows: Any, orders: Any, into: Any) -> None:
    """A row at a time, so that what its fits tell is still in the cache."""
    place, var, width = into.place, into.variance, into.place.shape[1]
    count, period = periods.number.size, periods.period
    (first, second, start, listed), crowded, tolerance, extent = orders
    work = np.empty((2 + periods.frame.shape[1], width), np.float32)
    t, v = np.empty((count, width), np.float32), np.empty((count, width), np.float32)
    weights, of_fit = np.empty((count, width), np.float32), np.empty((2, width), np.float32)
    scored = np.empty((3, width), np.float32)
    one, other, room = scored[0], scored[1], scored[2]
    cell, sums = np.empty(width, np.int32), np.empty((6, width), np.float32)
    own = np.empty((5, width), np.float32)
    error, amplitude, offset, misfit, clipped = own[0], own[1], own[2], own[3], own[4]
    for row in range(rows[0], rows[1]):
        lines = place[row], var[row], error, misfit
        clipped[:], misfit[:] = np.float32(0), np.float32(0)
        for j in range(count):
            fit = t[j], v[j], amplitude, offset, of_fit[0], of_fit[1]
            fit_line(light, noise, periods, j, row, work, fit)
            _kept(v[j], of_fit[0], of_fit[1], period[j], weights[j], misfit, clipped)
        _cells(t, period, cell)
        _listed_first(first, second, cell, one, other)
        _scores(t, weights, period, extent, one, room, sums[:3])
        _scores(t, weights, period, extent, other, room, sums[3:])
        _better(other, sums, lines)
        _doubt(v, period, tolerance, one, other, sums, error)
        for x in range(width if crowded else 0):
            low, high = start[cell[x]], start[cell[x] + 1]
            if high - low > 2:
                _compare_all(t, v, period, (extent, tolerance), listed[low:high], x, sums, lines)
        merge_line((place[row], var[row], error, amplitude, offset, misfit, clipped), noise, row, into)


@kernel
def _listed_first(first: Any, second: Any, cell: Any, one: Any, other: Any) -> None:
    for x in range(cell.size):
        one[x], other[x] = first[cell[x]], second[cell[x]]


@kernel
def _kept(var: Any, chi2: Any, saturated: Any, period: Any, weight: Any, misfit: Any, clipped: Any) -> None:
    """Of a period's fit: the weight of its place, its misfit, its saturated samples."""
    square = period * period
    for x in range(var.size):
        weight[x] = _ONE / (square * var[x])
        misfit[x] += chi2[x]
        clipped[x] = max(clipped[x], saturated[x])


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
def _scores(turns: Any, weights: Any, periods: Any, extent: Any, order: Any, mean: Any, sums: Any) -> None:
    """Of an order: weighted mean of the places that all periods give, sum of weights, misfit; mean: room."""
    last = periods.size - 1
    fine = periods[last]
    place, weight, square = sums[0], sums[1], sums[2]
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
        place[x] = at


@inlined
def _unlisted(tolerance: Any, variance: Any, other: Any) -> Any:
    """Probability that the true order's residues are beyond the tolerance."""
    half = _HALF * tolerance * tolerance
    return vanishing(half / variance) + vanishing(half / other)


@kernel
def _better(other: Any, sums: Any, lines: Any) -> None:
    """The order that fits better; its misfit joins that of the fits."""
    place, var, _, misfit = lines
    at, weight, score = sums[0], sums[1], sums[2]
    other_at, other_weight, rival = sums[3], sums[4], sums[5]
    for x in range(place.size):
        swap = (rival[x] < score[x]) & (other[x] > np.float32(-10000))
        here, there = at[x], other_at[x]
        of_one, of_other = weight[x], other_weight[x]
        best, next_ = score[x], rival[x]
        place[x] = there if swap else here
        var[x] = _ONE / (of_other if swap else of_one)
        misfit[x] += next_ if swap else best


@kernel
def _doubt(variances: Any, periods: Any, tolerance: Any, one: Any, other: Any, sums: Any, error: Any) -> None:
    """The probability that it is the other one or one that is not listed. (A loop of its own: compilers make
    no vector instructions of one that writes to as many lines.)"""
    last = periods.size - 1
    b = min(1, last - 1)
    r0, r1 = periods[last] / periods[0], periods[last] / periods[b]
    v0, v1, v = variances[0], variances[b], variances[last]
    score, rival = sums[2], sums[5]
    for x in range(error.size):
        alone = other[x] < np.float32(-10000)
        wrong = less_likely(_HALF * abs(rival[x] - score[x]))
        wrong = np.float32(0) if alone else wrong
        wrong += _unlisted(tolerance, v0[x] + r0 * r0 * v[x], v1[x] + r1 * r1 * v[x])
        error[x] = _ONE if one[x] < np.float32(-10000) else min(wrong, _ONE)


@exact
def _compare_all(
    turns: Any, variances: Any, periods: Any, numbers: Any, listed: Any, x: Any, sums: Any, lines: Any
) -> None:
    """As above, over all orders of a cell."""
    (place, var, error, misfit), (extent, tolerance) = lines, numbers
    last = periods.size - 1
    fine = periods[last]
    best, total, found, weight = np.inf, 0.0, 0.0, 1.0
    for order in listed:
        at = fine * (order + turns[last, x])
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
    place[x], var[x] = np.float32(found), np.float32(1.0 / weight)
    misfit[x] += np.float32(best) - min(sums[2, x], sums[5, x])
    r0, r1 = fine / periods[0], fine / periods[min(1, last - 1)]
    v, v0, v1 = variances[last, x], variances[0, x], variances[min(1, last - 1), x]
    left = _unlisted(tolerance, v0 + r0 * r0 * v, v1 + r1 * r1 * v)
    error[x] = min(np.float32(1.0 - 1.0 / total) + left, _ONE)
