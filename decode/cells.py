"""The display's cells: read through a footprint smaller than a cell, a fringe carries stairs."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["add_cell_term"]


def add_cell_term(
    coord: NDArray[Any], sigma: NDArray[Any], flags: NDArray[np.uint16], blur_px: float | None
) -> None:
    """Placeholder."""
