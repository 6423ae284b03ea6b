"""The package `fringes`, a peer of the decoder, set to frames of ours."""

import importlib
import math
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.patterns import Sequence

__all__ = ["fringes_coder"]


def fringes_coder(shown: Sequence) -> Any:
    """A coder that shows our frames; bad input: others than phase frames, the same on u and v."""
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
    """Periods in order of showing, and the number of steps, 0 if they are not evenly shifted."""
    frames = [frame for frame in shown.frames if frame.axis == axis and frame.kind == "phase"]
    periods = list(dict.fromkeys(float(frame.period_px or 0.0) for frame in frames))
    steps = len(frames) // max(len(periods), 1)
    even = [2 * math.pi * k / steps for _ in periods for k in range(steps)] if steps else []
    fits = len(even) == len(frames) and np.allclose([frame.shift or 0.0 for frame in frames], even)
    return periods, steps if fits else 0
