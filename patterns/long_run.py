"""Gray codes whose bits change as seldom as possible: no stripe is narrow, so that blur spares all of them.

In the reflected Gray code the last bit has stripes of two cells, and it is the first that defocus or a large
pixel wipes out. Codes with long bit runs (L. Goddyn, P. Gvozdjak, "Binary gray codes with long bit runs",
Electron. J. Combin. 10, R27, 2003; used in imaging by M. Gupta et al., IJCV 102, 2013,
doi:10.1007/s11263-012-0554-3) spread the changes evenly over the bits. Here, as there, large codes are woven
of two small ones: two cyclic codes advance in turns, in a periodic word of steps that visits every pair of
their states once.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["MOST_BITS", "long_run_words"]

#: Bit that changes at each step of a cyclic code, found by search with no bit again within 2, 2, 4, 4 steps.
_SMALL = {
    1: "00",
    2: "0101",
    3: "02010201",
    4: "2021020310120103",
    5: "20143024102430142014302410243014",
    6: "2451203420312451243154215401253120315421503125312431253425312401",
}
#: bits: (bits of the two codes, length of the word of steps, steps of the first in it), found by trying all.
_WOVEN = {
    7: (5, 2, 4, 3),
    8: (5, 3, 8, 5),
    9: (5, 4, 16, 11),
    10: (5, 5, 32, 15),
    11: (6, 5, 32, 15),
    12: (6, 6, 64, 29),
    13: (8, 5, 32, 17),
    14: (8, 6, 64, 33),
    15: (10, 5, 32, 21),
    16: (10, 6, 64, 39),
}
MOST_BITS = max(_WOVEN)


@cache
def long_run_words(bits: int) -> NDArray[np.int64]:
    """Words of cells 0 .. 2^bits - 1; neighbours differ in one bit."""
    changes = _changes(bits)
    words = np.concatenate([[0], np.bitwise_xor.accumulate(1 << changes[:-1])])
    words.setflags(write=False)
    return words


@cache
def _changes(bits: int) -> NDArray[np.int64]:
    """Bit that changes at each of the 2^bits steps of the cyclic code."""
    if bits in _SMALL:
        return np.array([int(digit) for digit in _SMALL[bits]], np.int64)
    if bits not in _WOVEN:
        raise InputError(f"code: long-run-gray has {bits} bits, must have 1..{MOST_BITS} (coarser cells)")
    first, second, length, share = _WOVEN[bits]
    one, other = _changes(first), first + _changes(second)
    word = np.diff(np.arange(length + 1) * share // length).astype(bool)
    turn = np.resize(word, len(one) * len(other))
    at_one, at_other = np.cumsum(turn) - turn, np.cumsum(~turn) - ~turn
    return np.asarray(np.where(turn, one[at_one % len(one)], other[at_other % len(other)]))
