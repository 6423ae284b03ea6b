"""How well white and black frames bound the levels of a code's bits."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .plan import Code, Plan

__all__ = ["beyond_references"]

#: Half contrasts by which bits of real displays pass white and black, at least and at most.
_USUAL, _MOST = 0.08, 1.0
_SIDE = 48


def beyond_references(frames: NDArray[Any], wanted: Plan, code: Code) -> float:
    """Half contrasts by which bits shown without their inverse may pass white or black.

    Half as much again as they do on 95 % of the lit pixels: a display whose lamp brightens dark pictures
    passes white everywhere, a flash on single pixels does not.
    """
    single = (code.plain < 0) != (code.inverse < 0)
    if wanted.white < 0 or wanted.black < 0 or not single.any():
        return _USUAL
    _, rows, cols = frames.shape
    at = (slice(None, None, max(1, rows // _SIDE)), slice(None, None, max(1, cols // _SIDE)))
    white, black = (frames[i][at].astype(np.float64).ravel() for i in (wanted.white, wanted.black))
    middle, half = 0.5 * (white + black), 0.5 * (white - black)
    bits = np.maximum(code.plain, code.inverse)[single]
    lit = half > 0.25 * np.percentile(half, 95)
    if not lit.any():
        return _USUAL
    passed = [np.abs(frames[i][at].ravel()[lit] - middle[lit]) / half[lit] for i in bits.tolist()]
    typical = float(np.percentile(np.max(passed, axis=0), 95)) - 1
    return float(np.clip(1.5 * typical, _USUAL, _MOST))
