"""The null space of the slope measurement: the change of height that only an anchor determines."""

import numpy as np

from optolever.arrays import Floats
from optolever.scene import Scene, dent, trace

from ..coupled import solved_height
from ..exact import exact_correspondence
from ..solver.edges import edge_weights, factor_increments
from ..solver.poisson import Accuracy, edge_problem

__all__ = ["null_space"]

_ACCURACY = Accuracy(relative=1e-12)


def null_space(scene: Scene) -> Floats:
    """The change of the mirror's height that leaves every measured slope as it is, (H, W): change of z on the
    camera's pixels, of largest value 1.

    Slopes determine the height up to a multiple of it (45-degree prism: in proportion to x, a rotation about
    the edge shared with the pattern). One known height fixes the multiple; an anchor's error scales with the
    mode over its value at the anchor. NaN where the mirror at rest shows no pattern.

    >>> from optolever.scene import load, resize
    >>> mode = null_space(resize(load("prism48"), 60, 80))
    >>> [round(float(part), 2) for part in mode[30, [0, 40, 76]]]
    [1.0, 0.5, 0.04]
    """
    seen = exact_correspondence(trace(scene, dent("flat", scene)), 1.0)
    solution = solved_height(seen, scene, "edge")
    problem, state = solution.problem, solution.state
    data = problem.data
    # the solver's integrating factor is approximate; here it is the result
    edges = edge_problem(*edge_weights(*state.variances, np.ones((1, 1)), data.mask), data.mask)
    _, _, p_w, q_w = data.slopes(state.w)
    fit = edges.solve(*factor_increments(p_w, q_w, data.mask), _ACCURACY)
    factor = np.exp(fit.x - fit.x[problem.labels > 0].max())
    if problem.data.rays.logarithmic:
        factor = factor * np.exp(state.w)
    whole = np.where(problem.labels > 0, factor, np.nan)
    mode = problem.to_image(whole, np.nan) * np.abs(problem.rays.inner_directions[2])
    scaled: Floats = mode / np.nanmax(mode)
    return scaled
