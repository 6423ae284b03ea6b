"""Outputs: devices and links written through, inputs and read-only files kept, full disks leave nothing."""

import os
import resource
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.files import write_json
from optolever.patterns import sequence
from optolever.projector import Capture

from .conftest import SCENE, Chain, Program, Refused


@contextmanager
def full_disk(room: int = 16384) -> Iterator[None]:
    """No file of this process may grow beyond `room` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_read_only_files_and_folders_are_kept_by_root_too(refused: Refused, tmp_path: Path) -> None:
    """Before any work: what the command would read does not even exist. Links that lead nowhere, too."""
    path, locked = tmp_path / "c.npz", tmp_path / "locked"
    path.write_bytes(b"an older result")
    path.chmod(0o444)
    locked.mkdir()
    locked.chmod(0o555)
    refused(["decode", "nowhere", "--out", path], path, "0444")
    refused(["decode", "nowhere", "--out", locked / "c.npz"], locked, "0555")
    refused(["demo", "--out", locked / "deeper" / "report"], locked, "0555")
    (tmp_path / "off").symlink_to(tmp_path / "none" / "off")
    refused(["simulate", "--json", tmp_path / "off", "--list"], "off", "does not exist")


def test_no_output_is_an_input(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    capture, found = tmp_path / "capture", tmp_path / "c.npz"
    shutil.copytree(chain.capture, capture)
    shutil.copy(chain.correspondence, found)
    (tmp_path / "link.npz").symlink_to(found)
    os.link(found, tmp_path / "hard.npz")
    shutil.copy(capture / "frames/003.png", tmp_path / "mask")
    typed, truth, out = capture / "scene.toml", capture / "truth.npz", ["--out", tmp_path / "new"]
    solve = ["reconstruct", found, "--scene", typed]
    dented = ["simulate", *SCENE, "--dent", f"relief:path={tmp_path / 'mask'},peak=1"]
    for args in (
        [*solve, "--out", tmp_path / "link.npz"],
        [*solve, "--out", tmp_path / "hard.npz"],
        [*solve, *out, "--truth", truth, "--slopes", truth],
        ["decode", capture, *out, "--mask", tmp_path / "mask", "--json", tmp_path / "mask"],
        [*dented, *out, "--json", tmp_path / "mask"],
        ["calibrate", f"flat={capture}", "--scene", typed, "--out", typed],
        ["design", *SCENE, "--add", capture, "--out", capture / "capture.toml"],
    ):
        path = next(str(arg) for arg in args[::-1] if str(arg).startswith(str(tmp_path)))
        refused(args, path, "an input (", "would destroy")


def test_two_outputs_are_two_files(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "link.json").symlink_to(tmp_path / "new")
    for other in (tmp_path / "new", tmp_path / "link.json"):
        args = ["decode", "nowhere", "--out", tmp_path / "new", "--json", other]
        refused(args, other, "two outputs")


def test_a_full_disk_is_one_line_and_leaves_nothing(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    """New files are absent, older ones as they were. The page of a demo has 1 MB; compiled kernels, which are
    kept, too, have up to 0.6 MB each."""
    (tmp_path / "h.npz").write_bytes(b"an older result")
    simulate = ["simulate", *SCENE, "--noise", "2", "--renderer", "numpy"]
    demo = ["demo", "--pixels", "96x96", "--renderer", "numpy"]
    for room, args, name in (
        (16384, ["decode", chain.capture], "c.npz"),
        (16384, chain.solve, "h.npz"),
        (4096, simulate, "capture"),
        (800_000, demo, "deep/er/demo"),
    ):
        with full_disk(room):
            refused([*args, "--out", tmp_path / name], tmp_path / name, "File too large")
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["h.npz"]


def test_all_outputs_or_none(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    """The last one does not fit: those before it, complete already, are not left either."""
    full = Path("/dev/full")
    if not os.geteuid():  # root could spoil the system's
        full = tmp_path / "full"
        try:
            os.mknod(full, 0o666 | stat.S_IFCHR, Path("/dev/full").stat().st_rdev)
            os.close(os.open(full, os.O_WRONLY))
        except OSError as error:
            pytest.skip(f"no device can be made here: {error}")
    folder = tmp_path / "new"
    folder.mkdir()
    args = [*chain.solve, "--out", folder / "h.npz", "--slopes", folder / "s.npz", "--json", full]
    refused(args, full, "The disk is full", folder=folder)
    assert stat.S_ISCHR(full.stat().st_mode)
    assert not list(folder.iterdir())
    (folder / "rig.toml").write_bytes((chain.capture / "scene.toml").read_bytes())
    rest = ["reconstruct", chain.correspondence, "--keep-rest", "--scene", folder / "rig.toml"]
    args = [*rest, "--out", folder / "h.npz", "--json", full]
    refused(args, full, "The disk is full", folder=folder)


def test_a_pipe_is_written_through() -> None:
    """As /dev/stdout is where the program's output is read by another one: a link to no name."""
    read, write = os.pipe()
    write_json(f"/dev/fd/{write}", {"a": 1})
    assert os.read(read, 99) == b'{\n  "a": 1\n}\n'
    os.close(read)
    os.close(write)


def test_show_writes_its_pictures_without_a_display(
    optolever: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> None:
        raise InputError("no display here")

    monkeypatch.setattr("optolever.projector.monitors", none)
    optolever("show", "--sequence", "gray", "--pixels", "16x12", "--pictures", tmp_path / "p")
    shown = sequence("gray", 12, 16)
    found = Capture.load(tmp_path / "p", shown)
    np.testing.assert_array_equal(found.frames, shown.render())
    assert Capture.load(tmp_path / "p").sequence == shown
