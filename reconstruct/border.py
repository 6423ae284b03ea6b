"""Noisy rows and broken lines along the border: left out of the solve, reached afterwards from inside.

Where the pattern ends, the outermost pixels are seen through half a blur: their sigma is many times that of
their neighbours, or they are flagged in patches. They tell nothing about the rest, but light edges along a
row (columns may have weights of their own) and a broken border would ask for a masked solve, and their slopes
would enter the increments of good pixels beside them. Their height follows outward, from the three lines
before, w_0 = w_1 + (23 p_1 - 16 p_2 + 5 p_3) / 12 (Adams-Bashforth, third order), or where its own slope is
known better than that, w_0 = w_1 + (9 p_0 + 19 p_1 - 5 p_2 + p_3) / 24 (Adams-Moulton).
"""

from collections.abc import Callable, Iterator

import numpy as np

from .arrays import Floats, Mask
from .edges import AT_END
from .measured import Measured

__all__ = ["core_windows", "extended", "solid_window"]

Window = tuple[slice, slice]

DEPTH = 4  # lines on every side at most
NOISY = 3.0  # times the next line's sigma
HOLLOW = 0.5, 0.9  # share of a line's pixels that is seen at most, and of a line's inside at least
_OPEN = (23.0 / 12.0, -16.0 / 12.0, 5.0 / 12.0)
_STEPS = 3  # of Newton
_APART = 3.0  # sigmas by which both may differ: a slope whose noise is not small is no slope


def solid_window(seen: Mask) -> Window:
    """The part of the grid without border lines of which little is left: their gaps would be one with the
    small holes of the line beside them, which can be bridged.
    """

    def hollow(window: list[list[int]], axis: int, side: int) -> bool:
        outer, inner = (seen[line] for line in _lines(window, axis, side))
        return bool(outer.size and outer.mean() < HOLLOW[0] and inner.mean() > HOLLOW[1])

    return _peeled(seen.shape, hollow)


def core_windows(data: Measured) -> Iterator[Window]:
    """What may be solved, the best first: the grid without its noisy lines, and without broken ones if what
    is left is whole then; without its noisy ones alone; all of it.

    What is left out costs the anchor: it is reached over a pixel more, or not at all.
    """
    whole = _core(data, broken=True)
    if data.mask[whole].all():
        yield whole
    yield _core(data, broken=False)
    yield slice(0, data.mask.shape[0]), slice(0, data.mask.shape[1])


def _core(data: Measured, broken: bool) -> Window:
    def bad(window: list[list[int]], axis: int, side: int) -> bool:
        return _bad(data, window, axis, side, broken)

    return _peeled(data.mask.shape, bad)


def _peeled(shape: tuple[int, ...], bad: Callable[[list[list[int]], int, int], bool]) -> Window:
    """The window that is left when lines that are `bad` (of a window, axis, side) are taken off."""
    window = [[0, size] for size in shape]
    for axis in (0, 1):
        for side in (0, 1):
            for _ in range(DEPTH):
                if window[axis][1] - window[axis][0] < 8 * DEPTH or not bad(window, axis, side):
                    break
                window[axis][side] += -1 if side else 1
    return slice(*window[0]), slice(*window[1])


def _lines(window: list[list[int]], axis: int, side: int) -> list[tuple[int | slice, int | slice]]:
    """A side's outermost line, and one inside, without their ends, which the other axis may peel."""
    first, inward = window[axis][side] - side, -1 if side else 1
    across = slice(window[1 - axis][0] + DEPTH, window[1 - axis][1] - DEPTH)
    return [(line, across) if axis == 0 else (across, line) for line in (first, first + DEPTH * inward)]


def _bad(data: Measured, window: list[list[int]], axis: int, side: int, broken: bool) -> bool:
    """Whether a side's outermost line is noisy, or broken and that counts."""
    lines = _lines(window, axis, side)
    outer, inner = (data.mask[line] for line in lines)
    if not outer.any() or not inner.any():
        return broken
    if broken and not outer.all():
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


def extended(
    data: Measured,
    window: Window,
    w: Floats,
    variance: Floats,
    solved: Mask,
) -> tuple[Floats, Floats, Mask]:
    """The core's unknown w, its variance and where it is solved, carried to the whole grid of data.

    Where a line before was not solved, nothing follows.
    """
    shape = data.mask.shape
    if solved.shape == shape:
        return w, variance, solved
    whole, spread = np.full(shape, np.nan), np.full(shape, np.nan)
    known, trusted = np.zeros((2, *shape), dtype=np.bool_)
    whole[window], spread[window], known[window], trusted[window] = w, variance, solved, True
    for axis in (1, 0):
        start, stop = window[axis].start, window[axis].stop
        for line in range(start - 1, -1, -1):
            _step(data, whole, spread, known, trusted, axis, line, 1)
        for line in range(stop, shape[axis]):
            _step(data, whole, spread, known, trusted, axis, line, -1)
    return whole, spread, known


def _step(
    data: Measured,
    w: Floats,
    variance: Floats,
    known: Mask,
    trusted: Mask,
    axis: int,
    line: int,
    inward: int,
) -> None:
    """Fill one line of a column axis (1) or row axis (0) from the three lines inward, and its own slope;
    trusted: pixels whose slopes agree with the way there, so that the next line may follow from them.
    """
    lines = [line + k * inward for k in range(4)]
    every = slice(0, data.mask.shape[1 - axis])
    here, *inner = [(k, every) if axis == 0 else (every, k) for k in lines]
    sure = data.mask[here].copy()
    for before in inner:
        sure &= known[before] & trusted[before]
    first = w[inner[0]]
    slope, _, spread = _slopes(data, w, axis, lines[1:])
    w[here] = first - inward * sum(weight * s for weight, s in zip(_OPEN, slope, strict=True))
    added = np.asarray(sum(weight**2 * s for weight, s in zip(_OPEN, spread, strict=True)))
    own, least = _closed(data, w, axis, lines, inward, first)
    agrees = np.square(own - w[here]) < _APART**2 * (added + least)
    better = (least < added) & agrees
    w[here] = np.where(sure, np.where(better, own, w[here]), np.nan)
    variance[here] = np.where(sure, variance[inner[0]] + np.where(better, least, added), np.nan)
    known[here], trusted[here] = sure, agrees


def _closed(
    data: Measured, w: Floats, axis: int, lines: list[int], inward: int, first: Floats
) -> tuple[Floats, Floats]:
    """The unknown in the outermost of four lines by the cubic through its own slope and three inside, Newton
    from what w (changed and restored) holds there; and the variance that this adds to the next line's, first.
    """
    here = (lines[0], slice(None)) if axis == 0 else (slice(None), lines[0])
    start = w[here].copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_STEPS):
            slope, change, spread = _slopes(data, w, axis, lines)
            off = w[here] - first + inward * sum(c * s for c, s in zip(AT_END, slope, strict=True))
            w[here] -= off / (1.0 + inward * AT_END[0] * change[0])
    own, w[here] = w[here].copy(), start
    return own, np.asarray(sum(c**2 * s for c, s in zip(AT_END, spread, strict=True)))


def _slopes(
    data: Measured, w: Floats, axis: int, lines: list[int]
) -> tuple[list[Floats], list[Floats], list[Floats]]:
    """Slopes across lines, their derivatives by w, and their variances, line by line."""
    strip = slice(min(lines), max(lines) + 1)
    every = slice(0, data.mask.shape[1 - axis])
    window = (strip, every) if axis == 0 else (every, strip)
    part, at = data.cropped(window), np.ascontiguousarray(w[window])
    across = 1 - axis
    found = part.slopes(at)
    maps = found[across], found[2 + across], part.variances(at)[across]
    slope, change, spread = ([(m if axis == 0 else m.T)[k - strip.start] for k in lines] for m in maps)
    return slope, change, spread
