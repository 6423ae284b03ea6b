"""Frames made in float64 from the definitions of the codes, without any of the package's tables."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence, code_words

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[np.generic]]


def level(frame: Frame, u: F64, v: F64) -> F64:
    """What a place on an ideal surface shows, 0..1."""
    coord = v if frame.axis == "v" else u
    if frame.kind in ("white", "black"):
        shown = np.full(u.shape, float(frame.kind == "white"))
    elif frame.kind == "uniform":
        shown = np.full(u.shape, frame.level / 255)
    elif frame.kind == "phase":
        shown = 0.5 + 0.5 * np.cos(2 * np.pi * coord / frame.period_px - frame.shift)
    elif frame.kind == "stripe":
        distance = np.abs(coord - (frame.at_v if frame.axis == "v" else frame.at_u)) / frame.width_px
        shown = np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * distance), 0.0)
    else:
        cell = np.floor((coord + 0.5) / frame.cell_px).astype(np.int64)
        gray = cell ^ (cell >> 1)
        words = {"binary": cell, "gray": gray, "xor-gray": gray ^ (-2 * (gray & 1))}
        if frame.kind == "long-run-gray":  # no closed form: tests/patterns tests the words
            words[frame.kind] = code_words(frame.kind, np.maximum(cell, 0), 8)
        shown = (words[frame.kind] >> frame.bit) & 1
    return 1.0 - shown if frame.inverted else np.asarray(shown, np.float64)


@pytest.fixture(scope="session")
def shoot() -> Shoot:
    """Function that captures a sequence: offset + amplitude (2 level - 1), noise, rounding, clipping."""

    def capture(
        sequence: Sequence,
        u: F64,
        v: F64,
        *,
        noise: float | F64 = 0.0,
        seed: int = 0,
        offset: float | F64 = 110.0,
        amplitude: float | F64 = 100.0,
        gamma: float = 1.0,
        gain: float = 0.0,
        dtype: type = np.uint8,
        top: float | None = None,
    ) -> NDArray[np.generic]:
        rng = np.random.default_rng(seed)
        limit = np.iinfo(dtype).max if top is None else top
        frames = np.empty((len(sequence), *u.shape), dtype)
        for i, frame in enumerate(sequence.frames):
            light = offset + amplitude * (2 * level(frame, u, v) ** gamma - 1)
            spread = np.sqrt(np.asarray(noise) ** 2 + gain * np.maximum(light, 0))
            frames[i] = np.clip(np.rint(light + spread * rng.standard_normal(u.shape)), 0, limit)
        return frames

    return capture


@pytest.fixture(scope="session")
def smooth() -> tuple[F64, F64]:
    """A map with changing gradient, on a surface of 150 rows x 170 columns; (120, 140)."""
    row, col = np.mgrid[:120, :140].astype(np.float64)
    return 12 + 0.97 * col + 9 * np.sin(row / 31), 10 + 1.03 * row + 6 * np.cos(col / 27)
