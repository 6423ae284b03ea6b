"""Lens blur, from the contrast of fringes where the map is steep.

A lens averages places with a variance of blur2 px^2 along either axis. This reduces the contrast of a fringe
with w turns per pixel to exp(-2 pi^2 blur2 w^2), and the pixel's area to sinc(w_x) sinc(w_y). In the ratio to
a coarser fringe, or to white and black, the pixel's light cancels; the display's transfer is constant, or
varies slowly, as a polynomial of the image's rows and columns:

    log(fine / coarse) - log(sinc sinc) = polynomial - 2 pi^2 blur2 (w_fine^2 - w_coarse^2).

The slope of a straight line through sampled pixels is blur2. Slopes from other pixels are its instrumental
variable (Wald, 1940): noise of the abscissa would flatten the line, and pixelation shifts neighbours at one
and at two pixels differently. Where the map is not curved, the lens is not determined, and has no effect. A
camera that sharpens (an unsharp mask of a times the effect of blur2 px^2: the variance -a blur2) adds
contrast in the same way.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Fringe, Plan
from .border import MARGIN
from .noise import Sample

__all__ = ["NO_LENS", "Lens", "measured_lens"]

F64 = NDArray[np.float64]
#: Variance of a pixel's area; turns per pixel beyond which it halves a contrast.
_OWN, _HALF = 1 / 12, 0.6
#: Terms of the polynomial (to second order, to third), and pixels on either side for slopes; alternatives
#: that must agree.
_FIT, _OTHERS = (6, 1), ((10, 1), (6, 2))
#: Parts of the sample for the error; deviations for a significant lens, and for outliers.
_PARTS, _SURE, _TRIM = 16, 2.5, 3.0
#: Standard deviation of the variance of a pixel's area if it is unknown: for a square of 1/4 to all of the
#: pitch's area, uniformly distributed, (1 - share) / 12 is missing.
_UNTOLD = 0.75 / 3**0.5 / 12
#: Fewest pixels of a part, and most of all; share of the coarser contrast below which noise is most of it.
_FEWEST, _MOST, _FAINT = 64, 4096, 0.05


class Lens(NamedTuple):
    """Variance of a lens's blur, px^2 of the camera, and its standard deviation. Negative: the camera
    sharpens more, or its pixels do not fill their pitch."""

    variance: float
    sigma: float


#: Unknown lens: pixels may not fill their pitch.
NO_LENS = Lens(0.0, _UNTOLD)


def measured_lens(
    plan: Plan, lit: Sample, maps: list[NDArray[np.float32]], flags: NDArray[np.uint16], footprint: float
) -> Lens | None:
    """0 if not significant; None: less precise than a pixel's area is large. maps: coordinate (H, W) of every
    axis; flags (H, W); footprint: side of a pixel over its pitch."""
    some = lit.only(slice(None, None, 1 + len(lit.places) // (_MOST + 1)))
    of_axes = [_line(plan, *one, some, flags, footprint) for one in zip(plan.axes, maps, strict=True)]
    lines = [line for line in of_axes if line is not None]
    over, under = _sums(lines, *_FIT)
    if under.sum() <= 0:
        return None
    blur2, without = over.sum() / under.sum(), (over.sum() - over) / (under.sum() - under)
    others = np.array([np.divide(*_sums(lines, *other).sum(axis=1)) for other in _OTHERS])
    # jackknife
    error = float(np.sqrt((_PARTS - 1) * np.var(without) + np.max((others - blur2) ** 2)))
    if not error < _OWN:
        return None
    if _SURE * error < abs(blur2):
        return Lens(float(blur2), error)
    return Lens(0.0, min(float(np.hypot(error, blur2)), _UNTOLD))


class _Line(NamedTuple):
    """Sampled pixels of an axis: terms of the polynomial (10, K); for slopes over either reach (2, K),
    logarithms of contrast ratios less the pixel area's, and factors of blur2."""

    terms: F64
    logs: F64
    turns: F64


def _line(
    plan: Plan,
    axis: AxisPlan,
    coord: NDArray[np.float32],
    lit: Sample,
    flags: NDArray[np.uint16],
    footprint: float,
) -> _Line | None:
    """None without a coarser fringe, or with too few pixels."""
    beside = _coarser(plan, axis, lit)
    if beside is None:
        return None
    coarse, turns_coarse = beside
    fine, turns_fine = _contrast(axis.fringes[-1], lit), 1 / axis.fringes[-1].period
    row, col = lit.places.T
    rows, cols = coord.shape
    inside = (row >= 2) & (row < rows - 2) & (col >= 2) & (col < cols - 2)
    told = (coarse > 0) & (fine > _FAINT * coarse) & (lit.levels < lit.white).all(axis=0)
    kept = np.flatnonzero(inside & told)
    row, col = row[kept], col[kept]
    here = coord[row, col]
    good = (flags[row, col] == 0) & (np.minimum(here + 0.5, axis.extent - 0.5 - here) > MARGIN)
    logs, turns = np.empty((2, 2, len(kept)))
    for reach in (1, 2):
        ends = (row - reach, col), (row + reach, col), (row, col - reach), (row, col + reach)
        good &= np.all([flags[end] == 0 for end in ends], axis=0)
        up, down, left, right = (coord[end] for end in ends)
        slopes = np.stack([down - up, right - left]) / np.float32(2 * reach)
        good &= np.abs(slopes * turns_fine).max(axis=0) < _HALF
        with np.errstate(divide="ignore", invalid="ignore"):  # at slopes across edges
            own = np.prod(
                np.sinc(footprint * slopes * turns_fine) / np.sinc(footprint * slopes * turns_coarse), axis=0
            )
            logs[reach - 1] = np.log(fine[kept] / (coarse[kept] * own))
        turns[reach - 1] = -2 * np.pi**2 * (turns_fine**2 - turns_coarse**2) * np.square(slopes).sum(axis=0)
    if np.count_nonzero(good) < _FEWEST * _PARTS:
        return None
    line = _Line(_terms(row[good] / rows - 0.5, col[good] / cols - 0.5), logs[:, good], turns[:, good])
    off = _left(*_within(line, *_FIT))
    usual = np.flatnonzero(np.abs(off) < _TRIM * np.sqrt(np.mean(off**2)))
    return _Line(*(one[:, usual] for one in line))


def _coarser(plan: Plan, axis: AxisPlan, lit: Sample) -> tuple[F64, float] | None:
    """Contrast (K,) for the ratio to the finest fringe, and its turns per pattern pixel."""
    if not axis.fringes:
        return None
    if plan.white >= 0 and plan.black >= 0:
        return (lit.levels[plan.white].astype(np.float64) - lit.levels[plan.black]) / 2, 0.0
    if len(axis.fringes) == 1:
        return None
    return _contrast(axis.fringes[0], lit), 1 / axis.fringes[0].period


def _contrast(fringe: Fringe, lit: Sample) -> F64:
    _, c, s = fringe.inverse.astype(np.float32) @ lit.levels[list(fringe.index)]
    return np.asarray(np.hypot(c, s, dtype=np.float64))


def _terms(y: F64, x: F64) -> F64:
    """Terms to third order (10, K)."""
    y2, x2 = y * y, x * x
    return np.stack([np.ones(len(x)), y, x, y2, y * x, x2, y2 * y, y2 * x, y * x2, x2 * x])


def _within(line: _Line, count: int, reach: int) -> F64:
    """Logarithms, turns over a reach and over the other one (3, K), less their fitted polynomials."""
    terms = line.terms[:count]
    three = np.stack([line.logs[reach - 1], line.turns[reach - 1], line.turns[2 - reach]])
    shares = np.linalg.lstsq(terms @ terms.T, terms @ three.T, rcond=None)[0]
    return np.asarray(three - shares.T @ terms)


def _left(logs: F64, turns: F64, others: F64) -> F64:
    """Residuals of the logarithms (K,) from the line."""
    return np.asarray(logs - turns * (others @ logs / (others @ turns or 1.0)))


def _sums(lines: list[_Line], count: int, reach: int) -> F64:
    """Sums over every part of the sample (2, _PARTS): blur2 is their ratio."""
    sums = np.zeros((2, _PARTS))
    for line in lines:
        logs, turns, others = _within(line, count, reach)
        products = np.stack([others * logs, others * turns]) / np.mean(_left(logs, turns, others) ** 2)
        begin = np.arange(_PARTS) * len(logs) // _PARTS
        sums += np.add.reduceat(products, begin, axis=1)
    return sums
