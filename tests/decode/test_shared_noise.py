"""Noise that rows, columns or whole frames share is told, and nothing else is taken for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.decode import Correspondence, SharedNoise, decode
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import WHITE_NOISE_SENSOR, capture
from optolever.scene import dent, load, resize

RIG = replace(resize(load("prism48", exact=True), 150, 200), sensor=WHITE_NOISE_SENSOR)
SURFACE = dent("gaussian", RIG, peak=0.2, sigma=6.0)
CODES = ("gray+phase", "phase", "phase:steps=3,periods=8.74/8.06/8", "micro-phase")


@pytest.fixture(scope="module", params=CODES)
def clean(request: pytest.FixtureRequest) -> tuple[np.ndarray, Sequence]:
    """Frames without noise."""
    shown = sequence_from_text(request.param, RIG.pattern.rows, RIG.pattern.cols)
    seen = capture(RIG, SURFACE, shown, renderer="numpy")
    return seen.frames.astype(np.float64), shown


def decoded(
    clean: tuple[np.ndarray, Sequence], noise: float, rows: float, cols: float, seed: int = 5
) -> Correspondence:
    frames, shown = clean
    rng = np.random.default_rng(seed)
    count, height, width = frames.shape
    noisy = frames + noise * rng.standard_normal(frames.shape)
    noisy += rows * rng.standard_normal((count, height, 1)) + cols * rng.standard_normal((count, 1, width))
    return decode(np.rint(noisy).clip(0, 255).astype(np.uint8), shown)


@pytest.mark.daily(3)
@pytest.mark.parametrize(("rows", "cols"), [(0.4, 0.0), (0.0, 0.4), (0.3, 0.5)])
def test_shares_are_told(clean: tuple[np.ndarray, Sequence], rows: float, cols: float) -> None:
    every = [decoded(clean, 1.0, rows, cols, seed).shared_noise for seed in (5, 6)]
    assert None not in every
    found = np.mean([(one.rows, one.cols) for one in every if one is not None], axis=0)
    whole = 1.0 + 1 / 12 + rows**2 + cols**2
    # a variance of 150 lines is uncertain by sqrt(2 / 150) of itself
    true = rows**2 / whole, cols**2 / whole
    assert tuple(found) == pytest.approx(true, rel=3 * np.sqrt(2 / 150), abs=0.015)


@pytest.mark.daily(3)
@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
def test_what_a_display_does_is_none(clean: tuple[np.ndarray, Sequence], noise: float) -> None:
    """Its cells leave residuals that all pixels of one place have, in whole lines of an aligned rig."""
    found = decoded(clean, noise, 0.0, 0.0).shared_noise
    # adds at most as much to heights as other noise
    assert found is None or max(found.rows, found.cols) < 0.02
    # below the rounding of levels shown grey values are, to some per cent, other than described, and what a
    # display scatters makes white and black, by which micro-phase is told, less than twice a fringe's mean
    most = 0.35 if any(frame.kind == "white" for frame in clean[1].frames) else 0.05
    assert found is None or max(found[:4]) < most


@pytest.mark.daily(1)
def test_a_lamp_that_flickers(clean: tuple[np.ndarray, Sequence]) -> None:
    frames, shown = clean
    rng = np.random.default_rng(5)
    lamp = 1 + 0.02 * rng.standard_normal((len(frames), 1, 1))
    noisy = lamp * frames + rng.standard_normal(frames.shape)
    found = decode(np.rint(noisy).clip(0, 255).astype(np.uint8), shown).shared_noise
    assert found is not None
    assert min(found.frames_u, found.frames_v) > 0.15
    assert max(found.rows, found.cols) < 0.02


def test_saved_and_loaded(tmp_path: Path) -> None:
    ones = np.ones((4, 5))
    found = Correspondence(ones, ones, ones, ones, np.zeros((4, 5), np.uint16))
    told = replace(found, shared_noise=SharedNoise(0.1, 0.0, 0.3, 0.2, 0.125, 0.125))
    for one in (found, told):
        one.save(tmp_path / "c.npz")
        assert Correspondence.load(tmp_path / "c.npz") == one
    replace(found, shared_noise=SharedNoise(1.5, 0.0, 0.0, 0.0, 0.1, 0.1)).save(tmp_path / "c.npz")
    with pytest.raises(InputError, match=r"c\.npz: shared_noise is .*four shares"):
        Correspondence.load(tmp_path / "c.npz")
