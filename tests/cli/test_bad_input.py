"""Unusable input: exit code 2, one line that names file, field, value and limit, nothing written."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from .conftest import SCENE, Chain, Program, Refused


# What is done to a capture folder, and what the message must name.
def missing_frame(folder: Path) -> None:
    (folder / "frames/003.png").unlink()


def nan_described(folder: Path) -> None:
    path = folder / "capture.toml"
    path.write_text(path.read_text().replace("period_px = ", "period_px = nan # ", 1))


def only_white(folder: Path) -> None:
    """A sequence that encodes nothing."""
    path = folder / "capture.toml"
    head, first, *_ = path.read_text().split("[[frames]]")
    path.write_text(head + "[[frames]]" + first)
    for frame in sorted((folder / "frames").glob("*.png"))[1:]:
        frame.unlink()


#: All that may be wrong with a folder is in tests/projector/test_capture.py.
SPOILED: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "missing frame": (missing_frame, ("003.png", "no such file")),
    "NaN": (nan_described, ("capture.toml", "period_px", "nan")),
    "encodes nothing": (only_white, ("sequence",)),
}


@pytest.mark.parametrize("case", SPOILED)
def test_spoiled_captures_are_refused(case: str, refused: Refused, chain: Chain, tmp_path: Path) -> None:
    spoil, words = SPOILED[case]
    folder = tmp_path / "capture"
    shutil.copytree(chain.capture, folder)
    spoil(folder)
    (tmp_path / "c.npz").write_bytes(b"an older result")
    refused(["decode", folder, "--out", tmp_path / "c.npz"], *words)


def npz_with(path: Path, source: Path, **changes: object) -> Path:
    """A copy of an .npz with fields replaced, or left out where None."""
    with np.load(source) as archive:
        fields = {**{name: archive[name] for name in archive.files}, **changes}
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return path


def test_spoiled_correspondences_are_refused(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    scene = ["--scene", chain.capture / "scene.toml", "--out", tmp_path / "h.npz"]
    flags = np.full((96, 96), 1, np.uint16)
    text = tmp_path / "text.npz"
    text.write_text("no archive")
    cases = {
        tmp_path / "absent.npz": ("absent.npz", "no such file"),
        text: ("text.npz",),
        npz_with(tmp_path / "nou.npz", chain.correspondence, u=None): ("nou.npz", "'u'"),
        npz_with(tmp_path / "size.npz", chain.correspondence, u=np.zeros((5, 5))): ("size.npz", "(5, 5)"),
        npz_with(tmp_path / "masked.npz", chain.correspondence, flags=flags): ("masked.npz", "flagged"),
    }
    (tmp_path / "h.npz").write_bytes(b"an older result")
    for source, words in cases.items():
        refused(["reconstruct", source, *scene], *words)


def test_correspondence_of_another_size_than_the_scene(
    refused: Refused, chain: Chain, tmp_path: Path
) -> None:
    args = ["reconstruct", chain.correspondence, "--scene", "paper-simulation", "--out", tmp_path / "h.npz"]
    refused(args, "96", "1637")


def test_no_anchor_is_refused(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    scene = ["--scene", chain.capture / "scene.toml", "--out", tmp_path / "h.npz"]
    args = ["reconstruct", chain.correspondence, *scene, "--anchor", "none"]
    refused(args, "anchor")


def test_a_spoiled_scene_is_refused(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    """All that may be wrong with one is in tests/scene/test_toml.py."""
    scene = tmp_path / "scene.toml"
    text = (chain.capture / "scene.toml").read_text()
    scene.write_text(re.sub(r"pitch_mm = (\[[^]]*\]|\S+)", "pitch_mm = nan", text))
    args = ["capture", "--scene", scene, "--out", tmp_path / "capture"]
    refused(args, "scene.toml", "pitch_mm", "nan")


ARGUMENTS = {
    "no such scene": (["capture", "--scene", "paper-simulatoin", "--out", "OUT"], ("paper-simulatoin",)),
    "no such dent": (["capture", *SCENE, "--dent", "dint", "--out", "OUT"], ("dint", "gaussian")),
    "no such sequence": (["capture", *SCENE, "--sequence", "grey", "--out", "OUT"], ("grey", "gray")),
    "negative noise": (["capture", *SCENE, "--noise", "-1", "--out", "OUT"], ("--noise", "-1")),
    "size": (
        ["capture", "--scene", "paper-simulation", "--size", "9by9", "--out", "OUT"],
        ("--size", "9by9"),
    ),
    "no out": (["capture", *SCENE], ("--out",)),
    "out without a parent": (["capture", *SCENE, "--out", "OUT/deeper/still"], ("deeper", "does not exist")),
    "json without a parent": (["capture", *SCENE, "--out", "OUT", "--json", "OUT/none/n.json"], ("n.json",)),
    "no command": (["captur"], ("captur",)),
    "no such option": (["decode", "x", "--outt", "y"], ("--outt",)),
    "no folder": (["decode", "OUT/nowhere", "--out", "OUT.npz"], ("nowhere", "no such")),
    "method": (["reconstruct", "C", "--scene", "S", "--method", "magic", "--out", "OUT.npz"], ("magic",)),
    "grid": (["reconstruct", "C", "--scene", "S", "--grid", "OUT.obj", "--out", "OUT.npz"], (".obj", ".x3p")),
    "anchor": (["reconstruct", "C", "--scene", "S", "--anchor", "corner", "--out", "OUT.npz"], ("corner",)),
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_bad_arguments(case: str, refused: Refused, chain: Chain, tmp_path: Path) -> None:
    args, words = ARGUMENTS[case]
    known = {"C": str(chain.correspondence), "S": str(chain.capture / "scene.toml")}
    filled = [known.get(arg, arg.replace("OUT", str(tmp_path / "out"))) for arg in args]
    refused(filled, *words)


def test_a_capture_is_never_written_over(refused: Refused, chain: Chain) -> None:
    args = ["capture", *SCENE, "--out", chain.capture]
    refused(args, chain.capture, "no empty folder", folder=chain.capture)


def test_a_folder_is_no_place_for_a_file(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    refused(["decode", chain.capture, "--out", tmp_path], "is a folder")


@pytest.mark.parametrize("level", [0, 255, 128])
def test_flat_grey_frames_are_a_result_with_flags(
    level: int, optolever: Program, chain: Chain, tmp_path: Path
) -> None:
    """A lens cap or a lamp in the camera is no crash: every pixel is flagged."""
    folder = tmp_path / "capture"
    shutil.copytree(chain.capture, folder)
    for path in (folder / "frames").iterdir():
        cv2.imwrite(str(path), np.full((96, 96), level, np.uint8))
    assert optolever("decode", folder, "--out", tmp_path / "c.npz").code == 0
    with np.load(tmp_path / "c.npz") as found:
        assert (found["flags"] != 0).all()
