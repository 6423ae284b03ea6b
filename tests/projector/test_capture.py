"""The capture record and its folder: round trips, foreign descriptions, and all kinds of bad input."""

import shutil
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.patterns import Frame, Sequence, sequence
from optolever.projector import Capture, capture
from optolever.scene import dent, load, resize, trace

SHOWN = Sequence(
    (
        Frame("white"),
        Frame("gray", "u", bit=3, inverted=True),
        Frame("phase", "v", period_px=7.5, shift=1.25),
        Frame("lattice", period_px=9.0, width_px=2.0),
    ),
    30,
    40,
    "mixed",
)


def made(bits: int = 8) -> Capture:
    """Random frames of 12 x 17 pixels."""
    kind = np.uint8 if bits == 8 else np.uint16
    frames = np.random.default_rng(2).integers(0, 2**bits, (4, 12, 17), kind)
    return Capture(frames, SHOWN, timestamps=np.array([0.0, 0.1, 0.25, 0.3]), bits=bits)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_round_trip(tmp_path: Path, bits: int) -> None:
    first = replace(made(bits), sequence=replace(SHOWN, nominal=bits > 8))
    first.save(tmp_path / "c")
    with pytest.raises(InputError, match="nothing is written over"):
        made().save(tmp_path / "c")
    again = Capture.load(tmp_path / "c")
    np.testing.assert_array_equal(again.frames, first.frames)
    assert again.frames.dtype == first.frames.dtype
    assert (again.sequence, again.bits, again.white) == (first.sequence, bits, 2**bits - 1)
    assert again.timestamps is not None
    assert again.timestamps.tolist() == [0.0, 0.1, 0.25, 0.3]
    assert (again.scene, again.shape) == (None, (12, 17))


def test_the_folder_can_be_read_without_this_project(tmp_path: Path) -> None:
    first = made()
    first.save(tmp_path / "c")
    described = tomllib.loads((tmp_path / "c" / "capture.toml").read_text())
    assert (described["version"], described["rows"], described["cols"], described["bits"]) == (1, 30, 40, 8)
    for table, frame, image in zip(described["frames"], SHOWN.frames, first.frames, strict=True):
        assert table["kind"] == frame.kind
        np.testing.assert_array_equal(
            cv2.imread(str(tmp_path / "c" / table["file"]), cv2.IMREAD_UNCHANGED), image
        )
    more = {"kind": "gray", "axis": "u", "bit": 3, "inverted": True, "time": 0.1}
    assert described["frames"][1] == {"file": "frames/001.png", **more}


def test_a_virtual_capture_keeps_its_scene_and_truth(tmp_path: Path) -> None:
    scene = resize(load("paper-simulation"), 24, 24)
    surface = dent("gaussian", scene)
    shown = sequence("gray", scene.pattern.rows, scene.pattern.cols)
    first = capture(scene, surface, shown, renderer="numpy")
    truth = trace(scene, surface)
    scene = replace(scene, accuracy=None)  # what is rendered has no errors
    first.save(tmp_path / "c", truth)
    assert Capture.load(tmp_path / "c").scene == scene
    with np.load(tmp_path / "c" / "truth.npz") as arrays:
        np.testing.assert_array_equal(arrays["u"], truth.u)


def test_foreign_captures_are_described_elsewhere(tmp_path: Path) -> None:
    """Any order and any names; other files in the folder are none of our business."""
    first = made()
    (tmp_path / "shots").mkdir()
    for index, image in enumerate(first.frames):
        cv2.imwrite(str(tmp_path / "shots" / f"IMG_{9 - index}.png"), image)
    (tmp_path / "shots" / "dark.png").write_bytes(b"")
    order = ((2, "white"), (0, "black"), (1, "white"))
    tables = [f'[[frames]]\nfile = "IMG_{9 - index}.png"\nkind = "{kind}"\n' for index, kind in order]
    description = tmp_path / "described.toml"
    description.write_text("version = 1\nrows = 5\ncols = 6\n" + "".join(tables))
    again = Capture.load(tmp_path / "shots", description)
    np.testing.assert_array_equal(again.frames, first.frames[[2, 0, 1]])
    assert [frame.kind for frame in again.sequence.frames] == ["white", "black", "white"]
    assert again.timestamps is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": np.zeros((3, 4, 5), np.uint8)}, ("frames", "(3, 4, 5)", "4")),
        ({"frames": np.zeros((4, 4, 5), np.float32)}, ("frames", "float32", "uint8")),
        ({"bits": 12}, ("frames", "uint8", "12 bits", "uint16")),
        ({"timestamps": np.array([0, 1, np.nan, 3])}, ("timestamps", "nan", "frame 2")),
    ],
)
def test_records_that_do_not_fit_together_are_refused(
    changes: dict[str, object], words: tuple[str, ...]
) -> None:
    fields = {"frames": made().frames, "sequence": SHOWN, **changes}
    with pytest.raises(InputError) as caught:
        Capture(**fields)  # type: ignore[arg-type]
    for word in words:
        assert word in str(caught.value)


def edit(old: str, new: str) -> Callable[[Path], None]:
    """Replace text in capture.toml."""

    def change(folder: Path) -> None:
        path = folder / "capture.toml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return change


def flip_a_bit(folder: Path) -> None:
    path = folder / "frames" / "002.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def other_scene(folder: Path) -> None:
    resize(load("paper-simulation"), 16, 16).save(folder / "scene.toml")


BAD: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, ("c: no such folder",)),
    "no description": (
        lambda folder: (folder / "capture.toml").unlink(),
        ("no capture.toml", "--sequence", "--description"),
    ),
    "missing frame": (lambda folder: (folder / "frames" / "001.png").unlink(), ("001.png", "no such file")),
    "extra frame": (
        lambda folder: shutil.copy(folder / "frames/001.png", folder / "frames/004.png"),
        ("004.png", "not in the description", "4 frames"),
    ),
    "damaged": (flip_a_bit, ("002.png", "damaged")),
    "other size": (
        lambda folder: cv2.imwrite(str(folder / "frames/002.png"), np.zeros((12, 16), np.uint8)),
        ("002.png", "12x16", "12x17"),
    ),
    "unknown key": (edit("bits = 8", "bits = 8\nlens = 3"), ("capture.toml", "'lens'", "known are")),
    "file outside": (edit("frames/001.png", "../001.png"), ("frames[1]", "../001.png", "inside")),
    "NaN time": (edit("time = 0.25", "time = nan"), ("capture.toml", "frames[2]", "time", "nan")),
    "scene of another pattern": (other_scene, ("scene.toml", "16x12", "30x40")),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_folders_end_in_one_line(tmp_path: Path, case: str) -> None:
    spoil, words = BAD[case]
    made().save(tmp_path / "c")
    spoil(tmp_path / "c")
    with pytest.raises(InputError) as caught:
        Capture.load(tmp_path / "c")
    for word in words:
        assert word in str(caught.value)
