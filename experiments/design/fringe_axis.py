"""Fringes along an axis, with or without a code for their order, in closed form."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, ndtr

from optolever.patterns import Frame, Sequence

from .border import Border, border_loss, border_of, density, kept_at_border
from .cells import combined_errors, seen_stairs_of_noise
from .codes import misread
from .fringes import (
    DOUBT,
    Fringe,
    combined,
    contrast,
    grouped,
    search_failure,
    step_failure,
    step_flagged,
    turn_variance,
)
from .records import AxisPrediction
from .response import fundamental_share, harmonic_error
from .shadow import shadowed
from .steep import unresolved
from .survey import blur_told
from .undoing import low_stairs, reads_off, shares, stairs_left, undoes
from .view import Floats, Levels, View

__all__ = ["fringe_axis"]

#: As in the decoder: amplitude over noise below which a pixel is refused.
LEAST_CONTRAST = 4.0
#: Bend over sigma above which the decoder reckons with it, and by what share of it.
BENT, BOX = 14.0, 1 / 24
#: Share of the doubt about a squared blur by which it is told what that does at the border.
SMALL = 0.1


@dataclass(frozen=True, slots=True)
class _Noise:
    """Of an axis, (H, W): amplitude of the finest fringe (levels), share of a sample's variance that its
    noise is, variances (cells^2) of every period, coarse to fine."""

    amplitude: Floats
    share: float
    variances: list[Floats]


def fringe_axis(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame], code: list[Frame]
) -> AxisPrediction:
    """The frames of an axis that are fringes, and those of a code for their order."""
    groups, blur = grouped(frames), view.scene.pattern.blur_px
    periods = [group.period for group in groups]
    seen = _noise(view, axis, groups, levels)
    told = blur_told(view, sequence, levels, axis)
    known, doubt = told is not None, told or 0.0
    variances, slopes = seen.variances, None
    if low_stairs(known, blur):
        there = [seen_stairs_of_noise(view, axis, period) for period in periods]
        variances = [variance / left**2 for variance, (left, _) in zip(variances, there, strict=True)]
        slopes = combined_errors(groups, [slope for _, slope in there])
    sigma = np.sqrt(combined(periods, variances))
    failure, flagged = _order_errors(view, sequence, levels, axis, code, periods, variances)
    border = _border(view, axis, sequence, groups, variances, sigma, doubt if known else None)
    refused = _low_contrast(seen, levels) + flagged + border.refused
    if not known:
        refused = refused + _shadowed(view, axis, periods[-1], seen, levels)
    read = known or reads_off(view, sequence, blur, sigma)
    bias = harmonic_error(view, groups[-1], axis) + border.left
    bias = bias + stairs_left(view, axis, groups, known, read, doubt)
    stated = _widened(np.hypot(sigma, border.shift), view.bend(axis))
    noise = sigma * border.gain
    if slopes is not None:
        noise = noise / (1 + slopes)
    elif read and undoes(blur):
        steep = unresolved(*shares(groups), blur, view.widths[axis], noise)
        noise, stated = (np.where(steep > 0, np.sqrt(steep), part) for part in (noise, stated))
        bias = np.where(steep > 0, 0.0, bias)
    return AxisPrediction(noise, bias, np.minimum(failure, 1.0), np.minimum(refused, 1.0), stated)


def _noise(view: View, axis: str, groups: list[Fringe], levels: Levels) -> _Noise:
    """What noise makes of the fringes."""
    full = fundamental_share(view.scene) * levels.half
    variances, amplitude, share = [], full, 0.5
    for group in groups:
        left = _contrast(view, axis, group.period) * np.abs(kept_at_border(view, axis, group.period))
        amplitude = full * left
        turns, share = turn_variance(group, amplitude, levels.half, levels.read2, levels.shot)
        variances.append(group.period**2 * turns)
    return _Noise(amplitude, share, variances)


def _border(
    view: View,
    axis: str,
    sequence: Sequence,
    groups: list[Fringe],
    variances: list[Floats],
    noise: Floats,
    doubt: float | None,
) -> Border:
    """Both borders; doubt: of the squared blur (cells^2) that the decoder knows, None where it does not."""
    blur, about = view.scene.pattern.blur_px, (view, axis, sequence, groups, variances, noise)
    if doubt is None:
        return border_of(*about, None)
    border = border_of(*about, blur)
    if doubt == 0:
        return border
    # the blur that the decoder measures is right on average; a step as small as that meets none of the
    # places where its table jumps from period to period
    return border.or_so(border_of(*about, math.sqrt(blur**2 + SMALL * doubt)), 1 / SMALL)


def _shadowed(view: View, axis: str, period: float, seen: _Noise, levels: Levels) -> Floats:
    """Probability that the decoder takes a pixel for one in the border's shadow."""
    uncertain = math.sqrt(seen.share) * np.sqrt(levels.variance(levels.half))
    inside, across = (_inside(view, name) for name in (axis, "v" if axis == "u" else "u"))
    nearer = np.where(inside > across, np.inf, inside)  # dim for the other border's sake
    common = _of_both(view, axis, seen.amplitude, levels, period, uncertain)
    return shadowed(nearer, common, levels, uncertain, period)


def _inside(view: View, axis: str) -> Floats:
    """Distance from the nearer border of an axis, cells."""
    coord = view.coordinate(axis)
    return np.asarray(np.minimum(coord + 0.5, view.extent(axis) - 0.5 - coord))


def _of_both(
    view: View, axis: str, amplitude: Floats, levels: Levels, period: float, noise: Floats
) -> Floats:
    """Mean of the amplitude that the decoder states, the lesser one of both axes (noise: of each), of whose
    other one the period is about the same: each loses what light the other one's border takes."""
    other = "v" if axis == "u" else "u"
    own = amplitude * (1 - border_loss(view, other))
    full = fundamental_share(view.scene) * levels.half
    across = full * _contrast(view, other, period) * (1 - border_loss(view, axis))
    spread = math.sqrt(2) * noise
    apart = np.abs(own - across) / spread
    return np.asarray(np.minimum(own, across) - spread * (density(apart) - apart * ndtr(-apart)))


def _widened(sigma: Floats, bend: Floats) -> Floats:
    """The decoder's sigma where the map bends within a pixel."""
    return np.asarray(np.where(bend > BENT * sigma, np.hypot(sigma, BOX * bend), sigma))


def _contrast(view: View, axis: str, period: float) -> Floats:
    """Share of a fringe's modulation that display, blur and pixels leave."""
    blur = view.scene.pattern.blur_px
    return view.kept(("contrast", axis, period), lambda: contrast(period, view.widths[axis], blur))


def _order_errors(
    view: View,
    sequence: Sequence,
    levels: Levels,
    axis: str,
    code: list[Frame],
    periods: list[float],
    variances: list[Floats],
) -> tuple[Floats, Floats]:
    """Probabilities that an order is wrong, and that the decoder flags one as doubtful, (H, W)."""
    extent = view.extent(axis)
    if code:
        failure = _misread(view, sequence, levels, axis, code)
        flagged = np.asarray(failure > DOUBT, np.float64)
    elif periods[0] >= extent:
        room = 0.5 * periods[0] - np.abs(view.coordinate(axis) - 0.5 * (extent - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            failure = np.nan_to_num(0.5 * erfc(room / np.sqrt(2 * variances[0])))
        flagged = np.zeros(failure.shape)
    else:
        failure, flagged = search_failure(periods, variances, extent)
    if code or periods[0] >= extent:
        for k in range(1, len(periods)):
            both = combined(periods[:k], variances[:k]) + variances[k]
            failure = failure + step_failure(periods[k], both)
            flagged = flagged + step_flagged(periods[k], both)
    return failure, flagged


def _misread(view: View, sequence: Sequence, levels: Levels, axis: str, code: list[Frame]) -> Floats:
    known = any(frame.kind in ("white", "black") for frame in sequence.frames)
    deviation = np.sqrt(levels.variance(levels.half))
    blur = view.scene.pattern.blur_px
    coord, widths = view.coordinate(axis), view.widths[axis]
    return misread(code, known, coord, levels.half, deviation, widths, blur, view.extent(axis))


def _low_contrast(seen: _Noise, levels: Levels) -> Floats:
    """Probability that the measured amplitude falls below 4 sigma."""
    deviation = np.sqrt(levels.variance(levels.half))
    short = LEAST_CONTRAST * deviation - seen.amplitude
    return np.asarray(ndtr(short / (math.sqrt(seen.share) * deviation)))
