"""Many captures by one command: results and their table, captures that fail, workers that are killed."""

import csv
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever.blocks import ONE_THREAD
from optolever.cli import run
from optolever.processes import safe_path

COUNT = 3


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    for k in range(COUNT):
        dent = f"gaussian:peak={0.01 * (k + 1)}"
        args = ["simulate", "--scene", "prism48", "--dent", dent, "--pixels", "80x60", "--seed", str(k)]
        assert run([*args, "--out", str(folder / f"c{k}")]) == 0
    return folder


def names(folder: Path) -> list[str]:
    return [str(folder / f"c{k}") for k in range(COUNT)]


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / "table.csv").open(encoding="utf-8") as file:
        return {row["capture"]: row for row in csv.DictReader(file)}


def same(one: Path, other: Path) -> None:
    with np.load(one) as a, np.load(other) as b:
        for name in ("u", "v", "sigma_u", "sigma_v", "flags"):
            np.testing.assert_array_equal(a[name], b[name])


@pytest.fixture(scope="module")
def decoded(captures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("one") / "c"
    assert run(["decode", *names(captures), "--out", str(out)]) == 0
    return out


def test_heights_of_many_captures_one_of_which_fails(
    decoded: Path, captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c1.npz").write_bytes(b"no archive")
    files = [str(decoded / "c0.npz"), str(tmp_path / "c1.npz"), str(decoded / "c2.npz")]
    args = ["reconstruct", *files, "--scene", str(captures / "c0" / "scene.toml")]
    assert run([*args, "--out", str(tmp_path / "h"), "--jobs", "2"]) == 2
    found = {name.rpartition("-")[2]: row for name, row in table(tmp_path / "h").items()}
    assert [row["code"] for row in found.values()] == ["0", "2", "0"]
    assert "c1.npz" in found["c1"]["error"]
    for k in (0, 2):
        assert float(found[f"c{k}"]["z_max_mm"]) == pytest.approx(0.01 * (k + 1), rel=0.1)
    assert "2 of 3 captures done" in capsys.readouterr().out


def test_two_processes_give_the_same_bits_as_one(decoded: Path, captures: Path, tmp_path: Path) -> None:
    assert run(["decode", *names(captures), "--out", str(tmp_path / "c"), "--jobs", "2"]) == 0
    for k in range(COUNT):
        same(decoded / f"c{k}.npz", tmp_path / "c" / f"c{k}.npz")


def test_captures_that_were_taken_are_measured(captures: Path, tmp_path: Path) -> None:
    args = ["camera", "measure", *names(captures)[:2], "--rig", str(captures / "c0" / "scene.toml")]
    assert run([*args, "--out", str(tmp_path / "m")]) == 0
    assert set(table(tmp_path / "m")) == {"c0", "c1"}
    assert (tmp_path / "m" / "c1" / "report.html").is_file()


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(decoded: Path, captures: Path, tmp_path: Path) -> None:
    dask: Any = pytest.importorskip("distributed", reason="distributed is not installed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "env": ONE_THREAD}
    with safe_path(), dask.LocalCluster(**options) as cluster:
        worker = next(iter(cluster.workers.values())).pid
        threading.Timer(4, os.kill, (worker, signal.SIGKILL)).start()
        args = ["decode", *names(captures), "--scheduler", cluster.scheduler_address]
        assert run([*args, "--out", str(tmp_path / "c")]) == 0
    for k in range(COUNT):
        same(decoded / f"c{k}.npz", tmp_path / "c" / f"c{k}.npz")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--json", "n.json"], "--json: is of one capture"),
        (["--scheduler", "tcp://127.0.0.1:9"], "no answer"),
    ],
)
def test_mistakes(
    more: list[str], words: str, captures: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    refused(["decode", *names(captures), "--out", tmp_path / "c", *more], words)
