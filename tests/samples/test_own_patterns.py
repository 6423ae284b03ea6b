"""Patterns and decoders of a user, faults of display and light, seconds of a display, in design."""

import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from optolever import design
from optolever.camera import Timing
from optolever.cli import run
from optolever.design import compare_codes, frame_rate
from optolever.design.chart import front
from optolever.projector import NOMINAL_SENSOR
from optolever.samples import Faults
from optolever.scene import load, resize

#: Random dots: a cell is black or white by chance in every image; a pixel is the cell that is most alike.
DOTS = """
import numpy as np
from scipy.spatial import cKDTree
from optolever.decode import Correspondence

COUNT = 48


def dots(rows, cols):
    return np.random.default_rng(1).integers(0, 2, (COUNT, rows, cols), np.uint8) * 255


def nearest(frames, images):
    def unit(levels):
        levels = levels.reshape(COUNT, -1).astype(float)
        levels = levels - levels.mean(axis=0)
        return (levels / np.maximum(np.linalg.norm(levels, axis=0), 1e-9)).T
    shape = frames.shape[1:]
    away, at = cKDTree(unit(images)).query(unit(frames))
    v, u = (part.reshape(shape).astype(float) for part in np.divmod(at, images.shape[2]))
    sigma = np.full(shape, 0.6)  # a cell, or the one beside it
    flags = np.where((away.reshape(shape) < 0.85) & (np.ptp(frames, axis=0) > 60), 0, 128).astype(np.uint16)
    return Correspondence(u, v, sigma, sigma, flags)


def ours(frames, shown):
    from optolever.decode import decode
    return decode(frames, shown)


def wrong(frames, shown):
    return frames
"""
SMALL = ["--scene", "prism48", "--pixels", "64x48"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working folder, with a module of the user's; docs/howto/code.md has one of that name."""
    (tmp_path / "my_dots.py").write_text(DOTS)
    monkeypatch.chdir(tmp_path)
    sys.modules.pop("my_dots", None)
    yield tmp_path
    sys.modules.pop("my_dots", None)


COMPARE = ["design", *SMALL, "--dent", "gaussian:peak=0.2"]


def test_random_dots_with_a_decoder_of_ones_own(folder: Path) -> None:
    """Places to a cell: a larger error than fringes; `gray` by a user's call of decode is `gray`."""
    codes = ["my_dots:dots@my_dots:nearest", "gray@my_dots:ours", "gray", "gray+phase"]
    options = [part for code in codes for part in ("--code", code)]
    assert run([*COMPARE, *options, "--exposure", "20", "--json", "b.json", "--out", "b.png"]) == 0
    rows = {row["code"]: row for row in json.loads(Path("b.json").read_text())["rows"]}
    assert list(rows) == ["dots (nearest)", "gray (ours)", "gray", "gray+phase"]
    assert rows["gray (ours)"]["simulated"] == rows["gray"]["simulated"]
    assert rows["dots (nearest)"]["simulated"] > 3 * rows["gray+phase"]["simulated"]
    assert rows["gray+phase"]["predicted"] == pytest.approx(rows["gray+phase"]["simulated"], rel=0.3)
    assert rows["dots (nearest)"]["acquisition_seconds"] == pytest.approx(48 / 30)
    assert all(row["cpu_seconds"] > 0 for row in rows.values())
    assert Path("b.png").read_bytes().startswith(b"\x89PNG")


def test_own_decoders_that_do_not_serve(folder: Path, refused: Callable[..., str]) -> None:
    written = ["--out", "b.png", "--json", "b.json"]
    refused([*COMPARE, "--code", "gray@my_dots:absent", *written], "my_dots:absent", "cannot be imported")
    refused(["design", *SMALL, "--add", "my_dots:dots"], "my_dots:dots", "is images, name a decoder")
    refused(["design", *SMALL, "--fault", "lag=0", "--fault", "lag=0.1"], "--code: missing")
    scene = resize(load("prism48"), 36, 48)
    refused([*COMPARE, "--code", "my_dots:dots"], "my_dots:dots", "is images, name a decoder")
    settings = {"faults": [Faults()], "noises": (1.0,), "resized": True, "renderer": "numpy"}
    (wrong,) = compare_codes(scene, None, ("gray@my_dots:wrong",), **settings)
    assert "returns ndarray, must be a Correspondence" in wrong.why


def test_what_is_stopped_keeps_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C after the first code of two: its line, its row, its mark."""

    def stopped(*args: Any, **given: Any) -> Iterator[design.Tradeoff]:
        (code, _) = args[2]
        row = design.Tradeoff(code, 1.0, 0.05, None, None, None, 24, 0.4)
        yield replace(row, cpu_seconds=0.1, simulated=1e-4, spread=1e-6, ratio=1.0, share=1.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(design, "compare_codes", stopped)
    table, chart = tmp_path / "t.csv", tmp_path / "t.png"
    args = ["design", *SMALL, "--code", "gray+phase", "--code", "phase"]
    assert run([*args, "--json", str(table), "--out", str(chart)]) == 130
    assert "gray+phase" in capfd.readouterr().out
    assert [line.partition(",")[0] for line in table.read_text().splitlines()] == ["code", "gray+phase"]
    assert chart.stat().st_size > 10_000


def test_the_rigs_lag_is_that_of_its_measured_wait(tmp_path: Path) -> None:
    """[sync]: a cell of time constant tau, exposed for T from ln(512) tau on, holds of the frame before
    tau / T (1 - exp(-T / tau)) / 512. --fault lag=L replaces it."""
    tau, exposure = 0.005, 0.016
    rig = resize(load("prism48"), 36, 48)
    rig.save(tmp_path / "rig.toml")
    timing = Timing(0.02, 0.0, tau, tau, 0.0, 0.0, period_s=0.017, exposure_s=exposure)
    with (tmp_path / "rig.toml").open("ab") as file:
        file.write(b"\n" + tomli_w.dumps({"sync": timing.to_table()}).encode())
    args = ["design", "--scene", str(tmp_path / "rig.toml"), "--code", "phase"]
    expected = tau / exposure * -math.expm1(-exposure / tau) / 512
    for more, lag in (([], expected), (["--fault", "lag=0.1"], 0.1)):
        assert run([*args, *more, "--json", str(tmp_path / "d.json")]) == 0
        (row,) = json.loads((tmp_path / "d.json").read_text())["rows"]
        assert row["lag"] == pytest.approx(lag, rel=1e-6)


def test_the_front_is_what_no_other_code_beats_in_both() -> None:
    cost, error = np.array([3.0, 1.0, 2.0, 4.0, 1.0]), np.array([2.0, 5.0, 3.0, 2.5, 6.0])
    best = {int(k) for k in front(cost, error)}
    beaten = {k for k in range(5) for j in range(5) if j != k and cost[j] <= cost[k] and error[j] <= error[k]}
    assert best == set(range(5)) - beaten


def test_faults_are_axes() -> None:
    scene = resize(load("prism48"), 36, 48)
    faults = [Faults(), Faults(0.1), Faults(blur=1.0), Faults(gamma=1.5)]
    rows = list(
        compare_codes(
            scene, None, ("gray+phase",), faults=faults, noises=(1.0, 4.0), resized=True, renderer="numpy"
        )
    )
    axes = [(row.lag, row.gamma, row.blur) for row in rows[::2]]
    assert axes == [(0.0, None, None), (0.1, None, None), (0.0, None, 1.0), (0.0, 1.5, None)]
    plain, noisy = rows[:2]
    shot = 255 / 2 / (scene.sensor or NOMINAL_SENSOR).gain_e  # variance by photons at mid grey
    expected = np.sqrt((16 + shot) / (1 + shot))
    assert [row.condition for row in rows[1:4]] == ["noise 4", "noise 1, lag 0.1", "noise 4, lag 0.1"]
    assert plain.ratio == pytest.approx(1.0, abs=0.4)
    assert noisy.simulated / plain.simulated == pytest.approx(expected, rel=0.3)
    assert rows[2].predicted != rows[2].predicted  # lag is not predicted
    assert rows[4].simulated > plain.simulated  # less contrast


@pytest.mark.parametrize(
    ("exposure", "refresh", "seconds"),
    [(0, 60, 1 / 60), (10, 60, 1 / 60), (20, 60, 2 / 60), (50, 240, 12 / 240)],
)
def test_a_frame_stays_for_the_refreshes_that_hold_its_exposure(
    exposure: float, refresh: float, seconds: float
) -> None:
    assert 1 / frame_rate(refresh, exposure) == pytest.approx(seconds)
