"""Swept stripes and codes without fringes as the decoder itself reads them: on a line of the pattern, in many
draws of noise.

What a window leaves out, what stands at the border, what few stripes tell of the noise, which bits blur and
noise turn over: none of this has a closed form that is worth having. A line costs some milliseconds.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from optolever.decode import decode
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR

from .codes import cell_error
from .free_codes import FAR, PER_CELL, at_places, seen_levels
from .view import Floats, Levels, View

__all__ = ["CodeReading", "SweepReading", "read_code", "read_sweep"]

#: Draws of noise; places over which their mean is smoothed.
DRAWS, SMOOTH = 64, PER_CELL
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SweepReading:
    """Per pixel (H, W): noise (rms, cells), bias (cells), the probabilities that the answer is another place
    (failure) and that it is flagged (refused), and the sigma that is stated (cells)."""

    noise: Floats
    bias: Floats
    failure: Floats
    refused: Floats
    stated: Floats


@dataclass(frozen=True, slots=True)
class CodeReading:
    """Per pixel (H, W), of answers that are not flagged: probabilities that they are the cell above or below
    (up, down), or one farther away (failure); the rest as in SweepReading."""

    up: Floats
    down: Floats
    failure: Floats
    refused: Floats
    stated: Floats


def read_sweep(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]
) -> SweepReading:
    """Stripes of an axis, read by pixels of the usual footprint in the usual light; noise grows with what
    light a pixel lacks."""
    place, coord, sigma, good = _line(view, sequence, levels, axis, frames)
    error = coord - place
    near = good & (np.abs(error) < FAR)
    count = np.maximum(near.sum(axis=0), 1)
    bias = np.sum(error, axis=0, where=near) / count
    square = np.sum((error - bias) ** 2, axis=0, where=near) / np.maximum(count - 1, 1)
    stated = np.sum(sigma, axis=0, where=near) / count
    here, visible = view.coordinate(axis), view.visible
    own = np.sqrt(levels.variance(levels.half)) / np.maximum(levels.half, 1e-9)
    own = np.where(visible, own / np.median(own[visible]), 1.0)
    return SweepReading(
        own * at_places(here, np.sqrt(np.maximum(_smooth(square), 0.0))),
        at_places(here, _smooth(bias)),
        at_places(here, 1 - near.sum(axis=0) / np.maximum(good.sum(axis=0), 1)),
        at_places(here, 1 - good.mean(axis=0)),
        own * at_places(here, stated),
    )


def read_code(view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]) -> CodeReading:
    """Bits of an axis, with the references of the sequence, read by pixels as in read_sweep."""
    shown = [*(frame for frame in sequence.frames if frame.kind in ("white", "black")), *frames]
    place, coord, sigma, good = _line(view, sequence, levels, axis, shown, told=True)
    cells = np.rint((coord - place - cell_error(place, frames[0])) / frames[0].cell_px)
    count = np.maximum(good.sum(axis=0), 1)
    here = view.coordinate(axis)
    up, down, far, stated = (
        at_places(here, np.sum(part, axis=0, where=good) / count)
        for part in (cells == 1, cells == -1, np.abs(cells) > 1, sigma)
    )
    return CodeReading(up, down, far, at_places(here, 1 - good.mean(axis=0)), stated)


def _line(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame], told: bool = False
) -> tuple[Floats, Floats, Floats, Mask]:
    """Places (K,), and what is read there: coordinate, its sigma, and whether it is unflagged (DRAWS, K).
    told: the decoder knows the noise, as frames of both axes tell it.

    In every draw they lie in another order: some pixels of a capture stand for all, neighbours tell nothing.
    """
    width = float(np.nanmedian(np.hypot(*view.widths[axis])))
    seen = seen_levels(frames, sequence, axis, width, view.scene.pattern.blur_px)
    half = float(np.median(levels.half[view.visible]))
    light = levels.dark + 2 * half * seen[:, None]
    bits = (view.scene.sensor or NOMINAL_SENSOR).bits
    top, kind = 2**bits - 1, np.uint8 if bits <= 8 else np.uint16
    step = 255 / top
    spread = np.sqrt(np.maximum(levels.variance(light - levels.dark) - step**2 / 12, 0.0))
    rng = np.random.default_rng(0)
    order = rng.permuted(np.tile(np.arange(seen.shape[1]), (DRAWS, 1)), axis=1)
    drawn = light[:, 0, order] + spread[:, 0, order] * rng.standard_normal((len(frames), *order.shape))
    shown = Sequence(tuple(frames), sequence.rows, sequence.cols)
    noise = np.sqrt(max(levels.read2 / step**2 - 1 / 12, 0.0)) if told else None
    raw = np.clip(np.rint(drawn / step), 0, top).astype(kind)
    found = decode(raw, shown, noise=noise, gain=levels.shot / step if told else 0.0, white_level=top)
    maps: list[Any] = [getattr(found, axis), getattr(found, f"sigma_{axis}"), found.good]
    coord, sigma, good = (np.take_along_axis(part, np.argsort(order, axis=1), axis=1) for part in maps)
    place = (np.arange(seen.shape[1]) + 0.5) / PER_CELL - 0.5
    return place, coord, sigma, good & np.isfinite(coord)


def _smooth(table: Floats) -> Floats:
    return np.asarray(uniform_filter1d(table, SMOOTH, mode="nearest"))
