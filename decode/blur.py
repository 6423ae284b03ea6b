"""How much a fringe is blurred: what its contrast has lost against white and black, or a coarser fringe."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .correspondence import Flag
from .plan import AxisPlan, Fringe, Plan
from .sample import quantile
from .survey import Survey

__all__ = ["measured_blur", "tells_blur"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Columns sampled at most, rows and pixels at least.
_COLUMNS, _LEAST_ROWS, _FEWEST = 144, 3, 64
#: Systematic error of a contrast's ratio that is always reckoned with; a square blur below so many times what
#: it makes is not told.
_UNSURE, _TOLD = 0.003, 3.0
#: Variation of the contrast over the image (its quartiles) above which it tells nothing, and what cells alone
#: make of it: quartiles of a sine lie so many amplitudes apart.
_VARIES, _QUARTILES = 0.1, 1.5
#: Footprint over period up to which what it leaves of the contrast is known well enough.
_WIDE = 0.7
#: Steps in which blur and swing are found.
_ROUNDS = 4
#: Share of the surface at either end where its border takes light from fringes of different periods.
_MARGIN = 0.1
_SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)


def tells_blur(wanted: Plan) -> bool:
    """Whether frames of that plan may tell how blurred their fringes are."""
    return _referenced(wanted) or any(len(axis.fringes) > 1 for axis in wanted.axes)


def _referenced(wanted: Plan) -> bool:
    return wanted.white >= 0 and wanted.black >= 0


def measured_blur(seen: Survey, lut: Map, wanted: Plan, axis: AxisPlan) -> float | None:
    """Rms Gaussian blur of the finest fringe in cells, None where the frames do not tell.

    Contrast against white - black, or against the coarsest fringe = sinc(1/P) of the cells, sinc(w/P) of each
    side of a camera pixel's footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur, over
    the same of the coarsest fringe. A contrast higher than blur allows (nonlinear display or camera) tells
    nothing; nor does one that varies over the image by a tenth more than over a cell, nor fringes too alike.
    """
    whole = _referenced(wanted)
    coord = seen.lines(axis.axis)
    rows, width = coord.shape
    if not (whole or len(axis.fringes) > 1) or rows < _LEAST_ROWS or width < 5:
        return None
    cols = np.unique(np.linspace(2, width - 3, _COLUMNS).astype(int))

    levels = _levels(seen.frames[:, :rows], cols, lut)
    down = np.abs(seen.down(axis.axis, cols))
    along = 0.25 * np.abs(coord[:, cols + 2] - coord[:, cols - 2])
    fine = axis.fringes[-1]
    if whole:
        least, coarse = 0.0, 0.5 * (levels(wanted.white) - levels(wanted.black))
    else:
        least = 1 / axis.fringes[0].period
        coarse = _amplitude(axis.fringes[0], levels) / _unblurred(axis.fringes[0].period, down, along)
    use = (seen.flags[:, cols] & _SPOILT == 0) & (down + along < _WIDE * fine.period) & (coarse > 0)
    use &= np.abs(coord[:, cols] - 0.5 * (axis.extent - 1)) < (0.5 - _MARGIN) * axis.extent
    if np.count_nonzero(use) < _FEWEST:
        return None
    left = (_amplitude(fine, levels) / _unblurred(fine.period, down, along))[use] / coarse[use]
    widths = [float(np.median(width[use])) for width in (down, along)]
    lever = 2 * np.pi**2 * (fine.period**-2 - least**2)
    square = _square_blur(left, coord[:, cols][use], lever, whole, fine.period, widths)
    return None if square is None else float(np.sqrt(square))


def _levels(frames: Map, cols: NDArray[np.int64], lut: Map) -> Callable[[int], F64]:
    """Linear levels of a frame at the columns."""

    def levels(index: int) -> F64:
        values = frames[index][:, cols]
        return np.asarray(lut[values] if len(lut) else values, np.float64)

    return levels


def _amplitude(fringe: Fringe, levels: Callable[[int], F64]) -> F64:
    _, of_cosine, of_sine = fringe.solve()
    c = s = np.zeros(())
    for k, index in enumerate(fringe.index):
        level = levels(index)
        c, s = c + of_cosine[k] * level, s + of_sine[k] * level
    return np.asarray(np.hypot(c, s))


def _unblurred(period: float, down: F64, along: F64) -> F64:
    """What cells and footprint leave of the contrast."""
    return np.asarray(np.sinc(1 / period) * np.sinc(down / period) * np.sinc(along / period))


def _square_blur(
    left: F64, place: F64, lever: float, whole: bool, period: float, widths: list[float]
) -> float | None:
    """Squared blur from what it left of the contrast at places (K,): exp(-lever blur^2), and its swing."""
    low, high = quantile(left, 0.25), quantile(left, 0.75)
    used = np.abs(left - 0.5 * (low + high)) <= 3 * (high - low) + 1e-3
    left, seen = left[used], place[used]
    # pixels that keep step with the cells do not average the swing: first without it, then with it
    height, shift = np.ones(1), np.zeros(1)
    for _ in range(_ROUNDS):
        # mean, not median: where the display is sharp, contrast varies with the place in the cell
        mean = float((left / height).mean())
        if not 0 < mean < 1.02:
            return None
        square = max(-np.log(min(mean, 1.0)) / lever, 0.0)
        height, shift = _cells(period, widths, square, seen - shift)
    if high - low > _VARIES + _QUARTILES * mean * abs(_sideband(period, widths, square, -1)):
        return None
    return square if whole or square * lever > _TOLD * _UNSURE else None


def _cells(period: float, widths: list[float], square: float, place: F64) -> tuple[F64, F64]:
    """What cells make of a fringe at places: of its amplitude 1 and the nearest sidebands (see cells), as its
    size, and as the shift that its angle is.
    """
    angle = (2 * np.pi * (place - np.rint(place))).astype(np.float32)  # five times as fast, exact to 1e-7
    one, other = (_sideband(period, widths, square, m) for m in (1, -1))
    real, imag = 1 + (one + other) * np.cos(angle), (one - other) * np.sin(angle)
    return np.hypot(real, imag), np.arctan2(imag, real) * (period / (2 * np.pi))


def _sideband(period: float, widths: list[float], square: float, m: int) -> float:
    """Amplitude of the sideband of frequency 1 / period + m, |m| = 1, as a share of the fringe's."""
    f, side = 1 / period, 1 / period + m
    left = -f / side * np.exp(-2 * np.pi**2 * square * (side**2 - f**2))
    for width in widths:
        left *= np.sinc(side * width) / np.sinc(f * width)
    return float(left)
