"""Outermost lines of the image that contradict those behind them: artefacts of the camera's filters.

Sharpening, demosaicing and median filters repeat or mirror pixels beyond the image. That shifts a fringe by
nearly the same amount along a line, so that means over some of its pixels reveal it. The outermost lines are
extrapolated from those behind them, and the next lines likewise from those behind these: the excess of the
first error over the second is neither noise nor curvature of the map. A dent might cause it, so that no
correction is applied: sigma of the line becomes at least as large.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .pixelation import REACH

__all__ = ["edge_lines", "widen_edge_lines"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Lines that may be shifted. A demosaicing kernel of 5 px reaches two; of an unsharp mask of 2 px rms the
#: third has a fifth of the first one's shift, the fourth 7 %.
_OUTER = 3
#: Lines of a parabola: extrapolated from six to the outermost line, its noise is 4.8 times a pixel's.
_BEHIND = 6
#: Pixels of a mean, which reduces 4.8 to 2.4: with the limits below, shifts above 3.5 sigma of a pixel are
#: significant along lines of 160 px or more.
_MEAN = 4
_MEANS = np.full(_MEAN, 1 / _MEAN)
#: Three deviations of the logarithm of two medians' ratio, each of n squares (2.33 / sqrt(n), from chi2 with
#: one degree of freedom, for either), are 10 / sqrt(n).
_CHANCE = 10.0
#: Log ratio of squared second differences over _OUTER lines: curvature fades over REACH px or more.
_BEND = 2 * _OUTER / REACH
#: Lines in the test; half of them may be flagged, as edges of bits may extend along a line.
_LINES = 2 * (2 * _OUTER + _BEHIND)
#: Of an image (H, W), every side's lines from the outermost inwards, as views.
_SIDES: tuple[Callable[[NDArray[Any]], NDArray[Any]], ...] = (
    lambda image: image,
    lambda image: image[::-1],
    lambda image: image.T,
    lambda image: image.T[::-1],
)


def widen_edge_lines(sigmas: Sequence[F32], off: F32) -> None:
    """Raise sigma (H, W) of each of A axes to at least the shift of its outermost lines, see edge_lines."""
    for side, lines_of in enumerate(_SIDES):
        for sigma, own in zip(sigmas, off[:, side], strict=True):
            outer = lines_of(sigma)[: len(own)]
            np.maximum(outer, own[: len(outer), None], out=outer)


def edge_lines(coords: Sequence[F32], flags: NDArray[np.uint16]) -> F32:
    """Shifts of the outermost lines of A coordinates (H, W), (A, 4, _OUTER): from each side inwards."""
    found = np.zeros((len(coords), len(_SIDES), _OUTER), np.float32)
    for side, lines_of in enumerate(_SIDES):
        good = lines_of(flags)[:_LINES] == 0
        count = good.sum(axis=1)
        inner = _OUTER + np.flatnonzero(2 * count[_OUTER:] >= count.max())[: _OUTER + _BEHIND]
        if len(inner) < _OUTER + _BEHIND:
            continue
        kept = np.append(np.arange(_OUTER), inner)
        weights, next_weights = _extrapolation(kept[:-_OUTER]), _extrapolation(inner)
        for coord, own in zip(coords, found, strict=True):
            lines = np.where(good[kept], lines_of(coord)[kept], np.float64(np.nan))
            missed2, usual2 = _missed2(lines[:-_OUTER], weights), _missed2(lines[_OUTER:], next_weights)
            own[side] = [_surely_off(*of_line) for of_line in zip(missed2, usual2, strict=True)]
    return found


def _extrapolation(at: NDArray[np.intp]) -> F64:
    """Weights of the last _BEHIND of some lines for least-squares parabolas at the others."""
    powers = np.vander(at, 3)
    return powers[:_OUTER] @ np.linalg.pinv(powers[_OUTER:])


def _missed2(lines: F64, weights: F64) -> list[F64]:
    """Squared extrapolation errors, px^2, of the first _OUTER lines (K, n), of means without NaN."""
    missed = lines[:_OUTER] - weights @ lines[_OUTER:]
    known = [line[np.isfinite(line)] for line in missed]
    return [(line[: line.size // _MEAN * _MEAN].reshape(-1, _MEAN) @ _MEANS) ** 2 for line in known]


def _surely_off(missed2: F64, usual2: F64) -> float:
    """Root of the difference of both medians if their ratio exceeds chance and curvature, else 0."""
    count = min(missed2.size, usual2.size)
    if not count:
        return 0.0
    found, usual = (float(np.sort(squares)[squares.size // 2]) for squares in (missed2, usual2))
    sure = found > usual * np.exp(max(_BEND, _CHANCE / count**0.5))
    return (found - usual) ** 0.5 if sure else 0.0
