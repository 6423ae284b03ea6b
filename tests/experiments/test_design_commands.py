"""`optolever design`, `sensor`: as a user calls them, on small scenes; bad input is one line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optolever.cli import run
from optolever.experiments.design import ranking

PRISM = ["--scene", "prism48", "--pixels", "96x72"]
SMALL = [*PRISM[:-1], "36x48"]


@pytest.mark.slow
def test_design_writes_what_capture_takes(tmp_path: Path) -> None:
    best, numbers = tmp_path / "best.toml", tmp_path / "design.json"
    budget = ["--time", "0.2", "--refresh", "60", "--verify", "1", "--renderer", "numpy"]
    assert run(["design", *PRISM, *budget, "--out", str(best), "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["settings"]["frames"] == 12
    assert all(row["frames"] <= 12 for row in found["rows"])
    assert run(["capture", *PRISM, "--sequence", str(best), "--out", str(tmp_path / "capture")]) == 0
    assert len(list((tmp_path / "capture/frames").glob("*.png"))) == found["rows"][0]["frames"]


@pytest.mark.slow
def test_a_users_pattern_is_always_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever it ranks, also where it is ruled out."""
    _little(monkeypatch)
    added = ["--add", "stripe:step=32", "--add", "phase:steps=3,periods=101/24", "--frames", "12"]
    options = ["--rows", "1", "--verify", "0", "--renderer", "numpy"]
    assert run(["design", *SMALL, *added, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    for text in added[1:4:2]:
        assert sum(line.startswith(text) for line in lines) == 1


def test_sensor_writes_its_numbers(tmp_path: Path) -> None:
    numbers = tmp_path / "sensor.json"
    assert run(["sensor", *SMALL, "--sweep", "angle=45/48/5", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert [row["value"] for row in found["sweeps"]] == [45, 48, 5]
    assert found["sweeps"][1] == {"sweep": "angle", "value": 48} | found["numbers"]
    assert "no valid pixel" in found["sweeps"][2]["why"]


def _little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few candidates, few draws: no figure is judged here."""
    offer = ranking.candidates

    def few(*asked: int) -> list[Any]:
        return offer(*asked)[:5]

    monkeypatch.setattr(ranking, "candidates", few)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["design", *PRISM, "--frames", "20", "--time", "1"], "--frames and --time"),
        (["design", *PRISM, "--frames", "3"], "no candidate fits"),
        (["design", *PRISM, "--time", "0.01"], "less than two frames"),
        (["design", *PRISM, "--out", "best.json"], "suffix '.json', must be .toml"),
        (["design", *PRISM, "--add", "nowhere:nothing"], "cannot be imported"),
        (["sensor", *PRISM, "--sweep", "angle"], "must read name=value/value"),
        (["sensor", *PRISM, "--sequence", "grey"], "name is 'grey'"),
        (["sensor", *PRISM, "--sweep", "colour=1"], "must be one of"),
    ],
)
def test_bad_input_is_one_line(
    args: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(args, words)
