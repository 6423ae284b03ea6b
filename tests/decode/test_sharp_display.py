"""A sharp display and small pixels: no answer is surer than it may be, whatever was shown."""

import numpy as np
import pytest

from optolever.decode import decode
from optolever.experiments.metrics import rms
from optolever.patterns import sequence

from .conftest import scores, silent
from .light import COLS, WIDTH, U, free_levels, photographed

CODES = {
    "stripes, 4 px apart": (sequence("stripe", 4, COLS, axes="u", step=4), {}),
    "stripes, 8 px apart": (sequence("stripe", 4, COLS, axes="u", step=8), {}),
    "micro phase": (sequence("micro-phase", 4, COLS, axes="u"), {}),
    "free grey values": (free_levels(COLS, 12), {}),
    "gray within its cells": (sequence("gray", 4, COLS, axes="u"), {"subpixel": True}),
}


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


@pytest.mark.parametrize("noise", [4.0, 10.0, 25.0])
def test_noise_that_reaches_over_cells_is_no_less_for_their_stairs(noise: float) -> None:
    """Coarse fringes, whose error is 0.15 to 1 cells."""
    shown = sequence("gray+phase", 4, COLS, axes="u", period=32)
    found = decode(photographed(shown, U, WIDTH, 0.05, noise, seed=4), shown, blur_px=0.05)
    assert rms(scores(found, U)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", CODES)
def test_what_few_pixels_cannot_tell_is_in_sigma(name: str) -> None:
    """Too small an image for runs of pixels that would tell how high the stairs are."""
    shown, options = CODES[name]
    few, noise = U[:20, :28], 2.0 if name == "free grey values" else 0.5
    found = decode(photographed(shown, few, WIDTH, 0.1, noise), shown, **options)
    score = scores(found, few)
    assert len(score) > 400
    assert np.abs(score).max() < 5


@pytest.mark.parametrize("blur", [1.2, 1.7, 3.3])
def test_blur_of_a_sweep_is_measured_between_those_that_are_tried(blur: float) -> None:
    shown = sequence("stripe", 4, COLS, axes="u", step=8)
    found = decode(photographed(shown, U, WIDTH, blur, 0.5), shown)
    assert found.good.mean() > 0.95
    assert rms(scores(found, U)) == pytest.approx(1.0, abs=0.15)


def test_light_that_is_missing_at_the_border_is_no_wrong_frame() -> None:
    shown = sequence("stripe", 4, 60, axes="u", step=4)
    u = -0.5 + 0.97 * np.arange(62)
    found = decode(photographed(shown, np.tile(u, (96, 1)), 0.97, 3.0, 0.5), shown)
    inner = (u > 8) & (u < 51)
    assert found.good[:, inner].mean() > 0.99
