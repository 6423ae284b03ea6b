"""Crosstalk that remains of a capture in colour: the mix of its channels is known with a standard deviation.

A share d of another channel's frames adds to a fringe of period P a wave of its own frames: places err by
about d P / 2 pi rms, with a period of the pattern. The factor is that of mixes drawn for three kinds of
sequences.
"""

import numpy as np

from . import Correction, Effect, View

__all__ = ["correct"]

#: Error of a place over leak * period / 2 pi.
_FACTOR = 1.1


def correct(view: View) -> Correction | None:
    """Variance by the leak of the finest fringe; None for grey captures."""
    packing = view.plan.packing
    if packing is None or packing.leak == 0:
        return None
    share = packing.leak
    periods = [axis.fringes[-1].period if axis.fringes else 0.0 for axis in view.plan.axes]
    variance = np.square(_FACTOR * share * np.array(periods) / (2 * np.pi))
    return Correction((Effect("crosstalk", share, float("nan"), "of another channel"),), variance)
