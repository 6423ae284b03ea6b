"""Arrays by what they hold; their shapes stand where they are used."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Floats", "Ints", "Labels", "Mask", "Pair", "middle", "some_rows"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
#: Connected components from 1 on, 0 elsewhere.
Labels = NDArray[np.int32]
Pair = tuple[Floats, Floats]
_ROWS = 64


def some_rows(image: NDArray[Any]) -> slice:
    """About 64 rows of an image, whose medians stand for those of all."""
    return slice(None, None, max(1, len(image) // _ROWS))


def middle(image: Floats, mask: Mask) -> float:
    """Median of an image's values in the mask, by some rows."""
    rows = some_rows(image)
    some = image[rows][mask[rows]]
    return float(np.median(some if some.size else image[mask]))
