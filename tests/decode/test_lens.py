"""A camera's lens that blurs: at the mirror's ends, and where the map bends."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from optolever.decode import decode
from optolever.errors import InputError
from optolever.experiments.metrics import rms
from optolever.patterns import sequence

from .conftest import silent
from .footprints import centres, footprints, places


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("lens", "told"), [(1.0, False), (0.0, False), (0.5, False), (0.5, True), (1.0, True)]
)
def test_a_round_mirror_behind_a_lens_that_blurs(lens: float, told: bool) -> None:
    """Pixels on its end, and up to some deviations inside, see more of the one side: sigma says so."""
    row, col = places(72, 90)
    u, v = 10 + 1.7 * col + 0.004 * (row - 30) ** 2, 8 + 1.5 * row
    away = 28 - np.hypot(row - 36, 0.8 * (col - 45))
    shown = sequence("gray+phase", 120, 170)
    frames = footprints(shown, u, v, noise=0.7, dark=(away < 0).astype(float), lens=lens)
    found = decode(frames, shown, lens_px=lens if told else None)
    inside = centres(away) > 0
    found = replace(found, flags=np.where(inside, found.flags, 1).astype(np.uint16))
    assert silent(found, centres(u), centres(v)) <= 5e-4
    assert found.good[centres(away) > 3].mean() > 0.98
    deep = found.good & (centres(away) > 5)
    assert np.median(found.sigma_u[deep]) < 0.025


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("steep", "lens", "told"), [(1, 0.4, True), (1, 0.7, True), (1, 0.7, False), (2, 0.7, True)]
)
@pytest.mark.parametrize("name", ["phase", "gray+phase"])
def test_what_a_lens_flattens_of_a_bend_is_taken_off(name: str, steep: int, lens: float, told: bool) -> None:
    """lens^2 / 2 of the Laplacian, in an image that shows no end of the mirror, and less where much of a
    fringe lies on a pixel; some of it noise hides. If nobody tells, the fringes do."""
    row, col = places(72, 90)
    away2 = ((row - 36) ** 2 + (col - 45) ** 2) / 9**2
    bump = 3 * np.exp(-away2 / 2)
    u, v = 10 + 1.2 * steep * col + bump, 8 + 1.3 * steep * row - bump
    flat = centres(lens**2 / 2 * bump * (away2 - 2) / 9**2)
    shown = sequence(name, 120 * steep, 150 * steep)
    # a fringe of 16 cells tells places half as well as one of 8
    frames = footprints(shown, u, v, noise=0.25 if name == "phase" else 0.5, lens=lens)
    found = decode(frames, shown, lens_px=lens if told else None)
    inner = found.good & (np.hypot(centres(row) - 36, centres(col) - 45) < 30)
    for error, sigma in ((found.u - centres(u), found.sigma_u), (centres(v) - found.v, found.sigma_v)):
        assert abs(error[inner] @ flat[inner]) < 0.3 * flat[inner] @ flat[inner]
        assert rms((error / sigma)[inner]) < 1.15


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["phase", "gray+phase"])
def test_what_a_camera_sharpens_of_a_bend_is_taken_off(name: str) -> None:
    """An unsharp mask of 1 px rms and 0.6: half of 0.6 px^2 of the Laplacian, the other way round; next to
    nothing of that under fringes of 8 cells, of which no more may be taken off."""
    row, col = places(72, 90)
    away2 = ((row - 36) ** 2 + (col - 45) ** 2) / 9**2
    bump = 3 * np.exp(-away2 / 2)
    u, v = 10 + 1.2 * col + bump, 8 + 1.3 * row - bump
    steep = centres(-0.6 / 2 * bump * (away2 - 2) / 9**2)
    shown = sequence(name, 120, 150)
    frames = footprints(shown, u, v, noise=0.35 if name == "phase" else 0.7).astype(np.float32)
    sharp = [frame + 0.6 * (frame - cv2.GaussianBlur(frame, (0, 0), 1.0)) for frame in frames]
    found = decode(np.clip(np.rint(sharp), 0, 255).astype(np.uint8), shown)
    inner = found.good & (np.hypot(centres(row) - 36, centres(col) - 45) < 30)
    for error in (found.u - centres(u), centres(v) - found.v):
        assert abs(error[inner] @ steep[inner]) < 0.3 * steep[inner] @ steep[inner]


@pytest.mark.parametrize("lens", [-0.1, 4.1, np.nan])
def test_a_lens_blurs_no_more_than_bends_are_told_over(lens: float) -> None:
    with pytest.raises(InputError, match=f"lens_px is {lens}, must be 0 to 4"):
        decode(np.zeros((24, 4, 4), np.uint8), sequence("phase", 40, 40), lens_px=lens)
