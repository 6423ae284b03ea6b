"""Commands for cameras and displays of a rig, on stand-ins and recordings: no hardware, no window."""

import io
import json
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.hardware.simulated import Setting, SimulatedCamera, SimulatedDisplay, SimulatedTime
from optolever.decode import Correspondence, Decoder, decode, estimate_profile
from optolever.experiments import frames_of_another
from optolever.patterns import sequence
from optolever.projector import (
    Capture,
    ClockMap,
    Image,
    Recorder,
    Recording,
    Shown,
    Timing,
    VirtualSensor,
    Wanted,
    choose_exposure,
    synchronise,
)  # fmt: skip
from optolever.scene import Scene, adjusted, dent_from_text, load, resize

from .conftest import Outcome, Program, Refused


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig whose camera is the virtual sensor, with a section that nobody knows but [devices] and [sync]."""
    scene = resize(load("prism48"), 48, 64)
    path = tmp_path / "rig.toml"
    replace(scene, dent="gaussian:peak=0.3,sigma=8").save(path)
    path.write_text(path.read_text() + '\n[devices]\ncamera = "virtual"\n\n[rest]\nnote = "kept"\n')
    return path


def sensor_frames(rig: Path, **words: Any) -> np.ndarray:
    scene = load(rig)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    assert scene.dent is not None
    with VirtualSensor(scene, dent_from_text(scene.dent, scene), shown, **words) as sensor:
        return sensor.capture().frames


def test_a_rig_captures_what_its_camera_sees(optolever: Program, rig: Path, tmp_path: Path) -> None:
    optolever("capture", "--rig", rig, "--out", tmp_path / "c", "--json", tmp_path / "n.json")
    done = Capture.load(tmp_path / "c")
    np.testing.assert_array_equal(done.frames, sensor_frames(rig))
    lines = [json.loads(line) for line in (tmp_path / "c" / "acquisition.jsonl").read_text().splitlines()]
    assert [line["index"] for line in lines] == list(range(len(done)))
    assert all(line["stamp_s"] >= line["swapped_s"] for line in lines)
    assert json.loads((tmp_path / "n.json").read_text())["repeats"] == 0
    assert not (tmp_path / "c.recording").exists()
    optolever(
        "capture", "--rig", rig, "--set", f"camera=folder:{tmp_path / 'c'}", "--out", tmp_path / "d", "--keep"
    )
    np.testing.assert_array_equal(Capture.load(tmp_path / "d").frames, done.frames)
    optolever("camera", "replay", tmp_path / "d.recording", "--out", tmp_path / "e")
    np.testing.assert_array_equal(Capture.load(tmp_path / "e").frames, done.frames)
    replayed = ("--set", f"camera=replay:{tmp_path / 'd.recording'}")
    optolever("capture", "--rig", rig, *replayed, "--out", tmp_path / "f")
    np.testing.assert_array_equal(Capture.load(tmp_path / "f").frames, done.frames)


@pytest.mark.slow
def test_measure_goes_to_the_report(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = optolever(
        "camera", "measure", "--rig", rig, "--out", tmp_path / "m", "--json", tmp_path / "m.json"
    )
    files = {"c.npz", "h.npz", "report.html", "capture", "figures.csv", "slopes.npz"}
    assert files == {one.name for one in (tmp_path / "m").iterdir()}
    assert "simulated, rig " in (tmp_path / "m/report.html").read_text()
    numbers = json.loads((tmp_path / "m.json").read_text())
    assert numbers["wrong_frames"] == []
    assert numbers["good_share"] > 0.5
    assert "report.html" in "".join(outcome.out.split())
    monkeypatch.setattr("optolever.cli.measure.measured_lag", lambda *_: 1 / 512)  # of a slow display
    optolever("camera", "measure", "--rig", rig, "--out", tmp_path / "slow")
    capture = Capture.load(tmp_path / "slow/capture")
    plain, found = (Correspondence.load(tmp_path / name / "c.npz") for name in ("m", "slow"))
    known = estimate_profile(capture.frames, capture.sequence).with_lag(1 / 512)
    expected = Decoder(capture.sequence, known).decode(capture.frames)
    np.testing.assert_array_equal(found.u, expected.u)
    assert np.nanmax(np.abs(found.u - plain.u)) > 1e-4


def test_a_frame_of_the_pattern_before_is_found(rig: Path) -> None:
    scene = load(rig)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    frames = sensor_frames(rig, noise=1.0)
    seen = decode(frames, shown)
    assert frames_of_another(Capture(frames, shown), seen) == []
    late = frames.copy()
    late[7] = frames[6]
    assert frames_of_another(Capture(late, shown), seen) == [7]


def test_record_and_replay(optolever: Program, refused: Refused, rig: Path, tmp_path: Path) -> None:
    shown = sequence("gray", 8, 8)
    Capture(np.repeat(shown.render()[:1], len(shown), axis=0), shown).save(tmp_path / "still")
    camera = ("--set", f"camera=folder:{tmp_path / 'still'}", "--set", "fps=50")
    words = ("camera", "record", "--rig", rig, *camera, "--seconds", "0.5")
    optolever(*words, "--out", tmp_path / "r", "--json", tmp_path / "n.json")
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert 3 < numbers["images"] <= 26
    assert (numbers["lost"], numbers["dropped"], numbers["incomplete"]) == (0, 0, 0)
    assert len(Recording(tmp_path / "r")) == numbers["images"]
    export = ("--mcap", tmp_path / "r.mcap") if find_spec("mcap") else ()
    assert f"{numbers['images']}, incomplete 0" in optolever("camera", "replay", tmp_path / "r", *export).out
    assert not export or (tmp_path / "r.mcap").read_bytes()[1:5] == b"MCAP"
    refused([*words, "--out", tmp_path / "r"], "no empty folder")
    refused(["camera", "replay", tmp_path / "r", "--out", tmp_path / "c"], "has no sequence")
    refused(["camera", "replay", tmp_path / "nothing"], "no recording")


def test_expose_takes_the_longest_that_does_not_saturate(
    optolever: Program, rig: Path, tmp_path: Path
) -> None:
    """The command on the virtual sensor, whose light stays; the rule on a camera whose light follows."""
    optolever("camera", "expose", "--rig", rig, "--mask", tmp_path / "m.png", "--json", tmp_path / "n.json")
    kept = tomllib.loads(rig.read_text())
    assert kept["rest"] == {"note": "kept"}
    assert kept["devices"]["camera"] == "virtual"
    mask = cv2.imread(str(tmp_path / "m.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert set(np.unique(mask)) <= {0, 255}

    def camera(gain: float) -> Callable[[float], tuple[float, np.ndarray, np.ndarray]]:
        light = np.geomspace(0.02, 1, 10_000).reshape(100, 100)

        def take(exposure: float) -> tuple[float, np.ndarray, np.ndarray]:
            accepted = round(exposure, 4)  # as drivers do
            white = np.clip(np.rint(16 + gain * accepted * light), 0, 255).astype(np.uint8)
            return accepted, white, np.full(light.shape, 16, np.uint8)

        return take

    for gain in (500.0, 20_000.0, 400_000.0):
        found = choose_exposure(camera(gain), 8, 0.01)
        assert found.contrast.saturated <= 1e-4
        assert 0.7 < found.contrast.bright < 1
    stepped = choose_exposure(camera(2000.0), 8, 0.01, 1 / 60)
    assert stepped.exposure_s == pytest.approx(6 / 60, abs=1e-3)
    assert stepped.contrast.range > 10
    assert len(stepped.further_s) == 1


class Logging:
    """A simulated camera with its display that a Recorder listens to."""

    def __init__(self, camera: SimulatedCamera, display: SimulatedDisplay, recorder: Recorder) -> None:
        self._camera, self._display, self._recorder = camera, display, recorder
        self.identity, self.refresh_s, self.lost = camera.identity, display.refresh_s, 0

    def show(self, index: int) -> Shown:
        shown = self._display.show(index)
        self._recorder.shown(shown)
        return shown

    def next(self, timeout_s: float) -> Image | None:
        image = self._camera.next(timeout_s)
        if image is not None:
            self._recorder.image(image, image.arrived_s)
        return image

    configure = start = trigger = stop = close = lambda self, *_: None


@pytest.mark.slow
def test_sync_of_a_recording_is_the_same_every_time(optolever: Program, rig: Path, tmp_path: Path) -> None:
    setting, rng, time = Setting(), np.random.default_rng(0), SimulatedTime()
    display = SimulatedDisplay(setting, time, np.repeat([[0.0], [1.0]], 8, axis=1), rng)
    camera = SimulatedCamera(setting, time, display, rng, rows=32)
    with Recorder(tmp_path / "r", {"refresh_s": setting.refresh}) as recorder:
        accepted = camera.configure(Wanted(0.01))
        recorder.configured(accepted)
        camera.start()
        both = Logging(camera, display, recorder)
        live, _ = synchronise(both, both, accepted, time=time, clock=ClockMap(), seed=0)
    found = []
    for _ in range(2):
        page = tmp_path / "sync.html"
        optolever(
            "camera", "sync", "--rig", rig, "--set", f"camera=replay:{tmp_path / 'r'}", "--report", page
        )
        kept = tomllib.loads(rig.read_text())
        assert kept["rest"] == {"note": "kept"}
        found.append(kept["sync"])
    assert found[0] == found[1]
    html = page.read_text()
    assert html.count("data:image/png") == 3
    wait = Timing.from_table(found[0], "rig").ready_s()
    assert all(text in html for text in (f"{1e3 * wait:.1f} ms", "60 flips", "16.67 ms", "Flicker"))
    assert found[0]["latency_s"] == live.latency_s
    assert found[0]["rise_s"] == pytest.approx(setting.rise, abs=5e-4)
    assert load(rig).pattern.rows > 0  # the rig is still a scene


def test_faults_are_one_line(refused: Refused, rig: Path, tmp_path: Path) -> None:
    capture = ("capture", "--rig", rig, "--out", tmp_path / "c")
    for words, message in (
        (("--set", "camera=0"), "must be serial:"),
        (("--set", "camera=serial:nobody"), "is not connected"),
        (("--set", "camera=v4l2:/dev/nobody"), "no such path"),
        (("--set", f"camera=folder:{tmp_path / 'none'}"), "no such folder"),
        (("--set", f"camera=replay:{tmp_path / 'none'}"), "no recording"),
    ):
        refused([*capture, *words], message)
    refused(["capture", "--out", tmp_path / "c"], "--rig")
    text = rig.read_text()
    for wrong, message in (
        ("camera = 3\n", "camera is 3, must be a text"),
        ('camera = "virtual"\nbits = "8"\n', "bits is '8', must be a whole number"),
        ('camera = "virtual"\nspeed = 3\n', "unknown field 'speed'"),
        ('camera = "virtual"\ntrigger = "soon"\n', "trigger is 'soon'"),
    ):
        rig.write_text(text.replace('camera = "virtual"\n', wrong))
        refused(capture, message)
    rig.write_text(text.replace('camera = "virtual"\n', ""))
    refused(capture, "camera is missing; give --set camera")


def test_devices_lists_and_never_fails(optolever: Program, tmp_path: Path) -> None:
    outcome = optolever("camera", "devices", "--json", tmp_path / "d.json")
    assert "Cameras" in outcome.out
    assert "Monitors" in outcome.out
    assert set(json.loads((tmp_path / "d.json").read_text())) == {"cameras", "not_looked_for", "monitors"}


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


@pytest.mark.slow  # two calibrations of a prism, the first by rest alone
def test_a_rig_is_calibrated_by_its_camera_step_by_step(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the prompts the file is the true rig, which the virtual camera sees; the typed one is off. A
    walk whose pipe ends goes on with its captures; a ball that was forgotten is asked for again."""
    typed = resize(load("prism48"), 120, 160)
    true = adjusted(typed, {"pattern.z": 0.4, "camera.rx": np.radians(0.5)})

    def walk(*acts: tuple[str, str], code: int = 0, words: tuple[str, ...] = ()) -> Outcome:
        replace(typed, dent="flat").save(rig)
        hands = Hands(lambda dent: replace(true, dent=dent).save(rig), *acts)
        monkeypatch.setattr("sys.stdin", hands)
        return optolever("calibrate", "--rig", rig, *targets, *words, code=code)

    targets, ball = ("rest", "ball:200,0.02"), "ball:radius=200,peak=0.1"
    broken = tmp_path / "rig.captures/1-rest.recording"  # a capture that broke off
    broken.mkdir(parents=True)
    (broken / "log.jsonl").write_text("")
    outcome = walk(("flat", ""), code=130)
    assert "1 of 2, rest: take everything off" in outcome.out
    assert "2 of 2, ball:200,0.02: press the ball" in outcome.out
    assert "press a ball of known radius" in outcome.out  # judged at once
    assert "--resume goes on" in outcome.err
    outcome = walk(words=("--yes", "--resume"))
    assert "of 2" not in outcome.out
    assert "2-ball-200-0.02: set aside" in outcome.out
    assert "1-rest: taken 20" in outcome.out
    (tmp_path / "rig.captures/finished").unlink()  # as if that one had been stopped
    monkeypatch.setattr("optolever.calibration.judgement.MOST_CHI", 0.1)  # all are doubtful
    outcome = walk(
        ("flat", "k"), (ball, ""), (ball, "k"), words=("--resume", "--json", str(tmp_path / "n.json"))
    )
    assert outcome.out.count("is above 0.1") == 2
    values = {one["name"]: one for one in json.loads((tmp_path / "n.json").read_text())["parameters"]}
    for name, truth in (("pattern.z", 0.4), ("camera.rx", np.radians(0.5))):
        assert abs(values[name]["value"] - truth) < 3 * values[name]["sigma"]
        assert values[name]["sigma"] < 0.4 * values[name]["prior_sigma"]
    kept = tomllib.loads(rig.read_text())
    assert kept["devices"] == {"camera": "virtual"}
    assert kept["rest"] == {"note": "kept"}
    assert kept["calibration"]["date"] == date.today()
    assert load(rig).covariance is not None
    names = {one.name for one in (tmp_path / "rig.captures").iterdir()}
    of_walk = {"1-rest", "1-rest.recording.aside1", "2-ball-200-0.02", "2-ball-200-0.02.aside1"}
    assert names == {*of_walk, "finished"}


def test_captures_of_an_earlier_calibration_are_set_aside(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The display is knocked after a calibration: the next one sees it, whatever yesterday's captures say."""
    monkeypatch.setattr(sys.modules["optolever.calibration.calibrate"], "_STARTS", 1)
    typed, folder = resize(load("prism48"), 48, 64), tmp_path / "rig.captures"
    knocked = adjusted(typed, {"pattern.y": 0.3})

    def walk(true: Scene, *words: str, pipe: str = "\n", code: int = 0) -> Outcome:
        monkeypatch.setattr("sys.stdin", io.StringIO(pipe))
        replace(true, dent="flat").save(rig)
        return optolever("calibrate", "--rig", rig, "rest", *words, code=code)

    walk(typed)
    first = Capture.load(folder / "1-rest").frames
    outcome = walk(knocked)
    assert "(finished calibration) are set aside" in outcome.out
    (aside,) = (path for path in folder.iterdir() if path.name.startswith("20"))
    assert np.array_equal(Capture.load(aside / "1-rest").frames, first)
    assert not np.array_equal(Capture.load(folder / "1-rest").frames, first)
    walk(typed, "ball:200,0.02", code=130)  # the pipe ends
    second = Capture.load(folder / "1-rest").frames
    outcome = walk(knocked, "--resume", pipe="")
    assert "1-rest: taken 20" in outcome.out
    assert np.array_equal(Capture.load(folder / "1-rest").frames, second)
    (folder / "finished").unlink()
    assert "(unfinished calibration) are set aside" in walk(knocked, "--yes").out


@pytest.mark.slow  # three calibrations without a guess
def test_five_flats_are_asked_for_in_open_air(
    optolever: Program, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses of the mirror are those of camera and display, the other way round. One pose is given twice."""
    typed = resize(load("monitor-mirror"), 96, 120)
    focal = typed.camera.focal[0]
    true = adjusted(typed, {"camera.f": 1.02 * focal, "pattern.z": 4.0, "pattern.rx": np.radians(1.0)})
    middle = np.array([0.5 * typed.mirror.length, 0.5 * typed.mirror.width, 0.0])

    def put(pose: str) -> None:
        about_x, about_y, height = map(float, pose.split())
        turn = Rotation.from_rotvec([about_x, about_y, 0]).as_matrix()

        def moved(part: Any) -> Any:
            origin = turn @ (part.origin - middle) + middle + [0, 0, height]
            return replace(part, origin=origin, u_axis=turn @ part.u_axis, v_axis=turn @ part.v_axis)

        replace(true, camera=moved(true.camera), pattern=moved(true.pattern), dent="flat").save(rig)

    poses = ("0 0 0", "0 0 0", "0.07 0.02 2", "-0.05 0.06 -2", "0.03 -0.07 1", "-0.06 -0.04 0")
    typed.save(rig)
    monkeypatch.setattr("sys.stdin", Hands(put, *((pose, "") for pose in poses)))
    outcome = optolever("calibrate", "--rig", rig, "--json", tmp_path / "n.json")
    assert "2-flat: set aside: captures '1-flat' and '2-flat': the same pose twice" in outcome.out
    assert "1-flat: the mirror fills 100.0 % of the image" in outcome.out
    assert "5 of 5, flat: put the reference mirror in place" in outcome.out
    assert list(json.loads((tmp_path / "n.json").read_text())["judged"]) == [f"{k}-flat" for k in range(1, 6)]
    found, corners = load(rig), np.array([[0, 0], [typed.pattern.cols, 0], [0, typed.pattern.rows]]).T
    off = {
        name: np.abs(scene.pattern.point(*corners) - true.pattern.point(*corners)).max()
        for name, scene in (("typed", typed), ("found", found))
    }
    assert off["typed"] > 3  # mm
    assert off["found"] < 1.0  # the gauge holds x, y and the turn of the camera
    assert found.camera.focal[0] == pytest.approx(1.02 * focal, rel=2e-3)


def test_a_walk_takes_its_own_captures(refused: Refused, rig: Path) -> None:
    for words, message in (
        (("--rig", rig, "flat=p.npz"), "takes the captures itself"),
        (("--rig", rig), "targets of a prism are missing"),
        (("--rig", rig, "ball"), "must be ball:RADIUS,SIGMA"),
        (("--rig", rig, "--scene", "prism48", "rest"), "--scene: is of captures that exist"),
        (("--scene", "prism48", "--out", "r.toml", "--yes", "rest=r.npz"), "--yes: needs --rig"),
        (("--scene", "prism48", "--out", "r.toml", "--resume", "rest=r.npz"), "--resume: needs --rig"),
        (("rest=r.npz",), "Missing option '--scene'"),
    ):
        refused(["calibrate", *words], message)
