"""`optolever codes`: what is predicted is what a simulation gives; what is called detected is."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.cli import run
from optolever.decode import Correspondence, decode
from optolever.experiments import code_rows, code_that_decodes, predict_code
from optolever.experiments.ideal import ideal_level
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, capture
from optolever.scene import Scene, dent, load, resize

SIZE = (120, 170)


def fringe(period: float, steps: int) -> float:
    """Cramer-Rao of N steps, amplitude 60, noise 2, px."""
    return float(period / (2 * np.pi) * np.sqrt(2 / steps) * 2 / 60)


TOGETHER = sum(fringe(period, 3) ** -2 for period in (20, 22, 25)) ** -0.5


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("name", "sigma"),
    [
        ("phase:steps=4", fringe(16, 4)),
        ("gray", 1 / np.sqrt(12)),
        ("long-run-gray", 1 / np.sqrt(12)),
        ("phase:steps=3,periods=20/22/25", TOGETHER),
        ("gray+phase", fringe(8, 4)),
    ],
)
def test_predicted_sigma_is_the_bound(name: str, sigma: float) -> None:
    """A cell, evenly; Cramer-Rao."""
    found = predict_code(sequence_from_text(name, *SIZE), 60.0, 2.0)
    assert found[1] == pytest.approx(sigma, rel=0.06)
    assert found[2] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "above"),
    [
        ("stripe:step=8", 1.06),
    ],
)
def test_predicted_sigma_of_sweeps_is_a_bound_that_is_nearly_reached(name: str, above: float) -> None:
    """Fisher's information of raised cosines, light and darkness not known, mean over the middle."""
    shown = sequence_from_text(name, *SIZE)
    v, u = np.mgrid[40:80:0.5, 60:110:0.5]
    level = 2 * 60.0 / 2.0 * np.stack([ideal_level(shown, i, u, v) for i in range(len(shown))])
    told = []
    for axis in (1, 2):
        slope = np.gradient(level, 0.5, axis=axis)
        left = slope - slope.mean(axis=0)
        lit = level - level.mean(axis=0)
        left -= lit * (lit * left).sum(axis=0) / (lit**2).sum(axis=0)
        told.append(np.mean(1 / (left**2).sum(axis=0)) ** 0.5)
    assert 0.97 < predict_code(shown, 60.0, 2.0)[1] / max(told) < above


def test_surfaces_longer_than_the_periods_tell_apart() -> None:
    """20, 22 and 25 px repeat after 1100: of 1920 px what lies beyond is taken for what lies before."""
    shown = sequence_from_text("phase:steps=4,periods=20/22/25", 200, 1920)
    reach, _, gross, stripe = predict_code(shown, 60.0, 2.0)
    assert (reach, stripe) == (200, 10.0)
    assert gross > 0.2


def test_rows_and_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "codes.json"
    names = ["phase:steps=3", "phase:steps=3,counts=0.9"]
    assert run(["codes", *names, "--size", "120x170", "--json", str(path)]) == 0
    rows = json.loads(path.read_text())["codes"]
    assert [row["name"] for row in rows] == names
    assert rows[0]["frames"] == len(sequence_from_text(names[0], *SIZE))
    assert rows[0]["swapped"] == 1.0
    assert rows[1]["swapped"] < 1.0  # of one period alone: another mirror
    streams = capsys.readouterr()
    assert names[0] in streams.out
    assert streams.err.splitlines() == [f"{names[0]} 0/2", f"{names[1]} 1/2"]  # progress, on no terminal too


def test_a_lost_frame_of_three_steps_is_no_silent_error() -> None:
    """Two steps of one period contradict the other periods."""
    (row,) = code_rows(["phase:steps=3"], SIZE, 60.0, 2.0)
    assert row.lost == 1.0


def test_bad_numbers() -> None:
    with pytest.raises(InputError, match="noise is 0"):
        list(code_rows(["gray"], SIZE, 60.0, 0.0))
    with pytest.raises(InputError, match="name is 'grey'"):  # before any code is decoded
        next(code_rows(["gray", "grey"], SIZE, 60.0, 1.0))


@pytest.fixture(scope="module")
def rig() -> Scene:
    return resize(load("prism48", exact=True), 90, 120)


def weak_capture(rig: Scene, text: str, reflectance: float, noise: float) -> tuple[Capture, Sequence]:
    """Frames of a mirror that reflects so little, 8 bits, noise in levels."""
    shown = sequence_from_text(text, rig.pattern.rows, rig.pattern.cols)
    ideal = capture(rig, dent("flat", rig), shown)
    light = reflectance * ideal.frames + noise * np.random.default_rng(3).standard_normal(ideal.frames.shape)
    return replace(ideal, frames=np.clip(np.rint(3 + light), 0, 255).astype(np.uint8)), shown


def decoded(rig: Scene, text: str, reflectance: float, noise: float) -> Correspondence:
    taken, shown = weak_capture(rig, text, reflectance, noise)
    return decode(taken.frames, shown)


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("text", "reflectance", "noise"),
    [
        ("gray+phase", 0.07, 2.0),
        ("gray+phase", 0.03, 1.0),
        ("phase", 0.05, 2.0),
        ("micro-phase", 0.07, 2.0),
    ],
)
def test_a_refused_capture_names_what_would_decode(
    rig: Scene,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    reflectance: float,
    noise: float,
) -> None:
    """A mirror of a few per cent, all of whose pixels are refused: both cures of the notice are tried, and
    modulation over noise is that of the frames."""
    taken, shown = weak_capture(rig, text, reflectance, noise)
    taken.save(tmp_path / "weak")
    assert decode(taken.frames, shown).good.mean() < 0.05
    assert run(["decode", str(tmp_path / "weak"), "--out", str(tmp_path / "c.npz")]) == 0
    assert "The pattern is too weak for" in capsys.readouterr().err
    (notice,) = (one for one in Correspondence.load(tmp_path / "c.npz").notices if "too weak" in one.name)
    found = re.search(r"expose ([\d.]+) times as long, or show --sequence (\S+) ", notice.cure)
    ratio = re.search(r"is ([\d.]+) times the noise", notice.name)
    assert found is not None
    assert ratio is not None
    bright = decoded(rig, text, 1.0, 1.0).amplitude
    assert bright is not None
    assert 0.75 < float(ratio[1]) / (reflectance * np.median(bright) / noise) < 1.25
    assert decoded(rig, found[2], reflectance, noise).good.mean() > 0.9
    assert decoded(rig, text, float(found[1]) * reflectance, noise).good.mean() > 0.85


def test_a_capture_that_decodes_is_told_no_other_code(rig: Scene) -> None:
    """Nor one that is refused as two frames have changed places, whatever its modulation."""
    taken, shown = weak_capture(rig, "phase:steps=3", 1.0, 1.0)
    assert code_that_decodes(decode(taken.frames, shown), shown) is None
    swapped = taken.frames[[1, 0, *range(2, len(shown))]]
    assert code_that_decodes(decode(swapped, shown), shown) is None
