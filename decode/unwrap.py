"""Fringe orders from coarse to fine: a coordinate that is known roughly chooses the order of a finer period.

The rough coordinate x has a variance s^2 (a coarser period), or lies anywhere within half a cell of x (a
code). A period p with phase t and variance p^2 v puts the pixel at p (t + k). With d the distance of the
nearest such place from x, the next one is p - |d| away, so that with
q(d) = max(|d| - half, 0)^2 / (s^2 + p^2 v)

    P(order is wrong) = 1 / (1 + exp((q(p - |d|) - q(d)) / 2)),

and q(d) is a misfit with one degree of freedom. The finer period's place stands: a coarser one would add
little to its precision and all of what is wrong with its grey values.
"""

from typing import Any

import numpy as np

from optolever.kernels import inlined, kernel

from .estimate import Estimate
from .phase import Fit

__all__ = ["join_code", "refine_order", "start_order", "vanishing"]

_ONE, _HALF = np.float32(1), np.float32(0.5)


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
    order, square = middle / period, period * period
    for x in range(turn.size):
        place[x] = period * (turn[x] + np.rint(order - turn[x]))
        var[x] = square * variance[x]
        error[x] = beyond
        misfit[x] = chi2[x]
        saturated[x] = clipped[x]


@kernel
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
    per_period, square = _ONE / period, period * period
    for x in range(turn.size):
        rough, own = place[x], square * variance[x]
        away = period * (turn[x] + np.rint(rough * per_period - turn[x])) - rough
        inverse = _ONE / (own + var[x])
        # ((p - |d|)^2 - d^2) / 2
        wrong = vanishing(period * (_HALF * period - abs(away)) * inverse)
        wrong = wrong / (_ONE + wrong)
        error[x] += wrong - wrong * error[x]
        misfit[x] += chi2[x] + away * away * inverse
        saturated[x] += clipped[x]
        place[x] = rough + away
        var[x] = own


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
        new = period * (turn[x] + np.rint(centre[x] * per_period - turn[x]))
        own = square * variance[x]
        inverse = _ONE / (own + centre_var[x])
        away = abs(new - centre[x])
        over, other = max(away - half, zero), max(period - away - half, zero)
        wrong = vanishing(_HALF * max(other * other - over * over, zero) * inverse)
        wrong = wrong / (_ONE + wrong)
        error[x] = wrong + centre_error[x] - wrong * centre_error[x]
        misfit[x] = chi2[x] + centre_chi2[x] + over * over * inverse
        saturated[x] = clipped[x]
        place[x] = new
        var[x] = own
