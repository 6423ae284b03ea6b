"""Frames made in float64 from the definitions of the codes, without any of the package's tables."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.figures.ideal import ideal_level
from optolever.decode import Correspondence
from optolever.patterns import Sequence

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[Any]]
#: u and v of every pixel.
Map = tuple[F64, F64]


def scores(found: Correspondence, *truth: F64) -> F64:
    """Errors of u, or of u and v, over sigma, of the good pixels."""
    axes = zip((found.u, found.v), (found.sigma_u, found.sigma_v), truth, strict=False)
    return np.concatenate([((coord - true) / sigma)[found.good] for coord, sigma, true in axes])


def silent(found: Correspondence, *truth: F64, least: float = 0.0) -> float:
    """Share of the good pixels off by more than 5 sigma and than `least`, in u, or in either of u and v."""
    off = np.zeros(found.flags.shape, np.bool_)
    for coord, sigma, true in zip((found.u, found.v), (found.sigma_u, found.sigma_v), truth, strict=False):
        off |= ~(np.abs(coord - true) <= np.maximum(5 * sigma, least))
    return float(off[found.good].mean()) if found.good.any() else 0.0


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
    ) -> NDArray[Any]:
        rng = np.random.default_rng(seed)
        limit = np.iinfo(dtype).max if top is None else top
        frames = np.empty((len(sequence), *u.shape), dtype)
        for i in range(len(sequence)):
            light = offset + amplitude * (2 * ideal_level(sequence, i, u, v) ** gamma - 1)
            spread = np.sqrt(np.asarray(noise) ** 2 + gain * np.maximum(light, 0))
            frames[i] = np.clip(np.rint(light + spread * rng.standard_normal(u.shape)), 0, limit)
        return frames

    return capture


@pytest.fixture(scope="session")
def smooth() -> Map:
    """A map with changing gradient, on a surface of 150 rows x 170 columns; (120, 140)."""
    row, col = np.mgrid[:120, :140].astype(np.float64)
    return 12 + 0.97 * col + 9 * np.sin(row / 31), 10 + 1.03 * row + 6 * np.cos(col / 27)
