"""Curl of the slopes around four pixels: zero for any surface,
so that what exceeds the noise is wrong data.
"""

import numpy as np
import scipy.ndimage

from .arrays import Floats, Mask
from .edges import curl

__all__ = ["curl_scale", "curl_score", "curl_suspects"]


def curl_score(p: Floats, q: Floats, var_p: Floats, var_q: Floats, mask: Mask) -> Floats:
    """Curl of the square (i, j) .. (i + 1, j + 1) over its standard deviation, (H, W);
    NaN where a corner is masked.
    """
    total = var_p + var_q
    around = np.full(total.shape, np.nan)
    around[:-1, :-1] = 0.25 * (total[:-1, :-1] + total[1:, :-1] + total[:-1, 1:] + total[1:, 1:])
    score: Floats = curl(p, q, mask) / np.sqrt(around)
    return score


def curl_scale(score: Floats) -> float:
    """Robust standard deviation of the score (1 for noise as announced), from at most a million squares."""
    sample = np.abs(score[:: max(1, score.shape[0] // 512)])
    sample = sample[np.isfinite(sample)]
    return 1.4826 * float(np.median(sample)) if sample.size else float("nan")


def curl_suspects(score: Floats, limit: float, cleared: Mask) -> Mask:
    """Pixels to which the large curls point, (H, W).

    An outlier spoils the four squares around it, its neighbours share two of them or one; so a pixel is
    suspected if the sum of the squares' evidence is over limit^2 and largest among its neighbours. Removed
    suspects clear their squares, and what remains is looked at again. cleared (H, W): pixels that have been
    replaced and cannot be to blame.
    """
    evidence = np.square(np.nan_to_num(score, nan=0.0, posinf=1e150, neginf=-1e150))
    evidence = np.minimum(evidence, 1e12)
    # On a border a pixel has two squares: as much evidence in these as an inner pixel has in four.
    share = 4.0 / np.maximum(_around(np.isfinite(score).astype(np.float64)), 1.0)
    suspects = np.zeros(score.shape, dtype=np.bool_)
    for _ in range(8):
        if not (evidence > limit**2).any():
            break
        total = np.where(cleared, 0.0, _around(evidence) * share)
        found = (total > limit**2) & (total >= scipy.ndimage.maximum_filter(total, 3))
        suspects |= found
        evidence[_touched(found)] = 0.0
    return suspects


def _around(evidence: Floats) -> Floats:
    """Sum over the four squares that hold a pixel."""
    total = evidence.copy()
    total[1:] += evidence[:-1]
    total[:, 1:] += evidence[:, :-1]
    total[1:, 1:] += evidence[:-1, :-1]
    return total


def _touched(pixels: Mask) -> Mask:
    """Squares that hold one of the pixels."""
    squares = pixels.copy()
    squares[:-1] |= pixels[1:]
    squares[:, :-1] |= pixels[:, 1:]
    squares[:-1, :-1] |= pixels[1:, 1:]
    return squares
