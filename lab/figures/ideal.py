"""Codes by their definitions: levels of an ideal surface at (u, v). Only bits and free levels have cells; no
blur, no pixel area. Independent of the package's tables, except for long-run words.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.patterns import Frame, Sequence, code_words


def ideal_level(shown: Sequence, index: int, u: Floats, v: Floats) -> Floats:
    """0..1 of frame `index` at places (u, v), pattern pixels."""
    frame = shown.frames[index]
    coord = v if frame.axis == "v" else u
    if frame.kind in ("white", "black"):
        level = np.full(u.shape, float(frame.kind == "white"))
    elif frame.kind == "uniform":
        level = np.full(u.shape, (frame.level or 0) / 255)
    elif frame.kind == "phase":
        level = 0.5 + 0.5 * np.cos(2 * np.pi * coord / (frame.period_px or 1.0) - (frame.shift or 0.0))
    elif frame.kind == "stripe":
        at = frame.at_v if frame.axis == "v" else frame.at_u
        away = np.minimum(np.abs(coord - (at or 0.0)) / (frame.width_px or 1.0), 1.0)
        level = 0.5 + 0.5 * np.cos(np.pi * away)
    else:
        cell = np.floor((coord - (frame.offset_px or 0.0) + 0.5) / frame.cell_px).astype(np.int64)
        level = _of_cells(shown, frame, cell)
    return 1.0 - level if frame.inverted else np.asarray(level, np.float64)


def _of_cells(shown: Sequence, frame: Frame, cell: NDArray[np.int64]) -> Floats:
    if frame.levels is not None:
        return np.asarray(frame.levels, np.float64)[np.clip(cell, 0, len(frame.levels) - 1)] / 255.0
    words = {"binary": cell, "gray": cell ^ (cell >> 1)}
    if frame.kind == "long-run-gray":  # no closed form: tests/patterns tests the words
        bits = 1 + max(other.bit or 0 for other in shown.frames if other.axis == frame.axis)
        words[frame.kind] = code_words(frame.kind, np.maximum(cell, 0), bits)
    return np.asarray((words[frame.kind] >> (frame.bit or 0)) & 1, np.float64)


def camera_frames(
    shown: Sequence,
    place: tuple[Floats, Floats],
    levels: tuple[float, float],
    noise: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Frames (N, H, W) of pixels at place (u, v); levels: offset and amplitude; noise: white, rms."""
    offset, amplitude = levels
    frames = np.empty((len(shown), *place[0].shape), np.uint8)
    for i in range(len(shown)):
        light = offset + amplitude * (2 * ideal_level(shown, i, *place) - 1)
        frames[i] = np.clip(np.rint(light + noise * rng.standard_normal(light.shape)), 0, 255)
    return frames
