"""Compiled unwrapping: phases of several periods (and a code's cell) -> coordinate, variance, order error.

`sequential_tile` takes the periods from coarse to fine: each one's fringe order is the one nearest to what is
known so far, and each adds its information (a Kalman filter whose observations are known up to a period).
`search_tile` does the same from every order of the coarsest period and keeps the most probable start, for
periods that are unambiguous only together (heterodyne, number-theoretic, any rational ratio).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, leaf_kernel

__all__ = ["MUCH_FINER", "UNKNOWN", "search_tile", "sequential_tile"]

Array = NDArray[Any]

#: Differences of chi squared beyond this are certain: exp(-20) = 2e-9.
_CERTAIN = 40.0
#: A period so many times coarser than the next only gives the order: it holds less than 1/16 of the
#: information, and its harmonics would weigh in with the ratio.
MUCH_FINER = 4.0
#: Variance (turns^2) of a phase that is not known; finite, so that its weight is 0 and not NaN.
UNKNOWN = 1e20

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


@leaf_kernel
def sequential_tile(
    n: int,
    periods: Array,
    turns: Array,
    variance: Array,
    guess: Array,
    coord: Array,
    spread: Array,
    step: Array,
    margin: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> None:
    """Orders nearest to guess (n,), then to the estimate so far. All float32.

    periods (G,) coarse to fine, turns and variance (G, n). Out (n,): coord and its variance `spread`; misfit
    += chi squared of the periods' agreement (G - 1 degrees of freedom); gap = |coord of the first - guess|;
    order_error += probability that an order is wrong, given the guess. step, margin: room for (n,).
    """
    _first_order(n, periods[0], turns[0], variance[0], guess, coord, spread, gap)
    for g in range(1, len(periods)):
        if _next_order(n, periods[g], turns[g], variance[g], coord, spread, step, margin, misfit):
            _add_doubt(n, periods[g], variance[g], spread, step, margin, order_error)
        _update(n, periods[g], MUCH_FINER * periods[g] < periods[g - 1], variance[g], coord, spread, step)


@fast_kernel
def _first_order(
    n: int, period: Any, turns: Array, variance: Array, guess: Array, coord: Array, spread: Array, gap: Array
) -> None:
    inverse = _ONE / period
    for x in range(n):
        coord[x] = period * (turns[x] + np.rint(guess[x] * inverse - turns[x]))
    for x in range(n):
        gap[x] = abs(coord[x] - guess[x])
    for x in range(n):
        spread[x] = variance[x] * (period * period)


@fast_kernel
def _next_order(
    n: int,
    period: Any,
    turns: Array,
    variance: Array,
    coord: Array,
    spread: Array,
    step: Array,
    margin: Array,
    misfit: Array,
) -> bool:
    """Step to the nearest order; margin = chi squared by which the next is worse. True: some are close."""
    inverse, square = _ONE / period, period * period
    for x in range(n):
        order = np.rint(coord[x] * inverse - turns[x])
        step[x] = period * (turns[x] + order) - coord[x]
    for x in range(n):
        both = spread[x] + variance[x] * square
        margin[x] = (square - _TWO * period * abs(step[x])) / both
    for x in range(n):
        misfit[x] += step[x] * step[x] / (spread[x] + variance[x] * square)
    close = 0
    for x in range(n):
        close += margin[x] < np.float32(_CERTAIN)
    return close > 0


@leaf_kernel
def _add_doubt(
    n: int, period: Any, variance: Array, spread: Array, step: Array, margin: Array, order_error: Array
) -> None:
    """Probability that another order is the right one: both neighbours, from chi squared (flat prior)."""
    for x in range(n):
        if margin[x] < _CERTAIN:
            both = float(spread[x]) + float(variance[x]) * period * period
            order_error[x] += _doubt(float(period), abs(float(step[x])), both)


@leaf_kernel
def _doubt(period: float, step: float, both: float) -> float:
    near = math.exp(-0.5 * period * (period - 2 * step) / both)
    far = math.exp(-0.5 * period * (period + 2 * step) / both)
    return (near + far) / (1 + near + far)


@fast_kernel
def _update(
    n: int, period: Any, alone: bool, variance: Array, coord: Array, spread: Array, step: Array
) -> None:
    square = period * period
    if alone:
        for x in range(n):
            coord[x] += step[x]
        for x in range(n):
            spread[x] = variance[x] * square
        return
    for x in range(n):
        fine = variance[x] * square
        coord[x] += spread[x] / (spread[x] + fine) * step[x]
    for x in range(n):
        fine = variance[x] * square
        spread[x] = spread[x] * fine / (spread[x] + fine)


@leaf_kernel
def search_tile(
    n: int,
    periods: Array,
    turns: Array,
    variance: Array,
    low: float,
    high: float,
    coord: Array,
    spread: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> None:
    """As sequential_tile, from every order of the coarsest period that puts it into [low, high]."""
    coarse = float(periods[0])
    for x in range(n):
        best, second_sum = np.inf, 0.0
        best_coord, best_spread, best_doubt = np.nan, np.inf, 0.0
        at = float(turns[0, x])
        beyond = min(3 * coarse * math.sqrt(float(variance[0, x])), 0.5 * coarse)
        first = math.ceil((low - beyond) / coarse - at)
        last = math.floor((high + beyond) / coarse - at)
        for order in range(first, last + 1):
            here = coarse * (at + order)
            here_spread = float(variance[0, x]) * coarse * coarse
            chi, doubt = 0.0, 0.0
            for g in range(1, len(periods)):
                period = float(periods[g])
                at_g = float(turns[g, x])
                fine_spread = float(variance[g, x]) * period * period
                both = here_spread + fine_spread
                step = period * (at_g + np.rint(here / period - at_g)) - here
                chi += step * step / both
                if chi > best + _CERTAIN:
                    break
                if period * (period - 2 * abs(step)) / both < _CERTAIN:
                    doubt += _doubt(period, abs(step), both)
                alone = MUCH_FINER * period < periods[g - 1]
                here += step if alone else here_spread / both * step
                here_spread = fine_spread if alone else here_spread / both * fine_spread
            if chi < best:
                worse = math.exp(max(-0.5 * (best - chi), -100.0)) if best < np.inf else 0.0
                second_sum = (1 + second_sum) * worse
                best, best_coord, best_spread, best_doubt = chi, here, here_spread, doubt
            elif chi < best + _CERTAIN:
                second_sum += math.exp(-0.5 * (chi - best))
        coord[x] = best_coord
        spread[x] = best_spread
        misfit[x] += best
        gap[x] = 0
        order_error[x] += second_sum / (1 + second_sum) + best_doubt
