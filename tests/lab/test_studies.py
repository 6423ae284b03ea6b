"""Adaptive sensing, and `design` against all candidates: against the truth, and as they are called."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lab.design.adaptive import Goal, adapt, share_within, starting
from lab.design.adaptive_study import virtual
from lab.program import run
from optolever.errors import InputError
from optolever.scene import dent, load, resize


def test_share_within_is_the_gaussian_one() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.5, 3.0, (200, 200))
    there = rng.random((200, 200)) > 0.1
    error = sigma * rng.normal(size=sigma.shape)
    found = (there & (np.abs(error) < 1.2)).mean()
    assert share_within(sigma, there, np.ones_like(there), 1.2) == pytest.approx(found, abs=0.01)


@pytest.mark.slow
def test_adaptive_sensing_says_when_a_goal_cannot_be_met() -> None:
    scene = resize(load("paper-prototype", exact=True), 80, 50)
    goal = Goal(1e-7, 0.95, 14)
    done = adapt(virtual(scene, dent("flat", scene), 1.0, 0, "numpy"), starting(scene, 1.0, goal), goal)
    assert not done.met
    assert done.why
    assert len(done.sequence) <= 14
    with pytest.raises(InputError, match="goal"):
        starting(scene, 1.0, Goal(0.0))


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
    call = ["--scene", "paper-prototype", "--pixels", "50x80", "--goal", "3e-3", "--seeds", "1"]
    dents = ["--dent", "flat", "--dent", "gaussian:peak=0.1,sigma=6"]
    assert run(["adapt", *call, *dents, "--renderer", "numpy", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["fixed"]["offered"] > found["fixed"]["simulated"] > 0
    assert all(row["fixed_within"] >= 0.95 for row in found["rows"])
    printed = capsys.readouterr().out
    assert f"on {found['fewer']} of 2 dents" in printed


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["adapt", "--scene", "prism48", "--goal", "0"], "--goal"),
        (["choices", "--first", "3"], "--first goes with --random"),
        (["choices", "--random", "1", "--case", "2"], "exclude each other"),
    ],
)
def test_bad_input_is_one_line(args: list[str], words: str, refused: Callable[..., str]) -> None:
    refused(args, words, run=run)
