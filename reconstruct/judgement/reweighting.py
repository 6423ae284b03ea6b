"""Robust solves: edges whose increments do not fit the heights count less, by iterated reweighting.

Cauchy's weight w / (1 + w (r / (2.385 s))^2) of an edge defect r (doi:10.1080/03610927708827533) is that of
an edge in doubt by |r| / (2.385 s): to the variance 1/w the square of the doubt is added. s is the scaled
median of |r| sqrt(w), one for noise as announced.
"""

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask, Pair
from .holes import LARGEST

__all__ = ["CAUCHY", "patches", "wrong_pixels"]

CAUCHY = 2.385  # deviations at which the weight is one half: 95 % efficiency under Gaussian noise
_WRONG = 4.0  # standard deviations of an edge: defects of both edges of a wrong pixel
_ALIKE = 0.25  # of the larger of both: beside a crease the other is 1/12


def wrong_pixels(defects: Pair, weights: Pair, scale: float) -> Mask:
    """Pixels (H, W) whose two edges along an axis miss the heights by much and likewise, as a wrong slope
    enters both; a crease enters one.
    """
    x, y = (defect * np.sqrt(weight) / scale for defect, weight in zip(defects, weights, strict=True))
    wrong: Mask = _likewise(x) | _likewise(y.T).T
    return wrong


def patches(wrong: Mask, surely: Mask, jumps: Mask) -> Mask:
    """Wrong pixels that are few, or a patch beyond the doubts of its edges (surely), unlike a crease; where
    slopes jump, unlike errors of the scene. A patch with the pixels around, wrong on one side."""
    square = np.ones((3, 3))
    parts, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(wrong, square), square)
    every, sure, sharp = (
        np.bincount(parts[wrong & part], minlength=count + 1) for part in (True, surely, jumps)
    )
    few, patch = ((sharp > 0) & part for part in (every <= LARGEST, sure > LARGEST))
    large = scipy.ndimage.binary_dilation(wrong & patch[parts], square)
    found: Mask = (wrong & few[parts]) | large
    return found


def _likewise(score: Floats) -> Mask:
    """Of the edges along rows; where one is missing the other decides."""
    before = np.roll(score, 1, axis=1)
    before[:, 0] = 0.0
    one, other = np.where(before == 0, score, before), np.where(score == 0, before, score)
    less, more = np.sort(np.abs([one, other]), axis=0)
    found: Mask = (one * other > 0) & (less > _WRONG) & (less > _ALIKE * more)
    return found
