"""A goal for the heights of a scene: the share expected within it, fixed sequences that meet it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from optolever.errors import InputError
from optolever.patterns import Sequence

from .candidates import LEAST_STEPS, Candidate, candidates
from .prediction import predict
from .sensitivity import Lever
from .view import Floats, Mask, View

__all__ = ["Goal", "Offer", "expected_share", "offers", "share_within"]


@dataclass(frozen=True, slots=True)
class Goal:
    """height: mm that the error may have; share: of the pixels that see the pattern, which must be within;
    frames: most to show."""

    height: float
    share: float = 0.95
    frames: int = 80


def share_within(sigma: Floats, measured: Mask, seen: Mask, goal: float, bias: Floats | float = 0.0) -> float:
    """Expected share of the `seen` pixels that are measured and within the goal; bias: known errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        above, below = ((goal + sign * bias) / (math.sqrt(2) * sigma) for sign in (1, -1))
        each = np.where(measured, 0.5 * (erf(above) + erf(below)), 0.0)
    return float(np.nan_to_num(each)[seen].mean()) if seen.any() else 0.0


def expected_share(view: View, unit: Floats, sequence: Sequence, noise: float, goal: Goal) -> float:
    """Share of a view's usable pixels whose height is expected within the goal; unit: rms errors of the
    height (mm) where those of the decoder are one cell, with which they grow."""
    try:
        drawn = predict(view, sequence, noise)
    except InputError:
        return 0.0
    return share_within(drawn.rms * unit, drawn.good[0], view.usable, goal.height)


@dataclass(frozen=True)
class Offer:
    """What a number of frames has to offer: candidates with their least predicted share, best first, none
    under what was asked for; looked_at: sequences among which they were found."""

    frames: int
    best: list[tuple[float, Candidate]]
    looked_at: int


def offers(levers: list[Lever], noise: float, goal: Goal, need: float) -> Iterator[Offer]:
    """From the fewest frames on: what is predicted to bring a share of at least `need` everywhere."""
    pattern = levers[0].scene.pattern
    order = list(levers)  # the hardest first
    for count in range(4 * LEAST_STEPS, goal.frames + 1):
        offered = [one for one in candidates(pattern.rows, pattern.cols, count) if len(one.sequence) == count]
        predicted = [(_least(order, one.sequence, noise, goal, need), one) for one in offered]
        best = sorted((one for one in predicted if one[0] >= need), key=lambda one: -one[0])
        yield Offer(count, best, len(offered))


def _least(order: list[Lever], sequence: Sequence, noise: float, goal: Goal, need: float) -> float:
    """Least predicted share; where it is under `need`, of those up to there, which then comes first."""
    least = 1.0
    for lever in tuple(order):
        least = min(least, expected_share(lever.view, lever.unit_sigma, sequence, noise, goal))
        if least < need:
            order.remove(lever)
            order.insert(0, lever)
            break
    return least
