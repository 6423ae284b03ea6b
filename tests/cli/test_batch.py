"""Many captures by one command: results and their table, captures that fail, workers that are killed."""

import csv
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from optolever.blocks import ONE_THREAD
from optolever.cli.workers import _end_processes
from optolever.decode import Correspondence, Flag
from optolever.notices import Notice
from optolever.processes import SAFE_PATH, environment

from .conftest import Program, Refused

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
    """Files as of one process; one that compiles its kernels rounds otherwise, by 3.4e-5 of a sigma."""
    for capture in captures:
        name = f"{capture.name}.npz"
        with np.load(capture.parent / "one" / name) as a, np.load(out / name) as b:
            np.testing.assert_array_equal(a["flags"], b["flags"])
            for field in ("u", "v", "sigma_u", "sigma_v"):
                np.testing.assert_allclose(
                    a[field], b[field], rtol=1e-4 if "sigma" in field else 2e-7, atol=0
                )


def test_heights_of_many_captures_one_of_which_fails(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    (tmp_path / "c1.npz").write_bytes(b"no archive")
    decoded = captures[0].parent / "one"
    scene = tmp_path / "rig.toml"
    shutil.copy(captures[0] / "scene.toml", scene)
    seen = Correspondence.load(decoded / "c2.npz")
    flags = np.where(np.arange(seen.u.shape[0])[:, None] < 18, Flag.DARK, seen.flags)
    replace(seen, flags=flags, notices=(Notice("half; half", 1, 0, ""),)).save(tmp_path / "c2.npz")
    args = ["reconstruct", decoded / "c0.npz", tmp_path / "c1.npz", tmp_path / "c2.npz", "--jobs", "2"]
    args += ["--scene", scene, "--out", tmp_path / "h"]
    said = optolever(*args, code=2)
    assert "2 of 3 captures done" in said.out
    assert "c2: notice: half; half\n" in said.err
    assert re.search(r"c2: notice: 67 % of the pixels are good, \d+ % of most captures'\n", said.err)
    found = table(tmp_path / "h")
    assert {name: row["code"] for name, row in found.items()} == {"c0": "0", "c1": "2", "c2": "0"}
    assert "c1.npz" in found["c1"]["error"]
    for k in (0, 2):
        assert float(found[f"c{k}"]["z_max_mm"]) == pytest.approx(0.01 * (k + 1), rel=0.1)
        assert float(found[f"c{k}"]["depth_mm"]) == pytest.approx(0.01 * (k + 1), rel=0.1)
    times = [path.stat().st_mtime_ns for path in sorted((tmp_path / "h").glob("*.npz"))]
    (tmp_path / "c2.npz").touch()  # one capture: the others stay
    said = optolever(*args, code=2).out
    assert said.count("as before") == 1
    assert re.search(r"c0  depth \S+ ± \S+ µm, .* % good, as before\n", said)
    scene.touch()  # a rig that changed is another one
    assert "as before" not in optolever(*args, code=2).out
    assert all(
        new > old
        for new, old in zip(
            [path.stat().st_mtime_ns for path in sorted((tmp_path / "h").glob("*.npz"))], times, strict=True
        )
    )


def test_two_processes_give_the_same_as_one(captures: list[Path], tmp_path: Path, optolever: Program) -> None:
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
        optolever("decode", *captures, "--jobs", cluster.scheduler_address, "--out", tmp_path / "c")
        assert kill.finished.is_set(), "the batch was done before the worker was killed"
    same(captures, tmp_path / "c")


def test_a_second_run_does_what_is_missing_or_changed(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    """A capture that changed, and what depends on its profile; --again all; another option all."""
    own = [tmp_path / f"press_0.{k}" for k in range(COUNT)]  # the dots are no suffixes
    for capture, copy in zip(captures, own, strict=True):
        shutil.copytree(capture, copy)
    out = tmp_path / "o"

    def done(*more: str, code: int = 0) -> set[str]:
        before = {path.name: path.stat().st_mtime_ns for path in out.glob("press*.npz")}
        optolever("decode", *own[::-1], "--out", out, *more, code=code)
        now = {path.name: path.stat().st_mtime_ns for path in out.glob("press*.npz")}
        return {name for name in now | before if now.get(name) != before.get(name)}

    everything = {f"press_0.{k}.npz" for k in range(COUNT)}
    assert done() == everything
    assert done() == set()
    assert done("--again") == everything
    (own[1] / "frames" / "003.png").touch()
    assert done() == {"press_0.1.npz"}
    assert done("--channel", "red") == everything
    (own[1] / "frames" / "003.png").unlink()
    assert done(code=2) == everything  # the result of the damaged one is gone
    assert not (out / "press_0.1.npz").exists()
    assert [row["code"] for row in table(out).values()] == ["0", "2", "0"]


def test_the_profile_is_of_the_first_good_capture_of_its_kind(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    """Whatever the order of the arguments: a damaged first capture, another size of the pictures."""
    shutil.copytree(captures[0], tmp_path / "a0")
    (tmp_path / "a0" / "frames" / "003.png").unlink()
    args = ["simulate", "--scene", "prism48", "--dent", "gaussian:peak=0.02", "--pixels", "60x48"]
    optolever(*args, "--out", tmp_path / "b0")
    for k, capture in enumerate(captures):
        shutil.copytree(capture, tmp_path / f"c{k}")
    folders = [tmp_path / name for name in ("a0", "b0", "c0", "c1", "c2")]
    for out, order in ((tmp_path / "o", folders), (tmp_path / "p", folders[::-1])):
        optolever("decode", *order, "--out", out, code=2)
        same(captures, out)
        assert {path.name for path in out.glob(".*")} == {".b0.profile.npz", ".c0.profile.npz"}
        assert not table(out)["b0"]["notices"]


def test_notices_are_in_the_table_and_on_the_terminal(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    shutil.copytree(captures[1], tmp_path / "jpg")
    description = (tmp_path / "jpg" / "capture.toml").read_text("utf-8")
    (tmp_path / "jpg" / "capture.toml").write_text(description.replace(".png", ".jpg"), "utf-8")
    for path in (tmp_path / "jpg" / "frames").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path.with_suffix(".jpg")), image, [cv2.IMWRITE_JPEG_QUALITY, 90])
        path.unlink()
    shutil.copytree(tmp_path / "jpg", tmp_path / "more")
    taken = (captures[0], tmp_path / "jpg", tmp_path / "more")
    said = optolever("decode", *taken, "--out", tmp_path / "o").err
    assert re.search("2 captures: such as .*: notice: pictures compressed with loss", said)
    assert said.count("pictures compressed with loss") == 1
    (with_loss,) = (row for name, row in table(tmp_path / "o").items() if name == "jpg")
    assert "pictures compressed with loss" in with_loss["notices"]


def _writing(path: Path, begun: Any) -> None:
    """A worker in compiled code for a second, where no signal is answered, with a file half-written."""

    def end(*_: object) -> None:
        raise SystemExit(130)

    signal.signal(signal.SIGTERM, end)
    try:
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        path.touch()
        begun.set()
        time.sleep(1.0)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
    finally:
        path.unlink()


def test_a_worker_that_is_slow_to_end_leaves_no_half_file(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    begun = context.Event()
    worker = context.Process(target=_writing, args=(tmp_path / ".half.npz", begun))
    worker.start()
    assert begun.wait(60)
    _end_processes()
    worker.join(60)
    assert worker.exitcode == 130
    assert not list(tmp_path.iterdir())


def test_results_that_are_cut_or_changed_are_done_again(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    """Nothing of theirs is deleted; one that is as its row says makes room for a new one."""
    out, words = tmp_path / "o", ["decode", *captures, "--out", tmp_path / "o"]
    optolever(*words)
    (out / "c0.npz").write_bytes(b"")
    (out / "c1.npz").write_bytes((out / "c1.npz").read_bytes()[:900])
    (out / "c2.json").write_text("{}")
    assert "as before" not in optolever(*words).out
    same(captures, out)
    assert (out / "c0.npz.aside1").read_bytes() == b""
    assert (out / "c1.npz.aside1").stat().st_size == 900
    assert (out / "c2.json.aside1").read_text() == "{}"
    assert "as before" not in optolever(*words, "--again").out
    assert len(list(out.glob("*.aside*"))) == 3
    assert not [path for path in out.iterdir() if path.is_dir()]


def test_an_older_result_with_files_of_others_is_refused_before_the_first_capture(
    captures: list[Path], tmp_path: Path, optolever: Program, refused: Refused
) -> None:
    words = ["camera", "measure", *captures[:2], "--rig", captures[0] / "scene.toml", "--out", tmp_path / "m"]
    optolever(*words)
    (tmp_path / "m" / "c1" / "notes.txt").write_text("ours")
    refused([*words, "--again"], tmp_path / "m" / "c1", "not made by this command", folder=tmp_path / "m")
    (tmp_path / "m" / "c1" / "notes.txt").unlink()
    (tmp_path / "m" / "c1" / "h.npz").unlink()
    assert "as before" in optolever(*words).out
    assert (tmp_path / "m" / "c1" / "h.npz").is_file()
    assert (tmp_path / "m" / "c1.aside1" / "c.npz").is_file()


def test_an_empty_folder_is_filled_and_stays_itself(
    captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    (tmp_path / "m" / "c0").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "m" / "c1").symlink_to(tmp_path / "elsewhere")
    before = (tmp_path / "m" / "c0").stat().st_ino
    rig = captures[0] / "scene.toml"
    optolever("camera", "measure", *captures[:2], "--rig", rig, "--out", tmp_path / "m")
    assert (tmp_path / "m" / "c0").stat().st_ino == before
    assert (tmp_path / "elsewhere" / "report.html").is_file()
    assert (tmp_path / "m" / "c1").is_symlink()


def test_every_column_has_a_unit_or_is_explained(
    captures: list[Path], tmp_path: Path, optolever: Program, root: Path
) -> None:
    """In the file and in the line about a capture."""
    decoded = captures[0].parent / "one"
    words = ["reconstruct", decoded / "c1.npz", decoded / "c2.npz", "--scene", captures[0] / "scene.toml"]
    said = optolever(*words, "--out", tmp_path / "h").out
    assert re.search(r"^c2  depth [\d.]+ ± [\d.]+ µm, \d\d\.\d % good$", said, re.MULTILINE)
    explained = set(re.findall(r"`(\w+)`", (root / "docs/reference/files.md").read_text()))
    columns = table(tmp_path / "h")["c2"].keys()
    assert {"depth_mm", "force_n", "area_mm2", "good_share"} <= columns
    assert not [name for name in columns - explained if not re.search(r"_(mm2?|n|px|share)$|seconds", name)]


def members(session: int) -> list[str]:
    """Processes of a session, by their command lines."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, *rest = status.read_text().rpartition(")")[2].split()
            if int(rest[2]) == session and state != "Z":
                found.append((status.parent / "cmdline").read_text())
    return found


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_stays_and_what_is_done_is_known(
    sent: signal.Signals, captures: list[Path], tmp_path: Path, optolever: Program
) -> None:
    """However a batch ends; then only captures that were in work, or not begun, are done."""
    many = [tmp_path / f"c{k:03}" for k in range(40)]
    for copy in many:
        copy.symlink_to(captures[0])
    words = ["decode", *map(str, many), "--out", str(tmp_path / "o")]
    command = [sys.executable, "-c", "from optolever.cli import main; main()", *words, "--jobs", "2"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as batch:
        while len(list((tmp_path / "o").glob("c*.npz"))) < 4:
            assert batch.poll() is None
            time.sleep(0.02)
        batch.send_signal(sent)
    time.sleep(2.0)
    assert not members(batch.pid)
    done = {path.stem for path in (tmp_path / "o").glob("c*.npz")}
    assert done <= table(tmp_path / "o").keys()
    few = [path for path in many if path.name in done]
    again = optolever("decode", *few, "--out", tmp_path / "o").out
    assert again.count("as before") == len(few)


@pytest.mark.slow
@pytest.mark.parametrize("to_group", [False, True])
def test_ctrl_c_ends_at_once_with_the_table_of_what_is_done(
    to_group: bool, captures: list[Path], tmp_path: Path
) -> None:
    many = [tmp_path / f"c{k:03}" for k in range(200)]
    for copy in many:
        copy.symlink_to(captures[0])
    command = [
        sys.executable, "-c", "from optolever.cli import main; main()", "decode", *map(str, many),
        "--out", str(tmp_path / "o"),
    ]  # fmt: skip
    with subprocess.Popen([*command, "--jobs", "2"], stderr=subprocess.PIPE, start_new_session=True) as batch:
        while len(list((tmp_path / "o").glob("*.json"))) < 3:
            assert batch.poll() is None
            time.sleep(0.05)
        (os.killpg if to_group else os.kill)(batch.pid, signal.SIGINT)
        batch.communicate(timeout=120)
    assert batch.returncode == 130
    found = table(tmp_path / "o")
    assert 2 <= len(found) < len(many)
    assert all((tmp_path / "o" / f"{name}.npz").exists() for name in found)
