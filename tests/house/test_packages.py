"""The wheel: every part is a package of it, everything that a part reads travels inside, `lab/` does not. The
repository: small, and its lists name what exists."""

import os
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest

from optolever.kernels import cache_folder

NOT_PARTS = {"examples", "docs", "lab", "tests", "typings", "out", "build", "dist"}


def pyproject(root: Path) -> dict[str, Any]:
    return tomllib.loads((root / "pyproject.toml").read_text())


def part_folders(root: Path) -> list[str]:
    """Folders at the root that hold Python, apart from tests and tools."""
    return sorted(
        path.name
        for path in root.iterdir()
        if path.is_dir()
        and path.name not in NOT_PARTS
        and not path.name.startswith(".")
        and any(path.glob("*.py"))
    )


def package_folders(root: Path) -> dict[str, str]:
    """Package -> folder: the parts, and the sub-packages inside them (folders that hold Python)."""
    folders = {
        str(path.parent.relative_to(root))
        for part in part_folders(root)
        for path in (root / part).rglob("*.py")
    }
    return {".".join(dict.fromkeys(["optolever", *folder.split("/")])): folder for folder in sorted(folders)}


def test_every_folder_is_a_package_with_mapping_and_stub(root: Path) -> None:
    """A folder missing from the list works in an editable install and is absent from the wheel."""
    tool = pyproject(root)["tool"]["setuptools"]
    folders = package_folders(root)
    assert sorted(tool["packages"]) == sorted(folders)
    assert tool["package-dir"] == folders
    assert tool["include-package-data"] is False
    for folder in folders.values():
        assert (root / folder / "__init__.py").is_file()
        if folder.split("/")[0] != "optolever":
            stub = root / "typings/optolever" / folder
            stub = stub / "__init__.pyi" if stub.is_dir() else stub.with_suffix(".pyi")
            assert stub.is_file()
    for folder in part_folders(root):
        assert (root / folder / "py.typed").is_file()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    """The wheel, built from a copy of the tree without network."""
    pytest.importorskip("setuptools", reason="setuptools is not installed: the wheel cannot be built offline")
    source = tmp_path_factory.mktemp("source") / "optolever"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / name, source)
    for folder in (*part_folders(root), "lab"):
        shutil.copytree(root / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    target = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation",
        "--no-index",
    ]  # fmt: skip
    run = subprocess.run(
        [*command, "--wheel-dir", str(target), str(source)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    (path,) = target.glob("*.whl")
    return path


def test_the_wheel_holds_every_file_of_every_part(wheel: Path, root: Path) -> None:
    """Python, py.typed, shaders, presets, report assets: what lies in a part folder is there to be used."""
    inside = set(zipfile.ZipFile(wheel).namelist())
    expected = {
        ("" if folder == "optolever" else "optolever/") + str(path.relative_to(root))
        for folder in part_folders(root)
        for path in (root / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert not expected - inside
    assert not [name for name in inside if "lab" in Path(name).parts]


def test_every_stub_leads_to_its_module(root: Path) -> None:
    """mypy finds `optolever.scene` by a stub that names `scene`; to one whose module is gone it says Any."""
    stubs = root / "typings/optolever"
    for stub in stubs.rglob("*.pyi"):
        name = stub.relative_to(stubs)
        module = name.parent if name.stem == "__init__" else name.with_suffix("")
        assert stub.read_text() == f"from {'.'.join(module.parts)} import *\n"
        assert (root / module).is_dir() or (root / module).with_suffix(".py").is_file(), stub


CONTAINER = """
import os, sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import optolever.decode
import numpy as np
from optolever.cli import run
from optolever.kernels import cache_folder
from optolever.scene import surface_from_array
names = [name for name in dir(optolever) if name not in optolever.__all__]
for part in map(optolever.__getattr__, names):
    assert Path(part.__file__).is_relative_to(sys.argv[1])
assert "paper-simulation" in optolever.scene.preset_names()
assert not hasattr(optolever, "nothing")
assert "matplotlib" not in sys.modules
assert cache_folder(Path(optolever.decode.__file__).parent) is None
good = abs(surface_from_array(np.ones((4, 4)), 0.0, 0.0, 1.0).height(1.5, 1.5) - 1.0) < 1e-12
print("works", good)
sys.exit(run(["doctor"]))
"""


def test_an_image_without_a_home_and_with_packages_that_are_read_only(wheel: Path, tmp_path: Path) -> None:
    """As a container has it: no kernel can be kept, all of them run, `doctor` says what that costs.

    Root may write everywhere: for him too a folder cannot be made where there is a file.
    """
    target = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(target)
    for package in {path.parent for path in target.rglob("__init__.py")}:
        (package / "__pycache__").write_text("")
    environment = {"HOME": "/dev/null", "PATH": os.environ["PATH"]}
    command = [sys.executable, "-c", CONTAINER, str(target)]
    run = subprocess.run(command, env=environment, cwd="/", capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "works True" in run.stdout
    assert "NUMBA_CACHE_DIR" in run.stdout


def test_a_cache_takes_away_only_older_ones_of_the_same_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its mark: folders of others, of another part, and what another process takes away meanwhile stay."""
    kept, part = tmp_path / "kept", tmp_path / "part"
    kept.mkdir()
    part.mkdir()
    others = [kept / "kernels-part-results", kept / "kernels-part-0123456789abcdef", kept / "kernels-mine"]
    for other in others:
        other.mkdir()
        (other / "data.csv").write_text("1")
    (kept / "kernels-part-gone").symlink_to("nowhere")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(kept))
    made = list[Path]()
    for k in range(6):
        (part / "a.py").write_text(f"# {k}")
        cache_folder.cache_clear()
        found = cache_folder(part)
        assert found is not None
        made.append(found)
        other = cache_folder(tmp_path / "other") if k == 0 else None
        others += [] if other is None else [other]
        time.sleep(0.01)
    assert {path.parent for path in made} == {kept}
    assert [path.is_dir() for path in made] == [False, False, True, True, True, True]
    assert all(map(Path.is_dir, others))


WARMED = """
import contextlib, io, sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import numpy as np
import optolever.scene
from optolever.kernels import cache_folder
said = io.StringIO()
with contextlib.redirect_stdout(said):  # of Numba's cache, see NUMBA_DEBUG_CACHE
    optolever.scene.surface_from_array(np.ones((4, 4)), 0.0, 0.0, 1.0).height(1.5, 1.5)
print("data loaded from" not in said.getvalue(), cache_folder(Path(optolever.scene.__file__).parent))
"""


@pytest.mark.parametrize("home", [True, False])
def test_kernels_that_an_owner_has_compiled_serve_those_who_may_only_read_them(
    wheel: Path, tmp_path: Path, home: bool
) -> None:
    """Written where that can be, to the user's folder or to one of the process alone."""
    target, kept = tmp_path / "site", tmp_path / "home"
    zipfile.ZipFile(wheel).extractall(target)
    kept.mkdir()
    environment = {"HOME": str(kept) if home else "/dev/null", "PATH": os.environ["PATH"]}
    environment["NUMBA_DEBUG_CACHE"] = "1"

    def answered(*before: str) -> list[str]:
        command = [*before, sys.executable, "-c", WARMED, str(target)]
        run = subprocess.run(command, env=environment, cwd="/", capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        return run.stdout.split()

    compiled, place = answered()
    assert compiled == "True"
    assert Path(place).is_relative_to(target)
    files = {path: path.stat().st_mtime_ns for path in target.rglob("*.nb?")}
    assert files
    Path(place).chmod(0o555)
    setpriv = shutil.which("setpriv")
    if not os.getuid() and setpriv is None:
        pytest.skip("setpriv is absent: root may write everywhere")
    compiled, place = answered(*([] if os.getuid() else [str(setpriv), "--bounding-set=-dac_override"]))
    assert compiled == "False"
    assert Path(place).is_relative_to(kept) == home
    assert home or not Path(place).exists()
    assert files == {path: path.stat().st_mtime_ns for path in target.rglob("*.nb?")}


MARKED = ("ctypes", "glob", "json", "multiprocessing", "random", "struct", "textwrap", "types", "optolever")


def test_nothing_is_imported_from_the_working_folder(tmp_path: Path) -> None:
    """Not by the program either that GLFW's binding starts."""
    script = Path(sys.executable).with_name("optolever")
    if not script.is_file():
        pytest.skip(f"{script} is absent: optolever is not installed as a program")
    for name in MARKED:
        mark = f"open({str(tmp_path / 'run')!r}, 'a').write({name!r})\n"
        (tmp_path / f"{name}.py").write_text(mark)
    command = [script, "show", "--list"]
    done = subprocess.run(command, cwd=tmp_path, check=False, capture_output=True, text=True)

    assert done.returncode == 0 or "display" in done.stderr, done.stderr
    assert not (tmp_path / "run").exists(), (tmp_path / "run").read_text()


BYTES = 1_000_000


def tracked(root: Path) -> list[Path]:
    """Files under version control; skips outside a git checkout."""
    run = subprocess.run(
        ["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True, check=False
    )
    if run.returncode:
        pytest.skip(f"{root} is no git checkout")
    return [root / name for name in run.stdout.split("\0") if name and (root / name).is_file()]


def test_no_heavy_file_is_tracked(root: Path) -> None:
    heavy = {
        str(path.relative_to(root)): path.stat().st_size
        for path in tracked(root)
        if path.stat().st_size > BYTES
    }
    assert not heavy


def test_figures_that_are_missed_name_tests_that_exist(root: Path) -> None:
    """A test that was moved would fail in CI where it is expected to."""
    listed = tomllib.loads((root / "tests/missed_figures.toml").read_text(encoding="utf-8"))["missed"]
    for name in (test for entry in listed for test in entry["tests"]):
        file, _, test = name.partition("::")
        assert f"def {test.partition('[')[0]}(" in (root / file).read_text(encoding="utf-8"), name
