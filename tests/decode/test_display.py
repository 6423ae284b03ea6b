"""What a display shifts is taken off, or in sigma: against light integrated cell by cell."""

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag, decode
from optolever.experiments.metrics import rms
from optolever.patterns import Sequence, sequence, sequence_from_text

from .conftest import scores, silent
from .light import COLS, WIDTH, U, camera, free_levels, photographed, seen_by_pixels


def _capture(
    cols: int, width: float, blur: float, seed: int = 0, **params: float | tuple[float, ...]
) -> tuple[Sequence, NDArray[np.float64], NDArray[np.float64]]:
    shown = sequence("phase" if "periods" in params else "gray+phase", 4, cols, axes="u", **params)
    u = np.arange(-0.4, cols - 0.7, width)
    frames = np.repeat(seen_by_pixels(shown, u, width, blur), 24, axis=1)
    noisy = frames + 0.5 * np.random.default_rng(seed).standard_normal(frames.shape)
    return shown, u, np.clip(np.rint(noisy * 16), 0, 4095).astype(np.uint16)


@pytest.mark.daily(1)
@pytest.mark.parametrize("blur", [0.4, 0.5, 0.8])
def test_levels_of_four_steps_are_rounded_alike_and_low_stairs_taken_off(blur: float) -> None:
    shown, u, frames = _capture(200, 0.7, blur, period=8.0)
    inside = (u > 4) & (u < 195)
    left = (decode(frames, shown).u - u).mean(axis=0)[inside]
    noise = 0.5 / (0.85 * 127.5 * 0.85) * 8.0 / (2 * np.pi) / np.sqrt(2 * 24)
    assert left.std() < 1.3 * noise + 3e-4
    assert abs(left.mean()) < 3 * noise / np.sqrt(inside.sum()) + 1e-4


@pytest.mark.daily(2)
@pytest.mark.parametrize(("lit", "blur"), [(0.8, 0.2), (0.6, 0.2), (0.6, 0.4)])
@pytest.mark.parametrize("code", ["gray+phase:axes=u", "phase:axes=u,steps=3,periods=8.73782/8.05745/8"])
def test_dark_rims_of_cells_are_told(code: str, lit: float, blur: float) -> None:
    """What they shift no blur of whole cells does, as two aliases of a fringe differ in it."""
    shown = sequence_from_text(code, 4, 150)
    row, col = np.mgrid[:96, :120]
    u = 12 + (0.8 + 0.01 * np.sin(row / 15)) * col + 2 * np.sin(col / 25 + row / 30)
    found = decode(photographed(shown, u, 0.8, blur, noise=0.7, lit=lit), shown)
    assert found.good.mean() > 0.95
    assert silent(found, u) < 3e-3
    assert rms(scores(found, u)) < 1.35


@pytest.mark.daily(1)
@pytest.mark.parametrize(("period", "blur"), [(4.0, 0.4), (5.0, 0.4), (6.0, 0.38)])
def test_low_stairs_leave_little(period: float, blur: float) -> None:
    """Of stairs of up to 0.04 cells less than a twelfth is left: tables follow them between their entries."""
    shown, u, frames = _capture(200, 0.53, blur, period=period)
    inside = (u > 6) & (u < 193)
    left = (decode(frames, shown, blur_px=blur).u - u).mean(axis=0)[inside]
    ideal = (decode(frames, shown, on_cells=False).u - u).mean(axis=0)[inside]
    wave = np.exp(2j * np.pi * u[inside])
    assert abs(np.mean(left * wave)) < abs(np.mean(ideal * wave)) / 12


@pytest.mark.parametrize(("period", "most"), [(3.0, 8e-4), (4.0, 5e-4)])
def test_tables_follow_the_stairs_of_fine_fringes(period: float, most: float) -> None:
    """Of stairs of 0.03 to 0.05 cells rms, without noise: straight lines between entries leave little."""
    shown = sequence("phase", 4, 200, axes="u", periods=(200.0, period))
    u = np.arange(-0.4, 199.3, 0.4949)
    frames = np.repeat(seen_by_pixels(shown, u, 0.4949, 0.4), 24, axis=1)
    inside = (u > 6) & (u < 193)
    left = (decode(frames, shown, blur_px=0.4).u - u).mean(axis=0)[inside]
    ideal = (decode(frames, shown, on_cells=False).u - u).mean(axis=0)[inside]
    assert ideal.std() > 0.02
    assert left.std() < most


@pytest.mark.daily(1)
@pytest.mark.parametrize("first", [9.4, 9.8])
def test_a_gain_that_all_pixels_have_is_no_blur(first: float) -> None:
    """Behind a blur that leaves nothing of the cells, in step with them: to correct it takes noise off."""
    shown = sequence("gray+phase", 4, 169, axes="u")
    u = first + 1.004 * np.arange(100) + 0.0005 * np.arange(96)[:, None]
    every = [decode(photographed(shown, u, 1.03, 0.75, noise=1.5, seed=seed), shown) for seed in range(4)]
    for found in every:
        assert found.good.all()
        assert rms((found.u - u).mean(axis=0)) < 1.2 * rms(found.sigma_u) / np.sqrt(96)
    # 0.90 over 15 draws: what the cells may leave is in sigma
    assert 0.88 < rms(np.concatenate([scores(found, u) for found in every])) < 1.05


def test_blur_is_told_by_fine_periods() -> None:
    """Without white and black contrasts are compared with those of another fine period."""
    shown, u, frames = _capture(78, 0.71, 0.3, periods=(4.94, 4.15, 4.0), steps=6)
    inside = (u > 6) & (u < 71)
    found, given = decode(frames, shown), decode(frames, shown, blur_px=0.3)
    good = (found.flags == 0) & (given.flags == 0) & inside
    assert good.sum() > 0.35 * good.shape[0] * inside.sum()
    assert rms((found.u - given.u)[good]) < 2e-3
    assert rms((given.u - u)[good]) < 2e-3
    assert rms(((found.u - u) / found.sigma_u)[good]) < 1.1


def test_dark_border_is_taken_off_or_flagged() -> None:
    shown, u, frames = _capture(120, 0.7, 0.5, period=8.0)
    found = decode(frames, shown)
    error = np.abs(found.u - u)
    good = found.flags == 0
    raw = np.abs(decode(frames, shown, on_cells=False).u - u)
    assert raw[:, 0].min() > 0.2
    assert (error[good] < 4 * found.sigma_u[good] + 0.01).all()
    assert (found.flags[:, 0] & Flag.OFF_PATTERN).all()
    assert good[:, 2:-2].all()


@pytest.mark.daily(2)
@pytest.mark.parametrize("width", [0.7, 0.95, 1.05])
def test_stairs_of_a_sharp_display_are_undone(width: float) -> None:
    """Pixels of 0.7 cells keep their place unknown on treads of 0.3 cells; wider ones have no treads."""
    shown, u, frames = _capture(400, width, 1e-3, period=8.0)
    inside = (u > 9) & (u < 390)
    found = decode(frames, shown)
    error, sigma = (found.u - u)[:, inside], found.sigma_u[:, inside]
    raw = (decode(frames, shown, on_cells=False).u - u)[:, inside]
    assert 0.55 < rms(error / sigma) < 1.15
    assert error.mean(axis=0).std() < (0.7 if width < 0.9 else 0.25) * raw.mean(axis=0).std()


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("period", "blur", "width", "most"),
    [
        (4.0, 0.25, 0.23, 0.01),
        (8.0, 0.2, 0.23, 0.02),
        (16.0, 0.2, 0.23, 0.03),
        (48.0, 0.02, 0.53, 0.12),
        (8.0, 0.18, 0.5, 0.02),
    ],
)
def test_sigma_on_steep_stairs(period: float, blur: float, width: float, most: float) -> None:
    """Where treads and risers leave many places likely, the error is that of their mean."""
    shown, u, frames = _capture(160, width, blur, period=period)
    found = decode(frames, shown)
    good = (found.flags == 0) & (u > 6) & (u < 153)
    score = ((found.u - u) / found.sigma_u)[good]
    assert rms((found.u - u)[good]) < most
    assert rms(score) < 1.1
    assert np.mean(np.abs(score) > 5) < 1e-3


@pytest.mark.daily(1)
@pytest.mark.parametrize("pixel", [0.3, 0.9, 1.7])
def test_ideal_cosines_are_left_alone(pixel: float) -> None:
    """Frames computed as cosines have the contrast of a sharp display, but none of its stairs."""
    row, col = np.mgrid[:96, :128].astype(float)
    u = 2 + pixel * col + 1.5 * np.sin(row / 17)
    shown = sequence("gray+phase", 4, 224, axes="u", period=16.0)
    bits = shown.tables()[0][:, np.rint(u).astype(int)] / 127.5 - 1
    fringes = [
        np.cos(2 * np.pi * u / f.period_px - (f.shift or 0)) if f.period_px else bits[i]
        for i, f in enumerate(shown.frames)
    ]
    found = decode(camera(128 + 100 * np.stack(fringes), 1.0), shown)
    assert found.good.mean() > 0.99
    assert 0.95 < rms(scores(found, u)) < 1.06


def test_noise_is_not_taken_for_a_contrast_that_varies() -> None:
    """Strong blur and noise, periods alike: untold, the border moved coordinates by five sigma, unflagged."""
    shown = sequence("phase", 4, 190, axes="u", periods=(38.1, 32.0, 26.8), steps=5)
    u = np.arange(-0.3, 189.4, 1.02)
    clean = 20 + (np.repeat(seen_by_pixels(shown, u, 1.0, 2.9), 96, axis=1) - 16) * 0.12
    found = decode(camera(clean, 1.6, 3), shown)
    assert found.good.mean() > 0.85
    assert silent(found, u) <= 1e-4
    assert found.good[:, (u > 3.5) & (u < 185.5)].mean() > 0.9


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("period", "blur", "width"), [(8.0, 0.2, 0.35), (8.0, 0.25, 0.35), (16.0, 0.2, 0.35)]
)
def test_nothing_is_wrong_at_the_border_of_a_sharp_display(period: float, blur: float, width: float) -> None:
    """The outermost cell is a tread up to the border; noise reaches from there to the next one."""
    shown, u, _ = _capture(120, width, blur, period=period)
    frames = np.repeat(seen_by_pixels(shown, u, width, blur), 48, axis=1)
    every = [decode(camera(frames, 1.0, seed), shown) for seed in range(4)]
    assert min(found.good.mean() for found in every) > 0.98
    assert np.mean([silent(found, u) for found in every]) <= 1e-4


CODES = {
    "stripes, 4 px apart": (sequence("stripe", 4, COLS, axes="u", step=4), {}),
    "stripes, 8 px apart": (sequence("stripe", 4, COLS, axes="u", step=8), {}),
    "micro phase": (sequence("micro-phase", 4, COLS, axes="u"), {}),
    "free grey values": (free_levels(COLS, 12), {}),
    "gray within its cells": (sequence("gray", 4, COLS, axes="u"), {"subpixel": True}),
}


@pytest.mark.daily(3)
@pytest.mark.parametrize("blur", [0.02, 0.2])
@pytest.mark.parametrize("name", CODES)
def test_stairs_of_the_cells_are_known(name: str, blur: float) -> None:
    """Treads of up to 0.4 cells: taken off where blur lets places on them be told, in sigma elsewhere."""
    shown, options = CODES[name]
    # of values that change from cell to cell, less noise tells that pixels are not a cell wide, and flags
    noise = 2.0 if name == "free grey values" else 0.5
    found = decode(photographed(shown, U, WIDTH, blur, noise), shown, **options)
    assert found.good.mean() > 0.95
    assert silent(found, U) < 2e-4
    assert rms(scores(found, U)) < 1.25
    stairs = (1 - WIDTH) / np.sqrt(12)
    assert rms((found.u - U)[found.good]) < (1.1 if blur < 0.1 else 0.6) * stairs


@pytest.mark.daily(1)
@pytest.mark.parametrize("noise", [4.0, 10.0, 25.0])
def test_noise_that_reaches_over_cells_is_no_less_for_their_stairs(noise: float) -> None:
    """Coarse fringes, whose error is 0.15 to 1 cells."""
    shown = sequence("gray+phase", 4, COLS, axes="u", period=32)
    found = decode(photographed(shown, U, WIDTH, 0.05, noise, seed=4), shown, blur_px=0.05)
    assert rms(scores(found, U)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.daily(2)
@pytest.mark.parametrize("name", CODES)
def test_what_few_pixels_cannot_tell_is_in_sigma(name: str) -> None:
    """Too small an image for runs of pixels that would tell how high the stairs are."""
    shown, options = CODES[name]
    few, noise = U[:20, :28], 2.0 if name == "free grey values" else 0.5
    found = decode(photographed(shown, few, WIDTH, 0.1, noise), shown, **options)
    score = scores(found, few)
    assert len(score) > 400
    assert np.abs(score).max() < 5


def test_light_that_is_missing_at_the_border_is_no_wrong_frame() -> None:
    shown = sequence("stripe", 4, 60, axes="u", step=4)
    u = -0.5 + 0.97 * np.arange(62)
    found = decode(photographed(shown, np.tile(u, (96, 1)), 0.97, 3.0, 0.5), shown)
    inner = (u > 8) & (u < 51)
    assert found.good[:, inner].mean() > 0.99


def test_pixels_beyond_a_depth_edge_tell_no_footprint() -> None:
    """Pixels up to three away from it were taken for wider or narrower ones."""
    shown = sequence("gray+phase", 4, 220, axes="u")
    col = np.arange(80)
    u = 20 + 1.58 * col - 10.7 * (col >= 40) + 0.013 * np.arange(48)[:, None]
    found = decode(photographed(shown, u, width=1.58, blur=0.2, noise=0.5), shown)
    assert found.good.mean() > 0.97
    assert (np.abs(found.u - u) / found.sigma_u)[found.good].max() < 5
