"""Fringe orders: from coarse to fine, or of close periods by a table of candidate orders.

A rough coordinate selects the order of a finer period. The rough coordinate x has a variance s^2 (a coarser
period), or lies anywhere within half a cell of x (a code). A period p with phase t and variance p^2 v gives
the places p (t + k). With d the distance from x to the nearest of these, the next one is p - |d| away, so
that with q(d) = max(|d| - half, 0)^2 / (s^2 + p^2 v)

    P(order is wrong) = 1 / (1 + exp((q(p - |d|) - q(d)) / 2)),

and q(d) is a misfit with one degree of freedom. The finer period's place is the result: a coarser one would
hardly improve its precision, and add the errors of its grey values.

If no period covers the surface, the finest is the most precise: its phase t gives the places p (t + k),
k = 0, 1, ... Each such place predicts every other phase, so a quantised table over two of them lists the
orders within the noise. Each pixel looks up its cell and compares the listed orders by all phases: their
posterior gives the probability of a wrong order, which includes orders beyond the table's tolerance.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, kernel

from ..estimate import less_likely, vanishing
from ..flags import Into, merge_line
from ..frames import KernelLight, Light
from ..profile.noise import Noise, Numbers
from .gray import CodePlan, read_line, room_for
from .phase import Periods, fit_line

__all__ = [
    "Orders",
    "climb",
    "order_table",
    "unwrap_close",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Of a period, lines (W,): phase, its variance, chi2, saturated samples; and the period.
_Told = tuple[F32, F32, F32, F32, np.float32]
#: Lines (W,) of the place so far, its variance, its error, misfit, saturated samples.
_Lines = tuple[F32, F32, F32, F32, F32]
_Three = tuple[F32, F32, F32]
#: Entries of a table along each of its axes, and deviations within which an order is listed.
_ENTRIES, _DEVIATIONS = 64, 5.0
#: Tables are cached for tolerances in steps of this factor.
_STEP = 2**0.5
#: No order, and the misfit of no order.
_NONE, _NEVER = np.float32(-20000), np.float32(1e30)
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
    """Decode rows start..stop from the coarsest period to the finest.

    code: gives the cell; without one the coarsest period's order is that of the place nearest to the middle
    of the surface.
    """
    coarsest = float(periods.period[0])
    beyond = max(0.0, 1 - coarsest / extent)  # share of the surface with another order
    numbers = np.float32((extent - 1) / 2), np.float32(beyond)
    _climb(light.numbers(), noise.numbers(), periods, rows, numbers, code, into)


@exact
def _climb(
    light: KernelLight,
    noise: Numbers,
    periods: Periods,
    rows: tuple[int, int],
    numbers: tuple[np.float32, np.float32],
    code: CodePlan | None,
    into: Into,
) -> None:
    """Row by row, so that the fits of a row stay in the cache."""
    place, var, width, (middle, beyond) = into.place, into.variance, into.place.shape[1], numbers
    work = np.empty((2, width), np.float32)
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
                if code.by_fringe:
                    cells[4, :] = offset + code.above * amplitude
                read_line(light, row, code, False, noise, room, read)
                cell = cells[0], cells[1], cells[2], cells[5], room.sure
                _join(told, _HALF * code.cell, cell, lines)
        found = place[row], var[row], error, amplitude, offset, misfit, lost
        merge_line(found, noise, row, into)


@kernel
def _start(told: _Told, middle: np.float32, beyond: np.float32, lines: _Lines) -> None:
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
def _refine(told: _Told, lines: _Lines) -> None:
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
def _join(told: _Told, half: np.float32, code: tuple[F32, F32, F32, F32, F32], lines: _Lines) -> None:
    turn, variance, chi2, clipped, period = told
    centre, centre_var, centre_error, centre_chi2, sure = code
    place, var, error, misfit, saturated = lines
    per_period, square, zero = _ONE / period, period * period, np.float32(0)
    for x in range(turn.size):
        new = period * (turn[x] + np.rint(centre[x] * per_period - turn[x]))
        own = square * variance[x]
        inverse = _ONE / (own + centre_var[x])
        away = abs(new - centre[x])
        over, other = max(away - half, zero), max(period - away - half, zero)
        # outside of the cell by noise of the fringe, or by an error of the weakest bit
        per_own = _ONE / own
        this = max(over * over * inverse, min(over * over * per_own, sure[x]))
        that = max(other * other * inverse, min(other * other * per_own, sure[x]))
        wrong = less_likely(_HALF * max(that - this, zero))
        error[x] = wrong + centre_error[x] - wrong * centre_error[x]
        misfit[x] = chi2[x] + centre_chi2[x] + over * over * inverse
        saturated[x] = clipped[x]
        place[x] = new
        var[x] = own


class Orders(NamedTuple):
    """A table of the orders of close periods.

    listed (most, cells): the nearest, the next, ... of a cell, then _NONE. tolerance: turns within which they
    are listed; extent: of the surface, px, which emits all light: a place beyond it is as unlikely as the
    noise that would shift it there.
    """

    listed: NDArray[np.float32]
    tolerance: np.float32
    extent: np.float32


def order_table(periods: tuple[float, ...], extent: int, deviation: float) -> Orders:
    """Orders of the last period by the residues of the first two, t_j - t p / p_j modulo 1.

    deviation: of a residue, turns; rounded up, as tables are cached by it.
    """
    tolerance = max(_DEVIATIONS * deviation, 1e-3)
    return _order_table(periods, extent, float(_STEP ** np.ceil(np.log(tolerance) / np.log(_STEP))))


@lru_cache(maxsize=16)
def _order_table(periods: tuple[float, ...], extent: int, tolerance: float) -> Orders:
    fine = periods[-1]
    order = np.arange(-1, int(np.ceil(extent / fine)) + 1)
    others = (*periods[:-1], periods[0])[:2]
    centre = (np.arange(_ENTRIES) + 0.5) / _ENTRIES
    away = [_wrapped(order * fine / other - centre[:, None]) for other in others]
    near = [np.abs(part) < tolerance + 0.5 / _ENTRIES for part in away]
    one, other, number = np.nonzero(near[0][:, None] & near[1][None])
    distance = away[0][one, number] ** 2 + away[1][other, number] ** 2
    cell = one * _ENTRIES + other
    sort = np.lexsort((distance, cell))
    count = np.bincount(cell, minlength=_ENTRIES**2)
    rank = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    listed = np.full((count.max(), len(count)), _NONE)
    listed[rank, cell[sort]] = order[number[sort]]
    return Orders(listed, np.float32(tolerance), np.float32(extent))


def _wrapped(turns: F64) -> F64:
    return turns - np.rint(turns)


def unwrap_close(
    light: Light, noise: Noise, periods: Periods, orders: Orders, rows: tuple[int, int], into: Into
) -> None:
    """Coordinates of rows start..stop from all periods, coarse to fine."""
    _unwrap(light.numbers(), noise.numbers(), periods, rows, orders, into)


@exact
def _unwrap(
    light: KernelLight, noise: Numbers, periods: Periods, rows: tuple[int, int], orders: Orders, into: Into
) -> None:
    """Row by row, so that the fits of a row stay in the cache."""
    place, var, width = into.place, into.variance, into.place.shape[1]
    count, period = periods.number.size, periods.period
    work = np.empty((2, width), np.float32)
    t, v = np.empty((count, width), np.float32), np.empty((count, width), np.float32)
    weights, of_fit = np.empty((count, width), np.float32), np.empty((2, width), np.float32)
    cell, own = np.empty(width, np.uint32), np.empty((10, width), np.float32)
    error, amplitude, offset, misfit, clipped = own[0], own[1], own[2], own[3], own[4]
    order, at, mean, score, least = own[5], own[6], own[7], own[8], own[9]
    for row in range(rows[0], rows[1]):
        weight = var[row]
        clipped[:], misfit[:], weight[:] = np.float32(0), np.float32(0), np.float32(0)
        place[row, :] = np.float32(np.nan)
        for j in range(count):
            fit = t[j], v[j], amplitude, offset, of_fit[0], of_fit[1]
            fit_line(light, noise, periods, j, row, work, fit)
            _kept(v[j], of_fit[0], of_fit[1], period[j], weights[j], weight, misfit, clipped)
        _cells(t, period, cell)
        error[:], least[:] = np.float32(0), _NEVER
        for rank in range(len(orders.listed)):
            if not _listed(orders.listed[rank], cell, order):
                break
            _scores(t, weights, weight, period, orders.extent, order, (at, mean, score))
            _compared(order, at, score, (place[row], least, error))
        _doubt(v, period, orders.tolerance, least, (weight, error, misfit))
        merge_line((place[row], weight, error, amplitude, offset, misfit, clipped), noise, row, into)


@kernel
def _kept(
    var: F32, chi2: F32, saturated: F32, period: np.float32, own: F32, weight: F32, misfit: F32, clipped: F32
) -> None:
    """Add a period's fit: weight of its place, misfit, saturated samples."""
    square = period * period
    for x in range(var.size):
        own[x] = _ONE / (square * var[x])
        weight[x] += own[x]
        misfit[x] += chi2[x]
        clipped[x] = max(clipped[x], saturated[x])


@kernel
def _cells(turns: F32, periods: F32, cell: NDArray[np.uint32]) -> None:
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
        cell[x] = np.uint32(i * np.int32(_ENTRIES) + j)


@kernel
def _listed(orders: F32, cell: NDArray[np.uint32], order: F32) -> bool:
    """Orders of one rank for a line's cells; whether there are any."""
    some = False
    for x in range(cell.size):
        order[x] = orders[cell[x]]
        some |= order[x] > _NONE
    return some


@kernel
def _scores(
    turns: F32, weights: F32, weight: F32, periods: F32, extent: np.float32, order: F32, out: _Three
) -> None:
    """Weighted mean of the places by all periods for an order, and misfit; weight: sum of weights."""
    last = periods.size - 1
    fine, t = periods[last], turns[last]
    place, mean, square = out
    for x in range(order.size):
        place[x] = fine * (order[x] + t[x])
        mean[x], square[x] = np.float32(0), np.float32(0)
    for j in range(last):
        p, per_period = periods[j], _ONE / periods[j]
        t, w = turns[j], weights[j]
        for x in range(order.size):
            off = place[x] * per_period - t[x]
            off = p * (np.rint(off) - off)
            mean[x] += w[x] * off
            square[x] += w[x] * off * off
    for x in range(order.size):
        off = mean[x] / weight[x]
        at = place[x] + off
        beyond = max(max(-_HALF - at, at + _HALF - extent), np.float32(0))
        square[x] += beyond * beyond * weight[x] - mean[x] * off
        place[x] = at


@kernel
def _compared(order: F32, at: F32, score: F32, best: tuple[F32, F32, F32]) -> None:
    """Update the best order: its place, its misfit, likelihood of all others relative to it."""
    place, least, others = best
    for x in range(order.size):
        here, before, there = at[x], least[x], place[x]
        rival = score[x] if order[x] > _NONE else _NEVER
        likely = vanishing(_HALF * abs(rival - before))
        better = rival < before
        others[x] = (others[x] + _ONE) * likely if better else others[x] + likely
        place[x] = here if better else there
        least[x] = min(rival, before)


@kernel
def _doubt(variances: F32, periods: F32, tolerance: np.float32, least: F32, lines: _Three) -> None:
    """Variance of the best order's place, its misfit including the fits', and probability of another order or
    of one beyond the tolerance."""
    last = periods.size - 1
    b = min(1, last - 1)
    r0, r1 = periods[last] / periods[0], periods[last] / periods[b]
    v0, v1, v = variances[0], variances[b], variances[last]
    weight, error, misfit = lines
    half = _HALF * tolerance * tolerance
    for x in range(error.size):
        wrong = error[x] / (_ONE + error[x])
        wrong += vanishing(half / (v0[x] + r0 * r0 * v[x])) + vanishing(half / (v1[x] + r1 * r1 * v[x]))
        error[x] = min(wrong, _ONE) if least[x] < _NEVER else _ONE
        misfit[x] += least[x]
        weight[x] = _ONE / weight[x]
