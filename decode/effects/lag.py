"""Lag: a frame contains a share of the one before, by a slow display or an early exposure.

x_i = (1 - m) I_i + m I_(i-1), x = A(m) I. Combinations C of a fringe's frames that vanish at every place are
C A(m)^-1 x = 0 for the right share m, found by Gauss-Newton. The fringes' mean level, amplitude and harmonics
up to the third are regressed out: a gamma or a flicker is no lag. The regressor's samples are their fit,
whose noise is not that of C x; the rest, by unequal noise of the levels, is subtracted. Three steps have no
such combinations: phases of two periods must agree, and bits be white or black; bits alone show the share of
the frame before the last one, so a ladder is not corrected. Codes without fringes need no
correction: a threshold bears it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F64

from ..plan import Fringe, Plan, constraints
from . import Correction, Effect, View

__all__ = ["LADDER", "correct", "matrix"]

#: Name of the effect of a ladder of three steps, which is not corrected: its estimate takes the light of all
#: frames before for a share of the last one.
LADDER = "lag of three steps"

#: Most pixels of the sample, and fewest; parts of them for the scatter of the share; steps.
_MOST, _FEWEST, _PARTS, _STEPS = 2048, 256, 16, 3
#: Deviations of a chance of 1e-6; largest share that is a lag.
_SURE, _LARGEST = 4.9, 0.5
#: Effects' units: shares of the frame before, and of the one before that.
_UNITS = ("of the frame before", "of the frame before that")
#: Share of the regressor that the fringes must leave; cycles within which phases of two periods agree; share
#: of the contrast, off the middle, of a bit that is decided.
_KNOWN, _NEAR, _DECIDED = 1e-3, 0.2, 0.25


def matrix(effects: tuple[Effect, ...], plan: Plan) -> F64:
    """(N, N): frames without the lag of a profile's effects from captured ones; the first exposure has
    none."""
    shares = [one.value for one in effects if one.unit in _UNITS]
    return np.asarray(np.linalg.inv(_mixture(np.array(shares), plan)))


def _mixture(shares: F64, plan: Plan) -> F64:
    """(N, N), by shares of the frame before, of the one before that."""
    mixed: F64 = (1 - shares.sum()) * np.eye(len(plan.frames))
    for depth, share in enumerate(shares, 1):
        mixed += share * plan.before(depth)
    return mixed


def correct(view: View) -> Correction | None:
    """Levels without a share of the frame before; its sigma by the scatter among parts of the image and among
    combinations."""
    plan, count = view.plan, len(view.sample.levels)
    rows = _vanishing(plan, count)
    sample = view.sample.only(np.isfinite(view.sample.levels).all(axis=0))
    sample = sample.only(slice(None, None, 1 + len(sample.places) // _MOST))
    several = (axis for axis in plan.axes if axis.fringes[1:] or (axis.fringes and axis.code))
    few = any(len(axis.fringes[-1].index) == 3 for axis in several)
    if not (len(rows) or few) or len(sample.places) < _FEWEST:
        return None
    levels, places = sample.levels.astype(np.float64), view.places(sample) if few else np.zeros((0, 0))
    bits = few and any(axis.code is not None for axis in plan.axes)
    shares, sigma, noise = np.zeros(1 + bits), np.zeros(1 + bits), view.noise.variance(levels)
    for k in range(_STEPS * len(shares)):
        depth = k % len(shares)
        step, sigma[depth] = _step(plan, rows, levels, noise, shares, depth, places)
        shares[depth] += step
        if abs(shares[0]) < 0.5 * _SURE * sigma[0]:
            return None
    sure = np.abs(shares) > _SURE * sigma
    if not (sure[0] and shares.max() < _LARGEST):
        return None
    if any(not axis.code and axis.fringes and len(axis.fringes[-1].index) == 3 for axis in plan.axes):
        return Correction((Effect(LADDER, float(shares[0]), float(sigma[0]), _UNITS[0]),))
    named = zip(("lag", "longer lag"), shares.tolist(), sigma.tolist(), _UNITS, strict=False)
    found = tuple(Effect(*one) for one in named)[: 1 + sure[1:].any()]
    return Correction(found, _variance(view, found), matrix(found, plan))


@lru_cache(maxsize=16)
def _vanishing(plan: Plan, count: int) -> F64:
    """Orthonormal combinations (M, N) without the first exposure, before which another one is unknown."""
    axes = tuple(replace(axis, code=None) for axis in plan.axes)
    rows = constraints(replace(plan, axes=axes, white=-1, black=-1), count)
    first = plan.exposures[0]
    return rows[0][(np.abs(rows[0][:, first]) < 1e-9).all(axis=1)] if rows else np.zeros((0, count))


def _step(
    plan: Plan, rows: F64, levels: F64, noise: F64, shares: F64, depth: int, places: F64
) -> tuple[float, float]:
    """Correction of one of the shares, and its sigma."""
    count = len(levels)
    back = np.linalg.inv(_mixture(shares, plan))
    change = np.eye(count) - plan.before(depth + 1)  # of -A, by the share
    light, fit, moved = back @ levels, np.eye(count) - rows.T @ rows, back @ change
    slope = rows @ moved @ fit  # of C A^-1 x with the share, from samples without their residuals
    found = [
        (row @ light, own @ light, ((row @ back) * (own @ back)) @ noise, _nuisance(plan, row, light))
        for row, own in zip(rows, slope, strict=True)
    ]
    for residual, gradient, known in _three_steps(plan, light, places):
        chance = ((back.T @ gradient) * ((moved @ back).T @ gradient) * noise).sum(axis=0)
        found.append((residual, (gradient * (moved @ light)).sum(axis=0), chance, known))
    product, square, power = np.zeros((len(found), _PARTS)), np.zeros((len(found), _PARTS)), 0.0
    for i, (one, other, chance, known) in enumerate(found):
        both = np.stack([one, other])
        residual, regressor = both - (both @ known) @ known.T
        parts = [np.array_split(of, _PARTS) for of in (residual * regressor - chance, regressor**2)]
        product[i], square[i] = ([part.sum() for part in of] for of in parts)
        power += float(np.square(other).sum())
    total = square.sum()
    if total <= _KNOWN * power:
        return 0.0, np.inf
    step = product.sum() / total
    scatter = product - step * square
    several = [scatter.sum(axis=axis) for axis in (0, 1) if scatter.shape[1 - axis] > 1]
    sigma2 = max(float(np.square(one).sum()) * len(one) / (len(one) - 1) for one in several if len(one) > 1)
    return -float(step), sigma2**0.5 / float(total)


def _three_steps(plan: Plan, light: F64, places: F64) -> Iterator[tuple[F64, F64, F64]]:
    """Of axes of three steps: residual (K,), its gradient (N, K) by the samples, orthonormal nuisance (K, M).

    A coarser phase less the place's, cycles, without harmonics of both; a bit's share of white less 0 or 1,
    without the mean of the bright ones and of the dark. 0 where a place or a bit is in doubt."""
    for axis, place in zip(plan.axes, places, strict=False):
        if not axis.fringes or len(axis.fringes[-1].index) != 3:
            continue
        turn, gradient, waves = _phase(axis.fringes[-1], light)
        order = np.rint(place / axis.fringes[-1].period - turn)
        for fringe in axis.fringes[:-1]:
            ratio, (other, slope, more) = axis.fringes[-1].period / fringe.period, _phase(fringe, light)
            away = other - ratio * (turn + order)
            away -= np.rint(away)
            known = np.abs(away) < _NEAR
            yield (
                np.where(known, away, 0.0),
                (slope - ratio * gradient) * known,
                _basis([known, *waves, *more], known),
            )
        if axis.code is None or min(plan.white, plan.black) < 0:
            continue
        black, span = light[plan.black], np.maximum(light[plan.white] - light[plan.black], 1e-6)
        for i in (int(i) for i in (*axis.code.plain, *axis.code.inverse) if i > 0):
            share = (light[i] - black) / span
            known, bright = np.abs(share - 0.5) > _DECIDED, share > 0.5
            slope = np.zeros_like(light)
            slope[i], slope[plan.black], slope[plan.white] = 1 / span, (share - 1) / span, -share / span
            yield (share - bright) * known, slope * known, _basis([known, bright], known)


def _phase(fringe: Fringe, light: F64) -> tuple[F64, F64, list[F64]]:
    """Phase (K,), cycles; its gradient (N, K); cosines and sines of one to three times the phase."""
    _, c, s = fringe.inverse @ light[list(fringe.index)]
    slope, turn = np.zeros_like(light), np.arctan2(s, c)
    slope[list(fringe.index)] = np.outer(fringe.inverse[2], c) - np.outer(fringe.inverse[1], s)
    waves = [wave(k * turn) for k in (1, 2, 3) for wave in (np.cos, np.sin)]
    return turn / (2 * np.pi), slope / np.maximum(c * c + s * s, 1e-6) / (2 * np.pi), waves


def _basis(columns: Sequence[NDArray[Any]], known: NDArray[np.bool_]) -> F64:
    """Orthonormal columns (K, M), 0 where not known."""
    return np.asarray(np.linalg.qr(np.stack(columns, axis=1) * known[:, None])[0])


def _nuisance(plan: Plan, row: F64, light: F64) -> F64:
    """Orthonormal columns (K, M): one; mean level, amplitude and harmonics of each fringe of a row."""
    columns, mean = [np.ones(light.shape[1])], np.zeros(light.shape[1])
    for fringe in (fringe for axis in plan.axes for fringe in axis.fringes):
        if np.abs(row[list(fringe.index)]).max() > 1e-9:
            _, offset, *waves = fringe.harmonics(light[list(fringe.index)])
            mean += offset  # not each by itself: its difference is what three steps' combinations are
            columns += waves
    return _basis([*columns, mean], np.ones(mean.size, np.bool_))


def _variance(view: View, found: tuple[Effect, ...]) -> F64:
    """px^2 of each axis (A,): sigma of the share times the mean square of the place's change by it."""
    plan, axes = view.plan, view.plan.axes
    light, shifts = matrix(found, plan) @ view.sample.levels.astype(np.float64), np.zeros(len(axes))
    before = plan.before(1) @ light - light
    for k, fringe in ((k, axis.fringes[-1]) for k, axis in enumerate(axes) if axis.fringes):
        turned = (_phase(fringe, light)[1] * before).sum(axis=0) * fringe.period
        shifts[k] = np.nanmean(np.square(turned))
    return np.asarray(found[0].sigma ** 2 * shifts)
