"""Compiled unwrapping: phases of several periods (and a code's cell) -> coordinate, variance, order error.

`sequential_tile` takes the periods from coarse to fine: each one's fringe order is the one nearest to what is
known so far, and each adds its information (a Kalman filter whose observations are known up to a period).
`search_tile` does the same from every order of the coarsest period and keeps the most probable start, for
periods that are unambiguous only together (heterodyne, number-theoretic, any rational ratio).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, kernel

__all__ = ["MUCH_FINER", "search_tile", "sequential_tile"]

Array = NDArray[Any]

#: Differences of chi squared beyond this are certain: exp(-20) = 2e-9.
_CERTAIN = 40.0
#: A period so many times coarser than the next only gives the order: it holds less than 1/16 of the
#: information, and its harmonics would weigh in with the ratio.
MUCH_FINER = 4.0


@fast_kernel
def sequential_tile(
    n: int,
    periods: Array,
    turns: Array,
    variance: Array,
    guess: Array,
    coord: Array,
    spread: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> None:
    """Orders nearest to guess (n,), then to the estimate so far.

    periods (G,) coarse to fine, turns and variance (G, n). Out (n,): coord and its variance `spread`; misfit
    += chi squared of the periods' agreement (G - 1 degrees of freedom); gap = |coord of the first - guess|;
    order_error += probability that an order is wrong, given the guess.
    """
    period = periods[0]
    for x in range(n):
        start = np.float64(guess[x])
        at = turns[0, x] * 1.0
        coord[x] = period * (at + np.rint(start / period - at))
        spread[x] = variance[0, x] * (period * period)
        gap[x] = abs(coord[x] - start)
    for g in range(1, len(periods)):
        period = periods[g]
        alone = MUCH_FINER * period < periods[g - 1]
        for x in range(n):
            at = turns[g, x] * 1.0
            fine = period * (at + np.rint(coord[x] / period - at))
            fine_spread = variance[g, x] * (period * period)
            both = spread[x] + fine_spread
            step = fine - coord[x]
            misfit[x] += step * step / both
            gain = 1.0 if alone else (spread[x] / both if both < np.inf else 0.0)
            margin = period * (period - 2 * abs(step)) / both
            if margin < _CERTAIN:
                order_error[x] += _doubt(margin, period, abs(step), both)
            coord[x] += gain * step
            spread[x] = gain * fine_spread if both < np.inf else np.inf


@kernel
def _doubt(margin: float, period: float, step: float, both: float) -> float:
    """Probability that another order is the right one: both neighbours, from chi squared (flat prior)."""
    other = period * (period + 2 * step) / both
    rest = np.exp(-0.5 * margin) + np.exp(-0.5 * other)
    return float(rest / (1 + rest))


@kernel
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
    coarse = periods[0]
    for x in range(n):
        best, second_sum = np.inf, 0.0
        best_coord, best_spread, best_doubt = np.nan, np.inf, 0.0
        at = np.float64(turns[0, x])
        margin = 3 * coarse * np.sqrt(np.float64(variance[0, x]))
        first = np.ceil((low - min(margin, 0.5 * coarse)) / coarse - at)
        last = np.floor((high + min(margin, 0.5 * coarse)) / coarse - at)
        order = first
        while order <= last:
            here = coarse * (at + order)
            here_spread = np.float64(variance[0, x]) * coarse * coarse
            chi, doubt = 0.0, 0.0
            for g in range(1, len(periods)):
                period = periods[g]
                at_g = np.float64(turns[g, x])
                fine_spread = np.float64(variance[g, x]) * period * period
                both = here_spread + fine_spread
                step = period * (at_g + np.rint(here / period - at_g)) - here
                chi += step * step / both
                closeness = period * (period - 2 * abs(step)) / both
                if closeness < _CERTAIN:
                    doubt += _doubt(closeness, period, abs(step), both)
                weight = here_spread / both if both < np.inf else 0.0
                if MUCH_FINER * period < periods[g - 1]:
                    weight = 1.0
                here += weight * step
                here_spread = weight * fine_spread if both < np.inf else np.inf
                if chi > best + _CERTAIN:
                    break
            order += 1
            if chi < best:
                second_sum = (
                    (1 + second_sum) * np.exp(max(-0.5 * (best - chi), -100.0)) if best < np.inf else 0.0
                )
                best, best_coord, best_spread, best_doubt = chi, here, here_spread, doubt
            elif chi < best + _CERTAIN:
                second_sum += np.exp(-0.5 * (chi - best))
        coord[x] = best_coord
        spread[x] = best_spread
        misfit[x] += best
        gap[x] = 0
        order_error[x] += second_sum / (1 + second_sum) + best_doubt
