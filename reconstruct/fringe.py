"""Noisy rows and broken lines along the border: left out of the solve, reached afterwards from inside.

Where the pattern ends, the outermost pixels are seen through half a blur: their sigma is many times that of
their neighbours, or they are flagged in patches. They tell nothing about the rest, but light edges along a
row (columns may have weights of their own) and a ragged border would ask for a masked solve, and their slopes
would enter the increments of good pixels beside them. Their height follows from the three lines before,
outward: w_0 = w_1 + (23 p_1 - 16 p_2 + 5 p_3) / 12 (Adams-Bashforth, third order).
"""

import numpy as np
from numpy.typing import NDArray

from .measured import Measured

__all__ = ["core_window", "extended"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Window = tuple[slice, slice]

DEPTH = 4  # lines on every side at most
NOISY = 3.0  # times the next line's sigma
BLIND = 0.5, 0.15  # of the way to the pattern: noise of the outermost line's slopes, and of the next one's
_WEIGHTS = (23.0 / 12.0, -16.0 / 12.0, 5.0 / 12.0)
_GAIN = sum(weight**2 for weight in _WEIGHTS)


def core_window(data: Measured) -> Window:
    """The part of the grid without its noisy rows; without broken ones too,
    if what is left is whole then.
    """
    whole = _peeled(data, broken=True)
    return whole if data.mask[whole].all() else _peeled(data, broken=False)


def _peeled(data: Measured, broken: bool) -> Window:
    window = [[0, size] for size in data.mask.shape]
    for axis in (0, 1):
        for side in (0, 1):
            for _ in range(DEPTH):
                if window[axis][1] - window[axis][0] < 8 * DEPTH or not _bad(
                    data, window, axis, side, broken
                ):
                    break
                window[axis][side] += -1 if side else 1
    return slice(*window[0]), slice(*window[1])


def _bad(data: Measured, window: list[list[int]], axis: int, side: int, broken: bool) -> bool:
    """Whether a side's outermost line (without its ends,
    which the other axis may peel) is noisy or broken.
    """
    first = window[axis][1] - 1 if side else window[axis][0]
    inward = -1 if side else 1
    across = slice(window[1 - axis][0] + DEPTH, window[1 - axis][1] - DEPTH)
    lines = [(line, across) if axis == 0 else (across, line) for line in (first, first + DEPTH * inward)]
    outer, inner = (data.mask[line] for line in lines)
    if not outer.any() or not inner.any():
        return broken
    if (broken and not outer.all()) or _blind(data, axis, first, first + inward):
        return True
    if axis == 1:  # weights may differ by columns as much as they like
        return False
    for sigma in (data.sigma_u, data.sigma_v):
        here, there = (
            float(np.median(sigma[line][m])) for line, m in zip(lines, (outer, inner), strict=True)
        )
        if here > NOISY * there:
            return True
    return False


def _blind(data: Measured, axis: int, line: int, inner: int) -> bool:
    """Whether noise moves a line's rays by as much as the pattern is away, and the next line's by a part:
    the slopes are no function of the coordinates any more that could be linearised.
    """
    return _swing(data, axis, line) > BLIND[0] and _swing(data, axis, inner) > BLIND[1]


def _swing(data: Measured, axis: int, line: int) -> float:
    """Noise of a line's slopes, over a pixel, as a share of the way to the pattern."""
    every = slice(0, data.mask.shape[1 - axis])
    strip = slice(line, line + 1)
    near = data.cropped((strip, every) if axis == 0 else (every, strip))
    if not near.mask.any():
        return 0.0
    rest = near.rest()
    noise = np.sqrt(np.maximum(*near.variances(rest)))
    return float(np.median((noise / near.clearance(rest))[near.mask]))


def extended(
    data: Measured,
    window: Window,
    w: Floats,
    variance: Floats,
    slope_variances: tuple[Floats, Floats],
    solved: Mask,
) -> tuple[Floats, Floats, Mask]:
    """The core's unknown w, its variance and where it is solved, carried to the whole grid of data.

    slope_variances: of p and q in the core. Where a line before was not solved, nothing follows.
    """
    shape = data.mask.shape
    if solved.shape == shape:
        return w, variance, solved
    whole, spread = np.full(shape, np.nan), np.full(shape, np.nan)
    known = np.zeros(shape, dtype=np.bool_)
    whole[window], spread[window], known[window] = w, variance, solved
    noise = [np.zeros(shape), np.zeros(shape)]
    for field, values in zip(noise, slope_variances, strict=True):
        field[window] = values
    for axis in (1, 0):
        start, stop = window[axis].start, window[axis].stop
        for line in range(start - 1, -1, -1):
            _step(data, whole, spread, known, noise, axis, line, 1)
        for line in range(stop, shape[axis]):
            _step(data, whole, spread, known, noise, axis, line, -1)
    return whole, spread, known


def _step(
    data: Measured,
    w: Floats,
    variance: Floats,
    known: Mask,
    noise: list[Floats],
    axis: int,
    line: int,
    inward: int,
) -> None:
    """Fill one line of a column axis (1) or row axis (0) from the three lines inward."""
    lines = [line + k * inward for k in (1, 2, 3)]
    strip = slice(min(lines), max(lines) + 1)
    every = slice(0, data.mask.shape[1 - axis])
    window = (strip, every) if axis == 0 else (every, strip)
    p, q = data.cropped(window).slopes(np.ascontiguousarray(w[window]))[:2]
    slope = q if axis == 0 else p.T
    rise = sum(weight * slope[k - strip.start] for weight, k in zip(_WEIGHTS, lines, strict=True))
    here = (line, every) if axis == 0 else (every, line)
    inner = [(k, every) if axis == 0 else (every, k) for k in lines]
    sure = known[inner[0]] & known[inner[1]] & known[inner[2]] & data.mask[here]
    w[here] = np.where(sure, w[inner[0]] - inward * rise, np.nan)
    beside = noise[1 - axis][inner[0]]
    variance[here] = np.where(sure, variance[inner[0]] + _GAIN * beside, np.nan)
    known[here] = sure
    for field in noise:
        field[here] = field[inner[0]]
