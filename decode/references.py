"""Levels of a code's bits: how well white and black bound them, how much of each bit the camera sees."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .noise import Noise
from .plan import Code, Plan
from .sample import quantile

__all__ = ["beyond_references", "bit_contrasts"]

#: Half contrasts by which bits of real displays pass white and black, at least and at most.
_USUAL, _MOST = 0.08, 1.0
_SIDE = 48
#: Pixels on which contrasts are measured, at least and about at most.
_FEWEST, _PIXELS = 50, 1024


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


def bit_contrasts(levels: NDArray[Any], noise: Noise, wanted: Plan, code: Code) -> NDArray[np.float32]:
    """Squared contrast of each bit (bits,), that of the best one being 1; levels (N, K), noise: of raw ones.

    Mean squares of margins, less the noise's: where noise reaches the contrast, blur cannot be told from it
    pixel by pixel, and fine bits have less contrast than coarse ones. 1 where too few pixels see the pattern.
    """
    own = levels[:, :: max(1, levels.shape[1] // _PIXELS)].astype(np.float32)
    both = (code.plain >= 0) & (code.inverse >= 0)
    shown = own[np.maximum(code.plain, code.inverse)]
    if min(wanted.white, wanted.black) >= 0:
        high, low = own[wanted.white], own[wanted.black]
    else:
        high, low = shown.max(axis=0), shown.min(axis=0)
    margin = np.where(both[:, None], 0.5 * (own[code.plain] - own[code.inverse]), shown - 0.5 * (high + low))
    half = 0.5 * (high - low)
    lit = half > 0.25 * quantile(half, 0.95)
    if np.count_nonzero(lit) < _FEWEST:
        return np.ones(len(code.plain), np.float32)
    sample = noise.read2 + noise.gain * float(np.mean(0.5 * (high + low)[lit]))
    square = np.mean(margin[:, lit] ** 2, axis=1) - np.where(both, 0.5, 1.0) * sample
    return np.clip(square / max(float(square.max()), 1e-9), 0.0, 1.0).astype(np.float32)
