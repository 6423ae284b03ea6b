"""Robust solves: edges whose increments do not fit the heights count less, by iterated reweighting.

Cauchy's weight w / (1 + w (r / (2.385 s))^2) of an edge defect r (doi:10.1080/03610927708827533) is that of
an edge in doubt by |r| / (2.385 s): to the variance 1/w the square of the doubt is added. s is the scaled
median of |r| sqrt(w), one for noise as announced.
"""

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Ints, Mask, Pair

from .holes import LARGEST

__all__ = ["CAUCHY", "patches", "wrong_pixels"]

CAUCHY = 2.385  # deviations at which the weight is one half: 95 % efficiency under Gaussian noise
_WRONG = 4.0  # standard deviations of an edge: defects of both edges of a wrong pixel
_ALIKE = 0.25  # of the larger of both: beside a crease the other is 1/12


def wrong_pixels(defects: Pair, weights: Pair, scale: float) -> Mask:
    """Pixels (H, W) whose two edges along an axis miss the heights by much and likewise, as a wrong slope
    enters both; a crease enters one.
    """
    (x, y), (of_x, of_y) = defects, weights
    wrong: Mask = _likewise(x, of_x, 1, scale) | _likewise(y, of_y, x.shape[1], scale)
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


def _likewise(defect: Floats, weight: Floats, step: int, scale: float) -> Mask:
    """Of the edges along an axis, from pixels to those so many later; where one is missing the other
    decides."""
    found, flat, of_flat = np.zeros(defect.size, np.bool_), defect.ravel(), weight.ravel()
    high = np.flatnonzero(flat * flat * of_flat > (_WRONG * scale) ** 2)
    pixels = np.union1d(high, high + step)  # no edge leads beyond the image

    def scores(at: Ints) -> Floats:
        at = np.maximum(at, 0)
        return np.asarray(flat[at] * np.sqrt(of_flat[at]) / scale)

    first = pixels % defect.shape[1] == 0 if step == 1 else pixels < step
    score, before = scores(pixels), np.where(first, 0.0, scores(pixels - step))
    one, other = np.where(before == 0, score, before), np.where(score == 0, before, score)
    less, more = np.minimum(abs(one), abs(other)), np.maximum(abs(one), abs(other))
    found[pixels] = (one * other > 0) & (less > _WRONG) & (less > _ALIKE * more)
    return found.reshape(defect.shape)
