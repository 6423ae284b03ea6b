"""How much a fringe is blurred: what its contrast has lost against white and black, or a coarser fringe."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .blur_kernels import Looked, Swing, Wave, contrasts, digest, sinc, swing_sums
from .plan import AxisPlan, Fringe, Plan
from .survey import SPOILT, Survey
from .swing import Blur, Contrasts, blur_by_swing, seems_to_swing

__all__ = ["measured_blur"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
F32 = np.float32
#: Columns sampled at most, rows and pixels at least.
_COLUMNS, _LEAST_ROWS, _FEWEST = 144, 3, 64
#: One of so many contrasts is asked first whether they swing.
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
    there = _contrasts(seen, lut, wanted, axis, _columns(width))
    told = _by_contrast(seen, there, wanted, axis)
    if told is not None:
        return told
    period = axis.fringes[-1].period
    if not seems_to_swing(_own(there[:, ::_EVERY]), period):
        return None
    return blur_by_swing(_own(there), period)


def _own(seen: F64) -> Contrasts:
    """Of contrasts (7, K) those over the offset."""
    return Contrasts(seen[4], seen[1], seen[2:4], seen[5:])


@lru_cache(maxsize=4)
def _columns(width: int) -> Map:
    """Those that are looked at: neighbours are asked, too."""
    return np.unique(np.linspace(2, width - 3, _COLUMNS).astype(int))


def _contrasts(seen: Survey, lut: Map, wanted: Plan, axis: AxisPlan, cols: Map) -> F64:
    """Of the finest fringe in those columns, (7, K): see blur_kernels.contrasts."""
    coord, fine = seen.lines(axis.axis), axis.fringes[-1]
    at = Looked(
        frames=seen.frames[:, : len(coord)],
        lut=lut if len(lut) else None,
        cols=cols,
        coord=coord,
        below=seen.below(axis.axis),
        apart=max(seen.apart, 1),
        flags=seen.flags,
        spoilt=SPOILT,
        clip=seen.clip,
        wide=_WIDE * fine.period,
        middle=0.5 * (axis.extent - 1),
        reach=(0.5 - _MARGIN) * axis.extent,
    )
    coarse = _coarse(wanted, axis)
    white = wanted.white if _referenced(wanted) else -1
    found = np.empty((7, coord.shape[0] * len(cols)))
    count = contrasts(
        at, _wave(fine), white, wanted.black, _wave(coarse) if coarse else None, np.empty((2, 3)), found
    )
    return found[:, :count]


def _coarse(wanted: Plan, axis: AxisPlan) -> Fringe | None:
    """The fringe with which the finest one is compared where white and black were not shown."""
    return None if _referenced(wanted) or len(axis.fringes) < 2 else axis.fringes[0]


def _by_contrast(seen: Survey, there: F64, wanted: Plan, axis: AxisPlan) -> Blur | None:
    """Blur of the finest fringe, None where its contrast does not tell.

    Contrast against white - black, or against the coarsest fringe = sinc(1/P) of the cells, sinc(w/P) of each
    side of a camera pixel's footprint (the local gradient of coord), exp(-2 (pi b / P)^2) of the blur, over
    the same of the coarsest fringe. A contrast higher than blur allows (nonlinear display or camera) tells
    nothing; nor does one that varies over the image by a tenth more than over a cell, nor fringes too alike.
    """
    fine, coarse, count = axis.fringes[-1], _coarse(wanted, axis), there.shape[1]
    if count < _FEWEST or not (coarse or _referenced(wanted)):
        return None
    usual, kept = np.empty(6), np.empty((2, count), F32)
    used = digest(there, kept, usual)
    *widths, low, middle, high, mean = usual.tolist()
    periods = [fine.period] if coarse is None else [fine.period, coarse.period]
    noise = _noise(seen, fine, coarse, middle)
    lever, by_chance = _lever(wanted, axis), noise / math.sqrt(count)
    square = _square_blur(kept[:, :used], mean, high - low, lever, periods, widths, noise)
    if square is None or (coarse and square * lever <= _TOLD * math.hypot(_UNSURE, by_chance)):
        return None
    return Blur(math.sqrt(square), math.hypot(0.5 * _UNSURE, by_chance) / lever)


def _noise(seen: Survey, fine: Fringe, coarse: Fringe | None, left: float) -> float:
    """Of a contrast of which that share is left, relative, rms; coarse: what it is compared with, None: white
    and black."""
    amplitude, offset = seen.usual_levels
    of_fine, of_whole = (_magnified(fringe) if fringe else 0.5 for fringe in (fine, coarse))
    variance = seen.noise.variance(offset) / amplitude**2
    return math.sqrt(variance * (of_fine + of_whole * left**2))


@lru_cache(maxsize=64)
def _magnified(fringe: Fringe) -> float:
    """Variance of a fit's amplitude, in that of a sample."""
    return 0.5 * float(np.sum(fringe.solve()[1:] ** 2))


@lru_cache(maxsize=64)
def _wave(fringe: Fringe) -> Wave:
    """As the kernels take it."""
    return fringe.period, np.array(fringe.index), fringe.solve()


def _square_blur(
    seen: Map,
    mean: float,
    spread: float,
    lever: float,
    periods: list[float],
    widths: list[float],
    noise: float,
) -> float | None:
    """Squared blur from what it left of contrasts: exp(-lever blur^2), and its swing.

    seen (2, K), float32: that, and places in their cells, without what lies far from most; mean: of the
    former, spread: distance of its quartiles; periods: of the fringe and, where white and black were not
    shown, of that against which its contrast is; noise: of a contrast, relative. None where the contrast
    varies by more than that and the cells explain.
    """
    # noise adds to amplitudes and to one over them; not the median: where the display is sharp, contrast
    # varies with the place
    mean /= 1 + 0.5 * noise**2
    if not 0 < mean < 1.02:
        return None
    square, shift = max(-math.log(mean) / lever, 0.0), np.zeros(seen.shape[1], F32)
    for _ in range(_ROUNDS):
        swing = sum(abs(_sideband(period, widths, square, -1)) for period in periods)
        if swing < _SLIGHT:
            break
        # pixels that keep step with the cells do not average the swing, and it tells of blur, too
        one, other = (_swinging(periods, widths, now, lever) for now in (square, square + _TRIAL))
        along, change = swing_sums(*seen, shift, periods[0], one, other)
        step = _TRIAL * along / change
        square = max(square + step, 0.0)
        if abs(step) * lever < _SLIGHT:
            break
    spread -= _QUARTILES * mean * swing
    return square if spread <= math.hypot(_VARIES, _NOISY * mean * noise) else None


def _swinging(periods: list[float], widths: list[float], square: float, lever: float) -> Swing:
    """What cells make of the contrast of periods[0], over that of the other one, as swing_sums takes it."""
    sides = [
        (_sideband(period, widths, square, 1), _sideband(period, widths, square, -1)) for period in periods
    ]
    (up, down), (coarse_up, coarse_down) = [*sides, (0.0, 0.0)][:2]
    left, fine = math.exp(-lever * square), (up + down, up - down)
    return F32(left), F32(fine[0]), F32(fine[1]), F32(coarse_up + coarse_down), F32(coarse_up - coarse_down)


def _sideband(period: float, widths: list[float], square: float, m: int) -> float:
    """Amplitude of the sideband of frequency 1 / period + m, |m| = 1, as a share of the fringe's."""
    f, side = 1 / period, 1 / period + m
    left = -f / side * math.exp(-2 * math.pi**2 * square * (side**2 - f**2))
    for width in widths:
        left *= sinc(side * width) / sinc(f * width)
    return left
