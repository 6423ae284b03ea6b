"""Commands for cameras and displays of a rig, on stand-ins and recordings: no hardware, no window."""

import json
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import load_colours
from optolever.camera import Recorder, choose_exposure
from optolever.camera.cameras import StillCamera
from optolever.decode import Correspondence, Decoder, Response, estimate_profile
from optolever.live import Prepared, prepare
from optolever.patterns import sequence
from optolever.projector import NOMINAL_SENSOR, Capture, ColourCapture, Image, capture
from optolever.reconstruct import HeightMap
from optolever.scene import adjusted, dent_from_text, load, resize, trace

from .conftest import Outcome, Program, Refused
from .test_outputs import full_disk


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig whose camera is the virtual sensor, with a section that nobody knows but [devices] and [sync]."""
    scene = resize(load("prism48"), 48, 64)
    path = tmp_path / "rig.toml"
    replace(scene, dent="gaussian:peak=0.3,sigma=8").save(path)
    path.write_text(path.read_text() + '\n[devices]\ncamera = "virtual"\n\n[rest]\nnote = "kept"\n')
    return path


@pytest.mark.parametrize("mosaic", [pytest.param(None, marks=pytest.mark.slow), "GRBG"])
def test_a_rig_measures_in_colour(
    mosaic: str | None, optolever: Program, refused: Refused, rig: Path, tmp_path: Path
) -> None:
    """The ramp, the response of the colours, then a third of the pictures; a recording gives them again."""
    scene = load(rig)
    replace(scene, sensor=replace(NOMINAL_SENSOR, mosaic=mosaic)).save(rig)
    measure = ("camera", "measure", "--rig", rig, "--colour", "none")
    refused([*measure, "--out", tmp_path / "m"], "--colour none needs [colour]", "response --colour")
    only = (*measure, "--frames-only", "--sequence")
    optolever(*only, "ramp", "--out", tmp_path / "ramp", "--keep")
    assert ColourCapture.load(tmp_path / "ramp").mosaic == (mosaic or "RGB")
    optolever("camera", "replay", tmp_path / "ramp.recording", "--out", tmp_path / "again")
    ramps = [ColourCapture.load(tmp_path / name).images for name in ("ramp", "again")]
    np.testing.assert_array_equal(*ramps)
    optolever("response", tmp_path / "ramp", "--colour", "--scene", rig)
    optolever(*measure, "--no-rest", "--out", tmp_path / "m")
    found = Correspondence.load(tmp_path / "m/c.npz")
    truth = trace(scene, dent_from_text(scene.dent or "flat", scene))
    error = (found.u - truth.u)[4:-4, 4:-4][found.good[4:-4, 4:-4]]
    assert np.sqrt(np.median(error**2) / 0.4549) < 0.05
    known, taken = load_colours(rig), ColourCapture.load(tmp_path / "m/capture")
    assert known is not None
    with pytest.raises(InputError, match=f"pictures are {mosaic or 'RGB'}, the response is of"):
        taken.unmixed(replace(known, mosaic=None if mosaic else "RGGB"))
    folder = f"camera=folder:{tmp_path / 'grey'}"
    optolever("camera", "measure", "--rig", rig, "--frames-only", "--out", tmp_path / "grey")
    refused([*only, "ramp", "--set", folder, "--out", tmp_path / "p"], "takes grey pictures; raw, or grey")


def sensor_frames(rig: Path, **words: Any) -> np.ndarray:
    scene = load(rig)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    assert scene.dent is not None
    return capture(scene, dent_from_text(scene.dent, scene), shown, **words).frames


def test_a_rig_captures_what_its_camera_sees(optolever: Program, rig: Path, tmp_path: Path) -> None:
    take = ("camera", "measure", "--frames-only", "--rig", rig)
    optolever(*take, "--out", tmp_path / "c", "--json", tmp_path / "n.json")
    done = Capture.load(tmp_path / "c")
    np.testing.assert_array_equal(done.frames, sensor_frames(rig))
    lines = [json.loads(line) for line in (tmp_path / "c" / "acquisition.jsonl").read_text().splitlines()]
    assert [line["index"] for line in lines] == list(range(len(done)))
    assert all(line["stamp_s"] >= line["swapped_s"] for line in lines)
    assert json.loads((tmp_path / "n.json").read_text())["repeats"] == 0
    assert not (tmp_path / "c.recording").exists()
    optolever(*take, "--set", f"camera=folder:{tmp_path / 'c'}", "--out", tmp_path / "d", "--keep")
    np.testing.assert_array_equal(Capture.load(tmp_path / "d").frames, done.frames)
    replayed = ("--set", f"camera=replay:{tmp_path / 'd.recording'}")
    optolever(*take, *replayed, "--out", tmp_path / "f")
    np.testing.assert_array_equal(Capture.load(tmp_path / "f").frames, done.frames)


@pytest.mark.slow
def test_measure_goes_to_the_report(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure, numbers = ("camera", "measure", "--rig", rig, "--no-rest", "--out"), tmp_path / "m.json"
    assert "report.html" in "".join(optolever(*measure, tmp_path / "m", "--json", numbers).out.split())
    files = {"c.npz", "h.npz", "report.html", "capture", "figures.csv", "slopes.npz"}
    assert files == {one.name for one in (tmp_path / "m").iterdir()}
    assert not HeightMap.load(tmp_path / "m/h.npz").against_rest
    assert "simulated, rig " in (tmp_path / "m/report.html").read_text()
    found = json.loads(numbers.read_text())
    assert found["good_share"] > 0.5
    monkeypatch.setattr("optolever.cli.measure.measured_lag", lambda *_: 1 / 512)  # of a slow display
    optolever(*measure, tmp_path / "slow")
    capture = Capture.load(tmp_path / "slow/capture")
    known = estimate_profile(capture.frames, capture.sequence).with_lag(1 / 512)
    expected = Decoder(capture.sequence, known).decode(capture.frames)
    np.testing.assert_array_equal(Correspondence.load(tmp_path / "slow/c.npz").u, expected.u)


def test_measure_doubts_a_response_that_the_frames_contradict(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A linear display that is said to have a gamma of 2.2, as `decode --response` doubts it."""
    levels = np.arange(0.0, 256.0)
    wrong = Response(levels, 255 * (levels / 255) ** 2.2 + 1e-3 * levels)
    monkeypatch.setattr("optolever.cli.measure.response_of", lambda _: wrong)
    words = ("--rig", rig, "--no-rest", "--sequence", "phase:steps=3", "--out", tmp_path / "m")
    assert "fit better without the stated response" in optolever("camera", "measure", *words).err


def test_exposure_is_the_longest_that_does_not_saturate() -> None:
    light = np.geomspace(0.02, 1, 10_000).reshape(100, 100)

    def take(exposure: float) -> tuple[float, np.ndarray, np.ndarray]:
        white = np.clip(np.rint(16 + 20_000 * exposure * light), 0, 255).astype(np.uint8)
        return exposure, white, np.full(light.shape, 16, np.uint8)

    _, found = choose_exposure(take, 8, 0.01)
    assert found.saturated <= 1e-4
    assert 0.7 < found.bright < 1
    exposure, found = choose_exposure(take, 8, 0.0119, most=235 / 255)  # which saturates nothing
    assert exposure < 0.0119
    assert 0.7 < found.bright <= 235 / 255
    with pytest.raises(InputError, match=r"white reaches 254 of 255 levels at 11.90 ms, at most 235 may"):
        choose_exposure(lambda _: take(0.0119), 8, 0.0119, most=235 / 255)


class Queued(StillCamera):
    """50 exposures a second from its start on; the last eight wait until they are asked for."""

    def start(self) -> None:
        self._from, self._given = time.monotonic(), 0

    def next(self, timeout_s: float) -> Image:
        exposed = int(50 * (time.monotonic() - self._from))
        self._given = max(self._given + 1, exposed - 7)
        due = self._from + self._given / 50
        time.sleep(max(due - time.monotonic(), 0.0))
        return Image(self._images[self._index], self._given, due, due)


def test_no_reading_is_of_the_time_of_preparation(
    optolever: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready, rig = [], tmp_path / "rig.toml"
    resize(load("prism48"), 96, 128).save(rig)

    def noted(*args: Any, **words: Any) -> Prepared:
        prepared = prepare(*args, **words)
        ready.append(time.monotonic())
        return prepared

    monkeypatch.setattr("optolever.live.open_rig.prepare", noted)
    monkeypatch.setattr("optolever.camera.rig_devices.StillCamera", Queued)
    out = optolever(
        "live", "--rig", rig, "--set", "camera=virtual", "--headless", "--json-lines", "--frames", "9"
    ).out
    times = [json.loads(line)["time_s"] for line in out.splitlines()]
    assert len(times) == 9
    assert min(times) >= ready[0]


def test_record_and_replay(optolever: Program, refused: Refused, rig: Path, tmp_path: Path) -> None:
    shown = sequence("gray", 8, 8)
    Capture(np.repeat(shown.render()[:1], len(shown), axis=0), shown).save(tmp_path / "still")
    camera = ("--set", f"camera=folder:{tmp_path / 'still'}", "--set", "fps=50")
    words = ("camera", "record", "--rig", rig, *camera, "--seconds", "0.5", "--out", tmp_path / "r")
    optolever(*words, "--json", tmp_path / "n.json")
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert 3 < numbers["images"] <= 26
    assert (numbers["lost"], numbers["dropped"], numbers["incomplete"]) == (0, 0, 0)
    assert f"{numbers['images']}, incomplete 0" in optolever("camera", "replay", tmp_path / "r").out
    refused([*words], "no empty folder")
    refused(["camera", "replay", tmp_path / "r", "--out", tmp_path / "c"], "has no sequence")


class Stopped(StillCamera):
    """Ctrl-C comes while the second image is waited for."""

    def next(self, timeout_s: float) -> Image:
        self._asked = getattr(self, "_asked", 0) + 1
        if self._asked > 1:
            raise KeyboardInterrupt
        return super().next(timeout_s)


def test_a_recording_that_is_cut_off_is_named(
    optolever: Program, refused: Refused, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By Ctrl-C, by a full disk after some images, and before the first one."""
    shown = sequence("gray", 8, 8)
    Capture(np.repeat(shown.render()[:1], len(shown), axis=0), shown).save(tmp_path / "still")
    still = ("--set", f"camera=folder:{tmp_path / 'still'}")
    record = ["camera", "record", "--rig", rig, *still, "--seconds", "0.5", "--out"]
    with full_disk(4096):
        err = optolever(*record, tmp_path / "full", code=2).err
    assert len(err.splitlines()) == 1
    assert f"images are in {tmp_path / 'full'}" in err
    optolever("camera", "replay", tmp_path / "full")
    with full_disk(0), pytest.raises(OSError, match="too large") as failed:
        Recorder(tmp_path / "none", {})
    assert failed.value.filename == str(tmp_path / "none")
    refused(["camera", "replay", tmp_path / "none"], tmp_path / "none", "stopped before its first image")
    monkeypatch.setattr("optolever.camera.cameras.stand_ins.StillCamera", Stopped)
    assert (
        f"interrupted; 1 images are in {tmp_path / 'r'}" in optolever(*record, tmp_path / "r", code=130).err
    )
    assert "images    1" in optolever("camera", "replay", tmp_path / "r").out
    monkeypatch.setattr("optolever.camera.rig_devices.StillCamera", Stopped)
    measure = ("camera", "measure", "--rig", rig, "--out", tmp_path / "c")
    assert f"{tmp_path / 'c.recording'} " in optolever(*measure, code=130).err


def test_expose_keeps_what_it_does_not_know(optolever: Program, rig: Path, tmp_path: Path) -> None:
    optolever("camera", "expose", "--rig", rig, "--mask", tmp_path / "m.png", "--json", tmp_path / "n.json")
    kept = tomllib.loads(rig.read_text())
    assert kept["rest"] == {"note": "kept"}
    assert kept["devices"]["camera"] == "virtual"
    mask = cv2.imread(str(tmp_path / "m.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert set(np.unique(mask)) <= {0, 255}


class Hands:
    """A user at the prompts, who puts something else on the virtual mirror before each answer."""

    def __init__(self, put: Callable[[str], None], *acts: tuple[str, str]) -> None:
        self._put, self._acts = put, list(acts)

    def isatty(self) -> bool:
        return False

    def readline(self) -> str:
        if not self._acts:
            return ""  # the pipe ends
        dent, answer = self._acts.pop(0)
        self._put(dent)
        return f"{answer}\n"


@pytest.mark.slow
def test_a_rig_is_calibrated_by_its_camera_step_by_step(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the prompts the file is the true rig, which the virtual camera sees; the typed one is off. A
    walk whose pipe ends goes on with its captures."""
    typed = resize(load("prism48"), 120, 160)
    true = adjusted(typed, {"pattern.z": 0.4, "camera.rx": np.radians(0.5)})

    def walk(*acts: tuple[str, str], code: int = 0, words: tuple[str, ...] = ()) -> Outcome:
        replace(typed, dent="flat").save(rig)
        hands = Hands(lambda dent: replace(true, dent=dent).save(rig), *acts)
        monkeypatch.setattr("sys.stdin", hands)
        return optolever("calibrate", "--rig", rig, *targets, *words, code=code)

    targets, ball = ("rest", "ball:200,0.02"), "ball:radius=200,peak=0.1"
    outcome = walk(("flat", ""), code=130)
    assert "1 of 2, rest: take everything off" in outcome.out
    assert "2 of 2, ball:200,0.02: press the ball" in outcome.out
    assert "--resume goes on" in outcome.err
    outcome = walk((ball, ""), words=("--resume", "--json", str(tmp_path / "n.json")))
    assert "1-rest: taken 20" in outcome.out
    values = {one["name"]: one for one in json.loads((tmp_path / "n.json").read_text())["parameters"]}
    for name, truth in (("pattern.z", 0.4), ("camera.rx", np.radians(0.5))):
        assert abs(values[name]["value"] - truth) < 3 * values[name]["sigma"]
        assert values[name]["sigma"] < 0.4 * values[name]["prior_sigma"]
    kept = tomllib.loads(rig.read_text())
    assert kept["devices"] == {"camera": "virtual"}
    assert kept["rest"] == {"note": "kept"}
    assert kept["calibration"]["date"] == date.today()
    assert load(rig).covariance is not None
