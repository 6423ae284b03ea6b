"""Binary code words: the integer whose bits a cell shows, for every code this project knows."""

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from .long_run import long_run_words

__all__ = ["BINARY_CODES", "bits_for", "code_words"]

#: Kinds whose frames show one bit of a code word.
BINARY_CODES = ("binary", "gray", "long-run-gray")

Words = NDArray[np.int64]


def bits_for(cells: int) -> int:
    """Codeword length, in bits, for `cells` distinct cells.

    >>> bits_for(1000)
    10
    """
    return max(1, (cells - 1).bit_length())


def code_words(kind: str, cell: Words, bits: int | None = None) -> Words:
    """Word of each cell (any shape, cell >= 0); bit 0 is the least significant.

    gray      n ^ (n >> 1): neighbours differ in one bit (F. Gray, US patent 2632058)
    long-run-gray  no bit has a narrow stripe; of `bits` bits (default: as many as the largest cell needs), up
              to 16, which is another code for each number of them: see long_run

    >>> import numpy as np
    >>> [int(word) for word in code_words("gray", np.arange(4))]
    [0, 1, 3, 2]
    """
    if kind == "binary":
        return cell
    if kind == "gray":
        return cell ^ (cell >> 1)
    if kind == "long-run-gray":
        return np.asarray(long_run_words(bits or bits_for(int(np.max(cell, initial=0)) + 1))[cell])
    raise InputError(f"code: kind is {kind!r}, known are {', '.join(BINARY_CODES)}")
