"""The correspondence that a perfect decoder would give."""

import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.scene import Trace

__all__ = ["exact_correspondence"]


def exact_correspondence(truth: Trace, sigma: float = 0.01) -> Correspondence:
    """Where every pixel truly looks, (H, W), with one stated sigma (px), flagged where it sees no pattern."""
    stated = np.full(truth.u.shape, sigma)
    flags = np.where(truth.visible, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
    return Correspondence(truth.u, truth.v, stated, stated.copy(), flags)
