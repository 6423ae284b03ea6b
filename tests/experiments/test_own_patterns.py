"""Patterns and decoders of a user, faults of display and light, seconds of a display, in design."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.cli import run
from optolever.experiments.design import frame_rate
from optolever.experiments.own_images import OwnImages, image_frames
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.scene import dent, load, resize, trace

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
SMALL = ["--scene", "prism48", "--size", "48x64"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a module of the user's."""
    (tmp_path / "my_dots.py").write_text(DOTS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_images_of_a_sequence_are_seen_as_the_sequence_is() -> None:
    """The two renderers agree where the image is smooth: fringes, as images and as what they are."""
    scene = resize(load("prism48"), 48, 64)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    phase = replace(shown, frames=tuple(frame for frame in shown.frames if frame.kind == "phase"))
    surface = dent("gaussian", scene)
    true = capture(scene, surface, phase, renderer="numpy").frames.astype(float)
    truth = trace(scene, surface)
    found = image_frames(scene, surface, truth, OwnImages(phase.render(), "own"), 0.0, 0.0, 0, "numpy")
    inside = truth.visible & (truth.u > 2) & (truth.v > 2)
    inside &= (truth.u < scene.pattern.cols - 3) & (truth.v < scene.pattern.rows - 3)
    off = np.abs(found - true)[:, inside]
    assert np.sqrt(np.mean(off**2)) < 0.02 * np.ptp(true)


def test_own_codes_and_decoders_beside_named_ones(folder: Path) -> None:
    """Places to a cell, which the solver makes heights of: the error of whole cells, not more."""
    dots = "my_dots:dots@my_dots:nearest"
    args = ["--code", dots, "--code", "gray@my_dots:ours", "--code", "gray", "--code", "gray+phase"]
    options = ["--lag", "0", "--lag", "0.1", "--exposure", "20", "--renderer", "numpy"]
    outputs = ["--csv", "d.csv", "--chart", "d.png", "--json", "d.json"]
    assert run(["design", *SMALL, *args, *options, *outputs]) == 0
    points = json.loads(Path("d.json").read_text())["points"]
    rows = {(point["row"]["text"], point["value"]): point["row"] for point in points}
    assert len(rows) == 8
    assert rows[dots, 0]["frames"] == 48
    assert rows[dots, 0]["seconds"] == pytest.approx(48 / 30)
    assert rows["gray@my_dots:ours", 0]["simulated"] == rows["gray", 0]["simulated"]
    assert (
        rows["gray+phase", 0]["simulated"] < 0.3 * rows["gray", 0]["simulated"] < rows[dots, 0]["simulated"]
    )
    assert rows["gray+phase", 0.1]["simulated"] > rows["gray+phase", 0]["simulated"]
    assert rows["gray", 0]["predicted"] == pytest.approx(rows["gray", 0]["simulated"], rel=0.3)
    assert all(row["cpu_seconds"] > 0 for row in rows.values())
    with Path("d.csv").open() as stream:
        assert [(row["text"], float(row["lag"])) for row in csv.DictReader(stream)] == list(rows)
    assert Path("d.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--code", "gray@my_dots:absent"], "my_dots:absent"),
        (["--add", "my_dots:dots"], "is images, name a decoder"),
        (["--lag", "0", "--lag", "0.1"], "need --code"),
        (["--code", "gray", "--lag", "0", "--lag", "0.1", "--blur", "1", "--blur", "2"], "one of them"),
        (["--chart", "d.png"], "needs --code"),
    ],
)
def test_what_cannot_be_compared(
    args: list[str], words: str, folder: Path, refused: Callable[..., str]
) -> None:
    refused(["design", *SMALL, *args], words)


@pytest.mark.parametrize(
    ("exposure", "refresh", "seconds"),
    [(0, 60, 1 / 60), (10, 60, 1 / 60), (20, 60, 2 / 60), (50, 240, 12 / 240)],
)
def test_a_frame_stays_for_the_refreshes_that_hold_its_exposure(
    exposure: float, refresh: float, seconds: float
) -> None:
    assert 1 / frame_rate(refresh, exposure) == pytest.approx(seconds)


@pytest.mark.slow
def test_design_simulates_a_decoder_of_ones_own(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = "my_dots:dots@my_dots:nearest"
    options = ["--verify", "1", "--frames", "12", "--rows", "1", "--renderer", "numpy", "--exposure", "20"]
    assert run(["design", *SMALL, "--add", own, *options, "--lag", "0.02", "--json", "d.json"]) == 0
    rows = json.loads(Path("d.json").read_text())["rows"]
    row = next(row for row in rows if row["text"] == own)
    assert row["simulated"] > 3 * rows[0]["simulated"] > 0
    assert row["seconds"] == pytest.approx(48 / 30)
    assert "own decoder: simulated only" in capsys.readouterr().out
