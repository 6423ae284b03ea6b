"""Sample sets: what their commands give is near the truth that lies apart."""

import csv
import re
import shlex
from dataclasses import replace
from glob import glob
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from optolever.cli import run
from optolever.metrology import fit_form
from optolever.reconstruct import HeightMap
from optolever.samples import write_sample
from optolever.samples.sets import Ball
from optolever.scene import Trace

NOTICE = re.compile("[Nn]otice: (.*)")
#: Notices that are true of the samples, by their first words.
TRUE = ("pictures compressed with loss", "No capture reveals it", "z = 0 is the mirror")


def _go_on(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What the sample's commands print."""
    commands, said = write_sample(name, name), ""
    assert len(commands) <= 4
    for line in commands:
        words = (sorted(glob(word)) if "*" in word else [word] for word in shlex.split(line)[1:])
        assert run(list(chain.from_iterable(words))) == 0, line
        printed = "".join(capsys.readouterr())
        assert [one for one in NOTICE.findall(printed) if not one.startswith(TRUE)] == [], line
        said += printed
    return said


def test_a_sensor_is_measured_by_its_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rig off by a third of a typed sigma: the deepest point errs by less than three of its sigmas."""
    monkeypatch.chdir(tmp_path)
    _go_on("sensor", capsys)
    height, true = HeightMap.load("sensor/h.npz"), Trace.load("sensor/truth/press.npz")
    deepest = np.unravel_index(np.nanargmax(np.where(height.good, true.z, np.nan)), true.z.shape)
    assert abs(height.z - true.z)[deepest] < 3 * height.total_sigma[deepest]
    assert abs(height.z[deepest] / true.z[deepest] - 1) < 0.1
    with Path("sensor/truth/contacts.csv").open() as file:
        (pressed,) = csv.DictReader(file)
    (found,) = height.contacts or ()
    area = np.pi * float(pressed["radius_mm"]) * float(pressed["depth_mm"])  # as Hertz has it
    for name, value in {
        "depth": pressed["depth_mm"], "indenter_radius": pressed["radius_mm"],
        "force": pressed["force_n"], "area": area,
    }.items():  # fmt: skip
        true, sigma = float(value), getattr(found, f"{name}_sigma")
        assert abs(getattr(found, name) - true) < 3 * sigma < 0.4 * true, name
    assert Path("sensor/report/report.html").stat().st_size > 100_000
    assert len(list(Path("sensor/press").glob("DSC_*.JPG"))) > 10


@pytest.mark.slow
def test_a_rig_is_designed_for_by_its_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With its noise and response; a sequence of one's own goes by its file's name."""
    monkeypatch.chdir(tmp_path)
    out = _go_on("design", capsys)
    assert "response of gamma 2.2; noise of" in out
    assert "\nmine " in out
    assert Path("design/codes.png").stat().st_size > 10_000


@pytest.mark.slow
def test_forty_presses_are_measured_by_their_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _go_on("forty", capsys)
    assert len(list(Path("forty/h").glob("press*.npz"))) == 40


@pytest.mark.slow
def test_a_mirror_is_measured_by_its_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _go_on("mirror", capsys)
    assert Path("mirror/measured/report.html").is_file()
    height, true = HeightMap.load("mirror/measured/h.npz"), Trace.load("mirror/truth/mirror.npz")
    good = height.good & true.visible
    there = replace(height, **{name: np.where(good, getattr(true, name), np.nan) for name in "xyz"})
    found, form = (fit_form(each, "tilt").residual[good] for each in (height, there))
    assert np.nanstd(found - form) < 0.2 * np.nanstd(form)


def test_the_slopes_of_the_ball_are_those_of_its_height() -> None:
    """By central differences, within the contact, at its edge and beyond."""
    ball, step = Ball(20.0, 15.0, 0.3), 1e-5
    x, y = (20 + 8 * np.cos(np.arange(50)), 15 + 0.2 * np.arange(50))
    numeric = [
        (ball.height(x + a, y + b) - ball.height(x - a, y - b)) / (2 * step)
        for a, b in ((step, 0), (0, step))
    ]
    np.testing.assert_allclose(ball.gradient(x, y), numeric, atol=1e-7)
