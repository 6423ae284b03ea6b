"""The first solution of a measurement: what cannot be solved is left out."""

from dataclasses import replace

import numpy as np

from optolever.decode import Correspondence
from optolever.scene import Scene

from .arrays import Mask
from .judgement.holes import whole_lines
from .problem import Problem, on_pixels, prepare
from .solver.anchors import Anchors
from .solver.newton import State, missed, solve

__all__ = ["first_solution"]

_ATTEMPTS = 3  # each without the pixels that have no normal at the last solution
#: Of w's change over a pixel: slopes that a wrong scene, any error, amplifies.
_SENSITIVE, _UNSTABLE = 0.25, 1.0
_MISSED = 5.0  # standard deviations of an edge


def first_solution(
    correspondence: Correspondence, scene: Scene, anchor: Anchors = None, mask: Mask | None = None
) -> tuple[Problem, State]:
    """The problem and its solution, without a look at outliers and discontinuities.

    Pixels that cannot be solved with the mirror at rest are excluded first, then those that cannot at the
    solution. If Newton's method does not converge, so are pixels close to the pattern with a large edge
    defect: in a scene that is slightly wrong they lie beyond the pattern.
    """
    singular = np.zeros(correspondence.u.shape, dtype=np.bool_)
    grid = prepare(correspondence, scene, anchor, mask)
    for _ in range(_ATTEMPTS):
        problem = on_pixels(grid, singular)
        data = problem.data
        state = solve(data, problem.samples, problem.labels, data.rest(), variances=problem.variances)
        hollow = data.singular(state.w, usual=problem.usual)[0]
        if not state.converged:
            limit = _UNSTABLE if hollow.any() else _SENSITIVE
            beside = data.sensitive(state.w, limit) | data.sensitive(data.rest(), limit)
            hollow = whole_lines(hollow | (beside & missed(data, state, _MISSED)))
        singular |= problem.to_image(hollow, False)
        problem = replace(problem, singular=problem.singular | (singular & problem.valid))
        if not hollow.any():
            break
    return problem, state
