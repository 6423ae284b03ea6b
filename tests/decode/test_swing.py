"""Blur from the swing of a contrast: against light integrated cell by cell, and where it must not be told."""

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import decode
from optolever.decode.swing import Contrasts, blur_by_swing
from optolever.decode.swing_kernels import LINES, prepare, swing
from optolever.patterns import sequence

from .light import seen_by_pixels

F64 = NDArray[np.float64]
COLS, ROWS = 160, 24


def drifting(width: float) -> F64:
    """Places (ROWS, W) of pixels that keep step with the cells but for a slow drift."""
    col = np.arange(int((COLS - 6) / width))
    return np.asarray(2.6 + width * col + 0.035 * np.arange(ROWS)[:, None] + 0.6 * np.sin(col / 9))


def contrasts(width: float, blur: float, period: float, noise: float) -> Contrasts:
    """Contrast of a fringe on cells as pixels see it, and noise of that."""
    u = drifting(width)
    shown = sequence("phase", 4, COLS, axes="u", periods=period, steps=16)
    wave = np.exp(2j * np.pi * np.arange(16) / 16)
    light = np.stack([wave @ seen_by_pixels(shown, row, width, blur)[:, 0] for row in u])
    sides = np.stack([np.zeros(u.shape), np.abs(np.gradient(u, axis=1))])
    at = np.stack(np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, u.shape[1]), indexing="ij"))
    inner = (u > 10) & (u < COLS - 10)
    rng = np.random.default_rng(0)
    seen = np.abs(light)[inner] * (1 + noise * rng.standard_normal(int(inner.sum())))
    return Contrasts(seen, u[inner], sides[:, inner], at[:, inner])


@pytest.mark.parametrize("period", [3.2, 4.0, 5.7, 9.0])
@pytest.mark.parametrize(("width", "blur"), [(1.0, 0.25), (1.0, 0.4), (2.0, 0.3), (2.0, 0.41), (0.5, 0.35)])
def test_the_swing_tells_the_blur(period: float, width: float, blur: float) -> None:
    noise = 0.001
    found = blur_by_swing(contrasts(width, blur, period, noise), period)
    assert found is not None
    assert abs(found.rms**2 - blur**2) < 3 * found.square_error + 0.004
    assert found.square_error < 0.02


@pytest.mark.parametrize("square", [0.0, 0.03, 0.2])
@pytest.mark.parametrize(("width", "period", "noise"), [(1.0, 3.2, 0.001), (2.0, 5.7, 0.05), (0.5, 9.0, 0.3)])
def test_kernels_against_formulas(square: float, width: float, period: float, noise: float) -> None:
    """Share of the swing, of one a quarter of a cell aside, and their error, by complex waves and pinv."""
    seen, f = contrasts(width, 0.3, period, noise), 1 / period
    left = np.prod(np.sinc(f * seen.sides), axis=0)
    above, below = (
        (-1) ** m
        * f
        / (f + m)
        * np.prod(np.sinc((f + m) * seen.sides), axis=0)
        / left
        * np.exp(-2 * np.pi**2 * square * ((f + m) ** 2 - f**2))
        for m in (1, -1)
    )
    wave = np.exp(2j * np.pi * seen.place)
    wave = np.exp(2j * np.pi * seen.place - 1j * np.angle(1 + above * wave + below / wave) / f)
    row, col = seen.at
    slow = np.stack([np.ones(len(row)), row, col, row * row, row * col, col * col], axis=1)
    less = np.eye(len(row)) - slow @ np.linalg.pinv(slow)
    level = seen.contrast / left
    rest = less @ (level / np.median(level))
    model = less @ np.abs(1 + above * wave + below / wave)
    aside = less @ np.abs(1 + 1j * (above * wave - below / wave))
    share = model @ rest / (model @ model)
    error = np.sqrt(np.mean((rest - share * model) ** 2) / (model @ model))
    room = np.empty((LINES, len(row)), np.float32)
    prepare(np.float32(f), *(np.float32(chart) for chart in (seen.contrast, seen.sides, seen.at)), room)
    place = np.float32(seen.place - np.rint(seen.place))
    found = swing(square, f, float(np.median(level)), place, room)
    want = share, aside @ rest / (aside @ aside), error
    np.testing.assert_allclose(found, want, rtol=1e-3, atol=1e-4)


def test_noise_that_hides_the_swing_hides_the_blur() -> None:
    assert blur_by_swing(contrasts(2.0, 0.41, 3.9, 0.05), 3.9) is not None
    assert blur_by_swing(contrasts(2.0, 0.41, 3.9, 0.3), 3.9) is None
    assert blur_by_swing(contrasts(2.0, 1.0, 3.9, 0.001), 3.9) is None


@pytest.mark.parametrize("turn", [0.25, 0.5, 0.75])
def test_what_else_swings_with_the_cells_is_no_blur(turn: float) -> None:
    """Neither aside by a quarter of a cell nor the wrong way round."""
    seen = contrasts(1.0, 0.35, 5.0, 0.001)
    place = Contrasts(seen.contrast, seen.place + turn, seen.sides, seen.at)
    assert blur_by_swing(place, 5.0) is None


def test_a_display_without_cells_has_no_swing() -> None:
    seen = contrasts(1.0, 0.35, 5.0, 0.001)
    rng = np.random.default_rng(1)
    flat = Contrasts(1 + 0.01 * rng.standard_normal(len(seen.place)), seen.place, seen.sides, seen.at)
    assert blur_by_swing(flat, 5.0) is None


@pytest.mark.parametrize(("width", "periods"), [(2.0, (3.91, 3.846)), (1.0, (4.2, 4.1)), (2.0, (5.87, 5.72))])
def test_alike_periods_on_pixels_that_keep_step(width: float, periods: tuple[float, ...]) -> None:
    """Nothing else tells the blur there: coordinates were off by up to four times their sigma, unflagged."""
    blur, u = 0.41, drifting(width)
    shown = sequence("phase", 4, COLS, axes="u", periods=periods, steps=9)
    frames = np.concatenate([seen_by_pixels(shown, row, width, blur) for row in u], axis=1)
    frames += 0.4 * np.random.default_rng(2).standard_normal(frames.shape)
    found = decode(np.clip(np.rint(frames), 0, 255).astype(np.uint8), shown)
    use = found.good & (u > 8) & (u < COLS - 8)
    assert use.mean() > 0.8
    wrong = ((found.u - u) / found.sigma_u)[use]
    assert np.sqrt(np.mean(wrong**2)) < 1.2
