"""A sharp display and small pixels: no answer is surer than it may be, whatever was shown."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import decode
from optolever.patterns import Frame, Sequence, sequence

from .light import seen_by_pixels

F64 = NDArray[np.float64]
ROWS, COLS, WIDTH = 96, 150, 0.6


@dataclass(frozen=True)
class Shot:
    shown: Sequence
    u: F64
    frames: NDArray[np.uint8]


def invented() -> Sequence:
    """Random grey values on single cells."""
    values = np.random.default_rng(0).integers(0, 256, (12, COLS))
    return Sequence(tuple(Frame("levels", "u", levels=tuple(row.tolist())) for row in values), 4, COLS)


def shot(shown: Sequence, blur: float, noise: float = 0.5) -> Shot:
    """Rows each of which sees the cells from a place of its own."""
    rng = np.random.default_rng(4)
    u = 8 + WIDTH * np.arange(int((COLS - 18) / WIDTH)) + 0.013 * np.arange(ROWS)[:, None]
    light = np.concatenate([seen_by_pixels(shown, row, WIDTH, blur) for row in u], axis=1)
    noisy = light + noise * rng.standard_normal(light.shape)
    return Shot(shown, u, np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


CODES = {
    "stripes, 4 px apart": (sequence("stripe", 4, COLS, axes="u", step=4), {}),
    "stripes, 8 px apart": (sequence("stripe", 4, COLS, axes="u", step=8), {}),
    "micro phase": (sequence("micro-phase", 4, COLS, axes="u"), {}),
    "free grey values": (invented(), {}),
    "gray within its cells": (sequence("gray", 4, COLS, axes="u"), {"subpixel": True}),
}


@pytest.mark.parametrize("blur", [0.02, 0.2])
@pytest.mark.parametrize("name", CODES)
def test_stairs_of_the_cells_are_known(name: str, blur: float) -> None:
    """Treads of up to 0.4 cells: taken off where blur lets places on them be told, in sigma elsewhere."""
    shown, options = CODES[name]
    # of values that change from cell to cell, less noise tells that pixels are not a cell wide, and flags
    one = shot(shown, blur, noise=2.0 if name == "free grey values" else 0.5)
    found = decode(one.frames, shown, **options)
    error, sigma = (found.u - one.u)[found.good], found.sigma_u[found.good]
    assert found.good.mean() > 0.95
    assert np.mean(np.abs(error) > 5 * sigma) < 2e-4
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.25
    stairs = (1 - WIDTH) / np.sqrt(12)
    assert np.sqrt(np.mean(error**2)) < (1.1 if blur < 0.1 else 0.6) * stairs


@pytest.mark.parametrize("noise", [4.0, 10.0, 25.0])
def test_noise_that_reaches_over_cells_is_no_less_for_their_stairs(noise: float) -> None:
    """Coarse fringes, whose error is 0.15 to 1 cells."""
    shown = sequence("gray+phase", 4, COLS, axes="u", period=32)
    one = shot(shown, 0.05, noise=noise)
    found = decode(one.frames, shown, blur_px=0.05)
    score = ((found.u - one.u) / found.sigma_u)[found.good]
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", CODES)
def test_what_few_pixels_cannot_tell_is_in_sigma(name: str) -> None:
    """Too small an image for runs of pixels that would tell how high the stairs are."""
    shown, options = CODES[name]
    one = shot(shown, 0.1, noise=2.0 if name == "free grey values" else 0.5)
    found = decode(one.frames[:, :20, :28], shown, **options)
    score = ((found.u - one.u[:20, :28]) / found.sigma_u)[found.good]
    assert len(score) > 400
    assert np.abs(score).max() < 5


@pytest.mark.parametrize("blur", [1.2, 1.7, 3.3])
def test_blur_of_a_sweep_is_measured_between_those_that_are_tried(blur: float) -> None:
    shown = sequence("stripe", 4, COLS, axes="u", step=8)
    one = shot(shown, blur)
    found = decode(one.frames, shown)
    error = (found.u - one.u)[found.good]
    assert found.good.mean() > 0.95
    assert np.sqrt(np.mean((error / found.sigma_u[found.good]) ** 2)) == pytest.approx(1.0, abs=0.15)


def test_light_that_is_missing_at_the_border_is_no_wrong_frame() -> None:
    shown = sequence("stripe", 4, 60, axes="u", step=4)
    u = -0.5 + 0.97 * np.arange(62)
    light = np.repeat(seen_by_pixels(shown, u, 0.97, 3.0), 96, axis=1)
    noisy = light + 0.5 * np.random.default_rng(2).standard_normal(light.shape)
    found = decode(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), shown)
    inner = (u > 8) & (u < 51)
    assert found.good[:, inner].mean() > 0.99
