"""Swept stripes and codes without fringes as the decoder itself reads them: on a line of the pattern, in many
draws of noise.

What a window leaves out, what stands at the border, what few stripes tell of the noise, which bits blur and
noise turn over: none of this has a closed form that is worth having. A line costs some milliseconds.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from optolever.decode import decode
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR

from .codes import cell_error
from .free_codes import FAR, PER_CELL, at_places, seen_levels
from .records import AxisPrediction
from .view import Floats, Levels, View

__all__ = ["read_code", "read_sweep"]

#: Draws of noise; places over which their mean is smoothed; both for codes, which change within a cell.
DRAWS, SMOOTH = 64, PER_CELL
CODE_DRAWS, CODE_PER_CELL = 64, 16
Mask = NDArray[np.bool_]


def read_sweep(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]
) -> AxisPrediction:
    """Stripes of an axis, read by pixels of the usual footprint in the usual light; noise grows with what
    light a pixel lacks."""
    place, coord, sigma, good = _line(view, sequence, levels, axis, frames, DRAWS, PER_CELL, told=False)
    error = coord - place
    near = good & (np.abs(error) < FAR)
    count = np.maximum(near.sum(axis=0), 1)
    bias = np.sum(error, axis=0, where=near) / count
    square = np.sum((error - bias) ** 2, axis=0, where=near) / np.maximum(count - 1, 1)
    stated = np.sum(sigma, axis=0, where=near) / count
    here, visible = view.coordinate(axis), view.visible
    own = np.sqrt(levels.variance(levels.half)) / np.maximum(levels.half, 1e-9)
    own = np.where(visible, own / np.median(own[visible]), 1.0)
    return AxisPrediction(
        own * at_places(here, np.sqrt(np.maximum(_smooth(square), 0.0))),
        at_places(here, _smooth(bias)),
        at_places(here, 1 - near.sum(axis=0) / np.maximum(good.sum(axis=0), 1)),
        at_places(here, 1 - good.mean(axis=0)),
        own * at_places(here, stated),
    )


def read_code(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]
) -> AxisPrediction:
    """Bits of an axis, with the references of the sequence, read by pixels as in read_sweep."""
    shown = [*(frame for frame in sequence.frames if frame.kind in ("white", "black")), *frames]
    place, coord, sigma, good = _line(
        view, sequence, levels, axis, shown, CODE_DRAWS, CODE_PER_CELL, told=True
    )
    pitch, error = frames[0].cell_px, coord - place
    far = np.abs(np.rint((error - cell_error(place, frames[0])) / pitch)) > 1
    near = good & ~far
    count = np.maximum(near.sum(axis=0), 1)
    mean = np.sum(error, axis=0, where=near) / count
    square = np.sum((error - mean) ** 2, axis=0, where=near) / count
    stated = np.sum(sigma, axis=0, where=near) / count
    astray = np.sum(good & far, axis=0) / np.maximum(good.sum(axis=0), 1)
    here = view.coordinate(axis)
    # means and variances change steadily from cell to cell, probabilities do not
    mean, square, stated, astray, refused = (
        at_places(here, table, CODE_PER_CELL)
        for table in (mean, square, stated, astray, 1 - good.mean(axis=0))
    )
    moved = (mean - cell_error(here, frames[0])) / pitch
    both = square / pitch**2 + moved**2
    up, down = (np.clip(0.5 * (both + way * moved), 0.0, 1.0) for way in (1, -1))
    moved = pitch * (up - down)
    noise = np.sqrt(np.maximum(pitch**2 * (up + down) - moved**2, 0.0))
    return AxisPrediction(
        noise, cell_error(here, frames[0]) + moved, astray, refused, stated, steps=(up, down, pitch)
    )


def _line(
    view: View,
    sequence: Sequence,
    levels: Levels,
    axis: str,
    frames: list[Frame],
    draws: int,
    per_cell: int,
    told: bool,
) -> tuple[Floats, Floats, Floats, Mask]:
    """Places (K,), and what is read there: coordinate, its sigma, and whether it is unflagged (draws, K).
    told: the decoder knows the noise, as frames of both axes tell it.

    In every draw they lie in another order: some pixels of a capture stand for all, neighbours tell nothing.
    """
    width = float(np.nanmedian(np.hypot(*view.widths[axis])))
    seen = seen_levels(frames, sequence, axis, width, view.scene.pattern.blur_px, per_cell)
    half = float(np.median(levels.half[view.visible]))
    light = levels.dark + 2 * half * seen[:, None]
    bits = (view.scene.sensor or NOMINAL_SENSOR).bits
    top, kind = 2**bits - 1, np.uint8 if bits <= 8 else np.uint16
    step = 255 / top
    spread = np.sqrt(np.maximum(levels.variance(light - levels.dark) - step**2 / 12, 0.0))
    rng = np.random.default_rng(0)
    order = rng.permuted(np.tile(np.arange(seen.shape[1]), (draws, 1)), axis=1)
    half_drawn = rng.standard_normal((len(frames), draws // 2, seen.shape[1]), np.float32)
    # every draw once more with the other sign: what is odd in it leaves the means
    unit = np.take_along_axis(np.concatenate([half_drawn, -half_drawn], axis=1), order[None], axis=2)
    drawn = light[:, 0, order] + spread[:, 0, order] * unit
    shown = Sequence(tuple(frames), sequence.rows, sequence.cols)
    noise = np.sqrt(max(levels.read2 / step**2 - 1 / 12, 0.0)) if told else None
    raw = np.clip(np.rint(drawn / step), 0, top).astype(kind)
    found = decode(raw, shown, noise=noise, gain=levels.shot / step if told else 0.0, white_level=top)
    maps: list[Any] = [getattr(found, axis), getattr(found, f"sigma_{axis}"), found.good]
    coord, sigma, good = (np.take_along_axis(part, np.argsort(order, axis=1), axis=1) for part in maps)
    place = (np.arange(seen.shape[1]) + 0.5) / per_cell - 0.5
    return place, coord, sigma, good & np.isfinite(coord)


def _smooth(table: Floats) -> Floats:
    return np.asarray(uniform_filter1d(table, SMOOTH, mode="nearest"))
