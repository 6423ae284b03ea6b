"""RigProfile: estimated on one capture, applied to others; told where it no longer holds."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, Decoder, RigProfile, decode, estimate_profile
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import capture
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace

from .conftest import scores, silent

Frames = NDArray[np.uint8]
#: Gray and fringes, fringes of a ladder, bits alone, close periods, codes that are looked up.
CODES = ("gray+phase", "phase", "gray", "phase:steps=4,periods=20/22/25", "micro-phase")


@lru_cache(maxsize=1)
def rig() -> Scene:
    """A prism in front of 1100 cells at most, which close periods tell apart."""
    return resize(load("prism48"), 180, 240)


@lru_cache(maxsize=16)
def shot(text: str, times: float, noise: float = 1.0, seed: int = 0) -> tuple[Frames, Sequence, Trace]:
    """Frames of a dent so many times as deep as the usual one, and where its pixels look."""
    shown = sequence_from_text(text, rig().pattern.rows, rig().pattern.cols)
    usual = dent_from_text("gaussian", rig())
    surface = dent_from_text(f"gaussian:peak={usual.formula.params['peak'] * times}", rig())
    return capture(rig(), surface, shown, noise=noise, seed=seed).frames, shown, trace(rig(), surface)


def good_share(found: Correspondence, truth: Trace) -> float:
    return float((found.good & truth.visible).sum() / truth.visible.sum())


@pytest.mark.daily(2)
@pytest.mark.parametrize("text", CODES)
def test_a_profile_of_one_capture_serves_another(text: str, tmp_path: Path) -> None:
    """Another dent, other noise: as many good pixels, sigma as true, none silently wrong; it is kept."""
    frames, shown, _ = shot(text, 1.0)
    estimate_profile(frames, shown).save(tmp_path / "p.npz")
    other, _, truth = shot(text, 1.3, seed=1)
    decoder = Decoder(shown, RigProfile.load(tmp_path / "p.npz"))
    found, alone = decoder.decode(other), decode(other, shown)
    assert not [notice for notice in found.notices if "profile" in notice.name]
    assert good_share(found, truth) == pytest.approx(good_share(alone, truth), abs=1e-3)
    assert silent(found, truth.u, truth.v) == 0
    ratio = float(np.sqrt(np.mean(scores(found, truth.u, truth.v) ** 2)))
    usual = float(np.sqrt(np.mean(scores(alone, truth.u, truth.v) ** 2)))
    assert 0.9 < ratio < 1.1 or ratio == pytest.approx(usual, rel=0.03)


@pytest.mark.daily(1)
@pytest.mark.parametrize("text", CODES)
def test_a_profile_of_the_same_capture_changes_nothing(text: str) -> None:
    frames, shown, _ = shot(text, 1.0)
    decoder = Decoder(shown)
    first, second, alone = decoder.decode(frames), decoder.decode(frames), decode(frames, shown)
    for name in ("u", "v", "sigma_u", "sigma_v", "flags"):
        np.testing.assert_array_equal(getattr(second, name), getattr(alone, name))
        np.testing.assert_array_equal(getattr(first, name), getattr(alone, name))


def test_a_profile_serves_a_window(tmp_path: Path) -> None:
    """Of a ladder whose periods disagree here and there: as in the whole, and the whole's profile stays."""
    frames, shown, _ = shot("phase", 1.0)
    decoder = Decoder(shown, estimate_profile(frames, shown))
    whole = decoder.decode(frames)
    for rows, cols in ((slice(0, 90), slice(20, 160)), (slice(60, 150), slice(100, 220))):
        found = decoder.decode(np.ascontiguousarray(frames[:, rows, cols]))
        assert not [notice for notice in found.notices if "profile" in notice.name]
        for name in ("u", "v", "sigma_u", "sigma_v", "flags"):
            inside = (slice(12, -12), slice(12, -12))
            ours, theirs = getattr(found, name)[inside], getattr(whole, name)[rows, cols][inside]
            np.testing.assert_allclose(ours, theirs, rtol=1e-4)  # rows are cut into vectors at other places


def _noisy(frames: Frames, by: float = 5.0) -> Frames:
    return np.clip(np.rint(frames + by * _grain(frames)), 0, 255).astype(np.uint8)


def _dimmed(frames: Frames, to: float = 0.4) -> Frames:
    return np.clip(np.rint(to * frames + 0.7 * _grain(frames)), 0, 255).astype(np.uint8)


def _defocused(frames: Frames) -> Frames:
    blurred = np.stack([cv2.GaussianBlur(one.astype(np.float32), (0, 0), 1.5) for one in frames])
    return np.clip(np.rint(blurred + _grain(frames)), 0, 255).astype(np.uint8)


def _bent(frames: Frames) -> Frames:
    return np.clip(np.rint(255 * (frames / 255.0) ** 1.5), 0, 255).astype(np.uint8)


def _grain(frames: Frames) -> NDArray[np.float64]:
    return np.random.default_rng(5).standard_normal(frames.shape)


#: Changes of residuals (a Gray code has none) or contrast by more than a factor of two, of the share of good
#: pixels by more than a tenth.
CHANGES = [
    *((text, _noisy) for text in CODES if text != "gray"),
    *((text, _dimmed) for text in CODES),
    *((text, change) for text in ("gray+phase", "micro-phase") for change in (_defocused, _bent)),
    *((text, _bent) for text in ("phase", "phase:steps=4,periods=20/22/25")),
]


@pytest.mark.daily(3)
@pytest.mark.parametrize(("text", "change"), CHANGES)
def test_a_profile_that_no_longer_holds_is_estimated_anew(text: str, change: Callable[..., Frames]) -> None:
    """Noise of five levels, a lamp dimmed to .4, a lens out of focus, another response."""
    frames, shown, _ = shot(text, 1.0)
    decoder = Decoder(shown, estimate_profile(frames, shown))
    other = change(shot(text, 1.3, seed=1)[0])
    found, alone = decoder.decode(other), decode(other, shown)
    assert [notice for notice in found.notices if "profile" in notice.name]
    np.testing.assert_array_equal(found.flags, alone.flags)
    np.testing.assert_array_equal(found.sigma_u, alone.sigma_u)
    # the next capture finds the new profile
    assert not [notice for notice in decoder.decode(other).notices if "profile" in notice.name]


@pytest.mark.daily(1)
@pytest.mark.parametrize("text", ["phase", "gray", "phase:steps=4,periods=20/22/25"])
def test_swapped_frames_are_told_by_a_profile(text: str) -> None:
    frames, shown, _ = shot(text, 1.0)
    order = np.arange(len(frames))
    order[[4, 9]] = 9, 4
    assert Decoder(shown, estimate_profile(frames, shown)).decode(shot(text, 1.3, seed=1)[0][order]).notices


@pytest.mark.daily(1)
@pytest.mark.parametrize("text", CODES)
def test_a_profile_holds_within_a_factor_of_two(text: str) -> None:
    """Light of .7 times with its noise: kept, and none silently wrong."""
    frames, shown, _ = shot(text, 1.0)
    other, _, truth = shot(text, 1.3, seed=1)
    found = Decoder(shown, estimate_profile(frames, shown)).decode(_dimmed(other, 0.7))
    assert not [notice for notice in found.notices if "profile" in notice.name]
    assert silent(found, truth.u, truth.v) <= 1e-4


def test_what_is_no_profile_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "c.npz", u=np.zeros(3))
    with pytest.raises(InputError, match=r"c\.npz: field 'profile' is missing"):
        RigProfile.load(tmp_path / "c.npz")
    for text in ("{", "3", "[]", '{"sequence": 3}'):
        np.savez(tmp_path / "d.npz", profile=np.array(text))
        with pytest.raises(InputError, match=r"d\.npz: no profile of this version"):
            RigProfile.load(tmp_path / "d.npz")
