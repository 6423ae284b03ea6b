"""What a sequence is worth in a scene before a frame is taken: closed forms, pixel by pixel.

Along each axis: the noise of the coordinate, its systematic error (cells), the probability that its order
or a code bit is wrong, and the probability that the decoder refuses the pixel.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, ndtr

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .border import border_of, kept_at_border, usual_width
from .codes import Misread, cell_error, code_of, misread, sidebands, stairs, stairs_of_noise
from .free_codes import free_code
from .fringes import (
    DOUBT,
    MUCH_FINER,
    Fringe,
    combined,
    contrast,
    grouped,
    search_failure,
    step_failure,
    step_flagged,
    turn_variance,
)
from .gathering import tells_stairs
from .line_reading import read_code, read_sweep
from .response import fundamental_share, harmonic_error
from .shadow import shadowed
from .steep import unresolved
from .view import Floats, Levels, View

__all__ = ["AxisPrediction", "Prediction", "border_loss", "predict", "predict_axis"]

#: As in the decoder: amplitude over noise below which a pixel is refused, and light lost at the border.
LEAST_CONTRAST = 4.0
#: Light lost beyond the border above which a pixel is left out of every figure: what is made of it there is a
#: matter of the border, not of the code.
MOST_LOST = 0.01
#: Contrast (its logarithm) that blur must take from the finest fringe, for the decoder to tell it.
BLUR_TOLD = 0.009
#: Attenuation of the cells' fundamental under which the decoder takes stairs off.
LOW_STAIRS = 0.1
#: Attenuation above which it reads stairs off the coordinates and undoes them; up to which it does so twice.
READ_OFF, READ_AGAIN = 0.012, 0.4
#: Pixels on either side over which it then takes the gradient.
AROUND, NEARBY = 8, 2
#: Rows and columns of the camera that it measures blur by, and the share of them that it uses.
SURVEYED, SURVEYED_SHARE = (24, 192), 0.8
#: Bend over sigma above which the decoder reckons with it, and by what share of it.
BENT, BOX = 14.0, 1 / 24


@dataclass(frozen=True, slots=True)
class AxisPrediction:
    """Per pixel (H, W): noise (rms, cells), bias (cells), failure and refused (probabilities), stated (the
    sigma that the decoder will give, cells). steps: of a code alone, whose noise is that it reads a
    neighbour: the probabilities of the one above and of the one below, and their distance (cells)."""

    noise: Floats
    bias: Floats
    failure: Floats
    refused: Floats
    stated: Floats
    steps: tuple[Floats, Floats, float] | None = None

    def drawn(self, unit: Floats) -> Floats:
        """An error (H, W) of mean 0 as the noise makes it, from Gaussian numbers of rms 1."""
        if self.steps is None:
            return self.noise * unit
        up, down, pitch = self.steps
        place = ndtr(unit)
        return np.asarray(pitch * ((place > 1 - up).astype(float) - (place < down) - (up - down)))


@dataclass(frozen=True, slots=True)
class Prediction:
    """Both axes of a sequence in a view; lit: pixels that see the pattern; usable: those that its border does
    not touch, over which errors are told."""

    u: AxisPrediction
    v: AxisPrediction
    lit: NDArray[np.bool_]
    usable: NDArray[np.bool_]

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Pixels that the decoder does not refuse outright."""
        return self.left(np.full((2, *self.lit.shape), 0.5))

    def left(self, chance: Floats) -> NDArray[np.bool_]:
        """Pixels that the decoder does not refuse, for even numbers (2, H, W) of 0..1: holes in the solver's
        grid."""
        return np.asarray(self.lit & (self.u.refused <= chance[0]) & (self.v.refused <= chance[1]))

    @property
    def failure(self) -> float:
        """Mean probability of a wrong order or bit over the usable pixels."""
        return self._mean(1 - (1 - self.u.failure) * (1 - self.v.failure))

    @property
    def measured_share(self) -> float:
        """Share of the usable pixels that are expected to pass the decoder's checks."""
        return self._mean((1 - self.u.refused) * (1 - self.v.refused))

    def _mean(self, values: Floats) -> float:
        return float(values[self.usable].mean()) if self.usable.any() else math.nan


def predict(view: View, sequence: Sequence, noise: float) -> Prediction:
    """The sequence in the view under Gaussian noise (rms, 8-bit levels).

    InputError if it does not encode both axes or a fringe cannot be decoded.
    """
    u, v = (predict_axis(view, sequence, noise, axis) for axis in "uv")
    lit = view.visible & (view.light > 0)
    usable = lit & (np.maximum(border_loss(view, "u"), border_loss(view, "v")) < MOST_LOST)
    return Prediction(u, v, lit, usable)


def predict_axis(view: View, sequence: Sequence, noise: float, axis: str) -> AxisPrediction:
    """The same along one axis, 'u' or 'v'."""
    if (sequence.rows, sequence.cols) != (view.scene.pattern.rows, view.scene.pattern.cols):
        raise InputError(
            f"sequence {sequence.name}: made for {sequence.rows}x{sequence.cols} cells, the pattern of scene "
            f"{view.scene.name!r} has {view.scene.pattern.rows}x{view.scene.pattern.cols}"
        )
    levels = view.levels(noise)
    mine = [frame for frame in sequence.frames if frame.axis == axis]
    fringes = [frame for frame in mine if frame.kind == "phase"]
    code, free, swept = code_of(mine), *([f for f in mine if f.kind == k] for k in ("levels", "stripe"))
    if fringes:
        return _fringe_axis(view, sequence, levels, axis, fringes, code)
    if code:
        return _code_axis(view, sequence, levels, axis, code)
    if swept:
        read = read_sweep(view, sequence, levels, axis, swept)
        return AxisPrediction(read.noise, read.bias, read.failure, read.refused, read.stated)
    if free:
        spread, failure = free_code(view, sequence, levels, axis, free)
        return AxisPrediction(spread, np.zeros(spread.shape), failure, failure, spread)
    raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")


def _fringe_axis(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame], code: list[Frame]
) -> AxisPrediction:
    groups = grouped(frames)
    blur, periods = view.scene.pattern.blur_px, [group.period for group in groups]
    full = fundamental_share(view.scene) * levels.half
    variances, amplitude, share = [], full, 0.5
    kept = [_kept_at_border(view, axis, group.period) for group in groups]
    for group, rho in zip(groups, kept, strict=True):
        amplitude = full * _contrast(view, axis, group.period) * np.abs(rho)
        turns, share = turn_variance(group, amplitude, levels.half, levels.read2, levels.shot)
        variances.append(group.period**2 * turns)
    refused = _low_contrast(amplitude, levels, share)
    told = _blur_told(view, sequence, levels, axis)
    known, doubt = told is not None, told or 0.0
    if _low_stairs(known, blur):
        there = [_stairs_of_noise(view, axis, group.period) for group in groups]
        variances = [variance / left**2 for variance, (left, _) in zip(variances, there, strict=True)]
    total = combined(periods, variances)
    failure, flagged = _order_errors(view, sequence, levels, axis, code, periods, variances)
    steps = _combined_errors(groups, [_stairs_of(view, axis, group.period) for group in groups])
    cells = [_cells(view, axis, group.period) for group in groups]
    about = view, axis, sequence, groups, kept, cells, variances, np.sqrt(total), steps
    border = border_of(*about, blur if known else None)
    if doubt > 0:  # the blur that the decoder measures is right on average
        border = border.or_so(border_of(*about, math.sqrt(blur**2 + doubt)))
    if not known:
        uncertain = math.sqrt(share) * np.sqrt(levels.variance(levels.half))
        common = _of_both(view, axis, amplitude, full, periods[-1], uncertain)
        inside = _inside(view, axis)
        inside[inside > _inside(view, "v" if axis == "u" else "u")] = np.inf  # dim for the other one's sake
        refused = refused + shadowed(inside, common, levels, uncertain, periods[-1])
    refused = np.minimum(refused + flagged + border.refused, 1.0)
    read = known or _read_off(view, sequence, blur, np.sqrt(total))
    left = border.left + _stairs(view, axis, groups, known, read, doubt)
    bias = harmonic_error(view, groups[-1], axis) + left
    stated = _widened(np.sqrt(total + border.shift**2), view.bend(axis))
    noise = np.sqrt(total) * border.gain
    if _low_stairs(known, blur):
        noise = noise / (1 + _combined_errors(groups, [slope for _, slope in there]))
    elif read and _left_by(blur) > READ_OFF:
        steep = unresolved(*_shares(groups), blur, view.widths[axis], noise)
        noise, stated = (np.where(steep > 0, np.sqrt(steep), part) for part in (noise, stated))
        bias = np.where(steep > 0, 0.0, bias)
    return AxisPrediction(noise, bias, np.minimum(failure, 1.0), refused, stated)


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
        failure = _misread(view, sequence, levels, axis, code).failure
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


def _widened(sigma: Floats, bend: Floats) -> Floats:
    """The decoder's sigma where the map bends within a pixel."""
    return np.asarray(np.where(bend > BENT * sigma, np.hypot(sigma, BOX * bend), sigma))


def _left_by(blur: float) -> float:
    """What a blur (cells) leaves of the cells' fundamental."""
    return math.exp(-2 * (math.pi * blur) ** 2)


def _inside(view: View, axis: str) -> Floats:
    """Distance from the nearer border of an axis, cells."""
    coord = view.coordinate(axis)
    return np.asarray(np.minimum(coord + 0.5, view.extent(axis) - 0.5 - coord))


def _of_both(view: View, axis: str, amplitude: Floats, full: Floats, period: float, noise: Floats) -> Floats:
    """Mean of the amplitude that the decoder states, the lesser one of both axes (noise: of each), of whose
    other one the period is about the same: each loses what light the other one's border takes."""
    other = "v" if axis == "u" else "u"
    own = amplitude * (1 - border_loss(view, other))
    across = full * _contrast(view, other, period) * (1 - border_loss(view, axis))
    apart = np.abs(own - across) / (math.sqrt(2) * noise)
    density = np.exp(-0.5 * apart**2) / math.sqrt(2 * math.pi)
    return np.asarray(np.minimum(own, across) - math.sqrt(2) * noise * (density - apart * ndtr(-apart)))


def _read_off(view: View, sequence: Sequence, blur: float, noise: Floats) -> bool:
    """Whether the coordinates of an axis tell how high the stairs are; noise of one: they are alike."""
    shown = {frame.axis for frame in sequence.frames if frame.kind == "phase"}
    left = _left_by(blur)
    return left > READ_OFF and any(tells_stairs(view, axis, left, noise) for axis in "uv" if axis in shown)


def _low_stairs(known: bool, blur: float) -> bool:
    """Whether the decoder takes the stairs of the usual pixel off."""
    return known and _left_by(blur) < LOW_STAIRS


def _stairs(view: View, axis: str, groups: list[Fringe], known: bool, read: bool, doubt: float) -> Floats:
    """What the cells' stairs leave in the coordinate; read: off the coordinates; doubt: of the squared blur
    (cells^2).

    Where it knows the blur, the decoder takes off low stairs, those of the usual pixel; higher ones it reads
    off the coordinates and undoes pixel by pixel, by gradients over some of them; what it cannot read stays.
    """
    blur, coord = view.scene.pattern.blur_px, view.coordinate(axis)
    left, soft = _left_by(blur), _low_stairs(known, blur)
    errors = [_stairs_of(view, axis, group.period) for group in groups]
    if soft:
        usual, believed = (np.full(coord.shape, usual_width(view, axis)),), math.sqrt(blur**2 + doubt)
        errors = [e - stairs(coord, usual, believed, g.period) for e, g in zip(errors, groups, strict=True)]
    elif read:
        reach = NEARBY if left < READ_AGAIN else AROUND
        errors = [e - _undone(view, axis, g.period, reach) for e, g in zip(errors, groups, strict=True)]
    return _combined_errors(groups, errors)


def _undone(view: View, axis: str, period: float, reach: int) -> Floats:
    """The stairs that the decoder takes for those of a fringe: of footprints told by gradients."""

    def undone() -> Floats:
        around = tuple(view.gradient(axis, along, reach) for along in (1, 0))
        return stairs(view.coordinate(axis), around, view.scene.pattern.blur_px, period)

    return view.kept(("undone", axis, period, reach), undone)


def _contrast(view: View, axis: str, period: float) -> Floats:
    """Share of a fringe's modulation that display, blur and pixels leave."""
    blur = view.scene.pattern.blur_px
    return view.kept(("contrast", axis, period), lambda: contrast(period, view.widths[axis], blur))


def _kept_at_border(view: View, axis: str, period: float) -> NDArray[np.complex128]:
    """What the border leaves of a fringe's complex amplitude."""
    return view.kept(("border", axis, period), lambda: kept_at_border(view, axis, period))


def _cells(view: View, axis: str, period: float) -> NDArray[np.complex128]:
    """What the cells make of a fringe's complex amplitude."""
    blur, coord, widths = view.scene.pattern.blur_px, view.coordinate(axis), view.widths[axis]
    return view.kept(("cells", axis, period), lambda: sidebands(coord, widths, blur, period)[0])


def _stairs_of(view: View, axis: str, period: float) -> Floats:
    """Error of a fringe from the cells' stairs."""
    blur, coord, widths = view.scene.pattern.blur_px, view.coordinate(axis), view.widths[axis]
    return view.kept(("stairs", axis, period), lambda: stairs(coord, widths, blur, period))


def _stairs_of_noise(view: View, axis: str, period: float) -> tuple[Floats, Floats]:
    """What the stairs make of its noise."""
    blur, coord, widths = view.scene.pattern.blur_px, view.coordinate(axis), view.widths[axis]
    return view.kept(("noise", axis, period), lambda: stairs_of_noise(coord, widths, blur, period))


def _shares(groups: list[Fringe]) -> tuple[list[float], list[float]]:
    """Periods that a coordinate is the mean of, and their shares in it, as the decoder weighs them."""
    periods = [group.period for group in groups]
    first = max((g for g in range(1, len(groups)) if periods[g] * MUCH_FINER < periods[g - 1]), default=0)
    own = [len(group.shifts) / group.period**2 for group in groups[first:]]
    return periods[first:], [part / sum(own) for part in own]


def _combined_errors(groups: list[Fringe], errors: list[Floats]) -> Floats:
    """One error of the coordinate from those of every fringe, coarse to fine, as the decoder weighs them."""
    total, information, previous = errors[0], 0.0, math.inf
    for group, error in zip(groups, errors, strict=True):
        own = len(group.shifts) / group.period**2
        alone = group.period * MUCH_FINER < previous
        total = error if alone else total + own / (information + own) * (error - total)
        information, previous = own if alone else information + own, group.period
    return total


def _blur_told(view: View, sequence: Sequence, levels: Levels, axis: str) -> float | None:
    """Noise of the squared blur (cells^2) that the decoder measures, None where it does not: white and black
    are shown, or contrasts likely differ enough, along this axis or else the other."""
    referenced, blur = _referenced(sequence), view.scene.pattern.blur_px
    for name in (axis, "v" if axis == "u" else "u"):
        groups = grouped([f for f in sequence.frames if f.axis == name and f.kind == "phase"])
        if not groups:
            continue
        lever, uncertain = _blur_survey(view, name, groups, levels, referenced)
        if referenced or (len(groups) > 1 and lever * blur**2 > BLUR_TOLD):
            return uncertain / lever
    return None


def _blur_survey(
    view: View, axis: str, groups: list[Fringe], levels: Levels, referenced: bool
) -> tuple[float, float]:
    """What measuring the blur by contrasts goes by: the logarithm of the contrast per squared blur (1 /
    cells^2), and its noise over the pixels surveyed."""
    blur, seen = view.scene.pattern.blur_px, view.visible
    widths = tuple(float(np.median(width[seen])) for width in view.widths[axis])
    half = float(np.median(levels.half[seen]))
    deviation = math.sqrt(float(levels.variance(half)))
    used = [groups[-1]] if referenced else [groups[-1], groups[0]]
    noise2, lever = (0.5 * (deviation / half) ** 2 if referenced else 0.0), 0.0
    for sign, group in zip((1, -1), used, strict=False):
        boxes = np.array(widths[0]), np.array(widths[1])
        amplitude = half * float(contrast(group.period, boxes, blur))
        noise2 += 2 / len(group.shifts) * (deviation / amplitude) ** 2
        lever += sign * 2 * (math.pi / group.period) ** 2
    full = [round(n * view.stride) for n in seen.shape]
    count = max(1.0, SURVEYED_SHARE * seen.mean() * math.prod(map(min, full, SURVEYED)))
    return lever, math.sqrt(noise2 / count)


def _code_axis(
    view: View, sequence: Sequence, levels: Levels, axis: str, code: list[Frame]
) -> AxisPrediction:
    read = read_code(view, sequence, levels, axis, code)
    pitch, moved = code[0].cell_px, read.up - read.down
    noise = pitch * np.sqrt(np.maximum(read.up + read.down - moved**2, 0.0))
    bias = cell_error(view.coordinate(axis), code[0]) + pitch * moved
    steps = read.up, read.down, pitch
    return AxisPrediction(noise, bias, read.failure, read.refused, read.stated, steps)


def _misread(view: View, sequence: Sequence, levels: Levels, axis: str, code: list[Frame]) -> Misread:
    known = any(frame.kind in ("white", "black") for frame in sequence.frames)
    deviation = np.sqrt(levels.variance(levels.half))
    blur = view.scene.pattern.blur_px
    coord, widths = view.coordinate(axis), view.widths[axis]
    return misread(code, known, coord, levels.half, deviation, widths, blur, view.extent(axis))


def _low_contrast(amplitude: Floats, levels: Levels, share: float) -> Floats:
    """Probability that the measured amplitude falls below 4 sigma; share: its variance over a sample's."""
    deviation = np.sqrt(levels.variance(levels.half))
    return np.asarray(ndtr((LEAST_CONTRAST * deviation - amplitude) / (math.sqrt(share) * deviation)))


def _referenced(sequence: Sequence) -> bool:
    return {"white", "black"} <= {frame.kind for frame in sequence.frames}


def border_loss(view: View, axis: str) -> Floats:
    """Share of a pixel's light that comes from beyond the pattern's border."""
    widths = view.widths[axis]
    spread = np.sqrt(view.scene.pattern.blur_px**2 + (widths[0] ** 2 + widths[1] ** 2) / 12 + 1e-12)
    coord = view.coordinate(axis)
    loss: Floats = ndtr((-0.5 - coord) / spread) + ndtr((coord - view.extent(axis) + 0.5) / spread)
    return np.nan_to_num(loss, nan=1.0)
