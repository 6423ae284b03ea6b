"""Arrays by what they hold; their shapes stand where they are used."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Circle", "Floats", "Ints", "Labels", "Map", "Mask"]

Floats = NDArray[np.float64]
#: Of a camera's cells, of either precision.
Map = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int64]
#: x, y, radius, mm.
Circle = tuple[float, float, float]
