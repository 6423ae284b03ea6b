"""Fringe orders from coarse to fine: a coordinate that is known roughly chooses the order of a finer period.

The rough coordinate x has a variance s^2 (a coarser period), or lies anywhere within half a cell of x (a code).
A period p with phase t and variance p^2 v puts the pixel at p (t + k). With d the distance of the nearest such place
from x, the next one is p - |d| away, so that with q(d) = max(|d| - half, 0)^2 / (s^2 + p^2 v)

    P(order is wrong) = 1 / (1 + exp((q(p - |d|) - q(d)) / 2)),

and q(d) is a misfit with one degree of freedom. Coordinates of several periods are averaged by their variances.
"""

from typing import Any

import numpy as np

from optolever.kernels import exact, inlined, kernel

from .estimate import Estimate
from .phase import Fit

__all__ = ["join_code", "refine_order", "start_order", "vanishing"]

_ONE, _TWO = np.float32(1), np.float32(2)
#: Pixels that are worked on while they are in the first-level cache.
_TILE = 2048


@inlined
def vanishing(x: Any) -> Any:
    """exp(-x) for x >= 0 from above, float32: (1 + x / 256)^-256 is 1.2 times that at x = 10."""
    y = _ONE / (_ONE + x * np.float32(1 / 256))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y


def start_order(fit: Fit, period: float, extent: int, estimate: Estimate) -> None:
    """Coordinates from the coarsest period alone: the place nearest to the middle of the surface."""
    beyond = max(0.0, 1 - period / extent)  # so much of the surface has another order
    _start(
        *(fit.turn.ravel(), fit.variance.ravel(), fit.chi2.ravel(), fit.clipped.ravel()),
        *(np.float32(period), np.float32((extent - 1) / 2), np.float32(beyond)),
        *(estimate.coordinate.ravel(), estimate.variance.ravel(), estimate.error.ravel()),
        *(estimate.chi2.ravel(), estimate.clipped.ravel()),
    )


def refine_order(fit: Fit, period: float, estimate: Estimate) -> None:
    """Coordinates from a finer period, in place."""
    _refine(
        *(fit.turn.ravel(), fit.variance.ravel(), fit.chi2.ravel(), fit.clipped.ravel(), np.float32(period)),
        *(estimate.coordinate.ravel(), estimate.variance.ravel(), estimate.error.ravel()),
        *(estimate.chi2.ravel(), estimate.clipped.ravel()),
    )


def join_code(fit: Fit, period: float, code: Estimate, cell: float, estimate: Estimate) -> None:
    """Coordinates from a period whose order a code of cells (pattern pixels) tells.

    code: coordinate of the cell's centre, variance beyond the cell's own.
    """
    _join(
        *(fit.turn.ravel(), fit.variance.ravel(), fit.chi2.ravel(), fit.clipped.ravel()),
        *(np.float32(period), np.float32(cell / 2)),
        *(code.coordinate.ravel(), code.variance.ravel(), code.error.ravel(), code.chi2.ravel()),
        *(estimate.coordinate.ravel(), estimate.variance.ravel(), estimate.error.ravel()),
        *(estimate.chi2.ravel(), estimate.clipped.ravel()),
    )


@kernel
def _start(
    turn: Any,
    variance: Any,
    chi2: Any,
    clipped: Any,
    period: Any,
    middle: Any,
    beyond: Any,
    place: Any,
    var: Any,
    error: Any,
    misfit: Any,
    saturated: Any,
) -> None:
    per_period, square = _ONE / period, period * period
    for x in range(turn.size):
        place[x] = period * (turn[x] + np.rint(middle * per_period - turn[x]))
    for x in range(turn.size):
        var[x] = square * variance[x]
    error[:] = beyond
    misfit[:] = chi2
    saturated[:] = clipped


@exact
def _refine(
    turn: Any,
    variance: Any,
    chi2: Any,
    clipped: Any,
    period: Any,
    place: Any,
    var: Any,
    error: Any,
    misfit: Any,
    saturated: Any,
) -> None:
    room = np.empty(_TILE, np.float32)
    for begin in range(0, turn.size, _TILE):
        end = min(begin + _TILE, turn.size)
        _refine_tile(
            *(turn[begin:end], variance[begin:end], chi2[begin:end], clipped[begin:end], period),
            *(place[begin:end], var[begin:end], error[begin:end], misfit[begin:end], saturated[begin:end]),
            room[: end - begin],
        )


@kernel
def _refine_tile(
    turn: Any,
    variance: Any,
    chi2: Any,
    clipped: Any,
    period: Any,
    place: Any,
    var: Any,
    error: Any,
    misfit: Any,
    saturated: Any,
    away: Any,
) -> None:
    per_period, square = _ONE / period, period * period
    for x in range(away.size):
        away[x] = period * (turn[x] + np.rint(place[x] * per_period - turn[x])) - place[x]
    for x in range(away.size):
        misfit[x] += chi2[x] + away[x] * away[x] / (square * variance[x] + var[x])
    for x in range(away.size):
        # (p - |d|)^2 - d^2
        gap = period * (period - _TWO * abs(away[x]))
        wrong = vanishing(gap / (_TWO * (square * variance[x] + var[x])))
        wrong = wrong / (_ONE + wrong)
        error[x] += wrong - wrong * error[x]
    for x in range(away.size):
        saturated[x] = max(saturated[x], clipped[x])
    for x in range(away.size):
        place[x] += away[x] * var[x] / (square * variance[x] + var[x])
    for x in range(away.size):
        own = square * variance[x]
        var[x] = own * var[x] / (own + var[x])


@kernel
def _join(
    turn: Any,
    variance: Any,
    chi2: Any,
    clipped: Any,
    period: Any,
    half: Any,
    centre: Any,
    centre_var: Any,
    centre_error: Any,
    centre_chi2: Any,
    place: Any,
    var: Any,
    error: Any,
    misfit: Any,
    saturated: Any,
) -> None:
    per_period, square, zero = _ONE / period, period * period, np.float32(0)
    for x in range(turn.size):
        place[x] = period * (turn[x] + np.rint(centre[x] * per_period - turn[x]))
    for x in range(turn.size):
        var[x] = square * variance[x]
    for x in range(turn.size):
        over = max(abs(place[x] - centre[x]) - half, zero)
        misfit[x] = chi2[x] + centre_chi2[x] + over * over / (var[x] + centre_var[x])
    for x in range(turn.size):
        away = abs(place[x] - centre[x])
        over, other = max(away - half, zero), max(period - away - half, zero)
        gap = max(other * other - over * over, zero)
        wrong = vanishing(gap / (_TWO * (var[x] + centre_var[x])))
        wrong = wrong / (_ONE + wrong)
        error[x] = wrong + centre_error[x] - wrong * centre_error[x]
    saturated[:] = clipped
