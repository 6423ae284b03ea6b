"""The change of height that no slope measurement sees: what anchors are for."""

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.scene import Scene, dent, trace

from .coupled import solved_height

__all__ = ["free_mode"]

Floats = NDArray[np.float64]


def free_mode(scene: Scene) -> Floats:
    """How the mirror at rest may move unseen, (H, W): change of z on the camera's pixels, largest value 1.

    Slopes tell the height up to a multiple of it (45-degree prism: in proportion to x, a rotation about the
    edge shared with the pattern). One known height settles the multiple; where the mode is small beside its
    value at the anchor, an anchor's error hurts little. NaN where the mirror at rest shows no pattern.
    """
    seen = trace(scene, dent("flat", scene))
    sigma = np.ones(seen.u.shape)
    flags = np.where(seen.visible, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
    problem, state, _ = solved_height(
        Correspondence(seen.u, seen.v, sigma, sigma.copy(), flags), scene, "edge"
    )
    factor = np.broadcast_to(state.root**2, state.w.shape)
    if problem.outer.rays.logarithmic:
        factor = factor * np.exp(state.w)
    whole = np.full(problem.outer.mask.shape, np.nan)
    whole[problem.core] = np.where(problem.labels > 0, factor, np.nan)
    mode = problem.to_image(whole, np.nan) * np.abs(problem.rays.inner_directions[2])
    scaled: Floats = mode / np.nanmax(mode)
    return scaled
