"""Wrong frames and descriptions: named, or nothing good is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import decode
from optolever.projector import Capture

from .light import World, shoot
from .rigs import draw_rig
from .wrong import (
    CODES,
    RIGHT,
    SHARED,
    broken,
    descriptions,
    frame_faults,
    named,
    outcome,
    right_window,
    silent,
)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.mark.slow
@pytest.mark.parametrize("rig", range(4))
@pytest.mark.parametrize("code", CODES)
def test_every_wrong_frame_is_named_or_harmless(code: str, rig: int) -> None:
    """95 % named, 2 % silent."""
    found = list(frame_faults(rig, code))
    assert np.mean([named(k, one) for k, one in found]) >= 0.95, [one for one in found if not named(*one)]
    assert np.mean([silent(one) for _, one in found]) <= 0.02


@pytest.mark.parametrize(("code", "k"), [("gray+phase", 4), ("gray+phase", 12), ("phase", 18)])
def test_a_black_picture_is_named(code: str, k: int) -> None:
    """The coarsest bit that the image shows, the finest but one, and a fringe."""
    shot = shoot(draw_rig(1), code, World())
    found = outcome(f"{code}: black", shot, broken(shot.frames, "black", k), shot.sequence)
    assert found.names(k)
    assert found.wrong <= 5e-3


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
    """At most two hundredths good and wrong; the right number in eight of ten."""
    shot, right = shoot(draw_rig(rig), "gray+phase", World()), []
    for name, numbers, described in descriptions(shot.sequence):
        found = outcome(name, shot, shot.frames, described)
        assert found.good * found.wrong <= 0.02, found
        right.append(found.names(*numbers) if numbers else found.verdict)
    assert np.mean(right) >= 0.8


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
@pytest.mark.parametrize("count", [1, pytest.param(100, marks=pytest.mark.slow)])
def test_windows_of_right_captures_get_no_verdict(count: int) -> None:
    rng = np.random.default_rng(81)
    for folder in (*SHARED.glob("real/refused/*"), *(SHARED / "cases" / one for one in RIGHT)):
        shot = Capture.load(folder)
        for _ in range(count):
            assert not right_window(shot, rng).verdict, folder


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_a_picture_too_many_in_front_is_left_out() -> None:
    """A real Gray capture behind a white picture; u decreases along the rows."""
    shot = Capture.load(SHARED / "cases/t5/extra_first_escuela")
    found = decode(shot.frames, shot.sequence)
    assert found.notices[0].name == "picture 0 is one too many"
    assert found.good.mean() > 0.9
