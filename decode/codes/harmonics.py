"""Phase error by a nonlinear response whose harmonics alias with few phase steps.

Light that is a nonlinear function of the cosine has harmonics h_k cos k(phase - d). N equidistant steps alias
those of N - 1 and N + 1 to the fundamental: the phase error is up to h_(N-1) / h_1, a wave with N periods per
turn. Such a wave is not random: a bound b adds b^2 / 3 to a phase's variance.

Four or more steps measure h_2; smooth curves have harmonics that fall off about as powers of it: b is taken
as (N - 2) (h_2 / h_1)^(N - 2). Three steps do not measure h_2, but their mean level deviates from the mean of
white and black: by h_2 for a quadratic curve, and within 1 % for x^2.2.
"""

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Fringe, Plan
from ..profile.noise import Noise, Sample, harmonics, product
from ..profile.unlike import whole

__all__ = ["aliasing_variance"]

F64 = NDArray[np.float64]
#: Fewest pixels for a ratio; deviations from which on it is significant.
_FEWEST, _SURE = 64, 4.0


def aliasing_variance(fringe: Fringe, axis: AxisPlan, plan: Plan, lit: Sample, noise: Noise) -> float:
    """Bound on the variance (radians^2) of a fringe's phase by aliased harmonics."""
    steps = len(fringe.index)
    if (fringe.exposure != 1).any():
        return 0.0
    if steps == 3:
        bound = _off_half_way(fringe, axis, plan, lit, noise)
    else:
        bound = (steps - 2) * _second(fringe, lit, noise) ** (steps - 2)
    return bound**2 / 3


def _second(fringe: Fringe, lit: Sample, noise: Noise) -> float:
    """h_2 / h_1 over the pixels; 0 if not significant."""
    few, rows = whole(lit, fringe.index), fringe.unlike
    if few.levels.shape[1] < _FEWEST:
        return 0.0
    levels = few.levels.astype(np.float64)
    waves = harmonics(fringe, levels)[3:5]
    seen = product(rows, levels[list(fringe.index)])
    of_one = rows @ np.stack([np.cos(2 * fringe.shifts), np.sin(2 * fringe.shifts)], axis=1)
    expected = product(of_one, waves)
    power = float(np.square(expected).sum())
    if power < levels.shape[1]:  # less than a level: no fringe
        return 0.0
    ratio = float((expected * seen).sum()) / power
    chance = float(np.sqrt(np.mean(few.variance(noise)) / power))
    return abs(ratio) if abs(ratio) > _SURE * chance else 0.0


def _off_half_way(fringe: Fringe, axis: AxisPlan, plan: Plan, lit: Sample, noise: Noise) -> float:
    """Deviation of a fringe's mean level from the mean of white and black, or of bit pairs, over its
    amplitude; 0 if not significant, or without such frames."""
    pairs = [] if axis.code is None else list(zip(axis.code.plain, axis.code.inverse, strict=True))
    ends = [pair for pair in (*pairs, (plan.white, plan.black)) if min(pair) >= 0]
    if not ends:
        return 0.0
    few = whole(lit, [*fringe.index, *np.ravel(ends)])
    if few.levels.shape[1] < _FEWEST:
        return 0.0
    levels = few.levels.astype(np.float64)
    offset, c, s = product(fringe.inverse, levels[list(fringe.index)])
    half = np.mean([levels[list(pair)].mean(axis=0) for pair in ends], axis=0)
    power = np.maximum(c * c + s * s, 1.0)
    ratio = (offset - half) / np.sqrt(power)
    chance = np.sqrt(np.median(few.variance(noise) / power) / len(ratio))
    found = float(abs(np.median(ratio)))
    return found if found > _SURE * float(chance) else 0.0
