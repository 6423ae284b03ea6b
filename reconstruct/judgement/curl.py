"""Curl of the slopes around four pixels: zero for any surface,
so that what exceeds the noise is wrong data.
"""

import math

import numpy as np
import scipy.ndimage
import scipy.special
from numpy.typing import NDArray

from ..arrays import Floats, Mask
from ..solver.edges import curl

__all__ = ["curl_limit", "curl_scale", "curl_score", "curl_suspects"]

_CHANCE = 0.01  # of a right image to hold a suspect
_LOOKS, _LARGEST = 8, 1e12  # evidence of a square
_NEAR, _MOST = 4, 0.7  # reach of what lies around, and the share of it that wrong pixels leave alone


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


def curl_limit(score: Floats) -> float:
    """What the root of the evidence against a pixel (see `curl_suspects`) exceeds by chance in one image of a
    hundred.

    The scores of two squares that share a corner alone are correlated by -1/4, of two that share a side not
    at all: the four around a pixel add up to 1.25 chi2(2) + 0.75 chi2(2), whose tail is 2.5 exp(-x / 2.5).
    """
    squares = int(np.count_nonzero(np.isfinite(score)))
    return math.sqrt(2.5 * math.log(2.5 * max(squares, 1) / _CHANCE))


def curl_suspects(score: Floats, limit: float, cleared: Mask) -> Mask:
    """Wrong pixels to which large curls point, (H, W).

    An outlier spoils the four squares around it, its neighbours share two of them or one; so a pixel is
    suspected if the sum of the squares' evidence is over limit^2 and largest among its neighbours, and far
    above that of the squares around: along a rim all have a curl. Suspects clear their squares, and what
    remains is looked at again. cleared (H, W): pixels that are interpolated and cannot be to blame.
    """
    evidence = np.minimum(np.square(np.nan_to_num(score, nan=0.0, posinf=1e6, neginf=-1e6)), _LARGEST)
    # On a border a pixel has two squares: as much evidence in these as an inner pixel has in four.
    share = 4.0 / np.maximum(_around(np.isfinite(score).astype(np.float64)), 1.0)
    suspects, others = np.zeros(score.shape, dtype=np.bool_), cleared.copy()
    for _ in range(_LOOKS):
        total = np.where(others, 0.0, _around(evidence) * share)
        at = np.argwhere((total > limit**2) & (total >= scipy.ndimage.maximum_filter(total, 3)))
        if not at.size:
            break
        alone = np.sqrt(total[tuple(at.T)]) > limit * np.maximum(1.0, _scale_around(score, at))
        suspects[tuple(at[alone].T)] = True
        others[tuple(at[~alone].T)] = True
        evidence[_touched(suspects)] = 0.0
    return suspects


def _scale_around(score: Floats, at: NDArray[np.intp]) -> Floats:
    """Robust deviation of the scores around pixels (M, 2), but for the four that hold each."""
    near = np.arange(-_NEAR, _NEAR)
    rows, cols = at[:, 0, None, None] + near[:, None], at[:, 1, None, None] + near
    inside = (rows >= 0) & (rows < score.shape[0]) & (cols >= 0) & (cols < score.shape[1])
    inside[:, _NEAR - 1 : _NEAR + 1, _NEAR - 1 : _NEAR + 1] = False
    sizes = np.abs(np.where(inside, score[rows % score.shape[0], cols % score.shape[1]], np.nan))
    sizes = sizes.reshape(len(at), -1)
    sizes[np.isnan(sizes).all(axis=1)] = 0.0
    scale: Floats = np.nanquantile(sizes, _MOST, axis=1) / scipy.special.ndtri(0.5 + 0.5 * _MOST)
    return scale


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
