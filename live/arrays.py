"""Names of arrays by their shapes: pixels of a frame (H, W), cells of several pixels (R, C)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells", "Float", "Frame", "Labels", "Mask", "Pixels"]

Pixels = NDArray[np.float32]
Cells = NDArray[np.float32]
Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Frame = NDArray[Any]
Labels = NDArray[np.int64]
