"""How much a fringe is blurred: what its contrast has lost against white and black."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .correspondence import Flag
from .plan import AxisPlan, Plan

__all__ = ["measured_blur"]

Map = NDArray[Any]
#: Pixels sampled along each side of the image.
_SAMPLES = 96
_FEWEST = 64
_SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)


def measured_blur(stack: Map, lut: Map, wanted: Plan, axis: AxisPlan, coord: Map, flags: Map) -> float | None:
    """Rms Gaussian blur of the finest fringe in cells, None where the frames do not tell.

    Contrast against white - black = sinc(1/P) of the cells, sinc(w/P) of each side of a camera pixel's
    footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur. A contrast higher than blur
    allows (nonlinear display or camera) tells nothing; nor does one that varies over the image by a tenth.
    """
    if wanted.white < 0 or wanted.black < 0:
        return None
    fringe = axis.fringes[-1]
    rows, cols = (np.unique(np.linspace(2, size - 3, _SAMPLES).astype(int)) for size in coord.shape)
    if min(coord.shape) < 5:
        return None
    at = np.ix_(rows, cols)

    def levels(index: int) -> NDArray[np.float64]:
        values = stack[index][at]
        return np.asarray(lut[values] if len(lut) else values, np.float64)

    half = 0.5 * (levels(wanted.white) - levels(wanted.black))
    fit = np.linalg.pinv(fringe.design())
    seen = np.stack([levels(i) for i in fringe.index])
    amplitude = np.hypot(np.tensordot(fit[1], seen, 1), np.tensordot(fit[2], seen, 1))
    down = 0.25 * np.abs(coord[np.ix_(rows + 2, cols)] - coord[np.ix_(rows - 2, cols)])
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
