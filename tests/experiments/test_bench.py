"""Cells, peers, plain integration, frontier, rows: against closed forms, brute force and each other."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.experiments.bench import (
    Cell,
    Grid,
    Row,
    bench_table,
    decoders,
    frontier,
    load_grid,
    run_cells,
    write_bench_report,
)
from optolever.experiments.bench import run as running
from optolever.experiments.place import Place
from optolever.reconstruct import HeightMap

CELL = Cell("paper-simulation", (64, 64), "gaussian", "gray+phase", 1.0, 0, "coupled", "numpy")


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """A small bench: two mirrors, several chains."""
    grid = Grid(
        scenes=("paper-simulation", "monitor-mirror"),
        sizes=((96, 96),),
        sequences=("exact", "gray+phase", "gray@cv2", "lattice"),
        solvers=("coupled", "paper", "decoupled"),
        renderer="numpy",
    )
    return list(run_cells(grid.cells(), timed=True))


def test_a_grid_has_every_combination_once() -> None:
    grid = Grid(("a", "b"), ("exact", "gray", "gray@cv2"), ("coupled", "paper"), noises=(1, 2), seeds=(0, 1))
    cells = grid.cells()
    assert len(cells) == len(set(cells)) == 2 * 2 * (1 + 2 * 2 * 2)
    assert len({cell.key for cell in cells}) == len(cells)
    assert all(cell == Cell.from_dict(json.loads(json.dumps(cell.to_dict()))) for cell in cells)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scenes = 3\nsequences = ['gray']", "scenes is 3"),
        ("scenes = ['a']", "sequences is missing"),
        ("scenes = ['a']\nsequences = ['gray']\nsizes = ['9']", "sizes holds '9'"),
        ("scenes = ['a']\nsequences = ['gray']\nnoises = [-1]", "noises holds -1"),
        ("scenes = ['a']\nsequences = ['gray']\nseeds = [0.5]", "seeds holds 0.5"),
        ("scenes = ['a']\nsequences = [2]", "sequences holds 2"),
        ("scenes = ['a']\nsequences = ['gray']\nrefresh = 0", "refresh holds 0"),
        ("scenes = ['a']\nsequences = ['gray']\nrenderer = 'x'", "renderer holds 'x'"),
        ("scenes = ['a']\nspeed = 1", "unknown field 'speed'"),
        ("scenes = ", "not readable as TOML"),
    ],
)
def test_a_bad_grid_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "grid.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"grid\.toml.*{re.escape(message)}"):
        load_grid(path)


def test_frontier_against_brute_force() -> None:
    rng = np.random.default_rng(3)
    points = [(float(t), float(e)) for t, e in rng.integers(0, 12, (60, 2))]
    points.append((math.nan, 0.0))
    found = {points[i] for i in frontier(points)}
    beaten = [
        p for p in points if math.isnan(p[0]) or any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in points)
    ]
    assert found == set(points) - set(beaten)


def test_opencv_decodes_our_gray_frames() -> None:
    """The frames are OpenCV's own; what it makes of them is the truth to a pixel."""
    cell = replace(CELL, sequence="gray@cv2", noise=0.0)
    shot = decoders.shoot(Place.of(cell.scene, cell.dent, cell.size), cell)
    _, shown = shot.taken()
    assert np.array_equal(decoders.cv2_coder(shown).generate()[1], shown.render()[2:])
    seen = decoders.decoder("cv2").run(shot)
    inside = seen.good & shot.place.truth.visible
    assert inside.mean() > 0.9
    assert np.abs(seen.u - shot.place.truth.u)[inside].max() < 1.0


def test_rows_of_a_bench(rows: list[Row]) -> None:
    found = {(row.cell.scene, row.cell.sequence, row.cell.solver): row for row in rows}
    assert len(found) == len(rows) == 24
    ours = found["paper-simulation", "gray+phase", "coupled"]
    floor = found["paper-simulation", "exact", "coupled"]
    paper = found["paper-simulation", "gray+phase", "paper"]
    assert (ours.kind, floor.kind, paper.kind) == ("own", "floor", "paper")
    assert floor.error < 1e-4 < paper.error
    assert floor.error < ours.error < paper.error
    assert ours.frames == 20
    assert ours.display_seconds(60.0) == pytest.approx(1 / 3)
    assert ours.timings["decode_bytes"] > 96 * 96 * 8
    assert 0 < ours.timings["floor_seconds"] < ours.timings["decode_seconds"]
    assert ours.timings["reconstruct_seconds"] > 0
    assert found["paper-simulation", "gray@cv2", "decoupled"].kind == "peer"
    lattice = found["paper-simulation", "lattice", "paper"]
    assert lattice.done
    assert lattice.frames == 1
    assert found["monitor-mirror", "gray+phase", "paper"].status == "not applicable"
    assert found["monitor-mirror", "lattice", "coupled"].status == "not applicable"


def test_a_single_shot_counts_one_frame_and_follows_the_rest() -> None:
    """The rest capture is no part of it; its error is the fringe's, not the dent's."""
    cell = replace(CELL, sequence="crossed:period=8", size=(96, 96), dent="gaussian:peak=0.2,sigma=30")
    (row,) = run_cells([cell], timed=False)
    assert row.done, row.why
    assert row.frames == 1
    assert row.metrics["u_rms_px"] < 0.03  # photons: noise of 2.2 levels
    assert row.metrics["sigma_ratio_height"] < 1.3
    assert row.error < 0.03  # 0.020 to 0.024 over seeds; 0.009 to 0.012 by one level of noise


def test_what_is_not_installed_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "installed", lambda module: module is None)
    cells = [
        replace(CELL, sequence="phase:periods=20/22/25@fringes"),
        replace(CELL, sequence="exact", solver="mbipy-dct"),
    ]
    for row in run_cells(cells, timed=False):
        assert row.status == "not installed"
        assert "is not installed" in row.why


def test_a_broken_solver_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> HeightMap:
        raise ZeroDivisionError("by zero")

    own = running.solver("coupled")
    monkeypatch.setattr(running, "solver", lambda name: replace(own, run=broken))
    (row,) = run_cells([replace(CELL, sequence="exact")], timed=False)
    assert (row.status, row.why) == ("failed", "ZeroDivisionError: by zero")
    assert not row.done


def test_the_report_has_a_section_per_mirror(rows: list[Row], tmp_path: Path) -> None:
    write_bench_report(tmp_path / "report.html", rows, {"refresh": 60.0}, {"total": 1.0})
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert html.count('<section id="mirror-') == 2
    assert html.count("data:image/png") == 2
    assert 'class="best"' in html
    assert "http" not in html.replace("http-equiv", "")
    names = [name for name, _, _ in bench_table(rows, 60.0)]
    assert all(name in html for name in names)
    (_, (header, *lines), absent) = next(iter(bench_table(rows, 60.0)))
    assert {len(line) for line in lines} == {len(header)}
    assert len(lines) == 10
    assert absent == [
        "lattice with coupled, decoupled: not applicable: lattice crossings are sparse: method paper only"
    ]
