"""What the pattern's border does to fringes: light is missing beyond it.

Through a Gaussian of rms s (blur and pixel) at u, a fringe keeps of its complex amplitude
rho = 1 - sum_{k < 0} exp(i w (k - u)) W_k(u) / (sinc(1/P) exp(-(w s)^2 / 2)), W_k the light of cell k and
w = 2 pi / P: a share |rho| of its contrast and a shift arg(rho) / w away from the border. Periods are shifted
and dimmed by different amounts: their coordinate is the mean by what each then knows, and where they come to
disagree they are refused.

The decoder takes the shift off by a table for the usual pixel, with the blur that it knows: what a pixel and
the true blur differ by stays.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .fringes import DOUBT, MUCH_FINER, Fringe
from .view import Floats, View

Complex = NDArray[np.complex128]

#: Spreads from the border at which it does nothing.
FAR = 8.0
#: Cells that the decoder's table reaches beyond the outermost cell's centre, its entries per cell, and the
#: contrast left under which it has none.
BEYOND, PER_CELL, LEAST_LEFT = 4, 8, 0.2
#: Contrast that the decoder believes lost, above which it refuses a pixel; shift that it adds to its sigma;
#: distance beyond the border, as it reads it, that puts a pixel off the pattern.
REFUSED_LOST, LEAST_SHIFT, OFF = 0.03, 1e-3, 0.5
#: Sigmas of a Gaussian as rare as disagreement of periods that the decoder refuses.
DISAGREE = 5.0

__all__ = ["Border", "border_effect", "border_factor", "border_of", "kept_at_border", "usual_width"]


@dataclass(frozen=True, slots=True)
class Border:
    """Per pixel (H, W), along an axis: refused, the probability that the border makes the decoder refuse it;
    shift, what the decoder adds to sigma for it (cells); left, what stays of the true shift (cells, signed);
    gain, by what noise counts there: the shift is looked up where noise puts the pixel."""

    refused: Floats
    shift: Floats
    left: Floats
    gain: Floats


def border_factor(distance: Floats, spread: Floats | float, period: float) -> Complex:
    """rho at a distance (cells) inside one border; its phase is positive for a shift inwards."""
    turn, place = 2 * math.pi / period, np.asarray(distance) - 0.5
    missing = np.zeros(place.shape, np.complex128)
    reach = FAR * float(np.max(spread, initial=0.0)) - float(np.min(place, initial=0.0))
    right = ndtr((-0.5 - place) / spread)
    for cell in range(-1, -2 - math.ceil(reach), -1):
        left = ndtr((cell - 0.5 - place) / spread)
        missing += np.exp(1j * turn * (cell - place)) * (right - left)
        right = left
    return np.asarray(1 - missing / (np.sinc(1 / period) * np.exp(-0.5 * (turn * spread) ** 2)))


def border_effect(distance: Floats, spread: Floats | float, period: float) -> tuple[Floats, Floats]:
    """(share of the contrast lost, shift inwards in cells) at a distance (cells) inside one border."""
    rho = border_factor(distance, spread, period)
    return 1 - np.abs(rho), np.angle(rho) * period / (2 * math.pi)


def kept_at_border(view: View, axis: str, period: float) -> Complex:
    """rho of both borders together, (H, W); the phase is positive for a shift towards larger coordinates."""
    widths, coord = view.widths[axis], np.nan_to_num(view.coordinate(axis), nan=-FAR)
    spread = np.sqrt(view.scene.pattern.blur_px**2 + (widths[0] ** 2 + widths[1] ** 2) / 12 + 1e-6)
    kept = np.ones(coord.shape, np.complex128)
    low, high = coord + 0.5, view.extent(axis) - 0.5 - coord
    for distance, turned in ((low, False), (high, True)):
        near = distance < FAR * np.nan_to_num(spread)
        rho = border_factor(distance[near], spread[near], period)
        kept[near] += (rho.conj() if turned else rho) - 1
    return kept


def border_of(
    view: View, axis: str, groups: list[Fringe], kept: list[Complex], variances: list[Floats], blur: float
) -> Border:
    """Both borders of an axis together.

    groups: coarse to fine; kept: kept_at_border of each; variances (cells^2) of each, with what is left of
    their contrast; blur: what the decoder takes for it.
    """
    coord, extent = view.coordinate(axis), view.extent(axis)
    spread = math.sqrt(blur**2 + usual_width(view, axis) ** 2 / 12 + 1e-6)
    refused, shift, left = (np.zeros(coord.shape) for _ in range(3))
    gain = np.ones(coord.shape)
    touched = np.abs(np.stack(kept) - 1).max(axis=0) > 1e-9
    touched |= np.minimum(coord + 0.5, extent - 0.5 - coord) < FAR * spread
    touched &= np.isfinite(coord) & np.all(np.isfinite(variances), axis=0)
    if not touched.any():
        return Border(refused, shift, left, gain)
    away, doubtful = _seen(
        groups, [np.angle(rho[touched]) for rho in kept], [variance[touched] for variance in variances]
    )
    at, *columns = _table(groups, spread)
    place = coord[touched] + away
    taken, added, change = (np.zeros(away.shape) for _ in range(3))
    for sign, inside in ((1.0, place + 0.5), (-1.0, extent - 0.5 - place)):
        near = (inside >= at[0]) & (inside <= at[-1])
        own, told, lost, slope = (np.where(near, np.interp(inside, at, column), 0.0) for column in columns)
        taken, added, change = taken + sign * own, added + told**2, change + slope
        doubtful = np.where((lost > REFUSED_LOST) | (inside < -OFF), 1.0, doubtful)
    refused[touched], left[touched] = np.minimum(doubtful, 1.0), away - taken
    shift[touched], gain[touched] = np.sqrt(added), np.abs(1 - change)
    return Border(refused, shift, left, gain)


def _seen(groups: list[Fringe], phases: list[Floats], variances: list[Floats]) -> tuple[Floats, Floats]:
    """(shift of the coordinate in cells, probability that the periods are found to disagree), (K,)."""
    place = phases[0] * groups[0].period / (2 * math.pi)
    spread = variances[0]
    apart, doubtful = np.zeros(place.shape), np.zeros(place.shape)
    for before, group, phase, variance in zip(groups, groups[1:], phases[1:], variances[1:], strict=False):
        period = group.period
        step = phase * period / (2 * math.pi) - place
        step = step - period * np.rint(step / period)
        both = spread + variance
        apart += step**2 / both
        least = 0.5 * period + both * math.log(DOUBT) / period
        doubtful += ndtr((np.abs(step) - least) / np.sqrt(both)) - ndtr(-least / np.sqrt(both))
        alone = MUCH_FINER * period < before.period
        weight = np.ones(place.shape) if alone else spread / both
        place, spread = place + weight * step, weight * variance
    return place, doubtful + _disagree(apart, len(groups) - 1)


def _disagree(apart: Floats, freedom: int) -> Floats:
    """Probability that chi squared, `apart` without noise, exceeds what noise alone does once in DISAGREE
    sigmas (Wilson and Hilferty 1931). Its root is Gaussian of rms 1 about sqrt(apart + freedom - 1), for one
    degree of freedom exactly."""
    if freedom < 1:
        return np.zeros(apart.shape)
    part = 2 / (9 * freedom)
    limit = freedom * (1 - part + DISAGREE * math.sqrt(part)) ** 3
    return np.where(apart > 0.1, ndtr(np.sqrt(apart + freedom - 1) - math.sqrt(limit)), 0.0)


def _table(groups: list[Fringe], spread: float) -> tuple[Floats, ...]:
    """What the decoder looks up at a distance (cells, as it reads it) inside a border: distances, shift to
    take off, what of it goes into sigma (cells), share of the contrast that it believes lost, slope of the
    shift."""
    reach = FAR * spread + 1
    true = np.arange(-BEYOND - 4 * spread, reach, 1 / PER_CELL)
    at = np.arange(0.5 - BEYOND, reach, 1 / PER_CELL)
    finer = [g for g in range(1, len(groups)) if groups[g].period * MUCH_FINER < groups[g - 1].period]
    total, information = np.zeros((2, len(at))), np.zeros(len(at))
    for group in groups[max(finer, default=0) :]:
        lost, shift = border_effect(true, spread, group.period)
        lit = lost < 1 - LEAST_LEFT
        read = np.maximum.accumulate(true[lit] + shift[lit])
        parts = np.stack([np.interp(at, read, part[lit]) for part in (shift, lost)])
        blurred = math.exp(-2 * (math.pi * spread / group.period) ** 2)
        contrast = np.maximum(1 - parts[1], LEAST_LEFT) * blurred
        own = len(group.shifts) * (contrast / group.period) ** 2
        information += own
        total += own / information * (parts - total)
    shift, lost = total
    # inside the innermost place where it does something, the decoder neither widens sigma nor refuses
    reached = np.flatnonzero((np.abs(shift) > LEAST_SHIFT) | (lost > REFUSED_LOST))
    outer = at <= (at[reached[-1]] if len(reached) else -math.inf)
    told = np.where(outer & (np.abs(shift) > LEAST_SHIFT), shift, 0.0)
    return at, shift, told, np.where(outer, lost, 0.0), np.gradient(shift, at)


def usual_width(view: View, axis: str) -> float:
    """The width of a pixel (cells) that the decoder assumes for all."""
    return sum(float(np.median(width[view.visible])) for width in view.widths[axis])
