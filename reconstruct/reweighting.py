"""Robust solve: edges whose increments do not fit the heights count less, by iterated reweighting.

Cauchy's weight w / (1 + w (r / (2.385 s))^2) of an edge defect r (doi:10.1080/03610927708827533) is that of
an edge in doubt by |r| / (2.385 s): to the variance 1/w the square of the doubt is added. s is the scaled
of |r| sqrt(w), one for noise as announced.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .edges import Doubt, defects, edge_weights
from .newton import Options, State, solve
from .problem import Problem

__all__ = ["reweighted"]

Floats = NDArray[np.float64]

_ONE = np.ones((1, 1))
_CAUCHY = 2.385  # deviations at which the weight is one half: 95 % efficiency under Gaussian noise
_STEPS = 10
_SETTLED = 1e-2  # change of the defects' scale, relative
_LEAST = 0.1  # of an edge's standard deviation: data better than announced need no steeper weights


def reweighted(problem: Problem, state: State, options: Options) -> State:
    """The solution with defects down-weighted; its weights stay with it, its doubt is not kept."""
    data, scale = problem.data, 0.0
    doubt: Doubt | None = None
    once = replace(options, max_steps=1)
    wx, wy = edge_weights(*state.variances, _ONE, data.mask)
    for _ in range(_STEPS):
        p, q = data.slopes(state.w)[:2]
        rx, ry = defects(p, q, state.w, _ONE, data.mask)
        before, scale = scale, max(_scale(((rx, wx), (ry, wy))), _LEAST)
        if abs(before - scale) <= _SETTLED * scale:
            break
        doubt = Doubt(np.abs(rx) / (_CAUCHY * scale), np.abs(ry) / (_CAUCHY * scale))
        state = solve(data, problem.samples, problem.labels, state.w, once, doubt)
    if doubt is not None:
        state = solve(data, problem.samples, problem.labels, state.w, options, doubt)
    return replace(state, doubt=None)


def _scale(pairs: tuple[tuple[Floats, Floats], ...]) -> float:
    """Scaled median of the defects over their standard deviations."""
    sizes = np.concatenate([np.abs(r[w > 0]) * np.sqrt(w[w > 0]) for r, w in pairs])
    return 1.4826 * float(np.median(sizes)) if sizes.size else 0.0
