"""Lag: a frame contains a share of the one before, by a slow display or an early exposure.

x_i = (1 - m) I_i + m I_(i-1), x = A(m) I. Combinations C of a fringe's frames that vanish at every place (of
three steps: of the mean levels of several fringes) are C A(m)^-1 x = 0 for the right share m, found by
Gauss-Newton. The fringes' mean level, amplitude and harmonics up to the third are regressed out: a gamma or
a flicker is no lag. The regressor's samples are their fit, whose noise is not that of C x; the rest, by
unequal noise of the levels, is subtracted. Codes without fringes need no correction: a threshold bears it.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from optolever.kernels import F64

from ..plan import Plan, constraints
from . import Correction, Effect, View

__all__ = ["correct", "matrix"]

#: Most pixels of the sample, and fewest; parts of them for the scatter of the share; steps.
_MOST, _FEWEST, _PARTS, _STEPS = 2048, 256, 16, 3
#: Deviations of a chance of 1e-6; largest share that is a lag.
_SURE, _LARGEST = 4.9, 0.5
#: Share of the regressor that the fringes must leave.
_KNOWN = 1e-3


def matrix(found: Effect, count: int) -> F64:
    """(N, N): frames without lag from captured ones; the first frame has none."""
    return np.asarray(np.linalg.inv(_mixture(found.value, count)))


def _mixture(share: float, count: int) -> F64:
    mixed = (1 - share) * np.eye(count) + share * np.eye(count, k=-1)
    mixed[0, 0] = 1.0
    return mixed


def correct(view: View) -> Correction | None:
    """Levels without a share of the frame before; its sigma by the scatter among parts of the image and among
    combinations."""
    plan, count = view.plan, len(view.sample.levels)
    rows = _vanishing(plan, count)
    levels = view.sample.levels[:, np.isfinite(view.sample.levels).all(axis=0)].astype(np.float64)
    levels = levels[:, :: 1 + levels.shape[1] // _MOST]
    if not len(rows) or levels.shape[1] < _FEWEST:
        return None
    share = sigma = 0.0
    for _ in range(_STEPS):
        step, sigma = _step(plan, rows, levels, view.noise.variance(levels), share)
        share += step
        if abs(share) < 0.5 * _SURE * sigma:
            return None
    if not (abs(share) > _SURE * sigma and abs(share) < _LARGEST):
        return None
    found = Effect("lag", share, sigma, "of the frame before")
    return Correction(found, _variance(view, found), matrix(found, count))


@lru_cache(maxsize=16)
def _vanishing(plan: Plan, count: int) -> F64:
    """Orthonormal combinations (M, N) without the first frame, before which another one is unknown."""
    axes = tuple(replace(axis, code=None) for axis in plan.axes)
    rows = constraints(replace(plan, axes=axes, white=-1, black=-1), count)
    return rows[0][np.abs(rows[0][:, 0]) < 1e-9] if rows else np.zeros((0, count))


def _step(plan: Plan, rows: F64, levels: F64, noise: F64, share: float) -> tuple[float, float]:
    """Correction of the share, and its sigma."""
    count = len(levels)
    back = np.linalg.inv(_mixture(share, count))
    change = np.eye(count) - np.eye(count, k=-1)  # of -A, by the share
    change[0, 0] = 0.0
    light, fit = back @ levels, np.eye(count) - rows.T @ rows
    slope = rows @ back @ change @ fit  # of C A^-1 x with the share, from samples without their residuals
    product, square, power = np.zeros((len(rows), _PARTS)), np.zeros((len(rows), _PARTS)), 0.0
    for i, row in enumerate(rows):
        known = _nuisance(plan, row, light)
        both = np.stack([row @ light, slope[i] @ light])
        residual, regressor = both - (both @ known) @ known.T
        chance = ((row @ back) * (slope[i] @ back)) @ noise
        parts = [np.array_split(one, _PARTS) for one in (residual * regressor - chance, regressor**2)]
        product[i], square[i] = ([part.sum() for part in one] for one in parts)
        power += float(np.square(both[1]).sum())
    total = square.sum()
    if total <= _KNOWN * power:
        return 0.0, np.inf
    step = product.sum() / total
    scatter = product - step * square
    several = [scatter.sum(axis=axis) for axis in (0, 1) if scatter.shape[1 - axis] > 1]
    sigma2 = max(float(np.square(one).sum()) * len(one) / (len(one) - 1) for one in several if len(one) > 1)
    return -float(step), sigma2**0.5 / float(total)


def _nuisance(plan: Plan, row: F64, light: F64) -> F64:
    """Orthonormal columns (K, M): one; mean level, amplitude and harmonics of each fringe of a row."""
    columns, mean = [np.ones(light.shape[1])], np.zeros(light.shape[1])
    for fringe in (fringe for axis in plan.axes for fringe in axis.fringes):
        if np.abs(row[list(fringe.index)]).max() > 1e-9:
            _, offset, *waves = fringe.harmonics(light[list(fringe.index)])
            mean += offset  # not each by itself: its difference is what three steps' combinations are
            columns += waves
    return np.asarray(np.linalg.qr(np.stack([*columns, mean], axis=1))[0])


def _variance(view: View, found: Effect) -> F64:
    """px^2 of each axis (A,): sigma of the share times the mean square of the place's change by it."""
    levels = matrix(found, len(view.sample.levels)) @ view.sample.levels.astype(np.float64)
    before = np.concatenate([levels[:1], levels[:-1]]) - levels
    shifts = []
    for axis in view.plan.axes:
        if not axis.fringes:
            shifts.append(0.0)
            continue
        fringe = axis.fringes[-1]
        _, c, s = fringe.inverse @ levels[list(fringe.index)]
        _, dc, ds = fringe.inverse @ before[list(fringe.index)]
        turned = (c * ds - s * dc) / np.maximum(c * c + s * s, 1e-6) / (2 * np.pi) * fringe.period
        shifts.append(float(np.nanmean(np.square(turned))) if np.isfinite(turned).any() else 0.0)
    return found.sigma**2 * np.array(shifts)
