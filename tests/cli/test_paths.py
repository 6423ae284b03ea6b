"""Folders whose names hold the separators of the command line's texts."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.scene import load

from .conftest import Program, Refused

#: As of Active Directory's users, of times and of copies.
NAME = "user@corp, 12:30 a=b [1]"
SMALL = ("--scene", "prism48", "--pixels", "32x24", "--renderer", "numpy")


def test_commands_read_folders_of_any_name(
    tmp_path: Path, optolever: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / NAME
    folder.mkdir()
    mask = np.zeros((24, 32), np.uint8)
    mask[:, 8:] = 255
    cv2.imwrite(str(folder / "mask.png"), mask)
    optolever("simulate", *SMALL, "--dent", "flat", "--noise", "1", "--out", folder / "rest")
    optolever(
        "simulate", *SMALL, "--dent", f"relief:path={folder / 'mask.png'},peak=0.2", "--out", folder / "b"
    )
    pattern = load(folder / "rest" / "scene.toml").pattern
    size = ("--sequence", "gray+phase", "--pixels", f"{pattern.cols}x{pattern.rows}")
    optolever("decode", folder / "rest", "--out", folder / "known.npz")
    optolever("decode", f"{folder}/rest/frames/*.png", *size, "--out", folder / "c.npz")
    found, known = (Correspondence.load(folder / name) for name in ("c.npz", "known.npz"))
    np.testing.assert_array_equal(found.u, known.u)
    monkeypatch.chdir(folder)
    for text in (f"rest={folder / 'rest'}", "rest=c.npz@mask.png", f"rest={folder}/c.npz@{folder}/mask.png"):
        optolever("calibrate", "--scene", folder / "rest" / "scene.toml", "--out", "cal.toml", text)


def test_what_is_missing_in_them_is_named_whole(tmp_path: Path, refused: Refused) -> None:
    folder = tmp_path / NAME
    calibrate = ["calibrate", "--out", tmp_path / "r.toml", "--scene", "prism48"]
    refused([*calibrate, f"rest={folder / 'none'}"], f"{folder / 'none'}: no such file")
    refused([*calibrate, f"rest={folder / 'none'}@no.png"], f"{folder / 'none'}: no such file")
    Correspondence(*np.zeros((4, 24, 32)), np.zeros((24, 32), np.uint16)).save(tmp_path / "c.npz")
    files = ",".join(str(folder / name) for name in ("camera.h5", "display.h5"))
    solve = ["reconstruct", tmp_path / "c.npz", "--out", tmp_path / "new.npz"]
    refused([*solve, "--scene", files], f"{folder / 'camera.h5'}: ")
