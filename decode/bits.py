"""How much of each bit of a code the camera sees, and how wide the edges of its stripes look.

Where noise reaches the contrast, blur cannot be told from it pixel by pixel; over many pixels it can.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import code_words

from .noise import Noise
from .plan import Code, Plan
from .records import Edges
from .sample import quantile

__all__ = ["bit_edges"]

F64 = NDArray[np.float64]
#: Pixels on which contrasts are measured, at least and about at most.
_FEWEST, _PIXELS = 50, 1024
#: Squared contrast of a bit that is nothing but edges; share or cells of a bit that are edges, at least.
_ALL_EDGES, _LEAST_SHARE = 1 / 3, 0.02
#: Sigmas of a certain bit's margin; part of a cell's width that its edges leave, at least: how far they reach
#: is an estimate.
_CERTAIN, _LEAST_INSIDE = 6.0, 0.85
#: Error of a threshold that was measured, as a share of how far it is from half way, and at least.
_UNSURE, _LEAST_ERROR = 0.25, 0.005
#: Variance of the mean of stripes some of which are in view, over their own.
_IN_VIEW = 0.2**2


def bit_edges(levels: NDArray[Any], noise: Noise, wanted: Plan, code: Code) -> Edges:
    """What a sample of raw levels (N, K) of frames and their noise tell of a code's bits; see records.Edges.

    Levels that are flat but for edges on a share e of the pixels, straight from one level to the other, have
    the mean square 1 - 2 e / 3; below 1/3 all is edges, and lower. Such stripes are narrow, so that a picture
    holds many of them: their mean is the light half way, which gamma, flicker and clipped white move.
    """
    square, mean, spread = _squares(levels, noise, wanted, code)
    half = _half_stripes(code.kind, len(code.plain))
    low = square < _ALL_EDGES
    fine = low & (np.minimum(code.plain, code.inverse) < 0)
    shift, astray = _threshold(mean[fine], square[fine])
    share = np.where(low, 0.0, (1 - square) / (1 - _ALL_EDGES))
    # as far for all bits: the best fit to their shares, reach / half
    reach = float(np.sum(share / half) / np.maximum(np.sum(~low / half**2), 1e-9))
    share = np.where(low, 1.0, np.clip(reach / half, _LEAST_SHARE, 1.0))
    reaches = np.clip(np.where(low, half, reach), _LEAST_SHARE, 1.0)
    level = np.where(low, np.sqrt(square / _ALL_EDGES), 1.0)
    # on either side an edge, up to where a bit is certain
    inside = max(1 - 2 * _CERTAIN * spread * float(reaches[0] / level[0]), _LEAST_INSIDE)
    contrast, level, share, reaches = (
        part.astype(np.float32) for part in (np.sqrt(square), level, share, reaches)
    )
    numbers = inside**2 / 12, shift, astray
    return Edges(contrast, level, share, reaches, *(np.float32(number) for number in numbers))


def _threshold(mean: F64, square: F64) -> tuple[float, float]:
    """Distance from the mid level, and its error, half contrasts, by mean and mean square of the margins of
    narrow stripes (bits,): the fainter, the less it matters which part of them is in view."""
    if not mean.size:
        return 0.0, 0.0
    weight = 1 / (_IN_VIEW * np.maximum(square - mean**2, 0) + _LEAST_ERROR**2)
    shift = float(np.average(mean, weights=weight))
    scatter = float(np.sqrt(np.average((mean - shift) ** 2, weights=weight)))
    return shift, max(scatter, _UNSURE * abs(shift), _LEAST_ERROR)


def _squares(levels: NDArray[Any], noise: Noise, wanted: Plan, code: Code) -> tuple[F64, F64, float]:
    """Mean square of each bit's margin (bits,), without that of the noise, over that of white and black or,
    if these were not shown, of the best bit; the mean margin (bits,) and the noise (rms) of the finest bit's,
    over the root of the same. 1, 0 and 0 where too few pixels see the pattern.
    """
    own = levels[:, :: max(1, levels.shape[1] // _PIXELS)].astype(np.float32)
    both = (code.plain >= 0) & (code.inverse >= 0)
    shown = own[np.maximum(code.plain, code.inverse)]
    referenced = min(wanted.white, wanted.black) >= 0
    if referenced:
        high, low = own[wanted.white], own[wanted.black]
    else:
        high, low = shown.max(axis=0), shown.min(axis=0)
    margin = np.where(both[:, None], 0.5 * (own[code.plain] - own[code.inverse]), shown - 0.5 * (high + low))
    half = 0.5 * (high - low)
    lit = np.flatnonzero(half > 0.25 * quantile(half, 0.95))
    if len(lit) < _FEWEST:
        return np.ones(len(code.plain)), np.zeros(len(code.plain)), 0.0
    sample = noise.read2 + noise.gain * float(np.mean(0.5 * (high + low)[lit]))
    variance = np.where(both, 0.5, 1.0) * sample
    margin = margin.take(lit, 1)
    square = np.mean(margin**2, axis=1, dtype=np.float64) - variance
    flat = float(np.mean(half[lit] ** 2)) - 0.5 * sample if referenced else 0.0
    whole = max(float(square.max()), flat, 1e-9)
    mean = np.mean(margin, axis=1, dtype=np.float64) / np.sqrt(whole)
    return np.clip(square / whole, 1e-6, 1.0), mean, float(np.sqrt(variance[0] / whole))


@lru_cache(maxsize=16)
def _half_stripes(kind: str, bits: int) -> F64:
    """Half the mean width of each bit's stripes (bits,), cells."""
    words = code_words(kind, np.arange(1 << bits), bits)
    changes = np.abs(np.diff((words[:, None] >> np.arange(bits)) & 1, axis=0)).sum(axis=0)
    return np.asarray(0.5 * len(words) / (1 + changes))
