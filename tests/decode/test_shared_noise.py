"""Noise that rows, columns or whole frames share is told, and nothing else is taken for it."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import shift

from optolever.decode import Correspondence, SharedNoise, decode
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import WHITE_NOISE_SENSOR, capture
from optolever.scene import dent, load, resize, trace

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
    assert max(found.shift_u, found.shift_v) < 1e-4  # what cells leave


@pytest.mark.daily(1)
def test_a_camera_that_shakes(clean: tuple[np.ndarray, Sequence]) -> None:
    """By 0.1 pixels: the mean over the frames that tell a place shifts all of them."""
    frames, shown = clean
    rng, truth, ratios = np.random.default_rng(5), trace(RIG, SURFACE), []
    periods = Counter((one.axis, one.period_px) for one in shown.frames if one.kind == "phase")
    telling = max(periods.values()) if max(periods.values()) > 3 else sum(periods.values()) / 2
    for _ in range(4):
        moved = [shift(one, 0.1 * rng.standard_normal(2), order=3, mode="nearest") for one in frames]
        found = told_of(np.stack(moved), shown, rng)
        assert found is not None
        for told, at in ((found.shift_u, truth.u), (found.shift_v, truth.v)):
            ratios.append(told / (0.1 * px(at) / np.sqrt(telling)))
    # 16 numbers tell it to 20 %
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.daily(1)
def test_a_steady_motion_leaves_the_moment_of_the_pose_open(clean: tuple[np.ndarray, Sequence]) -> None:
    """The scene's pose may hold at any frame's time: a twelfth of the squared motion, as much again at most
    as places are seen after the middle; and chance of three draws."""
    frames, shown = clean
    whole = 0.1 * px(trace(RIG, SURFACE).u)
    for seed in range(3):
        moved = [
            shift(one, (0, 0.1 * i / len(frames)), order=3, mode="nearest") for i, one in enumerate(frames)
        ]
        found = told_of(np.stack(moved), shown, np.random.default_rng(seed))
        assert found is not None
        assert 0.25 * whole < found.shift_u < 0.55 * whole


def told_of(frames: np.ndarray, shown: Sequence, rng: np.random.Generator) -> SharedNoise | None:
    """What is told of frames with noise of one level."""
    seen = np.rint(frames + rng.standard_normal(frames.shape)).clip(0, 255).astype(np.uint8)
    return decode(seen, shown).shared_noise


def px(at: np.ndarray) -> float:
    """Pattern pixels of a camera pixel, usually."""
    return float(np.nanmedian(np.hypot(*np.gradient(at))))


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
