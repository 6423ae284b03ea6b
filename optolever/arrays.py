"""Types of arrays by their content (shapes stand at each use); their norms and medians; memory for large
ones, asked for before they are made.
"""

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = [
    "Cells", "Circle", "Floats", "Frame", "Ints", "Labels", "Map", "Mask", "Pair", "Pixels",
    "free_memory", "middle", "norm", "require_room", "rms", "some_rows",
]  # fmt: skip

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
#: Connected components from 1 on, 0 elsewhere.
Labels = NDArray[np.int32]
#: Of a frame (H, W), and of cells of several of its pixels (R, C).
Pixels = NDArray[np.float32]
Cells = NDArray[np.float32]
Frame = NDArray[Any]
#: Of a camera's cells, of either precision.
Map = NDArray[np.floating[Any]]
Pair = tuple[Floats, Floats]
#: x, y, radius, mm.
Circle = tuple[float, float, float]
_ROWS = 64


def norm(*parts: Any) -> float:
    """Root of the sum of squares."""
    return float(np.linalg.norm(np.asarray(parts, np.float64)))


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def some_rows(image: NDArray[Any]) -> slice:
    """About 64 rows of an image, whose medians stand for those of all."""
    return slice(None, None, max(1, len(image) // _ROWS))


def middle(image: Floats, mask: Mask) -> float:
    """Median of an image's values in the mask, by some rows."""
    rows = some_rows(image)
    some = image[rows][mask[rows]]
    return float(np.median(some if some.size else image[mask]))


def require_room(what: str, size: float) -> None:
    """InputError if so many bytes are more than the machine has left: what for, how many, what there is."""
    there = free_memory()
    if size > there:
        raise InputError(f"{what}: takes {size / 2**30:.3g} GiB of memory, {there / 2**30:.3g} GiB are free")


def free_memory() -> int:
    """Bytes that can be had without swapping; of a system that does not tell, all that it has."""
    with suppress(OSError):
        found = re.search(r"MemAvailable:\s*(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        if found:
            return int(found[1]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
