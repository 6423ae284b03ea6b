"""Stripes of a display in colour that are not those stated: fringes are drawn for their places, bits not.

A bit's edges lie at the stripes of its channel, s cells from the edges of cells. By fringes that are drawn
for other stripes they are a third of a cell or two thirds elsewhere, in all pixels.
"""

import numpy as np

from optolever.patterns import STRIPES

from . import Correction, Effect, View
from .motion import edges_of, smooth_places

__all__ = ["NAME", "correct"]

NAME = "stripes"
#: Cells, half a third, and fewest pixels at edges of a bit.
_APART, _FEWEST = 1 / 6, 64


def correct(view: View) -> Correction | None:
    """Variance of u where the median of bits against fringes is off by more than half a stripe."""
    plan, number = view.plan, next((k for k, axis in enumerate(view.plan.axes) if axis.axis == "u"), -1)
    if plan.packing is None or plan.packing.stripes == "unknown" or number < 0 or not len(view.wide.places):
        return None
    view = view._replace(sample=view.wide)
    edges = edges_of(view, plan.axes[number], smooth_places(view, view.places(view.wide)[number]))
    if edges is None:
        return None
    stated, off = STRIPES[plan.packing.stripes], []
    for bit, index in enumerate(edges.frames):
        own = edges.bit == bit
        channels = np.nonzero((plan.exposures == index).any(axis=0))[0]
        if np.count_nonzero(own) >= _FEWEST and len(channels) == 1:
            off.append(float(np.median(edges.away[own])) - stated[channels[0]])
    apart = float(np.median(off)) if off else 0.0
    if abs(apart) < _APART:
        return None
    variance = np.zeros(len(plan.axes))
    variance[number] = apart**2
    return Correction((Effect(NAME, apart, float("nan"), "cells"),), variance)
