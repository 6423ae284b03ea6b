"""What the pattern's border does to fringes: light is missing beyond it.

Through a Gaussian of rms s and a pixel of b cells at u, a fringe keeps of its complex amplitude rho = 1 -
sum_{k < 0} exp(i w (k - u)) W_k(u) / (sinc(1/P) sinc(b/P) exp(-(w s)^2 / 2)), W_k the light of cell k and
w = 2 pi / P: a share |rho| of its contrast and a shift arg(rho) / w away from the border. Periods are shifted
and dimmed by different amounts: their coordinate is the mean by what each then knows, and where they come to
disagree they are refused.

The decoder takes the shift off by a table for the usual pixel, with the blur that it knows: what a pixel and
the true blur differ by stays.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.decode import border_table
from optolever.patterns import Sequence

from .border_draws import drawn_at_border, entry_of
from .cells import combined_errors, seen_sidebands, seen_stairs
from .fringes import DOUBT, MUCH_FINER, Fringe
from .view import Floats, View

Complex = NDArray[np.complex128]

#: Spreads from the border at which it does nothing.
FAR = 8.0
#: Distance beyond the border (cells), as the decoder reads it, that puts a pixel off the pattern.
OFF = 0.5
#: Cells from its reach in the decoder's table, as that knows it, at which the border is reckoned with.
NEAR = 2.0
#: Sigmas of a Gaussian as rare as disagreement of periods that the decoder refuses.
DISAGREE = 5.0
#: Light lost beyond the border above which a pixel is left out of every figure: what is made of it there is a
#: matter of the border, not of the code.
MOST_LOST = 0.01
#: Pixels that are refused in more of the draws than the first and fewer than the second are drawn.
PARTLY, SURELY = 1e-3, 1 - 1e-4
#: Contrast that a pixel leaves at least, where a share of it is told; width of a pixel without one, cells.
LEAST_KEPT, POINT = 0.05, 1e-3

__all__ = [
    "MOST_LOST",
    "Border",
    "border_factor",
    "border_loss",
    "border_of",
    "density",
    "kept_at_border",
    "usual_width",
]


@dataclass(frozen=True, slots=True)
class Border:
    """Per pixel (H, W), along an axis: refused, the probability that the border makes the decoder refuse it;
    shift, what the decoder adds to sigma for it (cells); left, what stays of the true shift (cells, signed);
    gain, by what noise counts there: the shift is looked up where noise puts the pixel."""

    refused: Floats
    shift: Floats
    left: Floats
    gain: Floats

    def or_so(self, other: "Border", times: float = 1.0) -> "Border":
        """Where what is left may as well be so many times as far off as that of `other`, on either side."""
        apart = np.where(self.refused > PARTLY, 0.0, times * (other.left - self.left))
        return replace(self, left=np.copysign(np.hypot(self.left, apart), self.left))


def border_factor(
    distance: Floats, spread: Floats | float, period: float, width: Floats | float = 0.0
) -> Complex:
    """rho at a distance (cells) inside one border; its phase is positive for a shift inwards."""
    turn, place = 2 * math.pi / period, np.asarray(distance) - 0.5
    missing = np.zeros(place.shape, np.complex128)
    reach = _reach(spread, width) - float(np.min(place, initial=0.0))
    right = _light_beyond(-0.5 - place, spread, width)
    for cell in range(-1, -2 - math.ceil(reach), -1):
        left = _light_beyond(cell - 0.5 - place, spread, width)
        missing += np.exp(1j * turn * (cell - place)) * (right - left)
        right = left
    kept = np.sinc(1 / period) * np.maximum(np.sinc(width / period), LEAST_KEPT)
    return np.asarray(1 - missing / (kept * np.exp(-0.5 * (turn * spread) ** 2)))


def _reach(spread: Floats | float, width: Floats | float) -> float:
    """Distance (cells) from which on the border does nothing."""
    return float(np.max(FAR * np.asarray(spread) + 0.5 * np.asarray(width), initial=0.0))


def _light_beyond(place: Floats, spread: Floats | float, width: Floats | float) -> Floats:
    """Share of the light from below a place (cells from the pixel's middle): Gaussian and box."""
    box = np.maximum(width, POINT)

    def integral(at: Floats) -> Floats:
        """Of the normal distribution."""
        z = at / spread
        return np.asarray(at * ndtr(z) + spread * density(z))

    return np.asarray((integral(place + 0.5 * box) - integral(place - 0.5 * box)) / box)


def kept_at_border(view: View, axis: str, period: float) -> Complex:
    """rho of both borders together, (H, W); the phase is positive for a shift towards larger coordinates."""
    return view.kept(("border", axis, period), lambda: _kept_at_border(view, axis, period))


def _kept_at_border(view: View, axis: str, period: float) -> Complex:
    coord = np.nan_to_num(view.coordinate(axis), nan=-FAR)
    # of a pixel's two sides one is the longer, as a rule by far
    width, other = (np.nan_to_num(side(*view.widths[axis])) for side in (np.maximum, np.minimum))
    spread = np.sqrt(view.scene.pattern.blur_px**2 + other**2 / 12 + 1e-6)
    kept = np.ones(coord.shape, np.complex128)
    low, high = coord + 0.5, view.extent(axis) - 0.5 - coord
    for distance, turned in ((low, False), (high, True)):
        near = distance < FAR * spread + 0.5 * width
        rho = border_factor(distance[near], spread[near], period, width[near])
        kept[near] += (rho.conj() if turned else rho) - 1
    return kept


def border_of(
    view: View,
    axis: str,
    sequence: Sequence,
    groups: list[Fringe],
    variances: list[Floats],
    noise: Floats,
    blur: float | None,
) -> Border:
    """Both borders of an axis together.

    groups: the sequence's fringes, coarse to fine; variances (cells^2) of each, with what is left of their
    contrast; noise: rms, of the coordinate; blur: what the decoder takes for it.
    """
    coord, extent = view.coordinate(axis), view.extent(axis)
    table = border_table(sequence, axis, usual_width(view, axis), blur)
    refused, shift, left = (np.zeros(coord.shape) for _ in range(3))
    gain = np.ones(coord.shape)
    kept = [kept_at_border(view, axis, group.period) for group in groups]
    cells = [seen_sidebands(view, axis, group.period) for group in groups]
    touched = np.abs(np.stack(kept) - 1).max(axis=0) > 1e-9
    reached = table.at[table.told | table.refused]
    middle = 0.5 * (extent - 1)
    inner = reached[reached < middle].max(initial=-1.0), reached[reached > middle].min(initial=extent)
    touched |= (coord < inner[0] + NEAR) | (coord > inner[1] - NEAR)
    touched &= np.isfinite(coord) & np.all(np.isfinite(variances), axis=0)
    if not touched.any():
        return Border(refused, shift, left, gain)
    phases = [np.angle((rho + whole - 1)[touched]) for rho, whole in zip(kept, cells, strict=True)]
    spreads = [variance[touched] for variance in variances]
    away, doubtful = _seen(groups, phases, spreads)
    by_cells = combined_errors(groups, [seen_stairs(view, axis, group.period)[touched] for group in groups])
    place = coord[touched] + away
    taken = np.interp(place, table.at, table.shift)
    change = np.interp(place, table.at, np.gradient(table.shift, table.at))
    entry = entry_of(table, place)
    # noise decides on which side of an entry's edge a pixel is read
    dark = np.flatnonzero(np.diff(table.refused.astype(int), prepend=0, append=0))
    edges = np.append(table.at, table.at[-1] + (table.at[1] - table.at[0]))[dark].reshape(-1, 2)
    for low, high in [(-np.inf, -0.5 - OFF), (extent - 0.5 + OFF, np.inf), *edges]:
        doubtful = doubtful + ndtr((high - place) / noise[touched]) - ndtr((low - place) / noise[touched])
    refused[touched], left[touched] = np.minimum(doubtful, 1.0), away - by_cells - taken
    shift[touched], gain[touched] = np.where(table.told[entry], np.abs(taken), 0.0), np.abs(1 - change)
    partly = (refused > PARTLY) & (refused < SURELY)
    some = partly[touched]
    if some.any():
        turns = (group.period / (2 * math.pi) for group in groups)
        shifts = [turn * phase[some] for turn, phase in zip(turns, phases, strict=True)]
        told = drawn_at_border(
            *(groups, shifts, [spread[some] for spread in spreads], coord[partly], table),
            *(extent, OFF, _disagreeing(len(groups) - 1)),
        )
        refused[partly], left[partly] = told.refused, told.mean - by_cells[some]
        gain[partly] = told.deviation / noise[partly]
    return Border(refused, shift, left, gain)


def density(z: Floats) -> Floats:
    """Of the normal distribution."""
    return np.asarray(np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi))


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
    """Probability that chi squared, `apart` without noise, exceeds the limit of _disagreeing. Its root is
    Gaussian of rms 1 about sqrt(apart + freedom - 1), for one degree of freedom exactly."""
    if freedom < 1:
        return np.zeros(apart.shape)
    limit = math.sqrt(_disagreeing(freedom))
    return np.where(apart > 0.1, ndtr(np.sqrt(apart + freedom - 1) - limit), 0.0)


def _disagreeing(freedom: int) -> float:
    """chi squared that noise alone exceeds once in DISAGREE sigmas (Wilson and Hilferty 1931); infinite
    without any freedom."""
    if freedom < 1:
        return math.inf
    part = 2 / (9 * freedom)
    return float(freedom * (1 - part + DISAGREE * math.sqrt(part)) ** 3)


def usual_width(view: View, axis: str) -> float:
    """The width of a pixel (cells) that the decoder assumes for all."""
    return sum(float(np.median(width[view.visible])) for width in view.widths[axis])


def border_loss(view: View, axis: str) -> Floats:
    """Share of a pixel's light that comes from beyond the pattern's border."""
    widths = view.widths[axis]
    spread = np.sqrt(view.scene.pattern.blur_px**2 + (widths[0] ** 2 + widths[1] ** 2) / 12 + 1e-12)
    coord = view.coordinate(axis)
    loss: Floats = ndtr((-0.5 - coord) / spread) + ndtr((coord - view.extent(axis) + 0.5) / spread)
    return np.nan_to_num(loss, nan=1.0)
