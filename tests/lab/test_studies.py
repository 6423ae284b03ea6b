"""Adaptive sensing, and `design` against all candidates: against the truth, and as they are called."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lab.design.adaptive import Goal, adapt, share_within, starting
from lab.design.adaptive_study import actual_share, virtual
from lab.program import run
from optolever.errors import InputError
from optolever.experiments.design import Lever
from optolever.scene import dent, load, resize


def test_share_within_is_the_gaussian_one() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.5, 3.0, (200, 200))
    there = rng.random((200, 200)) > 0.1
    error = sigma * rng.normal(size=sigma.shape)
    found = (there & (np.abs(error) < 1.2)).mean()
    assert share_within(sigma, there, np.ones_like(there), 1.2) == pytest.approx(found, abs=0.01)


@pytest.mark.slow
def test_adaptive_sensing_stops_when_the_goal_is_met() -> None:
    """A harder goal takes more frames; what it says of itself is what the truth says, mean of two draws.

    Pixels are two cells wide here: stairs that are left shift whole images and tilt the mirror.
    """
    scene = resize(load("paper-prototype", exact=True), 80, 50)
    surface = dent("gaussian", scene, peak=0.1, sigma=6)
    lever = Lever(scene, surface, stride=1)
    counts = []
    for height in (5e-4, 3e-4):
        goal = Goal(height, 0.9, 60)
        start, told, within = starting(scene, 1.0, goal), [], []
        for seed in range(2):
            done = adapt(virtual(scene, surface, 1.0, seed, "numpy"), start, goal)
            assert done.met
            within.append(actual_share(lever, done.height, goal))
            told.append(done.steps[-1].within)
        assert min(within) >= goal.share - 0.01
        assert np.mean(within) == pytest.approx(np.mean(told), abs=0.015)
        counts.append(len(done.sequence))
    assert counts[1] > counts[0]


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
    call = ["--scene", "paper-prototype", "--size", "80x50", "--goal", "3e-3", "--seeds", "1"]
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
