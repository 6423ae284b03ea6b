"""Robust solves: edges whose increments do not fit the heights count less, by iterated reweighting.

Cauchy's weight w / (1 + w (r / (2.385 s))^2) of an edge defect r (doi:10.1080/03610927708827533) is that of
an edge in doubt by |r| / (2.385 s): to the variance 1/w the square of the doubt is added. s is the scaled
median of |r| sqrt(w), one for noise as announced.
"""

import math
from collections.abc import Callable

import numpy as np

from ..arrays import Pair

__all__ = ["cauchy", "scaled_median"]

_CAUCHY = 2.385  # deviations at which the weight is one half: 95 % efficiency under Gaussian noise
_STEPS = 30
_ROWS = 256
_CHANCE = 0.01  # of an image without outliers to be reweighted
_SETTLED = 1e-3  # change of the defects' scale, relative


def cauchy(solve: Callable[[Pair | None], Pair], weights: Pair, least: float) -> Pair | None:
    """The doubts (H, W) of edges along columns and rows at which a robust solve ends; None if none is needed.

    solve: edge defects of the solution with such doubts; weights: of the edges without any; least: scale
    below which defects are rounding.
    """
    scale, doubts = 0.0, None
    for _ in range(_STEPS):
        residuals = solve(doubts)
        before, scale = scale, max(scaled_median(residuals, weights), least)
        if abs(before - scale) <= _SETTLED * scale or (doubts is None and _clean(residuals, weights, scale)):
            break
        doubts = np.abs(residuals[0]) / (_CAUCHY * scale), np.abs(residuals[1]) / (_CAUCHY * scale)
    return doubts


def _clean(residuals: Pair, weights: Pair, scale: float) -> bool:
    """Whether no edge exceeds what normal noise reaches by chance: least squares is then the best."""
    largest = max(float((np.abs(r) * np.sqrt(w)).max()) for r, w in zip(residuals, weights, strict=True))
    return largest <= math.sqrt(2 * math.log(2 * residuals[0].size / _CHANCE)) * scale


def scaled_median(residuals: Pair, weights: Pair) -> float:
    """Scaled median of edge values over their standard deviations, from about 256 rows."""
    pairs = [
        (r[:: max(1, len(r) // _ROWS)], w[:: max(1, len(w) // _ROWS)])
        for r, w in zip(residuals, weights, strict=True)
    ]
    sizes = np.concatenate([np.abs(r[w > 0]) * np.sqrt(w[w > 0]) for r, w in pairs])
    return 1.4826 * float(np.median(sizes)) if sizes.size else 0.0
