"""Sweeps: one file per cell, resumed, the same numbers on Dask as in one process, workers may die."""

import json
import os
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lab.bench.sweeps import sweep
from optolever.blocks import ONE_THREAD
from optolever.experiments.bench import Cell, Grid, Row, Store, load_grid
from optolever.experiments.bench.cell import grouped

GRID = """
scenes = ["paper-simulation"]
sizes = ["32x32"]
dents = ["gaussian", "raised-cosine"]
sequences = ["phase", "exact"]
seeds = [0, 1, 2]
solvers = ["decoupled", "paper"]
renderer = "numpy"
"""


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is compiled in a process apart: these tests do not look at the last bits."""
    monkeypatch.setattr("lab.bench.sweeps.compile_apart", lambda cells: None)


@pytest.fixture
def grid(tmp_path: Path) -> Grid:
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return load_grid(path)


def counted(cells: list[Cell], store: Store) -> tuple[list[Row], int]:
    """Rows of a serial sweep, and how many of them the store had before."""
    seen: list[tuple[str, int, int]] = []
    rows = list(sweep(cells, store, progress=lambda *word: seen.append(word)))
    return rows, seen[0][1]


@pytest.mark.usefixtures("compiled")
def test_what_is_finished_is_not_run_again(tmp_path: Path, grid: Grid) -> None:
    cells = grid.cells()
    store = Store(tmp_path / "out")
    first, had = counted(cells, store)
    assert had == 0
    assert len(list((tmp_path / "out/cells").iterdir())) == len(cells) == 16
    store.path(cells[0]).unlink()
    store.path(cells[1]).write_text("{ torn")
    store.save(replace(first[5], status="failed"))
    record = json.loads(store.path(first[6].cell).read_text())
    store.path(first[6].cell).write_text(json.dumps(record | {"version": "0"}))
    again, had = counted(cells, store)
    assert had == len(cells) - len({cells[0], cells[1], first[5].cell, first[6].cell})
    assert numbers(again) == numbers(first)


@pytest.mark.usefixtures("compiled")
def test_a_stopped_sweep_keeps_its_cells(tmp_path: Path, grid: Grid) -> None:
    store = Store(tmp_path / "out")
    running = sweep(grid.cells(), store)
    kept = [next(running), next(running)]
    running.close()
    rows, had = counted(grid.cells(), store)
    assert had == 2
    assert rows[:2] == kept


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_changes_nothing(root: Path, tmp_path: Path, grid: Grid) -> None:
    """Two local workers, one killed in the middle, against a fresh process that runs cell after cell."""
    dask: Any = pytest.importorskip("distributed", reason="distributed is not installed")
    command = [sys.executable, "-m", "lab", "sweep"]
    options = [str(tmp_path / "grid.toml"), "--workers", "0", "--out", str(tmp_path / "alone")]
    subprocess.run([*command, *options], cwd=root, check=True, capture_output=True)
    groups = len(grouped(grid.cells()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a dying worker's sockets say is no fault of ours
        local = dask.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, env=ONE_THREAD)
        with local as cluster, dask.Client(cluster) as client:
            victim = next(iter(client.run(os.getpid).values()))
            rows: list[Row] = []
            there = cluster.scheduler_address
            for row in sweep(grid.cells(), Store(tmp_path / "dask"), scheduler=there):
                if not rows:
                    os.kill(victim, signal.SIGKILL)
                rows.append(row)
    assert groups > 4
    assert numbers(rows) == numbers(sweep(grid.cells(), Store(tmp_path / "alone")))


def numbers(rows: Any) -> dict[str, dict[str, Any]]:
    """Everything but the timings, exactly."""
    return {row.cell.key: {k: repr(v) for k, v in row.numbers().items()} for row in rows}
