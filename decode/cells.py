"""The display's cells: read through a footprint smaller than a cell, a coordinate carries stairs.

A camera pixel that averages w cells of the map reads u + e(u) instead of u. Cells turn a fringe of P cells
into itself and sidebands of frequency 1/P + m,

    e = P / 2 pi arg(1 + sum over m of A_m exp(2 pi i m u)),   A_m = (-1)^m / (1 + m P) sinc((1/P + m) w) /
        sinc(w/P) T^(m^2 + 2 m / P),

T = exp(-2 (pi b)^2) being what a Gaussian blur of b cells leaves of a frequency of one per cell. For T = 1
and P >> 1, e is the sawtooth of the cells averaged over w, rms (1 - w) / sqrt(12): treads of 1 - w on which u
cannot be told, and risers between them on which it can. u + e(u) is inverted for u.

A coordinate that several periods share in has the mean of their stairs, weighed by their contrasts. A swept
stripe is a period of twice its width; grey values that are no fringe's are endless ones. T is measured where
nobody gave the blur (see gathering); where nothing tells it, the stairs that may be there go into sigma.
"""

from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows

from .gathering import Gathered, contradicted, gathered, largest_left, solve_stairs
from .plan import AxisPlan, Fringe
from .run_kernels import SOME, changes_down, large_variance
from .sample import quantile
from .stairs_kernels import Footprint, Points, undo_rows
from .swing import Blur
from .unwrap_kernels import MUCH_FINER

__all__ = ["Stairs", "given_stairs", "left_by", "read_stairs", "stairs_matter", "take_off_stairs"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Attenuation below which the stairs (under 0.003 px) are left out.
_NEGLIGIBLE = 0.012
#: Pixels on either side over which the gradient is taken, as stairs themselves must not count as gradient,
#: and share of the stairs' variance that is then reckoned as unknown, footprint and blur being estimates; T
#: up to which the gradient is taken again from coordinates without stairs.
_REACHES, _LOW = ((8, 0.02), (2, 0.005)), 0.4
#: Largest slope of stairs (-1 on a tread) that are inverted: steeper ones have no inverse, and usual noise
#: above so many cells reaches from a tread to a riser, so that places are distributed unlike noise.
_GENTLE, _UNEVEN, _NOISY = 0.8, 0.4, 0.02
#: Of stairs that are not known: widest footprint and step of a table, cells; share of sigma that is left out.
_WIDEST, _FINE, _SLIGHT = 4.0, 0.02, 0.2
#: Share of pixels whose stairs are no higher than those by which this is told; rows and columns, about, that
#: tell the usual sigma.
_MOST, _ROWS, _COLUMNS = 0.9, 8, 128
#: Harmonics of the stairs, at most; what blur leaves of one that does not matter.
_TERMS, _WEAK = 8, 1e-5


@dataclass(frozen=True, slots=True)
class Stairs:
    """Of one axis. shares (G, 2): periods, and their shares in the coordinate; left: T, 0 where it is not
    known; fill: footprint over gradient, below 1 where stairs are higher than a footprint that fills it
    allows; runs: of pixels, how they gather at cells; unsure: T's relative error; at_most: T where nothing
    tells more; told: something does, were it that it is 0; down: coordinates change down the columns.
    """

    shares: F64
    left: float
    fill: float
    runs: Gathered
    unsure: float = 0.0
    at_most: float = 0.0
    told: bool = False
    down: bool = False

    def known(self, left: float, unsure: float = 0.0) -> "Stairs":
        """With a T from elsewhere, unless these coordinates contradict it."""
        if self.left > 0 or left < _NEGLIGIBLE:
            return self
        if contradicted(left, self.runs, self.shares):
            return replace(self, told=True)
        return replace(self, left=left, unsure=unsure, told=True)

    def of_blur(self, blur: Blur | None) -> "Stairs":
        """With the T of a measured blur, if there is one, where the coordinates do not tell it."""
        if blur is None:
            return self
        return replace(self.known(left_by(blur.rms), 2 * np.pi**2 * blur.square_error), told=True)

    @property
    def largest(self) -> float:
        """T that these coordinates leave possible."""
        return largest_left(self.runs)

    def limited(self, at_most: float) -> "Stairs":
        """With a T that it does not exceed, where nothing tells it."""
        return self if self.told or self.left > 0 else replace(self, at_most=at_most)


def given_stairs(axis: AxisPlan, blur_px: float) -> Stairs:
    """Those of a known blur, rms in cells."""
    nothing = np.zeros(0)
    return Stairs(_shares(axis), left_by(blur_px), 1.0, Gathered(nothing, nothing, nothing), told=True)


def read_stairs(axis: AxisPlan, coord: Map, sigma: Map, flags: Map) -> Stairs:
    """What decoded maps (H, W) tell of them."""
    shares, down = _shares(axis), changes_down(coord.reshape(-1), coord.shape[1], np.empty(SOME, np.float32))
    runs = gathered(coord, sigma, flags, down)
    return Stairs(shares, *solve_stairs(runs, shares), runs, down=down)


def take_off_stairs(stairs: Stairs, extent: int, coord: Map, sigma: Map, flags: Map) -> None:
    """Undo the stairs in coord (H, W) and add to sigma (H, W) what cannot be undone, in place; extent: cells.

    To be called where they matter. The footprint is the local gradient of coord. A pixel that sees one cell
    only (a tread of the stairs) is put at its middle, with the rms (1 - w) / sqrt(12) of a place on it: see
    steep_kernels.
    """
    if stairs.left < _NEGLIGIBLE:
        _widen(stairs.at_most, coord, sigma)
        return
    points, seen, noise = _of_points(stairs), coord.copy(), sigma.copy()
    gentle = _UNEVEN if _usual(sigma) > _NOISY else _GENTLE
    # where the gradient changes, its mean is not the footprint; once low stairs are off, it can be had nearby
    for reach, doubt in _REACHES if stairs.left < _LOW else _REACHES[:1]:
        uneven = 0.0 if stairs.left < _LOW else stairs.left * 12**-0.5
        footprint = Footprint(stairs.fill, coord.copy(), reach, flags, uneven)
        rest = min(doubt + stairs.unsure**2, 1.0), gentle, float(extent), seen, coord, sigma
        sigma[...] = noise
        over_rows(partial(_undo, points, footprint, rest), len(coord), 64)


def stairs_matter(stairs: Stairs, coord: Map, sigma: Map) -> bool:
    """Whether there is anything to take off coord (H, W), or to add to sigma (H, W)."""
    if stairs.left >= _NEGLIGIBLE:
        return True
    if stairs.at_most < _NEGLIGIBLE:
        return False
    lines, table = (coord.reshape(-1), coord.shape[1], stairs.down), _squares()
    by_gradient = (_harmonics(stairs.at_most) ** 2 * table[:, 0]) @ table
    most = large_variance(*lines, _REACHES[0][0], by_gradient, 1 / _FINE, _MOST, np.empty(SOME, np.float32))
    return bool(most >= (_SLIGHT * _usual(sigma)) ** 2)


@cache
def _squares() -> F64:
    """What each harmonic (K,) of stairs that no blur has lowered may add to a coordinate's variance, by the
    footprint along one side (K, W); for both sides their product."""
    k = np.arange(1, _TERMS + 1)[:, None]
    return np.asarray(np.sinc(k * np.arange(0, _WIDEST, _FINE)) ** 2 / (np.sqrt(2) * np.pi * k))


def _harmonics(left: float) -> F64:
    """What a blur that leaves that much of the first harmonic's amplitude leaves of each (K,)."""
    return np.asarray(left ** np.arange(1, _TERMS + 1) ** 2)


def _widen(left: float, coord: Map, sigma: Map) -> None:
    """Add the stairs themselves to sigma, in place, where they may be there and nobody knows."""
    square = _harmonics(left)[:, None] * _squares()
    variance = square.T @ square

    def work(start: int, stop: int) -> None:
        rows = slice(start, stop)
        along, down = (_places(_least_gradient(coord, axis, rows)) for axis in (1, 0))
        sigma[rows] = np.sqrt(sigma[rows] ** 2 + variance[along, down])

    over_rows(work, len(coord), 64)


def _places(width: F64) -> NDArray[np.int64]:
    """Of footprints, in the table of variances."""
    return np.minimum(width / _FINE, _WIDEST / _FINE - 1).astype(np.int64)


def _least_gradient(coord: Map, axis: int, rows: slice) -> F64:
    """Size of coord's gradient (R, W), cells a pixel, along an image axis, in some rows: over a reach on that
    side where it is less, as pixels there may be wrong; 0: none."""
    reach, here = _REACHES[0][0], coord[rows]
    at = np.arange(coord.shape[axis])[rows if axis == 0 else slice(None)]
    sides = []
    for far in (np.maximum(at - reach, 0), np.minimum(at + reach, coord.shape[axis] - 1)):
        apart = np.abs(far - at).reshape(-1, 1) if axis == 0 else np.abs(far - at)
        step = np.abs((coord if axis == 0 else coord[rows]).take(far, axis) - here) / np.maximum(apart, 1)
        sides.append(np.where(apart > reach // 2, step, np.inf))
    return np.asarray(np.nan_to_num(np.fmin(*sides), posinf=0.0))


def _undo(points: Points, footprint: Footprint, rest: tuple[Any, ...], start: int, stop: int) -> None:
    undo_rows(start, stop, points, footprint, *rest)


def _shares(axis: AxisPlan) -> F64:
    """Periods whose mean a coordinate is, and their shares in it (G, 2), as in unwrap_kernels. A swept stripe
    is one period of a cosine; of free grey values, a pixel reads the mean of the cells that it sees."""
    if axis.levels or not axis.fringes:
        period = 2 * axis.stripes.width if axis.stripes and not axis.levels else axis.extent
        return np.array([[period, 1.0]])
    return _of_fringes(axis.fringes)


@lru_cache(maxsize=16)
def _of_fringes(fringes: tuple[Fringe, ...]) -> F64:
    periods = [fringe.period for fringe in fringes]
    first = max((g for g in range(1, len(periods)) if periods[g] * MUCH_FINER < periods[g - 1]), default=0)
    told = np.array([len(fringe.index) / fringe.period**2 for fringe in fringes[first:]])
    return np.stack([np.array(periods[first:]), told / told.sum()], axis=1)


def _of_points(stairs: Stairs) -> Points:
    """Periods, their shares by what cells and blur leave of them, and sidebands (G, 2, K) seen by a point."""
    (period, share), left = stairs.shares.T, stairs.left
    terms = np.arange(1, _TERMS + 1)
    # the strongest of each order is that of m = -k of the finest period
    seen = left ** (terms**2 - 2 * terms / period.min()) > _WEAK
    m = np.stack([terms, -terms])[:, : max(1, np.count_nonzero(seen))]
    heights = (-1.0) ** m * left ** (m**2 + 2 * m / period[:, None, None]) / (1 + m * period[:, None, None])
    weight = share * (np.sinc(1 / period) * left**period**-2) ** 2
    return Points(period, weight, heights)


def _usual(sigma: Map) -> float:
    """Of sigma (H, W); 0 where there is none."""
    some = sigma[:: max(1, len(sigma) // _ROWS), :: max(1, sigma.shape[1] // _COLUMNS)]
    known = some[some < np.inf]
    return quantile(known, 0.5) if len(known) else 0.0


def left_by(blur_px: float) -> float:
    """T of a Gaussian blur, rms in cells."""
    return float(np.exp(-2 * (np.pi * blur_px) ** 2))
