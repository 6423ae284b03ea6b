"""What a sequence is worth in a scene before a frame is taken, pixel by pixel.

Along each axis: the noise of the coordinate, its systematic error (cells), the probability that its order
or a code bit is wrong, and the probability that the decoder refuses the pixel.
"""

import numpy as np

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .border import MOST_LOST, border_loss
from .codes import code_of
from .free_codes import free_code
from .fringe_axis import fringe_axis
from .image_reading import is_read, read_axes
from .records import AxisPrediction, Prediction
from .view import Levels, View

__all__ = ["predict", "predict_axis"]


def predict(view: View, sequence: Sequence, noise: float) -> Prediction:
    """The sequence in the view under Gaussian noise (rms, 8-bit levels).

    InputError if it does not encode both axes or a fringe cannot be decoded.
    """
    told = _predicted(view, sequence, noise, ("u", "v"))
    lit = view.visible & (view.light > 0)
    usable = lit & (np.maximum(border_loss(view, "u"), border_loss(view, "v")) < MOST_LOST)
    return Prediction(told["u"], told["v"], lit, usable)


def predict_axis(view: View, sequence: Sequence, noise: float, axis: str) -> AxisPrediction:
    """The same along one axis, 'u' or 'v'."""
    return _predicted(view, sequence, noise, (axis,))[axis]


def _predicted(
    view: View, sequence: Sequence, noise: float, axes: tuple[str, ...]
) -> dict[str, AxisPrediction]:
    if (sequence.rows, sequence.cols) != (view.scene.pattern.rows, view.scene.pattern.cols):
        raise InputError(
            f"sequence {sequence.name}: made for {sequence.rows}x{sequence.cols} cells, the pattern of scene "
            f"{view.scene.name!r} has {view.scene.pattern.rows}x{view.scene.pattern.cols}"
        )
    levels = view.levels(noise)
    frames = {axis: [frame for frame in sequence.frames if frame.axis == axis] for axis in axes}
    read = read_axes(view, sequence, levels) if any(map(is_read, frames.values())) else {}
    return {axis: read.get(axis) or _of_levels(view, sequence, levels, axis, frames[axis]) for axis in axes}


def _of_levels(
    view: View, sequence: Sequence, levels: Levels, axis: str, mine: list[Frame]
) -> AxisPrediction:
    """Fringes, or any levels whatever."""
    fringes, free = ([frame for frame in mine if frame.kind == kind] for kind in ("phase", "levels"))
    if fringes:
        return fringe_axis(view, sequence, levels, axis, fringes, code_of(mine))
    if free:
        spread, failure = free_code(view, sequence, levels, axis, free)
        return AxisPrediction(spread, np.zeros(spread.shape), failure, failure, spread)
    raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")
