"""Frames in another order than described, and other descriptions: named, repaired, no false alarms."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
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


def named(found: Correspondence) -> str:
    """Name of the first notice that costs more than sigma."""
    return next((one.name for one in found.notices if not one.name.startswith("sigma")), "")


def repaired(found: Correspondence, truth: Map) -> bool:
    return bool(named(found)) and found.good.mean() > 0.9 and silent(found, *truth, least=2.0) < 0.01


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("light", [{"amplitude": 15.0, "offset": 30.0}, {"gamma": 2.2, "offset": 120.0}])
def test_frames_as_described_raise_no_alarm(
    name: str, light: dict[str, float], shoot: Shoot, smooth: Map
) -> None:
    frames = shoot(CODES[name], *smooth, noise=0.8, gain=1 / 30, **light)
    assert not named(decode(frames, CODES[name]))


@pytest.mark.parametrize("name", CODES)
def test_nine_of_ten_swaps_are_named_and_repaired(name: str, shoot: Shoot, smooth: Map) -> None:
    shown, rng, done = CODES[name], np.random.default_rng(3), 0
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    for _ in range(10):
        i, j = rng.choice(len(shown), 2, replace=False)
        while shown[int(i)].bit is not None and shown[int(i)].bit == shown[int(j)].bit:
            j = (j + 1) % len(shown)  # a bit and its inverse are the frames of another scene
        wrong = frames.copy()
        wrong[[i, j]] = frames[[j, i]]
        done += repaired(decode(wrong, shown), smooth)
    assert done >= 9


@pytest.mark.parametrize(("name", "lost"), [("gray", 9), ("gray", 20), ("phase", 7), ("gray+phase", 17)])
def test_a_lost_frame_is_named_and_left_out(name: str, lost: int, shoot: Shoot, smooth: Map) -> None:
    frames = shoot(CODES[name], *smooth, noise=1.0, gain=1 / 30)
    early, other = frames.copy(), frames.copy()
    early[lost:-1], other[lost] = frames[lost + 1 :], frames[lost - 1]
    for wrong in (early, other):
        found = decode(wrong, CODES[name])
        assert f"frame {lost} is missing" in named(found)
        assert repaired(found, smooth)


@pytest.mark.parametrize("axis", ["u", "v"])
def test_two_steps_of_a_fringe_that_are_exchanged_are_put_back(axis: str, shoot: Shoot, smooth: Map) -> None:
    """Three that are left of four agree with any order."""
    shown = CODES["gray+phase"]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    own = [i for i, frame in enumerate(shown) if frame.kind == "phase" and frame.axis == axis]
    for i, j in itertools.combinations(own, 2):
        wrong = frames.copy()
        wrong[[i, j]] = frames[[j, i]]
        found = decode(wrong, shown)
        if abs(own.index(i) - own.index(j)) == 2:  # half a period: the fringe of the other sign
            assert named(found)
        else:
            assert repaired(found, smooth)
            assert np.median(found.sigma_u + found.sigma_v) < 0.3


@pytest.mark.parametrize("bit", [1, 2, 3, 4])
def test_no_pixel_is_good_without_a_bit_that_the_code_needs(bit: int, shoot: Shoot, smooth: Map) -> None:
    shown = CODES["gray+phase"]
    lost = max(i for i, frame in enumerate(shown) if frame.bit == bit)
    frames = shoot(shown, *smooth, noise=1.0)
    frames[lost] = frames[lost - 1]
    found = decode(frames, shown)
    assert named(found)
    assert silent(found, *smooth, least=2.0) * found.good.mean() < 0.01


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
def test_a_folder_in_another_order_is_read(
    name: str, order: Callable[[Sequence], list[int]], shoot: Shoot, smooth: Map
) -> None:
    frames = shoot(CODES[name], *smooth, noise=1.0, gain=1 / 30)
    found = decode(frames[list(order(CODES[name]))], CODES[name])
    assert repaired(found, smooth)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("gray", {"inverted": lambda f: not f.inverted}),
        ("gray", {"kind": lambda f: "binary"}),
        ("plain gray", {"kind": lambda f: "binary"}),
        ("gray+phase", {"cell_px": lambda f: f.cell_px / 2}),
    ],
)
def test_another_description_is_found(
    name: str, change: dict[str, Callable[[Frame], object]], shoot: Shoot, smooth: Map
) -> None:
    shown = CODES[name]
    frames = shoot(shown, *smooth, noise=1.0, gain=1 / 30)
    other = [
        frame if frame.bit is None else replace(frame, **{key: of(frame) for key, of in change.items()})  # type: ignore[arg-type]
        for frame in shown
    ]
    assert repaired(decode(frames, replace(shown, frames=tuple(other))), smooth)


def test_a_sine_for_a_cosine_is_found(shoot: Shoot, smooth: Map) -> None:
    sine = [replace(f, shift=f.shift + np.pi / 2) if f.shift is not None else f for f in BOTH]
    frames = shoot(replace(BOTH, frames=tuple(sine)), *smooth, noise=1.0, gain=1 / 30)
    found = decode(frames, BOTH)
    assert "a negative sine for a cosine" in named(found)
    assert repaired(found, smooth)


@pytest.mark.parametrize(
    ("light", "said"), [(100.0, "periods repeat on the pattern"), (6.0, "expose longer")]
)
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
