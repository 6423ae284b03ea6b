"""Arrays by their content (shapes stand where they are used), norm and root mean square."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Circle", "Floats", "Ints", "Labels", "Map", "Mask", "norm", "rms"]

Floats = NDArray[np.float64]
#: Of a camera's cells, of either precision.
Map = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int64]
#: x, y, radius, mm.
Circle = tuple[float, float, float]


def norm(*parts: Any) -> float:
    """Root of the sum of squares."""
    return float(np.linalg.norm(np.asarray(parts, np.float64)))


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
