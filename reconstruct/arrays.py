"""Arrays by what they hold; their shapes stand where they are used."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Floats", "Ints", "Labels", "Mask", "Pair"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
#: Connected components from 1 on, 0 elsewhere.
Labels = NDArray[np.int32]
Pair = tuple[Floats, Floats]
