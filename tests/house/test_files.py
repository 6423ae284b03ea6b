"""Habits of the tree: small files, small repository, nothing that hides from strict checks."""

import subprocess
from pathlib import Path

import pytest

LINES = 450
BYTES = 1_000_000


def tracked(root: Path) -> list[Path]:
    """Files under version control; skips outside a git checkout."""
    run = subprocess.run(
        ["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True, check=False
    )
    if run.returncode:
        pytest.skip(f"{root} is no git checkout")
    return [root / name for name in run.stdout.split("\0") if name and (root / name).is_file()]


def test_files_stay_small(root: Path) -> None:
    """About 400 lines hold one thing; 450 is where it stops being a question."""
    long = {
        str(path.relative_to(root)): count
        for path in tracked(root)
        if path.suffix == ".py" and (count := len(path.read_text().splitlines())) > LINES
    }
    assert not long


def test_no_heavy_file_is_tracked(root: Path) -> None:
    heavy = {
        str(path.relative_to(root)): path.stat().st_size
        for path in tracked(root)
        if path.stat().st_size > BYTES
    }
    assert not heavy
