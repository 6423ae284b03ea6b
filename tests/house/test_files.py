"""Habits of the tree: a small repository."""

import subprocess
import tomllib
from pathlib import Path

import pytest

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
