"""Wrong frames and descriptions: refused, or nothing good is wrong; explained when asked."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import decode, explain
from optolever.projector import Capture

from .light import World, shoot
from .rigs import draw_rig
from .wrong import (
    CODES,
    COMPLEMENTARY,
    RIGHT,
    SHARED,
    broken,
    descriptions,
    explained,
    frame_faults,
    outcome,
    right_window,
    silent,
)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.mark.slow
@pytest.mark.parametrize("rig", range(4))
@pytest.mark.parametrize("code", CODES)
def test_every_wrong_frame_is_refused_or_harmless(code: str, rig: int) -> None:
    """Of plain Gray code a bit's picture that is shown twice, or exchanged with another, is a valid code."""
    found, most = [one for _, one in frame_faults(rig, code)], {"gray": 0.2}.get(code, 0.01)
    assert np.mean([silent(one) for one in found]) <= most, [one for one in found if silent(one)]


@pytest.mark.parametrize(
    ("code", "k", "named"), [("gray+phase", 4, False), ("gray+phase", 12, True), ("phase", 18, True)]
)
def test_a_black_picture_is_refused_and_explained(code: str, k: int, named: bool) -> None:
    """The coarsest bit that the image shows (few blocks see it: not named), the finest but one, a fringe."""
    shot = shoot(draw_rig(1), code, World())
    wrong = broken(shot.frames, "black", k)
    found = outcome(f"{code}: black", shot, wrong, shot.sequence)
    assert found.wrong <= 5e-3
    assert not named or explained(wrong, shot.sequence, k)


def test_half_of_a_picture_good_has_a_cause() -> None:
    """Frames that clip, of two levels, and of a pattern that is described too small."""
    shot = shoot(draw_rig(1), "phase", World())
    wide = shot.frames.astype(np.float64)
    clipped = np.clip(3 * wide, 0, 255).astype(np.uint8)
    binary = np.where(wide > wide.mean(axis=0), 255, 0).astype(np.uint8)
    small = replace(shot.sequence, rows=shot.sequence.rows // 2)
    for frames, sequence, words in (
        (clipped, shot.sequence, "frames clip"),
        (binary, shot.sequence, "two levels only"),
        (shot.frames, small, f"of {small.rows}: offset_px"),
    ):
        assert words in outcome(words, shot, frames, sequence).told[0]


@pytest.mark.parametrize("rig", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_wrong_descriptions(rig: int) -> None:
    """At most two hundredths good and wrong, but for exchanged axes, which frames do not show and a notice
    asks about; the right number in eight of ten."""
    shot, right = shoot(draw_rig(rig), "gray+phase", World()), []
    for name, numbers, described in descriptions(shot.sequence):
        found = outcome(name, shot, shot.frames, described)
        if name == "u and v exchanged":
            assert any("exchanged?" in text for text in found.told) or found.verdict, found
        else:
            assert found.good * found.wrong <= 0.02, found
            assert found.verdict, found
        right += [explained(shot.frames, described, *numbers)] if numbers else []
    assert np.mean(right) >= 0.8


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
@pytest.mark.parametrize("count", [1, pytest.param(40, marks=pytest.mark.slow)])
def test_windows_of_right_captures_get_no_verdict(count: int) -> None:
    rng = np.random.default_rng(81)
    for folder in (*SHARED.glob("real/refused/*"), *(SHARED / "cases" / one for one in RIGHT)):
        shot = Capture.load(folder)
        for _ in range(count):
            assert not right_window(shot, rng).verdict, folder


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_a_picture_too_many_in_front_is_refused_and_explained() -> None:
    """A real Gray capture behind a white picture; u decreases along the rows."""
    shot = Capture.load(SHARED / "cases/t5/extra_first_escuela")
    found = decode(shot.frames, shot.sequence)
    assert not found.good.any()
    first = explain(shot.frames, shot.sequence)[0]
    assert first.name.startswith("picture 0 is one too many")
    assert first.sequence is not None
    assert decode(shot.frames[list(first.pictures)], first.sequence).good.mean() > 0.9


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_complementary_bits_are_right_by_their_description_alone() -> None:
    """Cells of half a period, shifted by half: described as cells of a period they are refused."""
    shot = Capture.load(COMPLEMENTARY)
    assert not decode(shot.frames, shot.sequence).good.any()
    first = explain(shot.frames, shot.sequence)[0]
    assert "cells are 15 px, not 30 px, offset by half a cell, 15 px" in first.name
    right = Capture.load(COMPLEMENTARY, COMPLEMENTARY / "right.toml")
    assert decode(right.frames, right.sequence).good.mean() > 0.8


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_a_fault_in_a_part_costs_its_windows_alone() -> None:
    """A tenth of the picture is of another light in some frames."""
    shot, truth = Capture.load(SHARED / "cases/15/cap"), np.load(SHARED / "cases/15/truth.npz")
    found = decode(shot.frames, shot.sequence)
    off = [np.abs(getattr(found, a) - truth[a]) > 5 * getattr(found, f"sigma_{a}") for a in "uv"]
    assert not (off[0] | off[1])[found.good].any()
    assert found.good.mean() > 0.8
    assert found.notices


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_a_broken_bit_is_no_swap_of_fringes() -> None:
    """32 x 24 pixels: a swap of two steps fits nearly as well as the bit that shows another picture."""
    shot = Capture.load(SHARED / "cases/t6/bit_frame_swaps_fringes/cap")
    assert not decode(shot.frames, shot.sequence).good.any()
    assert explain(shot.frames, shot.sequence)[0].name.startswith("frame 7 is missing")
