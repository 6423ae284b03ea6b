"""Blur from how a fringe's contrast swings with the place in the cell, where nothing else tells it.

Cells turn a fringe of frequency f = 1/P into itself and sidebands of frequency f + m, see cells. The contrast
that a pixel of w cells sees at u is then

    C(u) = C |1 + r_- exp(-2 pi i u) + r_+ exp(2 pi i u)|,
    r_m = (-1)^m f / (f + m) sinc((f + m) w) / sinc(f w) exp(-2 (pi b)^2 ((f + m)^2 - f^2)),

whatever C is: no other fringe nor white and black are needed, and pixels may keep step with the cells, as
long as they do not all lie at the same place of one. An error of r P / 2 pi cells in a coordinate shows in a
hundred pixels' contrasts as soon as it does in one pixel's coordinate.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .sample import quantile
from .swing_kernels import LEVEL, LINES, prepare, swing

__all__ = ["Blur", "Contrasts", "blur_by_swing", "seems_to_swing"]

F32 = np.float32
F64 = NDArray[np.float64]
#: Pixels at least, and for a first look.
_FEWEST, _A_FEW = 256, 64
#: Standard errors of the swing that it has at least; swing out of phase with the cells (which only something
#: else makes), and excess over that of a display without blur, as shares of it, at most.
_SURE, _ASTRAY = 5.0, 0.25
#: Steps in which the blur is found.
_STEPS = 3


@dataclass(frozen=True, slots=True)
class Blur:
    """Rms Gaussian blur, cells, and the error of its square, rms, cells^2."""

    rms: float
    square_error: float


@dataclass(frozen=True, slots=True)
class Contrasts:
    """Of some pixels (K,): contrast of a fringe (any unit), place (decoded, cells), footprint along either
    side (2, K), cells, and where in the image, -1 to 1 (2, K)."""

    contrast: F64
    place: F64
    sides: F64
    at: F64


def seems_to_swing(seen: Contrasts, period: float) -> bool:
    """Whether the contrast of some pixels may swing: what a few tell is enough to ask the others."""
    if len(seen.place) < _A_FEW or period <= 2:
        return False
    share, _, error = _prepared(seen, 1 / period)(0.0)
    return share > error


def blur_by_swing(seen: Contrasts, period: float) -> Blur | None:
    """Blur of a fringe of that period (cells), None where the contrast does not tell it."""
    if len(seen.place) < _FEWEST or period <= 2:
        return None
    f = 1 / period
    of_blur, lever, square = _prepared(seen, f), 2 * np.pi**2 * (1 - 2 * f), 0.0
    share, astray, error = of_blur(square)
    if not 0 < share < 1 + _ASTRAY or _SURE * error > 1:
        return None
    for _ in range(_STEPS):
        # the more blur is reckoned with, the larger what is seen is against it
        square = max(square - math.log(share) / lever, 0.0)
        share, astray, error = of_blur(square)
        if share <= 0 or _SURE * error > 1:
            return None
    if abs(astray) > _ASTRAY + error:
        return None
    return Blur(float(np.sqrt(square)), float(np.hypot(error, astray)) / lever)


def _prepared(seen: Contrasts, f: float) -> Callable[[float], tuple[float, float, float]]:
    """swing_kernels.swing of a squared blur."""
    room = np.empty((LINES, len(seen.place)), np.float32)
    prepare(F32(f), *(chart.astype(F32) for chart in (seen.contrast, seen.sides, seen.at)), room)
    middle = quantile(room[LEVEL], 0.5)
    place = (seen.place - np.rint(seen.place)).astype(F32)
    return lambda square: swing(square, f, middle, place, room)
