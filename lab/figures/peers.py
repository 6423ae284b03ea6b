"""Other decoders on the same frames: `fringes` (GPL: run, never copied), OpenCV's structured_light."""

import importlib
import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

Images = list[NDArray[np.uint8]]


def axis_by_axis(shown: Sequence) -> Sequence:
    """The same frames in the peers' order: u before v, a fringe's shifts ascending. For a static rig and a
    display without lag the order has no effect."""
    periods = list(dict.fromkeys(frame.period_px for frame in shown.frames))

    def place(frame: Frame) -> tuple[str, int, float]:
        return frame.axis or "", periods.index(frame.period_px), frame.shift or 0.0

    return replace(shown, frames=tuple(sorted(shown.frames, key=place)))


def fringes_coder(shown: Sequence) -> Any:
    """A `fringes` coder of our frames. InputError unless all are phase frames, the same on u and v."""
    fringes: Any = importlib.import_module("fringes")
    periods, steps = _ladder(shown, "u")
    if (periods, steps) != _ladder(shown, "v") or any(f.kind != "phase" for f in shown.frames):
        raise InputError("fringes: takes phase frames of the same periods and steps on u and v only")
    coder = fringes.Fringes()
    coder.X, coder.Y = shown.cols, shown.rows
    coder.K = len(periods)
    coder.p0 = 0.0  # the crest of every fringe is at coordinate 0, as in our frames
    coder.N = [[steps] * len(periods)] * 2
    extent = max(shown.rows, shown.cols)
    coder.v = [[extent / period for period in periods]] * 2
    return coder


def _ladder(shown: Sequence, axis: str) -> tuple[list[float], int]:
    """Periods in display order, and the number of steps, 0 unless the shifts are equal."""
    frames = [frame for frame in shown.frames if frame.axis == axis and frame.kind == "phase"]
    periods = list(dict.fromkeys(float(frame.period_px or 0.0) for frame in frames))
    steps = len(frames) // max(len(periods), 1)
    even = [2 * math.pi * k / steps for _ in periods for k in range(steps)] if steps else []
    fits = len(even) == len(frames) and np.allclose([frame.shift or 0.0 for frame in frames], even)
    return periods, steps if fits else 0


def cv2_coder(shown: Sequence) -> Any:
    """OpenCV's Gray code of bits with inverses on a surface of this size."""
    return cv2.structured_light.GrayCodePattern.create(shown.cols, shown.rows)


def cv2_decode(coder: Any, images: Images, white: NDArray[np.uint8], black: NDArray[np.uint8]) -> Any:
    """OpenCV's loop over all pixels. It requires two cameras: it gets the same one twice, at twice the
    time."""
    return coder.decode([images, images], None, [black] * 2, [white] * 2)


def cv2_places(coder: Any, images: Images, pixels: NDArray[np.integer]) -> Floats:
    """u and v (N, 2) of pixels (N, 2: row, column), one by one; NaN where OpenCV rejects the pixel."""
    found = [coder.getProjPixel(images, int(col), int(row)) for row, col in pixels]
    return np.array([(math.nan, math.nan) if wrong else place for wrong, place in found], np.float64)
