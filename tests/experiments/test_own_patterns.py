"""Patterns and decoders of a user, faults of display and light, seconds of a display, in bench and design."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.cli import run
from optolever.experiments import Faults
from optolever.experiments.bench import Cell, Grid, load_grid, run_cells
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


def test_random_dots_with_a_decoder_of_ones_own(folder: Path) -> None:
    """Places to a cell, which the solver makes heights of: the error of whole cells, not more."""
    args = ["--add", "my_dots:dots@my_dots:nearest", "--sequence", "gray@my_dots:ours", "--sequence", "gray"]
    options = ["--solver", "coupled", "--noise", "1", "--out", "b", "--json", "b.json"]
    assert run(["bench", *SMALL, *args, *options]) == 0
    rows = {row["sequence"]: row for row in json.loads(Path("b.json").read_text())["rows"]}
    dots = rows["my_dots:dots@my_dots:nearest"]
    assert dots["status"] == "done", dots["why"]
    assert dots["frames"] == 48
    assert dots["flagged_share"] < 0.3
    assert 0.29 < dots["u_rms_px"] < 0.9
    assert 0.45 < dots["sigma_ratio_u"] < 1.5  # sigma is stated as 0.6; a cell, evenly: 0.29
    assert rows["gray@my_dots:ours"]["u_rms_px"] == rows["gray"]["u_rms_px"]
    with Path("b/results.csv").open() as stream:
        assert {row["sequence"] for row in csv.DictReader(stream)} == set(rows)


def test_own_decoders_that_do_not_serve(folder: Path, refused: Callable[..., str]) -> None:
    out = ["--solver", "coupled", "--out", "b"]
    refused(
        ["bench", *SMALL, "--sequence", "gray@my_dots:absent", *out], "my_dots:absent", "cannot be imported"
    )
    refused(["design", *SMALL, "--add", "my_dots:dots"], "my_dots:dots", "is images, name a decoder")
    grid = Grid(("prism48",), ("gray@my_dots:wrong", "my_dots:dots"), sizes=((36, 48),), renderer="numpy")
    rows = list(run_cells(grid.cells(), timed=False))
    assert [row.status for row in rows] == ["not applicable"] * 2
    assert "returns ndarray, must be a Correspondence" in rows[0].why
    assert "is images, name a decoder" in rows[1].why


def test_faults_are_axes(tmp_path: Path) -> None:
    (tmp_path / "grid.toml").write_text(
        'scenes = ["prism48"]\nsequences = ["gray+phase"]\nlags = [0, 0.1]\ngammas = [1.0, 2.2]\n'
        'blurs = [0.5, 1]\nsizes = ["36x48"]\nrenderer = "numpy"\n'
    )
    grid = load_grid(tmp_path / "grid.toml")
    cells = grid.cells()
    assert len(cells) == len({cell.key for cell in cells}) == 8
    assert len({cell.capture_seed for cell in cells}) == 1  # the same noise under every fault
    assert all(cell == Cell.from_dict(json.loads(json.dumps(cell.to_dict()))) for cell in cells)
    rows = {row.cell.faults: row for row in run_cells(cells, timed=False)}
    error = {faults: row.metrics["u_rms_px"] for faults, row in rows.items()}
    plain = error[Faults(0.0, 1.0, None, 0.5)]
    # four steps bear the harmonic of a gamma, and its darker frames have fewer photons' noise
    assert 0.7 * plain < error[Faults(0.0, 2.2, None, 0.5)] < 1.5 * plain
    assert error[Faults(0.1, 1.0, None, 0.5)] > plain
    assert error[Faults(0.0, 1.0, None, 1.0)] > 1.2 * plain  # less contrast
    assert rows[Faults(0.1, 1.0, None, 0.5)].flat(60)["lag"] == 0.1


@pytest.mark.parametrize(
    ("exposure", "refresh", "seconds"),
    [(0, 60, 1 / 60), (10, 60, 1 / 60), (20, 60, 2 / 60), (50, 240, 12 / 240)],
)
def test_a_frame_stays_for_the_refreshes_that_hold_its_exposure(
    exposure: float, refresh: float, seconds: float
) -> None:
    grid = Grid(("prism48",), ("gray",), refresh=refresh, exposure_ms=exposure)
    assert 1 / grid.rate == pytest.approx(seconds)


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
