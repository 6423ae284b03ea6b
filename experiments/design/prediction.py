"""What a sequence is worth in a scene before a frame is taken, pixel by pixel.

Along each axis: the noise of the coordinate, its systematic error (cells), the probability that its order
or a code bit is wrong, and the probability that the decoder refuses the pixel.
"""

import numpy as np

from optolever.errors import InputError
from optolever.patterns import Sequence

from .border import MOST_LOST, border_loss
from .codes import code_of
from .free_codes import free_code
from .fringe_axis import fringe_axis
from .line_reading import read_code, read_sweep
from .records import AxisPrediction, Prediction
from .view import View

__all__ = ["predict", "predict_axis"]


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
        return fringe_axis(view, sequence, levels, axis, fringes, code)
    if code:
        return read_code(view, sequence, levels, axis, code)
    if swept:
        return read_sweep(view, sequence, levels, axis, swept)
    if free:
        spread, failure = free_code(view, sequence, levels, axis, free)
        return AxisPrediction(spread, np.zeros(spread.shape), failure, failure, spread)
    raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")
