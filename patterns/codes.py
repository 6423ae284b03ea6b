"""Binary code words: the integer whose bits a cell shows, for every code this project knows."""

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["BINARY_CODES", "bits_for", "code_words"]

#: Kinds whose frames show one bit of a code word.
BINARY_CODES = ("binary", "gray", "xor-gray")

Words = NDArray[np.int64]


def bits_for(cells: int) -> int:
    """Bits that tell `cells` cells apart."""
    return max(1, (cells - 1).bit_length())


def code_words(kind: str, cell: Words) -> Words:
    """Word of each cell (any shape, cell >= 0); bit 0 is the least significant.

    gray      n ^ (n >> 1): neighbours differ in one bit (F. Gray, US patent 2632058)
    xor-gray  Gray bits, all but the last xored with the last: every frame is finely striped, against
              indirect light (Gupta et al., CVPR 2011, doi:10.1109/CVPR.2011.5995321)
    """
    gray = cell ^ (cell >> 1)
    if kind == "binary":
        return cell
    if kind == "gray":
        return gray
    if kind == "xor-gray":
        return gray ^ (-2 * (gray & 1))
    raise InputError(f"code: kind is {kind!r}, known are {', '.join(BINARY_CODES)}")
