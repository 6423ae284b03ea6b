"""Many captures by one command: results and their table, captures that fail, workers that are killed."""

import csv
import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever.blocks import ONE_THREAD
from optolever.processes import SAFE_PATH, environment

from .conftest import Program

COUNT = 3


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    from optolever.cli import run

    folder = tmp_path_factory.mktemp("captures")
    for k in range(COUNT):
        dent = f"gaussian:peak={0.01 * (k + 1)}"
        args = ["simulate", "--scene", "prism48", "--dent", dent, "--pixels", "80x60", "--seed", str(k)]
        assert run([*args, "--out", str(folder / f"c{k}")]) == 0
    assert run(["decode", *(str(folder / f"c{k}") for k in range(COUNT)), "--out", str(folder / "one")]) == 0
    return [folder / f"c{k}" for k in range(COUNT)]


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / "table.csv").open(encoding="utf-8") as file:
        return {row["capture"].rpartition("-")[2]: row for row in csv.DictReader(file)}


def same(captures: list[Path], out: Path) -> None:
    """The files are those of one process."""
    for capture in captures:
        name = f"{capture.name}.npz"
        with np.load(capture.parent / "one" / name) as a, np.load(out / name) as b:
            for field in ("u", "v", "sigma_u", "sigma_v", "flags"):
                np.testing.assert_array_equal(a[field], b[field])


def test_heights_of_many_captures_one_of_which_fails(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    (tmp_path / "c1.npz").write_bytes(b"no archive")
    decoded = captures[0].parent / "one"
    args = ["reconstruct", decoded / "c0.npz", tmp_path / "c1.npz", decoded / "c2.npz", "--jobs", "2"]
    args += ["--scene", captures[0] / "scene.toml", "--out", tmp_path / "h"]
    assert "2 of 3 captures done" in optolever(*args, code=2).out
    found = table(tmp_path / "h")
    assert [row["code"] for row in found.values()] == ["0", "2", "0"]
    assert "c1.npz" in found["c1"]["error"]
    for k in (0, 2):
        assert float(found[f"c{k}"]["z_max_mm"]) == pytest.approx(0.01 * (k + 1), rel=0.1)


def test_two_processes_give_the_same_bits_as_one(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    optolever("decode", *captures, "--out", tmp_path / "c", "--jobs", "2")
    same(captures, tmp_path / "c")


def test_captures_that_were_taken_are_measured(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    rig = captures[0] / "scene.toml"
    optolever("camera", "measure", *captures[:2], "--rig", rig, "--out", tmp_path / "m")
    assert set(table(tmp_path / "m")) == {"c0", "c1"}
    assert (tmp_path / "m" / "c1" / "report.html").is_file()


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    dask: Any = pytest.importorskip("distributed", reason="distributed is not installed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "env": ONE_THREAD}
    with environment(SAFE_PATH), dask.LocalCluster(**options) as cluster:
        worker = next(iter(cluster.workers.values())).pid
        kill = threading.Timer(1.5, os.kill, (worker, signal.SIGKILL))
        kill.start()
        optolever("decode", *captures, "--scheduler", cluster.scheduler_address, "--out", tmp_path / "c")
        assert kill.finished.is_set(), "the batch was done before the worker was killed"
    same(captures, tmp_path / "c")
