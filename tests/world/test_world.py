"""Decodes of drawn worlds within limits.toml, a few rigs a code; `python -m tests.world` runs all of them."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from optolever.decode import decode, explain

from .judge import LIMITS, Verdict, cases, judged, run
from .light import World, shoot
from .rigs import draw_rig
from .wrong import judges

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
CLEAN, FAULTS, ORDER = LIMITS["clean"], LIMITS["faults"], LIMITS["order"]
EVERY_DAY = ("gray+phase", "phase", "gray")
CODES = [pytest.param(code, marks=() if code in EVERY_DAY else pytest.mark.slow) for code in CLEAN["codes"]]


@cache
def verdict(rig: int, code: str, effect: str = "clean") -> Verdict:
    """One capture; every test that needs it shares it."""
    world = next(world for name, _, world in cases() if name == effect)
    return run(rig, code, World(**world))


@pytest.mark.parametrize("code", CODES)
def test_clean_captures(code: str) -> None:
    """Good, true, no false alarm, of four rigs; few captures allow less of the figures over many."""
    limits = CLEAN | CLEAN["codes"][code]
    found = [verdict(rig, code) for rig in range(4)]
    good = [one.good for one in found]
    assert np.mean(good) >= limits["good_mean"]
    assert min(good) >= limits["good_least"]
    assert np.nanmean([one.places for one in found]) <= limits["places_pooled"]
    assert np.nanmax([one.places for one in found]) <= limits["places_worst"]
    low, high = limits["ratio"]
    assert low / 1.15 <= np.nanmedian([one.place_ratio for one in found]) <= high * 1.15
    assert not [text for one in found for text in one.told if judges(text)]
    heights = np.array([one.heights for one in found])
    assert np.nanmax(heights) <= limits["heights_worst"]
    assert np.nanmean(heights) <= limits["heights_pooled"] * 2
    assert np.sum(heights > limits["heights_often"]) <= 1


def test_complementary_gray() -> None:
    """As good as with cells that begin with the surface."""
    found, other = verdict(0, "gray+phase:cells=half"), verdict(0, "gray+phase")
    assert found.good >= other.good - 0.005
    assert found.places <= CLEAN["places_pooled"]
    assert found.place_ratio == pytest.approx(other.place_ratio, rel=0.05)
    assert not found.told


@pytest.mark.daily(1)
@pytest.mark.parametrize("lens", [".4 px, not told", "lens .4 px", "no lens", "lens .2 px", "lens .7 px"])
def test_light_that_changes_over_a_pixel(lens: str) -> None:
    """A height behind a lens, known or not, near the angle at which total reflection begins."""
    limits = LIMITS["reflectance"]
    found = verdict(3, limits["codes"][0], f"reflectance, {lens}")
    assert found.heights <= limits["heights"]
    assert 0.6 <= found.height_ratio <= limits["ratio"][lens]


@pytest.mark.daily(2)
@pytest.mark.parametrize("share", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("code", ["phase:steps=3", "gray+phase:steps=3", "phase:steps=3,periods=9/10/11"])
def test_lag_in_three_steps(code: str, share: float) -> None:
    """Bits show it, and it is corrected: it was 9 of the heights' sigma. A ladder's periods show that there
    is one, and not how long it lasts: a notice says so, of no other capture."""
    found, bits = run(0, code, World(lag=share)), code.startswith("gray")
    assert any("which three steps take for places" in text for text in found.told) == (share > 0 and not bits)
    if bits or not share:
        assert found.heights <= 0.01
        assert found.height_ratio < 1.3


def test_a_cameras_tone_curve() -> None:
    """x / (x + .3) on six captures' mean of 16 bits, whose noise hides nothing: harmonics that four steps
    take for the phase were 2.0 of sigma."""
    rig = draw_rig(3)
    shots = [shoot(rig, "gray+phase", World(lens=0.0), seed) for seed in range(6)]
    mean = np.mean([one.frames for one in shots], axis=0) / 255
    shot = replace(shots[0], frames=np.rint(65535 * 1.3 * mean / (mean + 0.3)).astype(np.uint16))
    found = judged(rig, "gray+phase", shot, decode(shot.frames, shot.sequence))
    assert found.good > 0.98
    assert found.places <= CLEAN["places_pooled"]
    assert 0.6 < found.place_ratio < 1.25
    assert found.height_ratio < 1.25
    assert any("gamma" in text for text in found.told)


@pytest.mark.parametrize("told", [True, False])
def test_places_beside_the_rim_behind_a_lens(told: bool) -> None:
    """A lens of .7 px mixes the dark into two pixels along the mirror's end: .09 to .14 px where their own
    light is taken, sigma four times that."""
    shot = shoot(draw_rig(11), "gray+phase", World(lens=0.7))
    found = decode(shot.frames, shot.sequence, lens_px=0.7 if told else None)
    rim = found.good & shot.lit & (distance_transform_edt(np.pad(shot.lit, 1, mode="edge"))[1:-1, 1:-1] < 1.2)
    error = np.stack([(getattr(found, axis) - shot.truth[axis])[rim] for axis in "uv"])
    sigma = np.stack([getattr(found, f"sigma_{axis}")[rim] for axis in "uv"])
    assert rim.sum() > 20
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.mean(np.abs(error) > 5 * sigma) < 0.01
    assert np.median(sigma) < 0.12


def test_faults_are_held() -> None:
    """Of all effects and two codes together, each on one rig in turn."""
    runs = [
        (effect, code, verdict(number % 4, code, effect))
        for number, effect in enumerate(FAULTS["effects"])
        for code in FAULTS["codes"][:2]
    ]
    wrong = [(effect, code, one) for effect, code, one in runs if one.silent > FAULTS["silent"]]
    assert len(wrong) <= FAULTS["often"] * len(runs), wrong


@pytest.mark.parametrize("effect", ORDER["effects"])
def test_wrong_frames_are_refused_and_explained(effect: str) -> None:
    """Of a capture that the fault changes: not silently wrong, and one of the names holds its number."""
    code = ORDER["codes"][0]
    shot, right = (shoot(draw_rig(0), code, World(**of)) for of in (ORDER["effects"][effect], {}))
    changed = np.abs(shot.frames.astype(int) - right.frames).max(axis=0)[right.lit] > 40
    assert changed.mean() > 0.01
    found = verdict(0, code, effect)
    assert found.silent <= FAULTS["silent"], found
    names = [one.name for one in explain(shot.frames, shot.sequence)]
    numbers = {int(one) for text in names for one in re.findall(r"\d+", text)}
    assert any(abs(number - shot.wrong[0]) <= 1 for number in numbers)
