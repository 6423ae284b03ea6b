"""Decodes of drawn worlds within limits.toml, a few rigs a code; `python -m tests.world` runs all of them."""

import re
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from .judge import Verdict, run
from .light import World, shoot
from .limits import LIMITS, cases
from .rigs import draw_rig

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
CLEAN, FAULTS, ORDER = LIMITS["clean"], LIMITS["faults"], LIMITS["order"]
EVERY_DAY = ("gray+phase", "phase", "gray")


def _codes() -> Iterator[object]:
    for code in CLEAN["codes"]:
        yield pytest.param(code, 4, marks=() if code in EVERY_DAY else pytest.mark.slow)


@cache
def verdict(rig: int, code: str, effect: str = "clean") -> Verdict:
    """One capture; every test that needs it shares it."""
    world = next(world for name, _, world in cases() if name == effect)
    return run(rig, code, World(**world))


@pytest.mark.parametrize(("code", "rigs"), list(_codes()))
def test_clean_captures(code: str, rigs: int) -> None:
    """Good, true places and heights; few captures allow less of the figures over many."""
    limits = CLEAN | CLEAN["codes"][code]
    found = [verdict(rig, code) for rig in range(rigs)]
    good = [one.good for one in found]
    assert np.mean(good) >= limits["good_mean"]
    assert min(good) >= limits["good_least"]
    assert np.nanmean([one.places for one in found]) <= limits["places_pooled"]
    assert np.nanmax([one.places for one in found]) <= limits["places_worst"]
    low, high = limits["ratio"]
    slack = 1.0 if rigs >= 12 else 1.15
    assert low / slack <= np.nanmedian([one.place_ratio for one in found]) <= high * slack
    heights = np.array([one.heights for one in found])
    assert np.nanmax(heights) <= limits["heights_worst"]
    assert np.nanmean(heights) <= limits["heights_pooled"] * (1 if rigs >= 12 else 2)
    assert np.sum(heights > limits["heights_often"]) <= max(1, rigs / 16)


@pytest.mark.daily(1)
@pytest.mark.parametrize("lens", [".4 px, not told", "lens .4 px", "no lens", "lens .2 px", "lens .7 px"])
def test_light_that_changes_over_a_pixel(lens: str) -> None:
    """A height behind a lens, known or not, near the angle at which total reflection begins."""
    limits = LIMITS["reflectance"]
    found = verdict(3, limits["codes"][0], f"reflectance, {lens}")
    assert found.heights <= limits["heights"]
    assert 0.6 <= found.height_ratio <= limits["ratio"][lens]


@pytest.mark.parametrize("rigs", [1])
def test_faults_are_held(rigs: int) -> None:
    """Of all effects and codes together; each day of one rig per effect, in turn."""
    runs = []
    for number, effect in enumerate(FAULTS["effects"]):
        for code in FAULTS["codes"] if rigs > 1 else FAULTS["codes"][:2]:
            runs += [(effect, code, verdict(number % 4 + rig, code, effect)) for rig in range(rigs)]
    wrong = [(effect, code, one) for effect, code, one in runs if one.silent > FAULTS["silent"]]
    assert len(wrong) <= FAULTS["often"] * len(runs), wrong


@pytest.mark.parametrize("rigs", [1])
@pytest.mark.parametrize("effect", ORDER["effects"])
def test_wrong_frames_are_named_and_repaired(effect: str, rigs: int) -> None:
    """Of captures that the fault changes: none is silently wrong, most are read as in the right order."""
    repaired = []
    for code in ORDER["codes"] if rigs > 1 else ORDER["codes"][:1]:
        for rig in range(rigs):
            shot = shoot(draw_rig(rig), code, World(**ORDER["effects"][effect]))
            right = shoot(draw_rig(rig), code, World())
            changed = np.abs(shot.frames.astype(int) - right.frames).max(axis=0)[right.lit] > 40
            if changed.mean() < 0.01:
                continue
            found, whole = verdict(rig, code, effect), verdict(rig, code)
            assert found.silent <= FAULTS["silent"], (code, rig, found)
            numbers = {int(one) for text in found.told for one in re.findall(r"\d+", text)}
            named = any(abs(number - shot.wrong[0]) <= 1 for number in numbers)
            repaired.append(named and found.good >= ORDER["good"] * whole.good)
    assert np.mean(repaired or [1.0]) >= ORDER["repaired"]
