"""The border's shadow, where a code does not tell its blur: the decoder refuses pixels near the border that
are dimmer than those around, unless something nearer to the border is not.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .view import Floats, Levels

__all__ = ["shadowed"]

#: As in the decoder: amplitude over that of pixels around below which one is dim; cells from the border up to
#: which it may lie in its shadow, and the same in periods of the finest fringe; pixels around; cells by which
#: a pixel is surely nearer to the border than another.
DIMMED, REACH, REACH_PERIODS, AROUND, NEARER = 0.96, 16.0, 0.9, 3, 1.0
#: Mean of the largest of three Gaussian numbers, the amplitudes inwards, each the lesser one of two.
BRIGHTEST = 0.85 * 0.83
_WAYS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def shadowed(inside: Floats, amplitude: Floats, levels: Levels, noise: Floats, period: float) -> Floats:
    """Probability (H, W) that a pixel seems to lie in the border's shadow.

    inside: distance from the nearer border, cells, NaN where nothing is seen, inf where another border is
    nearer; noise: of the amplitude; period: of the finest fringe.
    """
    deviation = np.sqrt(levels.variance(levels.half))
    usual = np.nan_to_num(amplitude + BRIGHTEST * noise - 3 * deviation)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (2 * AROUND + 1, 2 * AROUND + 1))
    around = cv2.dilate(usual, cross)
    dim = ndtr((DIMMED * around - amplitude) / noise)
    near = (inside < min(REACH, REACH_PERIODS * period)) & (dim > 0)
    hidden = ndtr((around - _brightest_outwards(inside, amplitude, near)) / noise)
    return np.where(near, dim * hidden, 0.0)


def _brightest_outwards(inside: Floats, amplitude: Floats, near: NDArray[np.bool_]) -> Floats:
    """Largest amplitude on the way from the pixels `near` the border towards it, -inf where there is none."""
    closest = np.min([_beside(inside, *way, 1) for way in _WAYS], axis=0)
    found = np.full(inside.shape, -np.inf)
    for way in _WAYS:
        here, step = inside, 1
        going = near & (_beside(inside, *way, 1) == closest) & (closest < inside)
        while going.any():
            there = _beside(inside, *way, step)
            going &= there < here
            counts = going & (there < inside - NEARER)
            found = np.where(counts, np.fmax(found, _beside(amplitude, *way, step)), found)
            here, step = there, step + 1
    return found


def _beside(values: Floats, down: int, right: int, step: int) -> Floats:
    """What lies `step` pixels that way, inf beyond the image and where there is nothing."""
    rows, cols = values.shape
    found = np.full(values.shape, np.inf)
    to_rows, from_rows = _shift(down * step, rows)
    to_cols, from_cols = _shift(right * step, cols)
    found[to_rows, to_cols] = values[from_rows, from_cols]
    return np.asarray(np.nan_to_num(found, nan=np.inf, posinf=np.inf))


def _shift(by: int, size: int) -> tuple[slice, slice]:
    """Where values go, and whence they come."""
    by = max(-size, min(by, size))
    return slice(max(0, -by), size - max(0, by)), slice(max(0, by), size + min(0, by))
