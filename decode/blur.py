"""How much a fringe is blurred: what its contrast has lost against white and black, or a coarser fringe."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .correspondence import Flag
from .plan import AxisPlan, Fringe, Plan

__all__ = ["measured_blur", "median_footprint", "surveyed_rows", "with_partners"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Rows and columns sampled at most, distance of the rows between which the gradient is taken.
_ROWS, _COLUMNS = 24, 192
_APART = 2
#: Differences that the footprint's median is taken of, about.
_FOOTPRINTS = 8192
_FEWEST = 64
#: Systematic error of a contrast's ratio that is always reckoned with; a square blur below so many times what
#: it makes is not told.
_UNSURE, _TOLD = 0.003, 3.0
#: Share of the surface at either end where its border takes light from fringes of different periods.
_MARGIN = 0.1
_SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)


def surveyed_rows(height: int, wanted: Plan) -> NDArray[np.int64]:
    """Rows r whose decoded coordinates, with those of r + 2, tell footprint and, if frames do, blur."""
    count = _ROWS if _tells_blur(wanted) else _ROWS // 3
    return np.unique(np.linspace(0, max(height - 1 - _APART, 0), count).astype(np.int64))


def _tells_blur(wanted: Plan) -> bool:
    return _referenced(wanted) or any(len(axis.fringes) > 1 for axis in wanted.axes)


def _referenced(wanted: Plan) -> bool:
    return wanted.white >= 0 and wanted.black >= 0


def with_partners(rows: NDArray[np.int64], height: int) -> NDArray[np.int64]:
    """The surveyed rows and those that their gradient is taken to."""
    both = np.unique(np.concatenate([rows, rows + _APART]))
    return both[both < height]


def median_footprint(coord: Map, rows: NDArray[np.int64]) -> float:
    """Median extent of a camera pixel in pattern cells, along both sides; at most 8."""
    lines = coord[rows]
    step = max(1, lines.size // _FOOTPRINTS)
    along = lines[:, 1::step] - lines[:, :-1:step]
    total = 0.0
    for change in (along, _down(coord[:, ::step], rows)):
        size = np.abs(change)
        sure = size[size < np.inf]
        total += float(np.partition(sure, len(sure) // 2)[len(sure) // 2]) if len(sure) else 0.0
    return min(total, 8.0)


def _down(coord: Map, rows: NDArray[np.int64]) -> Map:
    """Change of coord from one row to the next, at rows."""
    if coord.shape[0] <= _APART:
        return np.diff(coord, axis=0)
    return np.asarray((coord[rows + _APART] - coord[rows]) / _APART)


def measured_blur(
    stack: Map, lut: Map, wanted: Plan, axis: AxisPlan, coord: Map, flags: Map, rows: NDArray[np.int64]
) -> float | None:
    """Rms Gaussian blur of the finest fringe in cells, None where the frames do not tell.

    Contrast against white - black, or against the coarsest fringe = sinc(1/P) of the cells, sinc(w/P) of each
    side of a camera pixel's footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur, over
    the same of the coarsest fringe. A contrast higher than blur allows (nonlinear display or camera) tells
    nothing; nor does one that varies over the image by a tenth, nor fringes too alike.
    """
    whole = _referenced(wanted)
    if not (whole or len(axis.fringes) > 1) or min(coord.shape) < 5:
        return None
    cols = np.unique(np.linspace(2, coord.shape[1] - 3, _COLUMNS).astype(int))
    at = np.ix_(rows, cols)

    def levels(index: int) -> F64:
        values = stack[index][at]
        return np.asarray(lut[values] if len(lut) else values, np.float64)

    down = np.abs(_down(coord, rows)[:, cols])
    along = 0.25 * np.abs(coord[np.ix_(rows, cols + 2)] - coord[np.ix_(rows, cols - 2)])
    fine = axis.fringes[-1]
    if whole:
        least, coarse = 0.0, 0.5 * (levels(wanted.white) - levels(wanted.black))
    else:
        least = 1 / axis.fringes[0].period
        coarse = _amplitude(axis.fringes[0], levels) / _unblurred(axis.fringes[0].period, down, along)
    use = (flags[at] & _SPOILT == 0) & (down + along < 0.5 * fine.period) & (coarse > 0)
    use &= np.abs(coord[at] - 0.5 * (axis.extent - 1)) < (0.5 - _MARGIN) * axis.extent
    if np.count_nonzero(use) < _FEWEST:
        return None
    left = (_amplitude(fine, levels) / _unblurred(fine.period, down, along))[use] / coarse[use]
    square = _square_blur(left, 2 * np.pi**2 * (fine.period**-2 - least**2), whole)
    return None if square is None else float(np.sqrt(square))


def _amplitude(fringe: Fringe, levels: Callable[[int], F64]) -> F64:
    fit = np.linalg.pinv(fringe.design())
    seen = np.stack([levels(i) for i in fringe.index])
    return np.asarray(np.hypot(np.tensordot(fit[1], seen, 1), np.tensordot(fit[2], seen, 1)))


def _unblurred(period: float, down: F64, along: F64) -> F64:
    """What cells and footprint leave of the contrast."""
    return np.asarray(np.sinc(1 / period) * np.sinc(down / period) * np.sinc(along / period))


def _square_blur(left: F64, lever: float, whole: bool) -> float | None:
    """Squared blur from what it left of the contrast, exp(-lever blur^2)."""
    low, high = np.quantile(left, [0.25, 0.75])
    # mean, not median: where the display is sharp, contrast varies with the place in the cell
    mean = float(left[np.abs(left - 0.5 * (low + high)) <= 3 * (high - low) + 1e-3].mean())
    if not 0 < mean < 1.02 or high - low > 0.1:
        return None
    square = max(-np.log(min(mean, 1.0)) / lever, 0.0)
    return square if whole or square * lever > _TOLD * _UNSURE else None
