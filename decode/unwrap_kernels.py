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

from .jit import apart_kernel, leaf_kernel, pasted_kernel
from .wave_kernels import falling

__all__ = ["CERTAIN", "MUCH_FINER", "UNKNOWN", "doubt_of", "search_tile", "sequential_tile"]

Array = NDArray[Any]

#: Differences of chi squared beyond this are certain: exp(-20) = 2e-9.
CERTAIN = np.float32(40.0)
#: A period so many times coarser than the next only gives the order: it holds less than 1/16 of the
#: information, and its harmonics would weigh in with the ratio.
MUCH_FINER = 4.0
#: Variance (turns^2) of a phase that is not known; finite, so that its weight is 0 and not NaN.
UNKNOWN = 1e20

#: How far beyond [low, high] is not yet outside, pixels: blur and the dark border shift by that much.
_SLACK = 0.5

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)


@leaf_kernel
def sequential_tile(
    n: int,
    periods: Array,
    turns: Array,
    variance: Array,
    guess: Array,
    coord: Array,
    spread: Array,
    near: Array,
    far: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> None:
    """Orders nearest to guess (n,), then to the estimate so far. All float32.

    periods (G,) coarse to fine, turns and variance (G, n). Out (n,): coord and its variance `spread`; misfit
    = chi squared of the periods' agreement (G - 1 degrees of freedom); gap = |coord of the first - guess|;
    order_error = probability that an order is wrong, given the guess. near, far: room for (n,).
    """
    if len(periods) == 1:
        _first_order(n, periods[0], turns[0], variance[0], guess, coord, spread, misfit, gap, order_error)
        return
    blended = MUCH_FINER * periods[1] >= periods[0]
    if _two_orders(
        *(n, periods[0], periods[1], blended, turns[0], variance[0], turns[1], variance[1], guess),
        *(coord, spread, near, far, misfit, gap, order_error),
    ):
        _add_doubt(n, near, far, order_error)
    for g in range(2, len(periods)):
        blended = MUCH_FINER * periods[g] >= periods[g - 1]
        if _next_order(n, periods[g], blended, turns[g], variance[g], coord, spread, near, far, misfit):
            _add_doubt(n, near, far, order_error)


@apart_kernel
def _first_order(
    n: int,
    period: Any,
    turns: Array,
    variance: Array,
    guess: Array,
    coord: Array,
    spread: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> None:
    inverse, square = _ONE / period, period * period
    for x in range(n):
        place = period * (turns[x] + np.rint(guess[x] * inverse - turns[x]))
        coord[x] = place
        gap[x] = abs(place - guess[x])
        spread[x] = variance[x] * square
        misfit[x] = _ZERO
        order_error[x] = _ZERO


@apart_kernel
def _two_orders(
    n: int,
    coarse: Any,
    period: Any,
    blended: bool,
    coarse_turns: Array,
    coarse_variance: Array,
    turns: Array,
    variance: Array,
    guess: Array,
    coord: Array,
    spread: Array,
    near: Array,
    far: Array,
    misfit: Array,
    gap: Array,
    order_error: Array,
) -> bool:
    """_first_order and the first _next_order, without the way through memory between them."""
    slope = _ONE if blended else _ZERO
    inverse, square, twice = _ONE / period, period * period, _TWO * period
    over, close = _ONE / coarse, _ZERO
    for x in range(n):
        place = coarse * (coarse_turns[x] + np.rint(guess[x] * over - coarse_turns[x]))
        before, fine = coarse_variance[x] * (coarse * coarse), variance[x] * square
        step = period * (turns[x] + np.rint(place * inverse - turns[x])) - place
        share = _ONE / (before + fine)
        weight = (_ONE - slope) + slope * (before * share)
        coord[x], spread[x] = place + weight * step, weight * fine
        near[x], far[x] = (square - twice * abs(step)) * share, (square + twice * abs(step)) * share
        misfit[x], gap[x] = step * step * share, abs(place - guess[x])
        order_error[x] = _ZERO
        close += _ONE if near[x] < CERTAIN else _ZERO
    return bool(close > _ZERO)


@apart_kernel
def _next_order(
    n: int,
    period: Any,
    blended: bool,
    turns: Array,
    variance: Array,
    coord: Array,
    spread: Array,
    near: Array,
    far: Array,
    misfit: Array,
) -> bool:
    """Step to the nearest order, all the way or (blended) as far as both variances say.

    near, far = chi squared by which the two orders beside it are worse. True: some are close.
    """
    inverse, square, twice = _ONE / period, period * period, _TWO * period
    start, slope = (_ZERO, _ONE) if blended else (_ONE, _ZERO)
    close = _ZERO
    for x in range(n):
        step = period * (turns[x] + np.rint(coord[x] * inverse - turns[x])) - coord[x]
        fine = variance[x] * square
        share = _ONE / (spread[x] + fine)
        weight = start + slope * (spread[x] * share)
        near[x] = (square - twice * abs(step)) * share
        far[x] = (square + twice * abs(step)) * share
        misfit[x] += step * step * share
        coord[x] += weight * step
        spread[x] = weight * fine
        close += _ONE if near[x] < CERTAIN else _ZERO
    return bool(close > _ZERO)


@apart_kernel
def _add_doubt(n: int, near: Array, far: Array, order_error: Array) -> None:
    """Probability that another order is the right one: both neighbours, from chi squared (flat prior)."""
    for x in range(n):
        order_error[x] += doubt_of(near[x], far[x]) if near[x] < CERTAIN else _ZERO


@pasted_kernel
def doubt_of(near: Any, far: Any) -> Any:
    """Probability that one of the two orders beside is the right one, to 2e-5 of itself; near, far: chi
    squared by which they are worse. Vectors, as where nothing is seen all pixels ask for it."""
    other = falling(_HALF * near) + falling(_HALF * far)
    return other / (_ONE + other)


@leaf_kernel
def _beside(period: float, step: float, both: float) -> float:
    """Probability that an order beside is the right one; both: variance of the step to the nearest one."""
    near = math.exp(-0.5 * period * (period - 2 * step) / both)
    far = math.exp(-0.5 * period * (period + 2 * step) / both)
    return (near + far) / (1 + near + far)


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
    """As sequential_tile, from every order of the coarsest period that puts it into [low, high].

    Of the answers the one with the least chi squared is taken, that of its way out of [low, high] included.
    For two periods this is the most likely one whatever the amplitudes and the density of the phase's error,
    if that is even: where two answers are as likely, their residuals are mirror images.
    """
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
                if chi > best + CERTAIN:
                    break
                if period * (period - 2 * abs(step)) / both < CERTAIN:
                    doubt += _beside(period, abs(step), both)
                alone = MUCH_FINER * period < periods[g - 1]
                here += step if alone else here_spread / both * step
                here_spread = fine_spread if alone else here_spread / both * fine_spread
            # where the range of the periods is the surface, both its ends look alike: outside is less likely
            outside = max(low - _SLACK - here, here - high - _SLACK, 0.0)
            chi += outside * outside / here_spread
            if chi < best:
                worse = math.exp(max(-0.5 * (best - chi), -100.0)) if best < np.inf else 0.0
                second_sum = (1 + second_sum) * worse
                best, best_coord, best_spread, best_doubt = chi, here, here_spread, doubt
            elif chi < best + CERTAIN:
                second_sum += math.exp(-0.5 * (chi - best))
        coord[x] = best_coord
        spread[x] = best_spread
        misfit[x] = best
        gap[x] = 0
        order_error[x] = second_sum / (1 + second_sum) + best_doubt
