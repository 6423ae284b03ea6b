"""How much of the image the mirror fills."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes

from .records import Flag


def mirror_coverage(flags: NDArray[np.unsignedinteger[Any]]) -> tuple[float, float]:
    """Share of the image (H, W) that the mirror fills, and good share of the mirror (NaN without one).

    The mirror: pixels whose level changes with the patterns, with holes filled, except masked pixels.
    """
    without = Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID
    changing = (flags & without == 0) | (flags & Flag.SATURATED != 0)
    mirror = np.asarray(binary_fill_holes(changing)) & (flags & Flag.INVALID == 0)
    good = float((flags == 0)[mirror].mean()) if mirror.any() else math.nan
    return float(mirror.mean()), good
