"""`optolever design`, `sensor`, `adapt`: as a user calls them, on small scenes; bad input is one line."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from optolever.cli import run
from optolever.experiments import design
from optolever.experiments.design import CASES, Case, ChoiceRow, drawn_cases, ranking

PRISM = ["--scene", "prism48", "--size", "72x96"]
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


def test_sensor_writes_a_page_and_numbers(tmp_path: Path) -> None:
    out, numbers = tmp_path / "sensor", tmp_path / "sensor.json"
    sweep = ["--sweep", "angle=45/48", "--out", str(out), "--json", str(numbers)]
    assert run(["sensor", *SMALL, *sweep]) == 0
    found = json.loads(numbers.read_text())
    assert [row["value"] for row in found["sweeps"]] == [45, 48]
    assert found["sweeps"][1]["reflection_margin_deg"] == pytest.approx(
        found["numbers"]["reflection_margin_deg"]
    )
    page = (out / "report.html").read_text()
    assert "Where total reflection is lost" in page
    assert "http://" not in page
    assert "https://" not in page


def test_adapt_tells_its_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "adapt.json"
    call = [
        "--scene",
        "paper-prototype",
        "--size",
        "48x30",
        "--dent",
        "flat",
        "--goal",
        "3e-3",
        "--seeds",
        "1",
    ]
    options = ["--renderer", "numpy", "--no-compare", "--json", str(numbers)]
    assert run(["adapt", *call, *options]) == 0
    (row,) = json.loads(numbers.read_text())["rows"]
    assert row["met"]
    assert row["steps"][-1]["frames"] == row["frames"]
    assert "Adaptive sensing" in capsys.readouterr().out


@pytest.mark.slow
def test_adapt_stands_beside_the_best_fixed_sequence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = tmp_path / "adapt.json"
    call = ["--scene", "paper-prototype", "--size", "80x50", "--goal", "3e-3", "--seeds", "1"]
    dents = ["--dent", "flat", "--dent", "gaussian:peak=0.1,sigma=6"]
    assert run(["adapt", *call, *dents, "--renderer", "numpy", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["fixed"]["offered"] > found["fixed"]["simulated"] > 0
    assert all(row["fixed_within"] >= 0.95 for row in found["rows"])
    printed = capsys.readouterr().out
    assert f"on {found['fewer']} of 2 dents" in printed


def _little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few candidates, few draws: no figure is judged here."""
    offer = ranking.candidates

    def few(*asked: int) -> list[Any]:
        return offer(*asked)[:5]

    monkeypatch.setattr(ranking, "candidates", few)


@pytest.mark.slow
def test_choices_come_case_by_case(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in the second case keeps the first one, printed and in the file."""
    numbers, small = tmp_path / "choices.json", replace(CASES[7], frames=12)
    monkeypatch.setattr(design, "CASES", (small, CASES[8]))
    _little(monkeypatch)
    real, asked = design.run_choice, []

    def until_interrupted(case: Case, **options: Any) -> ChoiceRow:
        asked.append(case)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return real(case, **options)

    monkeypatch.setattr(design, "run_choice", until_interrupted)
    options = ["--pixels", "48", "--seeds", "1", "--more", "1", "--renderer", "numpy"]
    assert run(["choices", *options, "--json", str(numbers)]) == 130
    (row,) = json.loads(numbers.read_text())["rows"]
    assert row["case"] == small.name
    assert row["excess"] >= 0
    printed = capsys.readouterr().out
    assert row["chosen"] in printed
    assert f"within 5 % of the best  {int(row['excess'] <= 0.05)} of 1" in printed


def test_drawn_scenes_have_numbers() -> None:
    """A number's scene is always the same, and one that can be built."""
    assert list(drawn_cases(3, 4)) == list(drawn_cases(7))[4:]
    for case in drawn_cases(12):
        assert min(case.scene(48).camera.rows, case.scene(48).camera.cols) == 48


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["design", *PRISM, "--frames", "20", "--time", "1"], "--frames and --time"),
        (["design", *PRISM, "--frames", "3"], "no candidate fits"),
        (["design", *PRISM, "--time", "0.01"], "less than two frames"),
        (["design", *PRISM, "--out", "best.json"], "suffix '.json', must be .toml"),
        (["design", *PRISM, "--add", "nowhere:nothing"], "cannot be imported"),
        (["sensor", *PRISM, "--sweep", "angle", "--out", "here"], "must read name=value/value"),
        (["sensor", *PRISM, "--sweep", "colour=1", "--out", "here"], "must be one of"),
        (["adapt", *PRISM, "--goal", "0"], "--goal"),
        (["choices", "--first", "3"], "--first goes with --random"),
        (["choices", "--random", "1", "--case", "2"], "exclude each other"),
    ],
)
def test_bad_input_is_one_line(
    args: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(args, words)
