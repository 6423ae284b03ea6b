"""How much of the image the mirror fills."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .records import Flag


def mirror_coverage(flags: NDArray[np.unsignedinteger[Any]]) -> tuple[float, float]:
    """Share of the image (H, W) that the mirror fills, and good share of the mirror (NaN without one).

    The mirror: pixels whose level changes with the patterns, with holes filled, except masked pixels.
    """
    without = Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID
    changing = (flags & without == 0) | (flags & Flag.SATURATED != 0)
    around = np.pad(changing.astype(np.uint8), 1)
    cv2.floodFill(around, None, (0, 0), 2)
    mirror = (around[1:-1, 1:-1] != 2) & (flags & Flag.INVALID == 0)
    good = float((flags == 0)[mirror].mean()) if mirror.any() else math.nan
    return float(mirror.mean()), good
