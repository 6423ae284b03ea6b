"""Noise that pixels have in common: within a row, a column, a frame.

Cameras read by rows and amplify by columns (EMVA 1288 release 4.0); a lamp's flicker gives bands with a
rolling shutter, and frames of unequal light with a global one. A height accumulates common errors along a
line, or over half a fringe, while independent noise averages out. Constraints of a plan do not depend on the
scene: the part of their residuals that follows level and phase belongs to a frame; of the rest, the mean
product of two pixels is their common variance. Lines of equal place share deviations of the display, too: the
smaller estimate of both axes counts.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F64

from ..correspondence import SharedNoise
from ..noise import Sample, regression
from ..plan import Fringe, Plan, constraints
from . import Correction, View

__all__ = ["correct"]

#: Most and fewest pixels; deviations of a chance of 1e-6; squared ones of an outlier, over the median square.
_MOST, _FEWEST, _SURE, _FAR = 4096, 64, 4.9, 16 / 0.455


def correct(view: View) -> Correction | None:
    """None if nothing is significant, or without fringes along both axes."""
    plan, sample = view.plan, view.wide
    fringes = {axis.axis: (*axis.fringes, *axis.singles) for axis in plan.axes}
    if len(fringes) != 2 or not all(fringes.values()):
        return None
    sample = sample.only(slice(None, None, 1 + len(sample.places) // _MOST))
    turns = {name: max(1 / fringe.period for fringe in every) for name, every in fringes.items()}
    shares = {axis.axis: _shares(plan, k, sample) for k, axis in enumerate(plan.axes)}
    rows, cols, _ = np.minimum(shares["u"], shares["v"]).tolist()
    frames = shares["u"][2], shares["v"][2]
    found = SharedNoise(rows, cols, *frames, turns["u"], turns["v"], view.lens, view.lens)
    return Correction((), shared=found) if max(*found[:4], view.lens) > 0 else None


def _shares(plan: Plan, number: int, sample: Sample) -> tuple[float, float, float]:
    """Shares of rows, columns and frames, by the constraints of axis `number`."""
    axis, rows = plan.axes[number], _rows(plan, number, len(sample.levels))
    if not len(rows) or not axis.fringes:
        return 0.0, 0.0, 0.0
    used = (np.abs(rows) > 1e-9).any(axis=0)
    sample = sample.only(np.isfinite(sample.levels[used]).all(axis=0))
    residual = rows[:, used] @ sample.levels[used].astype(np.float64)
    usual = (
        np.flatnonzero(_bulk(residual).all(axis=0)) if residual.shape[1] >= _FEWEST else np.zeros(0, np.int64)
    )
    if len(usual) < _FEWEST:
        return 0.0, 0.0, 0.0
    waves = np.stack([_waves(fringe, sample.levels) for fringe in axis.fringes])  # (F, 7, K)
    # mean levels of several fringes count as one, as their differences are residuals
    level = waves[:, 0].mean(axis=0, keepdims=True)
    light, every = (np.concatenate([level, *(one[1:count] for one in waves)]) for count in (3, 7))
    of_frames, of_lines = _without(residual, light, usual), _without(residual, every, usual)
    kept = _bulk(of_lines)
    square = float(np.square(residual)[kept].sum())
    if square == 0:
        return 0.0, 0.0, 0.0
    # pixels of one level and phase are rounded alike: no more than 1 / 12
    beyond_rounding = 1 - min(float(np.count_nonzero(kept)) / 12 / square, 1.0)
    frames = beyond_rounding - float(np.square(of_frames)[kept].sum()) / square
    chance = (len(light) + _SURE * np.sqrt(2 * len(light))) / residual.shape[1]
    by_row, by_col = (_common(of_lines * kept, line, square) for line in sample.places.T)
    return by_row, by_col, frames if frames > chance else 0.0


@lru_cache(maxsize=16)
def _rows(plan: Plan, number: int, count: int) -> F64:
    """Constraints (M, count) of one axis, if necessary with white and black."""
    alone = replace(plan, axes=plan.axes[number : number + 1])
    groups = constraints(replace(alone, white=-1, black=-1), count) or constraints(alone, count)
    return groups[-1] if groups else np.zeros((0, count))


def _bulk(residual: F64) -> NDArray[np.bool_]:
    """Residuals (M, K) but for outliers of their row."""
    square = np.square(residual)
    return np.asarray(square <= _FAR * np.median(square, axis=1, keepdims=True))


def _waves(fringe: Fringe, levels: NDArray[np.floating]) -> F64:
    """Offset; cosine and sine of one, two and three times the phase, times the amplitude, (7, K)."""
    return np.delete(fringe.harmonics(levels[list(fringe.index)].astype(np.float64)), (0, 2), axis=0)


def _without(residual: F64, waves: F64, usual: NDArray[np.int64]) -> F64:
    """Residuals (M, K) less their regression on waves (W, K) over usual pixels."""
    return np.asarray(residual - regression(waves[:, usual], residual[:, usual], 1e-6) @ waves)


def _common(residual: F64, line: NDArray[np.int64], square: float) -> float:
    """Mean product of residuals (M, K) of two pixels of a line (K,) over the mean square, whose sum is given;
    0 if not significant."""
    count = np.bincount(line).astype(np.float64)
    pairs = max(float((count * (count - 1)).sum()), 1.0)
    sums = np.stack([np.bincount(line, one) for one in residual])
    share = float(np.square(sums).sum() - np.square(residual).sum()) / pairs / (square / line.size)
    return min(share, 1.0) if share > _SURE * np.sqrt(2 / (pairs * len(residual))) else 0.0
