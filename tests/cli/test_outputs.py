"""Outputs: devices and links written through, inputs and read-only files kept, full disks leave nothing."""

import importlib
import os
import resource
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import pytest

from optolever.cli.commands import SECTIONS, module_of
from optolever.cli.outputs import OutputFile

from .conftest import SCENE, Chain, Refused


@contextmanager
def full_disk(room: int = 16384) -> Iterator[None]:
    """No file of this process may grow beyond `room` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def device(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """/dev/null and /dev/full that may be spoilt: for root of his own, for others the system's."""
    folder = tmp_path_factory.mktemp("devices")

    def made(name: str) -> Path:
        system, own = Path("/dev") / name, folder / name
        if os.geteuid():
            return system
        try:
            os.mknod(own, 0o666 | stat.S_IFCHR, system.stat().st_rdev)
            os.close(os.open(own, os.O_WRONLY))
        except OSError as error:
            pytest.skip(f"no device can be made here: {error}")
        return own

    return made


def _commands() -> dict[str, click.Command]:
    """Every command by its name, those of a group by both names."""
    found = {}
    for name in (name for names in SECTIONS.values() for name in names):
        command = importlib.import_module(f"optolever.cli.{module_of(name)}").command
        inner = command.commands if isinstance(command, click.Group) else {"": command}
        found |= {f"{name} {each}".strip(): one for each, one in inner.items()}
    return found


def _outputs() -> list[tuple[str, click.Option]]:
    """Commands and their options that name an output or a folder of them."""
    return [
        (name, option)
        for name, command in _commands().items()
        for option in command.params
        if isinstance(option, click.Option)
        and (isinstance(option.type, OutputFile) or getattr(option.type, "files", ()))
    ]


@pytest.mark.parametrize(
    ("name", "option"), [pytest.param(*one, id=f"{one[0]} {one[1].opts[0]}") for one in _outputs()]
)
def test_a_suffix_that_is_not_written_is_refused(
    refused: Refused, tmp_path: Path, name: str, option: click.Option
) -> None:
    """`decode --out a.csv` wrote a ZIP. Refused while options are read, whatever else is given or missing."""
    if isinstance(option.type, OutputFile):
        path, words = tmp_path / "a.bin", ["suffix '.bin', must be", *option.type.suffixes]
    else:
        files = option.type.files  # type: ignore[attr-defined]
        path, words = tmp_path / f"a{Path(files[0]).suffix}", ["must be a folder", *files]
    refused([*name.split(), option.opts[0], path], f"{option.opts[0]} {path}: ", *words)
    assert not list(tmp_path.iterdir())


def test_a_link_that_leads_nowhere_is_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "off").symlink_to(tmp_path / "none" / "off")
    refused(["simulate", "--json", tmp_path / "loop", "--list"], "loop", "itself")
    refused(["simulate", "--json", tmp_path / "off", "--list"], "off", "does not exist")


def test_read_only_files_and_folders_are_kept_by_root_too(refused: Refused, tmp_path: Path) -> None:
    """Before any work: what the command would read does not even exist."""
    path = tmp_path / "c.npz"
    path.write_bytes(b"an older result")
    path.chmod(0o444)
    refused(["decode", "nowhere", "--out", path], path, "0444")
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0o555)
    for args in (
        ["decode", "nowhere", "--out", locked / "c.npz"],
        ["reconstruct", "nowhere", "--scene", "none", "--out", tmp_path / "h.npz", "--ply", locked / "h.ply"],
        ["simulate", "--scene", "paper-simulation", "--out", locked / "capture"],
        ["demo", "--out", locked],
        ["demo", "--out", locked / "deeper" / "report"],
    ):
        refused(args, locked, "0555")


def test_no_output_is_an_input(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    capture, found = tmp_path / "capture", tmp_path / "c.npz"
    shutil.copytree(chain.capture, capture)
    shutil.copy(chain.correspondence, found)
    (tmp_path / "link.npz").symlink_to(found)
    os.link(found, tmp_path / "hard.npz")
    shutil.copy(capture / "frames/003.png", tmp_path / "mask")
    described, typed = tmp_path / "other", capture / "scene.toml"
    described.write_text((capture / "capture.toml").read_text())
    solve = ["reconstruct", found, "--scene", capture / "scene.toml"]
    out = ["--out", tmp_path / "new"]
    dented = ["simulate", *SCENE, "--dent", f"relief:path={tmp_path / 'mask'},peak=1"]
    for args in (
        [*solve, "--out", found],
        [*solve, "--out", tmp_path / "link.npz"],
        [*solve, "--out", tmp_path / "hard.npz"],
        [*solve, *out, "--slopes", found],
        [*solve, *out, "--grid", found],
        [*solve, *out, "--truth", capture / "truth.npz", "--slopes", capture / "truth.npz"],
        ["reconstruct", tmp_path / "link.npz", "--scene", capture / "scene.toml", "--out", found],
        ["decode", capture, *out, "--description", described, "--json", described],
        ["decode", capture, *out, "--mask", tmp_path / "mask", "--json", tmp_path / "mask"],
        [*dented, *out, "--json", tmp_path / "mask"],
        ["calibrate", f"flat={capture}", "--scene", typed, "--out", typed],
        ["design", "--scene", typed, "--out", typed],
        ["design", *SCENE, "--add", capture, "--out", capture / "capture.toml"],
    ):
        path = next(str(arg) for arg in args[::-1] if str(arg).startswith(str(tmp_path)))
        refused(args, path, "an input (", "would destroy")


def test_two_outputs_are_two_files(refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "c"
    args = ["decode", "nowhere", "--out", path, "--json", path]
    refused(args, path, "two outputs")
    path.write_bytes(b"an older result")
    refused(args, path, "two outputs")
    path.unlink()  # nor where neither is there yet
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "new")
    for other in (tmp_path / "folder/../new", tmp_path / "link.json"):
        args = ["decode", "nowhere", "--out", tmp_path / "new", "--json", other]
        refused(args, other, "two outputs")


def test_a_full_disk_is_one_line_and_leaves_nothing(refused: Refused, chain: Chain, tmp_path: Path) -> None:
    """New files are absent, older ones as they were."""
    (tmp_path / "h.npz").write_bytes(b"an older result")
    for name, args in {"c.npz": ["decode", chain.capture], "h.npz": chain.solve}.items():
        path = tmp_path / name
        with full_disk():
            refused([*args, "--out", path], path, "File too large")


def test_a_full_disk_leaves_no_folder(refused: Refused, tmp_path: Path) -> None:
    """The page of a demo has 1 MB; compiled kernels, which are kept, too, have up to 0.6 MB each."""
    for room, args in (
        (4096, ["simulate", *SCENE, "--noise", "2", "--renderer", "numpy", "--out", tmp_path / "capture"]),
        (800_000, ["demo", "--pixels", "96x96", "--renderer", "numpy", "--out", tmp_path / "deep/er/demo"]),
    ):
        with full_disk(room):
            refused(args, args[-1], "File too large")
        assert not list(tmp_path.iterdir())


def test_all_outputs_or_none(
    refused: Refused, chain: Chain, tmp_path: Path, device: Callable[[str], Path]
) -> None:
    """The last one does not fit: those before it, whole already, are not left either."""
    full = device("full")
    args = [*chain.solve, "--out", tmp_path / "h.npz", "--ply", tmp_path / "h.ply", "--json", full]
    refused(args, full, "The disk is full")
    assert stat.S_ISCHR(full.stat().st_mode)
    (tmp_path / "rig.toml").write_bytes((chain.capture / "scene.toml").read_bytes())
    args = ["rest", chain.correspondence, "--scene", tmp_path / "rig.toml", "--json", full]
    refused(args, full, "The disk is full")
