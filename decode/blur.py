"""How much a fringe is blurred: what its contrast has lost against white and black."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .correspondence import Flag
from .plan import AxisPlan, Plan

__all__ = ["measured_blur", "median_footprint", "surveyed_rows", "with_partners"]

Map = NDArray[Any]
#: Rows and columns sampled at most, distance of the rows between which the gradient is taken.
_ROWS, _COLUMNS = 24, 384
_APART = 2
#: Differences that the footprint's median is taken of, about.
_FOOTPRINTS = 8192
_FEWEST = 64
_SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)


def surveyed_rows(height: int, wanted: Plan) -> NDArray[np.int64]:
    """Rows r whose decoded coordinates, with those of r + 2, tell footprint and, given references, blur."""
    count = _ROWS if _tells_blur(wanted) else _ROWS // 3
    return np.unique(np.linspace(0, max(height - 1 - _APART, 0), count).astype(np.int64))


def _tells_blur(wanted: Plan) -> bool:
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

    Contrast against white - black = sinc(1/P) of the cells, sinc(w/P) of each side of a camera pixel's
    footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur. A contrast higher than blur
    allows (nonlinear display or camera) tells nothing; nor does one that varies over the image by a tenth.
    """
    if not _tells_blur(wanted) or min(coord.shape) < 5:
        return None
    fringe = axis.fringes[-1]
    cols = np.unique(np.linspace(2, coord.shape[1] - 3, _COLUMNS).astype(int))
    at = np.ix_(rows, cols)

    def levels(index: int) -> NDArray[np.float64]:
        values = stack[index][at]
        return np.asarray(lut[values] if len(lut) else values, np.float64)

    half = 0.5 * (levels(wanted.white) - levels(wanted.black))
    fit = np.linalg.pinv(fringe.design())
    seen = np.stack([levels(i) for i in fringe.index])
    amplitude = np.hypot(np.tensordot(fit[1], seen, 1), np.tensordot(fit[2], seen, 1))
    down = np.abs(_down(coord, rows)[:, cols])
    along = 0.25 * np.abs(coord[np.ix_(rows, cols + 2)] - coord[np.ix_(rows, cols - 2)])
    period = fringe.period
    sharp = half * np.sinc(1 / period) * np.sinc(down / period) * np.sinc(along / period)
    fine = (flags[at] & _SPOILT == 0) & (down + along < 0.5 * period) & (half > 0)
    if np.count_nonzero(fine) < _FEWEST:
        return None
    left = amplitude[fine] / sharp[fine]
    low, high = np.quantile(left, [0.25, 0.75])
    # mean, not median: where the display is sharp, contrast varies with the place in the cell
    mean = float(left[np.abs(left - 0.5 * (low + high)) <= 3 * (high - low) + 1e-3].mean())
    if not 0 < mean < 1.02 or high - low > 0.1:
        return None
    return float(period / (np.pi * np.sqrt(2)) * np.sqrt(max(-np.log(min(mean, 1.0)), 0.0)))
