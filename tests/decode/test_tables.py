"""Swept stripes, free grey values, micro phase shifting, Gray codes within their cells."""

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import Frame, Sequence, sequence
from optolever.samples.metrics import rms

from .conftest import F64, Map, Shoot, scores, silent
from .light import cell_frames, free_levels, photographed


@pytest.mark.daily(1)
@pytest.mark.parametrize("params", [{"step": 4}, {"step": 8, "width": 16}, {"step": 3, "width": 9}])
def test_swept_stripe(shoot: Shoot, smooth: Map, params: dict[str, float]) -> None:
    shown = sequence("stripe", 150, 170, **params)
    found = decode(shoot(shown, *smooth, noise=1.0), shown)
    assert found.good.mean() > 0.999
    assert np.abs(found.u - smooth[0])[found.good].max() < 0.03 * params["step"]
    assert 0.87 < rms(scores(found, *smooth)) < 1.03


@pytest.mark.daily(1)
@pytest.mark.parametrize("step", [3, 4, 8])
def test_a_clipped_stripe_is_known_by_its_flanks(smooth: Map, step: int) -> None:
    """What is not clipped tells the place, however many samples a stripe has."""
    shown = sequence("stripe", 150, 170, step=step)
    frames = np.minimum(cell_frames(shown, *smooth, blur=0.5, noise=1.0), 140)
    found = decode(frames, shown, white_level=140)
    assert found.good.mean() > 0.99
    assert silent(found, *smooth) == 0
    assert np.quantile(np.abs(found.u - smooth[0])[found.good], 0.999) < 0.7
    assert 0.45 < rms(scores(found, *smooth)) < 1.1


@pytest.mark.daily(1)
@pytest.mark.parametrize("named", [False, True])
def test_micro_phase_shifting(shoot: Shoot, smooth: Map, named: bool) -> None:
    """Periods near 16 px, three shifts for the first and one for each other (Gupta & Nayar, CVPR 2012)."""
    frames = [Frame("white"), Frame("black")]
    for axis in "uv":
        frames += [Frame("phase", axis, period_px=16.0, shift=2 * np.pi * k / 3) for k in range(3)]
        frames += [Frame("phase", axis, period_px=period, shift=0.0) for period in (16.9, 17.8, 18.9, 20.1)]
    shown = sequence("micro-phase", 150, 170) if named else Sequence(tuple(frames), 150, 170)
    found = decode(shoot(shown, *smooth, noise=1.0), shown)
    assert found.good.mean() > 0.99
    assert np.abs(found.u - smooth[0])[found.good].max() < 0.15
    assert 0.7 < rms(scores(found, *smooth)) < 1.1


@pytest.mark.parametrize("jump", [0.0, 100.0])
def test_of_two_places_that_fit_neighbours_choose(shoot: Shoot, smooth: Map, jump: float) -> None:
    """Noise leaves a twelfth of the pixels two places; sigma beside them is that of the others, and no pixel
    amid a jump gets the place of the wrong side."""
    u, v = smooth[0] + 300 + jump * (np.arange(140) > 70), smooth[1] + 200
    shown = sequence("micro-phase", 600, 800)
    found = decode(shoot(shown, u, v, noise=3.0, gain=0.05), shown)
    assert found.good.mean() > 0.995
    assert silent(found, u, v) == 0
    assert np.mean(found.sigma_u[:, :60] > 0.2) < 0.01


def test_pattern_that_was_just_invented(smooth: Map) -> None:
    """Random grey values on cells of two pixels: unknown to the decoder but for their table."""
    values = np.random.default_rng(0).integers(0, 256, (2, 12, 90))
    shown = Sequence(
        tuple(
            Frame("levels", axis, levels=tuple(row.tolist()), cell_px=2.0)
            for axis, rows in zip("uv", values, strict=True)
            for row in rows
        ),
        150,
        170,
    )
    found = decode(cell_frames(shown, *smooth, blur=0.5, noise=1.0), shown)
    assert found.good.mean() > 0.97
    assert np.abs(found.u - smooth[0])[found.good].max() < 0.5
    assert 0.7 < rms(scores(found, *smooth)) < 1.3


def rows_of_pixels(cols: int, width: float) -> F64:
    """Where 40 rows of pixels of `width` cells look, each row from a place of its own."""
    return 6 + 0.97 * width * np.arange(int((cols - 14) / width)) + 0.0273 * np.arange(40)[:, None]


@pytest.mark.daily(1)
@pytest.mark.parametrize(("width", "blur", "noise"), [(1.0, 0.5, 1.0), (0.6, 0.02, 2.0), (2.0, 0.3, 1.0)])
def test_free_levels(width: float, blur: float, noise: float) -> None:
    shown, u = free_levels(200, 12), rows_of_pixels(200, width)
    found = decode(photographed(shown, u, width, blur, noise), shown)
    score = scores(found, u)
    assert found.good.mean() > 0.95
    assert np.mean(np.abs(score) > 5) <= 2e-4
    assert 0.3 < rms(score) < (1.35 if width == 2.0 else 1.25)  # look-ups share no blur
    assert np.median(found.amplitude) == pytest.approx(0.85 * 127.5, rel=0.1)
    assert np.median(found.offset) == pytest.approx(16 + 0.85 * 127.5, rel=0.1)


def test_two_places_alike_are_known() -> None:
    """Every level is shown at two places: an even chance, and no pixel is good."""
    values = np.tile(np.random.default_rng(5).integers(0, 256, (8, 60)), 2)
    shown = Sequence(tuple(Frame("levels", "u", levels=tuple(row.tolist())) for row in values), 4, 120)
    u = 5 + 0.9 * np.arange(50) + 0.013 * np.arange(20)[:, None]
    found = decode(photographed(shown, u), shown)
    assert found.good.mean() < 0.01
    assert np.median(found.order_error) > 0.45


def test_a_second_stripe_as_bright_is_doubtful() -> None:
    shown, u = sequence("stripe", 4, 170, axes="u", step=4), rows_of_pixels(170, 1.0)[:, :100]
    ghost = np.rint(0.5 * photographed(shown, u) + 0.5 * photographed(shown, u + 40)).astype(np.uint8)
    found = decode(ghost, shown)
    assert (found.order_error > 0.1).all()
    assert not found.good.any()
