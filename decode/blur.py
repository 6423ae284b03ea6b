"""How much a fringe is blurred: what its contrast has lost against white and black, or a coarser fringe."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .blur_kernels import Swing, Wave, contrasts, sinc, swing_sums
from .correspondence import Flag
from .plan import AxisPlan, Fringe, Plan
from .sample import quantile
from .survey import Survey
from .swing import Blur, Contrasts, blur_by_swing, seems_to_swing

__all__ = ["measured_blur"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
F32 = np.float32
#: Columns sampled at most, rows and pixels at least.
_COLUMNS, _LEAST_ROWS, _FEWEST = 144, 3, 64
#: Of the columns, one of so many is asked first whether a contrast swings.
_EVERY = 4
#: Systematic error of a contrast's ratio that is always reckoned with; a square blur below so many times what
#: it makes is not told.
_UNSURE, _TOLD = 0.003, 3.0
#: Variation of the contrast over the image (its quartiles) above which it tells nothing, and what cells alone
#: make of it: quartiles of a sine lie so many amplitudes apart.
_VARIES, _QUARTILES = 0.1, 1.5
#: The same of noise: quartiles of the normal distribution, in its deviations.
_NOISY = 1.35
#: Footprint over period up to which what it leaves of the contrast is known well enough.
_WIDE = 0.7
#: Steps in which blur and swing are found, at most; step of the squared blur by which it is told what they
#: change; swing, and change of the contrast, that do not matter.
_ROUNDS, _TRIAL, _SLIGHT = 6, 0.01, 1e-3
#: Share of the surface at either end where its border takes light from fringes of different periods.
_MARGIN = 0.1
_SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)


def _referenced(wanted: Plan) -> bool:
    return wanted.white >= 0 and wanted.black >= 0


def _lever(wanted: Plan, axis: AxisPlan) -> float:
    """What a squared blur takes from the logarithm of the contrast that is compared."""
    least = 0.0 if _referenced(wanted) else axis.fringes[0].period ** -2
    return float(2 * np.pi**2 * (axis.fringes[-1].period ** -2 - least))


def measured_blur(seen: Survey, lut: Map, wanted: Plan, axis: AxisPlan) -> Blur | None:
    """Blur of the finest fringe, None where the frames do not tell: by its contrast against another one, or
    else by how that swings with the place in the cell (see swing)."""
    rows, width = seen.lines(axis.axis).shape
    if rows < _LEAST_ROWS or width < 5:
        return None
    cols = np.unique(np.linspace(2, width - 3, _COLUMNS).astype(int))
    told = _by_contrast(seen, lut, wanted, axis, cols)
    if told is not None:
        return told
    period = axis.fringes[-1].period
    if not seems_to_swing(_contrasts(seen, lut, axis, cols[::_EVERY]), period):
        return None
    return blur_by_swing(_contrasts(seen, lut, axis, cols), period)


def _contrasts(seen: Survey, lut: Map, axis: AxisPlan, cols: Map) -> Contrasts:
    """Amplitude over offset of the finest fringe in those columns."""
    coord, fringe = seen.lines(axis.axis), axis.fringes[-1]
    raw = seen.frames[list(fringe.index), : len(coord)][:, :, cols]
    levels = lut[raw] if len(lut) else raw.astype(np.float64)
    offset, c, s = np.einsum("kn,nrc->krc", fringe.solve(), levels)
    place = coord[:, cols]
    down = np.abs(seen.below(axis.axis)[:, cols] - place) / max(seen.apart, 1)
    along = 0.25 * np.abs(coord[:, cols + 2] - coord[:, cols - 2])
    use = (seen.flags[:, cols] & _SPOILT == 0) & (down + along < _WIDE * fringe.period) & (offset > 0)
    use &= raw.max(axis=0) < seen.clip
    use &= np.abs(place - 0.5 * (axis.extent - 1)) < (0.5 - _MARGIN) * axis.extent
    at = np.meshgrid(*(np.linspace(-1, 1, n) for n in use.shape), indexing="ij")
    return Contrasts(
        np.hypot(c, s)[use] / offset[use], place[use], np.stack([down, along])[:, use], np.stack(at)[:, use]
    )


def _by_contrast(seen: Survey, lut: Map, wanted: Plan, axis: AxisPlan, cols: Map) -> Blur | None:
    """Blur of the finest fringe, None where its contrast does not tell.

    Contrast against white - black, or against the coarsest fringe = sinc(1/P) of the cells, sinc(w/P) of each
    side of a camera pixel's footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur, over
    the same of the coarsest fringe. A contrast higher than blur allows (nonlinear display or camera) tells
    nothing; nor does one that varies over the image by a tenth more than over a cell, nor fringes too alike.
    """
    whole = _referenced(wanted)
    coord = seen.lines(axis.axis)
    if not (whole or len(axis.fringes) > 1):
        return None
    fine, coarse = axis.fringes[-1], None if whole else axis.fringes[0]
    room = np.empty((4, len(coord) * len(cols)))
    count = contrasts(
        *(seen.frames[:, : len(coord)], lut if len(lut) else None, cols),
        *(_wave(fine), wanted.white, wanted.black),
        *(_wave(coarse) if coarse else None, coord, seen.below(axis.axis), max(seen.apart, 1)),
        *(seen.flags, _SPOILT, seen.clip, _WIDE),
        *(0.5 * (axis.extent - 1), (0.5 - _MARGIN) * axis.extent, room),
    )
    if count < _FEWEST:
        return None
    left, place, *sides = room[:, :count]
    widths = [quantile(side, 0.5) for side in sides]
    periods = [fine.period] if coarse is None else [fine.period, coarse.period]
    noise = _noise(seen, fine, coarse, quantile(left, 0.5))
    lever, by_chance = _lever(wanted, axis), noise / np.sqrt(count)
    square = _square_blur(left, place, lever, periods, widths, noise)
    if square is None or (coarse and square * lever <= _TOLD * np.hypot(_UNSURE, by_chance)):
        return None
    return Blur(float(np.sqrt(square)), float(np.hypot(0.5 * _UNSURE, by_chance)) / lever)


def _noise(seen: Survey, fine: Fringe, coarse: Fringe | None, left: float) -> float:
    """Of a contrast of which that share is left, relative, rms; coarse: what it is compared with, None: white
    and black."""
    step = max(1, seen.flags.shape[1] // _COLUMNS)
    use = seen.flags[:, ::step] & _SPOILT == 0
    if not use.any():
        step, use = 1, seen.flags & _SPOILT == 0
    amplitude, offset = (quantile(chart[: len(use), ::step][use], 0.5) for chart in seen.maps.common[1:3])
    of_fine, of_whole = (
        0.5 * float(np.sum(fringe.solve()[1:] ** 2)) if fringe else 0.5 for fringe in (fine, coarse)
    )
    variance = seen.noise.variance(offset) / amplitude**2
    return float(np.sqrt(variance * (of_fine + of_whole * left**2)))


def _wave(fringe: Fringe) -> Wave:
    """Its period, frames (N,) and what they weigh in cosine and sine (2, N)."""
    return fringe.period, np.array(fringe.index), fringe.solve()[1:]


def _square_blur(
    left: F64, place: F64, lever: float, periods: list[float], widths: list[float], noise: float
) -> float | None:
    """Squared blur from what it left of the contrast at places (K,): exp(-lever blur^2), and its swing.

    periods: of the fringe and, where no white and black were shown, of that against which its contrast is;
    noise: of a contrast, relative. None where the contrast varies by more than that and the cells explain.
    """
    low, high = quantile(left, 0.25), quantile(left, 0.75)
    used = np.abs(left - 0.5 * (low + high)) <= 3 * (high - low) + 1e-3
    left, seen = left[used], place[used]
    # noise adds to amplitudes and to one over them; not the median: where the display is sharp, contrast
    # varies with the place
    mean = float(left.mean()) / (1 + 0.5 * noise**2)
    if not 0 < mean < 1.02:
        return None
    square = max(-np.log(mean) / lever, 0.0)
    shift = np.zeros(len(left), np.float32)
    values = left.astype(np.float32), (seen - np.rint(seen)).astype(np.float32), shift
    for _ in range(_ROUNDS):
        swing = sum(abs(_sideband(period, widths, square, -1)) for period in periods)
        if swing < _SLIGHT:
            break
        # pixels that keep step with the cells do not average the swing, and it tells of blur, too
        one, other = (_swinging(periods, widths, now, lever) for now in (square, square + _TRIAL))
        along, change = swing_sums(*values, periods[0], one, other)
        step = _TRIAL * along / change
        square = max(square + step, 0.0)
        if abs(step) * lever < _SLIGHT:
            break
    spread = high - low - _QUARTILES * mean * swing
    return square if spread <= np.hypot(_VARIES, _NOISY * mean * noise) else None


def _swinging(periods: list[float], widths: list[float], square: float, lever: float) -> Swing:
    """What cells make of the contrast of periods[0], over that of the other one, as swing_sums takes it."""
    sides = [
        (_sideband(period, widths, square, 1), _sideband(period, widths, square, -1)) for period in periods
    ]
    (up, down), (coarse_up, coarse_down) = [*sides, (0.0, 0.0)][:2]
    left, fine = np.exp(-lever * square), (up + down, up - down)
    return F32(left), F32(fine[0]), F32(fine[1]), F32(coarse_up + coarse_down), F32(coarse_up - coarse_down)


def _sideband(period: float, widths: list[float], square: float, m: int) -> float:
    """Amplitude of the sideband of frequency 1 / period + m, |m| = 1, as a share of the fringe's."""
    f, side = 1 / period, 1 / period + m
    left = -f / side * math.exp(-2 * math.pi**2 * square * (side**2 - f**2))
    for width in widths:
        left *= sinc(side * width) / sinc(f * width)
    return left
