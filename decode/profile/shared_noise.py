"""Noise that pixels have in common: within a row, a column, a frame.

Cameras read by rows and amplify by columns (EMVA 1288 release 4.0, row and column noise); a lamp's flicker
gives bands with a rolling shutter, and frames of unequal light with a global one. A height accumulates common
errors along a line, or over half a fringe, while independent noise averages out. Constraints of a plan are
independent of the scene: the part of their residuals that follows level and phase belongs to a frame, and of
the rest the mean product of two pixels is their common variance. Deviations of the display from the
description cause residuals, too, which lines of equal place share: the axis that varies along the line is
affected least, so that the smaller estimate of both axes is used.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..correspondence import SharedNoise
from ..plan import AxisPlan, Plan, constraints
from .moved import Moved, Seen, frames_moved
from .noise import Sample, bulk, harmonics, product, unexplained, unsaturated

__all__ = ["shared_noise"]

F32 = NDArray[np.float32]
#: Largest number of pixels; deviations of chance from which on a share is significant.
_MOST, _SURE = 4096, 3.0
#: Fewest pixels for a variance (18 %).
_FEWEST = 64
#: Pixels in the regression of residuals on level and phase.
_ASKED = 1024
#: Number of waves (see noise.harmonics) for level and phase: light or gain of one frame changes them.
_LIGHT = 3


def shared_noise(
    plan: Plan, lit: Sample, seen: dict[str, Seen], unsure: dict[str, float]
) -> SharedNoise | None:
    """None if no share is significant, or without fringes. unsure: deviation of residual pixelation common to
    neighbours, pattern px, by axis."""
    thin = max(1, lit.levels.shape[1] // _MOST)
    some = lit.only(slice(None, None, thin))
    fringes = {axis.axis: (*axis.fringes, *axis.singles) for axis in plan.axes}
    if len(fringes) != 2 or not all(fringes.values()) or len(some.places) < 2:
        return None
    turns = {name: max(1 / fringe.period for fringe in every) for name, every in fringes.items()}
    shares = {axis.axis: _shares(plan, axis, some) for axis in plan.axes}
    rows, cols, _ = np.minimum(shares["u"], shares["v"]).tolist()
    # residuals by motion of frames are not noise
    still = {name: Moved(0.0, share) for name, (_, _, share) in shares.items()}
    moved = still | frames_moved(plan, lit, seen)
    u, v = moved["u"], moved["v"]
    shift_u, shift_v = math.hypot(u.shift, unsure["u"]), math.hypot(v.shift, unsure["v"])
    found = SharedNoise(rows, cols, u.gains, v.gains, turns["u"], turns["v"], shift_u, shift_v)
    return found if max(*found[:4], *found[6:]) > 0 else None


def _shares(plan: Plan, axis: AxisPlan, sample: Sample) -> tuple[float, float, float]:
    """Shares of rows, of columns and of frames, from one axis' constraints, if necessary with white and
    black; 0 without any."""
    alone, count = replace(plan, axes=(axis,)), len(sample.levels)
    groups = constraints(replace(alone, white=-1, black=-1), count) or constraints(alone, count)
    if not groups:
        return 0.0, 0.0, 0.0
    tests = groups[-1].astype(np.float32)
    sample = sample.only(unsaturated(tests, sample.levels, sample.white).all(axis=0))
    residual = product(tests, sample.levels)
    if residual.shape[1] < _FEWEST or not axis.fringes:
        return 0.0, 0.0, 0.0
    waves = np.stack([harmonics(one, sample.levels) for one in axis.fringes], axis=1)
    # mean levels of several fringes count as one, as their differences are residuals
    level, usual = waves[0].mean(axis=0, keepdims=True), np.flatnonzero(bulk(residual).all(axis=0))
    usual = usual[:: max(1, len(usual) // _ASKED)]
    of_frames, of_lines = (
        unexplained(residual, np.concatenate([level, *waves[1:count]]), usual) for count in (_LIGHT, None)
    )
    kept = bulk(of_lines)
    square = float(np.square(residual)[kept].sum())
    if square == 0:
        return 0.0, 0.0, 0.0
    frames = 1 - float(np.square(of_frames)[kept].sum()) / square
    chance = (_LIGHT + _SURE * np.sqrt(2 * _LIGHT)) / residual.shape[1]
    rows, cols = (_shared(of_lines * kept, line, square) for line in sample.places.T)
    return rows, cols, frames if frames > chance else 0.0


def _shared(residual: F32, line: NDArray[np.int64], square: float) -> float:
    """Mean product of residuals (M, K) of two pixels of a line (K,), over the mean square, which has the sum
    `square`; 0 if not significant."""
    count = np.bincount(line).astype(np.float64)
    pairs = float((count * (count - 1)).sum())
    sums = np.stack([np.bincount(line, one) for one in residual])
    both = float(np.square(sums).sum() - np.square(residual, dtype=np.float64).sum())
    share = both / max(pairs, 1.0) / (square / line.size)
    return min(share, 1.0) if share > _SURE * np.sqrt(2 / (max(pairs, 1.0) * len(residual))) else 0.0
