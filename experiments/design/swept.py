"""A swept stripe as the decoder itself reads it: on a line of the pattern, in many draws of noise.

What its window leaves out, what stands at the border, what it takes for noise where few stripes are shown:
none of this has a closed form that is worth having. A line of the pattern costs some milliseconds.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from optolever.decode import decode
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR

from .free_codes import FAR, PER_CELL, at_places, seen_levels
from .view import Floats, Levels, View

__all__ = ["Read", "read_sweep"]

#: Draws of noise; places over which their mean is smoothed.
DRAWS, SMOOTH = 64, PER_CELL


@dataclass(frozen=True, slots=True)
class Read:
    """Per pixel (H, W): noise (rms, cells), bias (cells), the probabilities that the answer is another place
    (failure) and that it is flagged (refused), and the sigma that is stated (cells)."""

    noise: Floats
    bias: Floats
    failure: Floats
    refused: Floats
    stated: Floats


def read_sweep(view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]) -> Read:
    """Stripes (and references) of an axis, read by pixels of the usual footprint under the usual light; noise
    grows with what a pixel's own light lacks."""
    width = float(np.nanmedian(np.hypot(*view.widths[axis])))
    seen = seen_levels(frames, sequence, axis, width, view.scene.pattern.blur_px)
    visible = view.visible
    half = float(np.median(levels.half[visible]))
    light = levels.dark + 2 * half * seen[:, None]
    bits = (view.scene.sensor or NOMINAL_SENSOR).bits
    top, kind = 2**bits - 1, np.uint8 if bits <= 8 else np.uint16
    step = 255 / top
    spread = np.sqrt(np.maximum(levels.variance(light - levels.dark) - step**2 / 12, 0.0))
    rng = np.random.default_rng(0)
    drawn = light + spread * rng.standard_normal((len(frames), DRAWS, seen.shape[1]))
    shown = Sequence(tuple(frames), sequence.rows, sequence.cols)
    found = decode(np.clip(np.rint(drawn / step), 0, top).astype(kind), shown, white_level=top)
    error = getattr(found, axis) - ((np.arange(seen.shape[1]) + 0.5) / PER_CELL - 0.5)
    good = found.good & np.isfinite(error)
    near = good & (np.abs(error) < FAR)
    count = np.maximum(near.sum(axis=0), 1)
    bias = np.sum(error, axis=0, where=near) / count
    square = np.sum((error - bias) ** 2, axis=0, where=near) / np.maximum(count - 1, 1)
    stated = np.sum(getattr(found, f"sigma_{axis}"), axis=0, where=near) / count
    here = view.coordinate(axis)
    own = np.sqrt(levels.variance(levels.half)) / np.maximum(levels.half, 1e-9)
    own = np.where(visible, own / np.median(own[visible]), 1.0)
    return Read(
        own * at_places(here, np.sqrt(_smooth(square))),
        at_places(here, _smooth(bias)),
        at_places(here, 1 - near.sum(axis=0) / np.maximum(good.sum(axis=0), 1)),
        at_places(here, 1 - good.mean(axis=0)),
        own * at_places(here, stated),
    )


def _smooth(table: Floats) -> Floats:
    return np.asarray(uniform_filter1d(table, SMOOTH, mode="nearest"))
