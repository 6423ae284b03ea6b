"""Pixels that nothing is said against, where nearly all around them are flagged: noise let them pass.

What a pixel must reach (contrast, margins of its bits, a place on the pattern) it reaches by chance, too, one
time in so many; the same chance carries its answer away, further than its sigma says. Where most pixels are
refused, those that are not have been chosen by it.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from .correspondence import Flag

__all__ = ["flag_survivors"]

#: Side of the window around a pixel, and good pixels in it, itself included, up to which it is one by chance:
#: a line of them has more, and stays.
_SIDE, _FEW = 5, 4
_SURVIVOR = np.uint16(Flag.OUTLIER)


def flag_survivors(flags: NDArray[np.uint16]) -> None:
    """Flag good pixels (H, W) among refused ones as OUTLIER, in place."""
    # every window holds a row of these, in which a survivor's has flags
    if flags[::_SIDE].max(initial=0) == 0 and flags[-1:].max(initial=0) == 0:
        return
    good = (flags == 0).view(np.uint8)
    around = cv2.boxFilter(good, -1, (_SIDE, _SIDE), normalize=False, borderType=cv2.BORDER_REFLECT_101)
    np.bitwise_or(flags, _SURVIVOR, out=flags, where=(around <= _FEW) & good.view(np.bool_))
