"""Which pixels see the fringe, and how noisy they are: a mirror may fill a small part of the picture.

Beside it there may be darkness, a lit room, a lamp, a second and weaker reflection of the pattern.
"""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["noise_of", "overexposed", "seeing", "window_width"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Rms width of the window in periods of the fringe.
_WIDTH = 0.5
#: Amplitude over that around it: a window whose middle lies on a straight border sees half.
_HALF = 0.5
#: Amplitude over the usual one: twice what bare glass of index 1.5 reflects, ((1.5 - 1) / (1.5 + 1))^2.
_GLASS = 0.08


def window_width(at_rest: tuple[F64, F64], lit: Mask, period: float) -> float:
    """Rms width of the window, camera pixels, from the flatter coordinate's median gradient where lit."""
    steepness = []
    for coord in at_rest:
        slope = np.hypot(*np.gradient(coord))
        slope = slope[lit & np.isfinite(slope)]
        steepness.append(float(np.median(slope)) if slope.size else 1.0)
    return _WIDTH * period / max(min(steepness), 1e-3)


def seeing(height: F32, known: Mask, width: float) -> Mask:
    """Pixels that see the fringe, from the amplitude (H, W) that windows of this width see.

    Borders are where it falls to half of the largest within two widths, beyond which a window sees 2 % of
    what lies behind the border; half a width is left out along them, as a step of brightness has amplitude
    as well. The usual amplitude weighs pixels by its square: many faint ones do not count.
    """
    lit = np.where(known, height, np.float32(0)).astype(np.float32)
    size = 2 * math.ceil(2 * width) + 1
    around = cv2.dilate(lit, np.ones((size, size), np.uint8))
    power = np.square(lit, dtype=np.float64)
    usual = float((power * lit).sum() / max(power.sum(), 1e-9))
    blind = known & (height < np.maximum(_HALF * around, _GLASS * usual))
    size = 2 * math.ceil(width / 2) + 1
    return np.asarray(known & (cv2.dilate(blind.astype(np.uint8), np.ones((size, size), np.uint8)) == 0))


def overexposed(image: NDArray[Any], width: float) -> Mask:
    """Where an integer image is at its top over half a period both ways: no fringe stays bright that far."""
    if image.dtype.kind not in "ui":
        return np.zeros(image.shape, bool)
    top = (image == np.iinfo(image.dtype).max).astype(np.uint8)
    size = math.ceil(0.5 * width / _WIDTH)
    return np.asarray(cv2.morphologyEx(top, cv2.MORPH_OPEN, np.ones((size, size), np.uint8)) > 0)


def noise_of(image: F32, lit: Mask) -> float:
    """Immerkaer's estimate (doi:10.1006/cviu.1996.0060), median in place of mean, where his mask is lit.

    The mask is blind to fringes along either axis of the camera. At least that of rounding to integers.
    """
    inner = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    across = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    size = np.abs(second[inner])
    return max(1.4826 * float(np.median(size)) if size.size else 0.0, 12**-0.5)
