"""The program itself: help with real samples, speed of --help, exit codes, interruption, doctor."""

import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from optolever import live
from optolever.cli.commands import CAMERA, SECTIONS

from .conftest import Program

COMMANDS = [name for names in SECTIONS.values() for name in names]
CALLS = [name for name in COMMANDS if name not in ("camera", "rig")] + [f"camera {name}" for name in CAMERA]


@pytest.mark.parametrize("command", [*CALLS, "rig new"])
def test_help_has_synopsis_options_and_a_sample_with_output(command: str, optolever: Program) -> None:
    shown = optolever(*command.split(), "--help").out
    assert f"Usage: optolever {command}" in shown
    assert "--json" in shown
    sample = shown.partition("Sample:")[2].strip().splitlines()
    assert sample[0].startswith(f"$ optolever {command}")
    assert len(sample) > 1, "the sample shows no output"
    if "--help-all" in shown:
        assert len(optolever(*command.split(), "--help-all").out) > len(shown)


def test_help_shows_every_summary_whole() -> None:
    """In 80 columns; and nothing heavy is imported before a command runs."""
    code = (
        "import sys; from optolever.cli import run; run(['--help']); run(['simulate', '--help']); "
        "heavy = {'numpy', 'numba', 'cv2', 'scipy', 'matplotlib', 'moderngl'} & set(sys.modules); "
        "sys.exit(str(heavy) if heavy else 0)"
    )
    environment = {**os.environ, "COLUMNS": "80"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.partition("Usage: optolever simulate")[0].splitlines()
    for name in COMMANDS:
        (line,) = [line for line in lines if re.match(rf"  {name}  +", line)]
        assert len(line) <= 80
        assert "..." not in line


def shape(text: str) -> str:
    """Text with every number as # and every run of blanks as one: what stays the same from run to run."""
    return " ".join(re.sub(r"-?\d[\d.]*(e[+-]?\d+)?", "#", text).split())


def test_samples_are_real(optolever: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sample sessions of --help, run one after the other, print what they show."""
    monkeypatch.chdir(tmp_path)
    for command in ("simulate", "decode", "reconstruct", "demo"):
        sample = optolever(command, "--help").out.partition("Sample:")[2]
        lines = textwrap.dedent(sample.strip("\n")).splitlines()
        ends = next(i for i, line in enumerate(lines) if not line.endswith("\\"))
        call = " ".join(line.removesuffix("\\") for line in lines[: ends + 1])
        outcome = optolever(*shlex.split(call.removeprefix("$ "))[1:])
        assert shape(outcome.out) == shape("\n".join(lines[ends + 1 :]))
    assert {path.name for path in Path("demo").iterdir()} == {"report.html", "height.npz", "figures.csv"}


def test_interruption_is_130(optolever: Program, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from optolever import scene

    def interrupt(name: str, *, exact: bool) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(scene, "load", interrupt)
    optolever("simulate", "--scene", "paper-simulation", "--out", tmp_path / "capture", code=130)
    assert not list(tmp_path.iterdir())


def test_ctrl_c_ends_a_live_view_with_its_numbers(
    optolever: Program, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    follow = live.follow

    def interrupted(*args: Any) -> Iterator[live.Followed]:
        yield from islice(follow(*args), 3)
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "follow", interrupted)
    words = ("live", "--pixels", "96x72", "--rate", "0", "--headless", "--json", tmp_path / "n.json")
    assert "readings  3," in optolever(*words, code=130).out
    assert json.loads((tmp_path / "n.json").read_text())["readings"] == 3


def test_names_of_presets(optolever: Program, tmp_path: Path) -> None:
    path = tmp_path / "names.json"
    optolever("simulate", "--json", path, "--list")
    names = json.loads(path.read_text())
    assert {"paper-simulation", "prism48"} <= set(names["scenes"])
    assert names["parameters"]["dents"]["gaussian"]["peak"] == pytest.approx(1.3)
    assert "gray+phase" in optolever("simulate", "--list").out


def test_doctor_says_what_there_is_and_what_is_missing(optolever: Program, tmp_path: Path) -> None:
    path = tmp_path / "doctor.json"
    optolever("doctor", "--json", path)
    report = json.loads(path.read_text())
    assert {"optolever", "python", "numpy", "OpenGL"} <= set(report["found"])
    assert {"cameras", "monitors"} <= set(report)
