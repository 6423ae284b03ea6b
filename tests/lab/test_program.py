"""`python -m lab`: help with real samples, outputs that are checked, what is missing said before the work."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from lab.figures.house import PARTS
from lab.program import NAME, SECTIONS, run

COMMANDS = [name for names in SECTIONS.values() for name in names]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_a_synopsis_and_a_sample_with_output(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run([name, "--help"]) == 0
    text = capfd.readouterr().out
    assert f"Usage: {NAME} {name}" in text
    sample = text.partition("Sample:")[2].strip().splitlines()
    assert sample[0].startswith(f"$ {NAME} {name}")
    assert len(sample) > 3, "the sample shows no output"


def test_it_runs_from_the_root(root: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "lab", "--help"], cwd=root, capture_output=True, text=True, check=True
    )
    for name in COMMANDS:
        assert f"\n  {name} " in done.stdout


def test_every_installed_part_is_counted(root: Path) -> None:
    """The folders of pyproject.toml, down to their names."""
    tool = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert {Path(folder).parts[0] for folder in tool["package-dir"].values()} <= set(PARTS)


@pytest.mark.parametrize("cases", [20, pytest.param(600, marks=pytest.mark.slow)])
def test_damaged_inputs_end_in_one_line_or_a_result_that_holds(
    cases: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "f.json"
    code = run(["fuzz", "--cases", str(cases), "--seed", "7", "--json", str(path)])
    assert code == 0, capfd.readouterr().out
    assert path.is_file()
