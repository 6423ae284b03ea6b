"""What blur leaves of contrasts: the kernels against the formulas in NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.blur_kernels import Looked, contrasts, swing_sums

F64 = NDArray[np.float64]
ROWS, WIDTH, APART = 6, 60, 2
FINE, COARSE = 8.0, 40.0
CLIP = 250.0


def wave(period: float, first: int) -> tuple[float, NDArray[Any], F64]:
    """Four quarters from frame `first` on."""
    weights = [[0.25] * 4, [0.5, 0, -0.5, 0], [0, 0.5, 0, -0.5]]
    return period, np.arange(first, first + 4), np.array(weights)


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
    samples = [0, 1, 2, 3] + ([8] if whole else [4, 5, 6, 7])
    top, offset = frames[samples].max(axis=0)[:, cols], levels[:4].mean(axis=0)[:, cols]
    use = (flags[:, cols] == 0) & (down + along < 0.2 * FINE) & (np.abs(coord[:, cols] - 20) < 12)
    use &= (against > 0) & (top < CLIP)
    image = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, len(cols)), indexing="ij")
    own = amplitude(levels, 0)[:, cols] / offset
    left = clear(0, FINE)[use] / against[use]
    want = np.stack([left, *(chart[use] for chart in (coord[:, cols], down, along, own, *image))])

    at = Looked(
        *(frames, None if linear else lut, cols, coord, below, APART, flags, 1, CLIP, 0.2 * FINE, 20.0, 12.0)
    )
    room, seen = np.empty((2, 3)), np.empty((7, ROWS * len(cols)))
    white = 8 if whole else -1
    count = contrasts(at, wave(FINE, 0), white, 9, None if whole else wave(COARSE, 4), room, seen)
    assert 5 < count < 0.5 * use.size
    np.testing.assert_allclose(seen[:, :count], want, rtol=1e-5, atol=1e-12)
    alone = contrasts(at, wave(FINE, 0), -1, -1, None, room, seen)
    assert alone > count
    assert np.all(seen[0, :alone] == 1)


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
