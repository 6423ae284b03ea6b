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

from optolever.kernels import exact, kernel

from .estimate import less_likely
from .flags import Into, merge_line
from .frames import Light
from .gray import CodePlan, read_line, room_for
from .noise import Noise
from .phase import Periods, fit_line

__all__ = ["climb"]

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
