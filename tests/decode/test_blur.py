"""What blur leaves of contrasts: the kernels against the formulas in NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.blur_kernels import contrasts, swing_sums

F64 = NDArray[np.float64]
ROWS, WIDTH, APART = 6, 60, 2
FINE, COARSE = 8.0, 40.0
CLIP = 250.0


def wave(period: float, first: int) -> tuple[float, NDArray[Any], F64]:
    """Four quarters from frame `first` on."""
    return period, np.arange(first, first + 4), np.array([[0.5, 0, -0.5, 0], [0, 0.5, 0, -0.5]])


def amplitude(levels: F64, first: int) -> F64:
    return np.asarray(
        0.5 * np.hypot(levels[first] - levels[first + 2], levels[first + 1] - levels[first + 3])
    )


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("linear", [True, False])
def test_contrasts(whole: bool, linear: bool) -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (10, ROWS, WIDTH)).astype(np.uint8)
    lut = (255 * (np.arange(256) / 255) ** 2.2).astype(np.float32)
    coord = np.arange(WIDTH) * 0.7 + rng.normal(0, 0.5, (ROWS, WIDTH))
    below = coord + rng.normal(0, 4, coord.shape)
    flags = (rng.random(coord.shape) < 0.2).astype(np.uint16)
    cols = np.arange(2, WIDTH - 2, 3)
    levels = frames.astype(np.float64) if linear else lut[frames].astype(np.float64)
    down = np.abs(below - coord)[:, cols] / APART
    along = 0.25 * np.abs(coord[:, cols + 2] - coord[:, cols - 2])

    def clear(first: int, period: float) -> F64:
        left = np.sinc(1 / period) * np.sinc(down / period) * np.sinc(along / period)
        return amplitude(levels, first)[:, cols] / left

    against = 0.5 * (levels[8] - levels[9])[:, cols] if whole else clear(4, COARSE)
    top = frames[[0, 1, 2, 3, 8] if whole else slice(0, 8)].max(axis=0)[:, cols]
    use = (flags[:, cols] == 0) & (down + along < 0.2 * FINE) & (against > 0) & (top < CLIP)
    use &= np.abs(coord[:, cols] - 20) < 12
    left = clear(0, FINE)[use] / against[use]
    want = np.stack([left, coord[:, cols][use], down[use], along[use]])

    seen = np.empty((4, ROWS * len(cols)))
    count = contrasts(
        *(frames, None if linear else lut, cols, wave(FINE, 0), 8, 9, None if whole else wave(COARSE, 4)),
        *(coord, below, APART, flags, 1, CLIP, 0.2, 20.0, 12.0, seen),
    )
    assert 5 < count < 0.5 * use.size
    np.testing.assert_allclose(seen[:, :count], want, rtol=1e-6)


@pytest.mark.parametrize("coarse", [(0.0, 0.0), (0.03, -0.05)])
def test_swing(coarse: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    left, place = rng.uniform(0.5, 1, 200), rng.uniform(-0.5, 0.5, 200)
    before = rng.normal(0, 0.02, 200)
    now, trial = (0.8, 0.1, -0.3, *coarse), (0.78, 0.08, -0.25, *coarse)

    def seen(swing: tuple[float, ...], at: F64) -> F64:
        angle = 2 * np.pi * at
        fine, other = (
            (1 + both * np.cos(angle)) + 1j * odd * np.sin(angle) for both, odd in (swing[1:3], swing[3:])
        )
        return np.asarray(swing[0] * np.abs(fine / other))

    angle = 2 * np.pi * (place - before)
    shift = FINE / (2 * np.pi) * np.arctan2(now[2] * np.sin(angle), 1 + now[1] * np.cos(angle))
    model = seen(now, place - shift)
    change = seen(trial, place - shift) - model
    narrow = before.astype(np.float32)
    got = swing_sums(
        *(left.astype(np.float32), place.astype(np.float32), narrow, FINE),
        *(tuple(map(np.float32, swing)) for swing in (now, trial)),
    )
    np.testing.assert_allclose(got, [np.sum(change * (left - model)), np.sum(change**2)], rtol=1e-4)
    np.testing.assert_allclose(narrow, shift, atol=2e-6)
