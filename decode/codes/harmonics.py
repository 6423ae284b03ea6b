"""What a display's or a camera's curve does to a phase that few steps cannot see.

Light that is a curve of the cosine has harmonics h_k cos k(phase - d). N even steps read those of N - 1 and
N + 1 as the fringe itself: the phase is off by up to h_(N-1) / h_1, as a wave of N to a turn. Such a wave is
no noise: an error b at most adds b^2 / 3 to a phase's variance.

Four steps or more show h_2; smooth curves have harmonics that fall off about as powers of it: b is taken to
be (N - 2) (h_2 / h_1)^(N - 2). Three steps show none, but their mean level is not half way between white and
black: by h_2 for a quadratic curve, and within 1 % for x^2.2.
"""

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Fringe, Plan
from ..profile.noise import Noise, Sample, harmonics, product
from ..profile.unlike import whole

__all__ = ["aliasing_variance"]

F64 = NDArray[np.float64]
#: Pixels that tell a ratio; deviations by which one is told from none.
_FEWEST, _SURE = 64, 4.0


def aliasing_variance(fringe: Fringe, axis: AxisPlan, plan: Plan, lit: Sample, noise: Noise) -> float:
    """Variance (radians^2) of a fringe's phase by the harmonics that its steps may hide."""
    steps = len(fringe.index)
    if (fringe.exposure != 1).any():
        return 0.0
    if steps == 3:
        bound = _off_half_way(fringe, axis, plan, lit, noise)
    else:
        bound = (steps - 2) * _second(fringe, lit, noise) ** (steps - 2)
    return bound**2 / 3


def _second(fringe: Fringe, lit: Sample, noise: Noise) -> float:
    """h_2 / h_1 as far as it is sure, of most pixels."""
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
    """How far a fringe's mean level is from half way between white and black, over its amplitude, as far as
    that is sure; 0 where nothing shows what is half way."""
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
