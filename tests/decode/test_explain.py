"""Frames in another order than described, and other descriptions: refused, and explained when asked."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode, explain, without
from optolever.patterns import Frame, Sequence, sequence
from optolever.projector import capture
from optolever.scene import dent, load, resize

from .conftest import Map, Shoot, silent

Frames = NDArray[np.uint8]
SURFACE = (150, 170)
CODES = {
    "gray": sequence("gray", *SURFACE),
    "plain gray": sequence("gray", *SURFACE, inverses=False),
    "gray+phase": sequence("gray+phase", *SURFACE),
    "phase": sequence("phase", *SURFACE),
}
#: Bits to the last pixel, and fringes of 16.
BOTH = replace(
    CODES["plain gray"],
    frames=(
        *CODES["plain gray"].frames,
        *(Frame("phase", axis, shift=k * np.pi / 2, period_px=16.0) for axis in "uv" for k in range(4)),
    ),
)


def notice(found: Correspondence) -> str:
    """Name of the first notice that costs more than sigma."""
    return next((one.name for one in found.notices if not one.name.startswith("sigma")), "")


def harmless(found: Correspondence, truth: Map) -> bool:
    """Nothing good is wrong, or a notice says so and little of it is."""
    wrong = silent(found, *truth, least=2.0)
    return wrong < 0.02 or (bool(notice(found)) and wrong * found.good.mean() < 0.02)


def mended(frames: Frames, shown: Sequence, truth: Map, text: str = "") -> bool:
    """A mistake of that name (default: the first one) is explained; its description decodes the frames."""
    for one in explain(frames, shown)[: None if text else 1]:
        if text in one.name and one.sequence is not None:
            found = decode(frames[list(one.pictures)], one.sequence)
            return found.good.mean() > 0.9 and silent(found, *truth, least=2.0) < 0.01
    return False


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("light", [{"amplitude": 15.0, "offset": 30.0}, {"gamma": 2.2, "offset": 120.0}])
def test_frames_as_described_raise_no_alarm(
    name: str, light: dict[str, float], shoot: Shoot, smooth: Map
) -> None:
    frames = shoot(CODES[name], *smooth, noise=0.8, gain=1 / 30, **light)
    found = decode(frames, CODES[name])
    assert not notice(found)
    assert not any(one.fails for one in found.tests)


@pytest.mark.parametrize("name", CODES)
def test_nine_of_ten_swaps_are_refused_and_explained(name: str, shoot: Shoot, smooth: Map) -> None:
    shown, rng, safe, named = CODES[name], np.random.default_rng(3), 0, 0
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    for _ in range(10):
        i, j = rng.choice(len(shown), 2, replace=False)
        while shown[int(i)].bit is not None and shown[int(i)].bit == shown[int(j)].bit:
            j = (j + 1) % len(shown)  # a bit and its inverse are the frames of another scene
        wrong = frames.copy()
        wrong[[i, j]] = frames[[j, i]]
        safe += harmless(decode(wrong, shown), smooth)
        named += mended(wrong, shown, smooth)
    assert safe >= (5 if name == "plain gray" else 9)  # a line of jumps per edge of a bit is little
    assert named >= 9


@pytest.mark.parametrize(("name", "lost"), [("gray", 9), ("gray", 20), ("phase", 7), ("gray+phase", 17)])
def test_a_lost_frame_is_refused_and_explained(name: str, lost: int, shoot: Shoot, smooth: Map) -> None:
    frames = shoot(CODES[name], *smooth, noise=1.0, gain=1 / 30)
    early, other = frames.copy(), frames.copy()
    early[lost:-1], other[lost] = frames[lost + 1 :], frames[lost - 1]
    for wrong in (early, other):
        assert harmless(decode(wrong, CODES[name]), smooth)
        assert mended(wrong, CODES[name], smooth, f"frame {lost} is missing")


@pytest.mark.parametrize("axis", ["u", "v"])
def test_two_steps_of_a_fringe_that_are_exchanged_are_explained(axis: str, shoot: Shoot, smooth: Map) -> None:
    """Three that are left of four agree with any order: their mean levels and the fourth do not."""
    shown = CODES["gray+phase"]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    own = [i for i, frame in enumerate(shown) if frame.kind == "phase" and frame.axis == axis]
    for i, j in itertools.combinations(own, 2):
        wrong = frames.copy()
        wrong[[i, j]] = frames[[j, i]]
        found = decode(wrong, shown)
        assert notice(found)
        assert not found.good.any()
        assert mended(wrong, shown, smooth)


@pytest.mark.parametrize("bit", [0, 1, 2, 3, 4])
def test_no_pixel_is_wrong_where_a_bit_shows_another_picture(bit: int, shoot: Shoot, smooth: Map) -> None:
    shown = CODES["gray+phase"]
    lost = max(i for i, frame in enumerate(shown) if frame.bit == bit)
    frames = shoot(shown, *smooth, noise=1.0)
    frames[lost] = frames[lost - 1]
    assert harmless(decode(frames, shown), smooth)
    assert any(f"frame {lost} is missing" in one.name for one in explain(frames, shown))


def folder(frame: Frame) -> tuple[bool, str, int, bool, bool]:
    """Order of u, v, black, white."""
    ends = frame.kind in ("white", "black")
    return ends, frame.axis or "", -(frame.bit or 0), frame.inverted, frame.kind == "white"


@pytest.mark.parametrize("name", ["gray", "plain gray", "gray+phase"])
@pytest.mark.parametrize(
    "order",
    [
        lambda shown: range(len(shown))[::-1],
        lambda shown: sorted(range(len(shown)), key=str),
        lambda shown: sorted(range(len(shown)), key=lambda i: folder(shown[i])),
        lambda shown: [1, 0, *range(2, len(shown))],
    ],
    ids=["reverse", "alphabetical", "u v black white", "white for black"],
)
def test_a_folder_in_another_order_is_explained(
    name: str, order: Callable[[Sequence], list[int]], shoot: Shoot, smooth: Map
) -> None:
    frames = shoot(CODES[name], *smooth, noise=1.0, gain=1 / 30)
    wrong = frames[list(order(CODES[name]))]
    assert harmless(decode(wrong, CODES[name]), smooth)
    assert mended(wrong, CODES[name], smooth)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("gray", {"inverted": lambda f: not f.inverted}),
        ("gray", {"kind": lambda f: "binary"}),
        ("plain gray", {"kind": lambda f: "binary"}),
        ("gray+phase", {"cell_px": lambda f: f.cell_px / 2}),
    ],
)
def test_another_description_is_explained(
    name: str, change: dict[str, Callable[[Frame], object]], shoot: Shoot, smooth: Map
) -> None:
    shown = CODES[name]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    other = [
        frame if frame.bit is None else replace(frame, **{key: of(frame) for key, of in change.items()})  # type: ignore[arg-type]
        for frame in shown
    ]
    described = replace(shown, frames=tuple(other))
    assert harmless(decode(frames, described), smooth)
    assert mended(frames, described, smooth)


@pytest.mark.parametrize(("by", "said"), [(-0.25, "a negative sine for a cosine"), (0.1, "by +0.10 periods")])
def test_shifts_of_the_fringes_are_explained(by: float, said: str, shoot: Shoot, smooth: Map) -> None:
    moved = [replace(f, shift=f.shift - 2 * np.pi * by) if f.shift is not None else f for f in BOTH]
    frames = shoot(replace(BOTH, frames=tuple(moved)), *smooth, noise=1.0, gain=1 / 30)
    assert harmless(decode(frames, BOTH), smooth)
    assert mended(frames, BOTH, smooth, said)


def test_complementary_bits_are_explained(shoot: Shoot, smooth: Map) -> None:
    """Cells of half a period, shifted by half a period, described as cells of one."""

    def bits(cell: float, offset: float) -> Sequence:
        frames = [
            frame if frame.bit is None else replace(frame, cell_px=cell, offset_px=offset)
            for frame in CODES["gray+phase"].frames
        ]
        return replace(CODES["gray+phase"], frames=tuple(frames))

    described, shown = bits(8.0, 0.0), CODES["gray+phase"]
    moved = shoot(shown, smooth[0] - 4, smooth[1] - 4, noise=1.0, gain=1 / 30)
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    coded = [frame.bit is not None for frame in shown]
    frames[coded] = moved[coded]
    assert harmless(decode(frames, described), smooth)
    assert mended(frames, described, smooth, "cells are 4 px, not 8 px, offset by half a cell, 4 px")


@pytest.mark.parametrize("share", [0.5, 1.0], ids=["half of each before", "torn"])
def test_pictures_between_two_patterns_are_explained(share: float, shoot: Shoot, smooth: Map) -> None:
    shown = CODES["gray"]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    wrong, lower = frames.astype(np.float64), slice(0 if share < 1 else 60, None)
    wrong[1:, lower] += share * (frames[:-1, lower].astype(np.float64) - frames[1:, lower])
    mixed = np.rint(wrong).astype(np.uint8)
    assert harmless(decode(mixed, shown), smooth)
    assert any("while the display changes" in one.name for one in explain(mixed, shown))


@pytest.mark.parametrize("light", [{"offset": 120.0}, {"gamma": 2.2, "offset": 120.0}])
def test_nothing_explains_a_right_capture(light: dict[str, float], shoot: Shoot, smooth: Map) -> None:
    """Nor a gamma: without a frame the fringes' residual is unknown, which fits no better."""
    for shown in (*CODES.values(), sequence("gray+phase", *SURFACE, axes="u")):
        assert explain(shoot(shown, *smooth, noise=1.0, gain=1 / 30, **light), shown) == ()


@pytest.mark.parametrize(("number", "good"), [(0, 0.9), (1, 0.9), (13, 0.5), (21, 0.9)])
def test_a_picture_is_left_out_by_its_number(number: int, good: float, shoot: Shoot, smooth: Map) -> None:
    """White, black, the finest bit and a fringe's step: the others hold the place."""
    shown = CODES["gray+phase"]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    frames[number] = 0
    kept, less = without(shown, [number])
    found = decode(frames[list(kept)], less)
    assert found.good.mean() > good
    assert silent(found, *smooth, least=2.0) < 0.01


@pytest.mark.parametrize(("light", "said"), [(100.0, "fringe orders are ambiguous"), (6.0, "expose longer")])
def test_orders_that_are_ambiguous_have_their_cause(
    light: float, said: str, shoot: Shoot, smooth: Map
) -> None:
    shown = sequence("phase", *SURFACE, periods=(7, 8))
    found = decode(shoot(shown, *smooth, noise=1.0, amplitude=light), shown)
    assert said in "".join(map(str, found.notices))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda frame: frame * (100 / frame.mean()), "automatic exposure"),
        (lambda frame: cv2.GaussianBlur(frame, (0, 0), 2.0), "focus the camera"),
    ],
    ids=["exposure", "focus"],
)
def test_a_fault_of_the_camera_is_named(change: Callable[[Frames], Frames], said: str) -> None:
    """Each frame as bright as the others; a lens out of focus, which is no lack of light."""
    whole = load("monitor-mirror")
    scene = replace(resize(whole, 96, 120), pattern=whole.pattern)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    seen = capture(scene, dent("flat", scene), shown, noise=1.0, seed=1, renderer="numpy").frames
    frames = np.stack([np.clip(np.rint(change(frame.astype(np.float64))), 0, 255) for frame in seen])
    found = decode(frames.astype(np.uint8), shown)
    assert found.good.mean() < 0.1
    assert said in str(found.notices[0])


def test_levels_in_reverse_order_end_in_a_notice(shoot: Shoot, smooth: Map) -> None:
    rng = np.random.default_rng(1)
    images = rng.integers(0, 2, (24, 170)) * 255
    frames = [
        Frame("levels", axis, levels=tuple(image[:extent].tolist()))
        for axis, extent in (("u", 170), ("v", 150))
        for image in images
    ]
    shown = Sequence(tuple(frames), *SURFACE)
    found = decode(shoot(shown, *smooth, noise=1.0)[::-1], shown)
    assert not found.good.any() or silent(found, *smooth, least=2.0) < 0.01
    assert found.notices
