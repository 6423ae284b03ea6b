"""Large arrays on whole huge pages: memory that is written once costs as much as writing it does."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["roomy_empty"]

#: A huge page of the usual systems, bytes.
_PAGE = 1 << 21


def roomy_empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """np.empty; of one huge page or more: its pages are its own from the first to the last byte.

    NumPy asks for huge pages, but the ends of an array share theirs with others, and what does not fill a
    huge page the system fetches and clears by 4 KiB: for maps of 2 Mpx that took twice as long as all the
    rest of their memory. The room beside the array is never touched, so that it takes no memory.
    """
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if size < _PAGE:
        return np.empty(shape, kind)
    room = np.empty(size + 2 * _PAGE, np.uint8)
    start = -room.ctypes.data % _PAGE
    return room[start : start + size].view(kind).reshape(shape)
