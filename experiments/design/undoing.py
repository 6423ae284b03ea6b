"""What the decoder takes off of the cells' stairs, and what stays."""

import math

import numpy as np

from optolever.patterns import Sequence

from .border import usual_width
from .cells import combined_errors, seen_stairs, stairs
from .fringes import MUCH_FINER, Fringe
from .gathering import tells_stairs
from .view import Floats, View

__all__ = ["low_stairs", "reads_off", "shares", "stairs_left", "undoes"]

#: Attenuation of the cells' fundamental under which the decoder takes stairs off.
LOW_STAIRS = 0.1
#: Attenuation above which it reads stairs off the coordinates and undoes them; up to which it does so twice.
READ_OFF, READ_AGAIN = 0.012, 0.4
#: Pixels on either side over which it then takes the gradient.
AROUND, NEARBY = 8, 2


def undoes(blur: float) -> bool:
    """Whether a blur (cells) leaves stairs that the decoder undoes pixel by pixel."""
    return _left_by(blur) > READ_OFF


def reads_off(view: View, sequence: Sequence, blur: float, noise: Floats) -> bool:
    """Whether the coordinates of an axis tell how high the stairs are; noise of one: they are alike."""
    shown = {frame.axis for frame in sequence.frames if frame.kind == "phase"}
    left = _left_by(blur)
    return left > READ_OFF and any(tells_stairs(view, axis, left, noise) for axis in "uv" if axis in shown)


def low_stairs(known: bool, blur: float) -> bool:
    """Whether the decoder takes the stairs of the usual pixel off."""
    return known and _left_by(blur) < LOW_STAIRS


def stairs_left(view: View, axis: str, groups: list[Fringe], known: bool, read: bool, doubt: float) -> Floats:
    """What the cells' stairs leave in the coordinate; read: off the coordinates; doubt: of the squared blur
    (cells^2).

    Where it knows the blur, the decoder takes off low stairs, those of the usual pixel; higher ones it reads
    off the coordinates and undoes pixel by pixel, by gradients over some of them; what it cannot read stays.
    """
    blur, coord = view.scene.pattern.blur_px, view.coordinate(axis)
    left, soft = _left_by(blur), low_stairs(known, blur)
    errors = [seen_stairs(view, axis, group.period) for group in groups]
    if soft:
        usual, believed = (np.full(coord.shape, usual_width(view, axis)),), math.sqrt(blur**2 + doubt)
        errors = [e - stairs(coord, usual, believed, g.period) for e, g in zip(errors, groups, strict=True)]
    elif read:
        reach = NEARBY if left < READ_AGAIN else AROUND
        errors = [e - _undone(view, axis, g.period, reach) for e, g in zip(errors, groups, strict=True)]
    return combined_errors(groups, errors)


def _undone(view: View, axis: str, period: float, reach: int) -> Floats:
    """The stairs that the decoder takes for those of a fringe: of footprints told by gradients."""

    def undone() -> Floats:
        around = tuple(view.gradient(axis, along, reach) for along in (1, 0))
        return stairs(view.coordinate(axis), around, view.scene.pattern.blur_px, period)

    return view.kept(("undone", axis, period, reach), undone)


def _left_by(blur: float) -> float:
    """What a blur (cells) leaves of the cells' fundamental."""
    return math.exp(-2 * (math.pi * blur) ** 2)


def shares(groups: list[Fringe]) -> tuple[list[float], list[float]]:
    """Periods that a coordinate is the mean of, and their shares in it, as the decoder weighs them."""
    periods = [group.period for group in groups]
    first = max((g for g in range(1, len(groups)) if periods[g] * MUCH_FINER < periods[g - 1]), default=0)
    own = [len(group.shifts) / group.period**2 for group in groups[first:]]
    return periods[first:], [part / sum(own) for part in own]
