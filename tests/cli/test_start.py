"""`optolever start`: wrong answers, leaving and coming back, from an empty folder to a live height."""

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import click
import cv2
import numpy as np
import pytest

from optolever import InputError, live
from optolever.calibration import aim_fault, load_colours, rest_fault
from optolever.cli import run
from optolever.cli.rig.new import visible_share
from optolever.cli.rig.questions import KINDS, questions_of
from optolever.cli.rig.start_page import Interviewer, _Answer
from optolever.cli.rig.start_steps import Begun, require_devices, rest
from optolever.decode import Correspondence
from optolever.live import fringe_period, prepare
from optolever.patterns import sequence
from optolever.projector import NOMINAL_SENSOR, capture, exact_response
from optolever.scene import (
    Scene,
    TypedRig,
    adjusted,
    dent,
    load,
    parameter_values,
    rig_toml,
    trace,
    write_sections,
)

from ..projector.conftest import x_display
from ..projector.screen import ENTER, ESCAPE, FrameBuffer, press
from .chromium import Chromium, answered, asked

WORLD = Path(__file__).with_name("start_world.py")
#: Seconds until a program that does not go on counts as stuck: a busy machine is ten times slower.
STUCK_S = 600.0
#: True rigs, and the dent that is measured.
RIGS = {
    "monitor": TypedRig((150, 110), (240, 320), 1.0, (180, 240), 686.0, math.radians(30), 500, 400),
    "prism": TypedRig(
        (60, 45), (320, 240), 0.19, (180, 240), 600.0, math.radians(50), 120,
        display_angle=math.radians(48), bezel=0.0, index=1.41,
    ),
    "laptop": TypedRig((150, 110), (480, 640), 0.5, (180, 240), 686.0, math.radians(30), 500, 400),
}  # fmt: skip
DENTS = {"monitor": "gaussian:peak=0.1,sigma=15", "prism": "gaussian:peak=0.1,sigma=5"}
#: Typed answers, as good as a tape: of the display, of sizes and places, of the view.
SCREEN = {"monitor": ("320x240", "15.75"), "prism": ("240x320", "2.992")}
PLACES = {
    "monitor": ("150x110", "30.7", "500.4", "399.7"),
    "prism": ("60x45", "49.5", "119.6", "48", "0", "silicone", ""),
}
VIEW = {"monitor": ("500", "180"), "prism": ("120", "49.2")}
for table in (DENTS, PLACES, VIEW):
    table["laptop"] = table["monitor"]  # type: ignore[index]
SCREEN["laptop"] = ("15.75",)  # type: ignore[assignment]


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "true.toml").write_text(rig_toml("true", RIGS["monitor"]))
    return load(tmp_path / "true.toml")


def seen_by(true: Scene, **changes: Any) -> Correspondence:
    flat = trace(true, dent("flat", true))
    sigma = np.where(flat.visible, 0.05, np.inf)
    flags = np.where(flat.visible, 0, 1).astype(np.uint16)
    level = np.full(flat.u.shape, 100.0)
    return Correspondence(flat.u, flat.v, sigma, sigma, flags, level, level, **changes)


@pytest.mark.parametrize(("kind", "other"), [KINDS, KINDS[::-1]])
def test_questions_are_those_of_the_kind_of_rig(kind: str, other: str) -> None:
    assert not [one.text for one in questions_of(kind)[1:] if other in one.text.lower()]


def test_a_rig_as_typed_has_no_fault(scene: Scene) -> None:
    values = parameter_values(scene)
    assert rest_fault(seen_by(scene), scene) == ""
    for change in ({"camera.f": 1.1 * values["camera.f"]}, {"camera.ry": 0.03}, {"pattern.z": 20.0}):
        assert rest_fault(seen_by(adjusted(scene, change)), scene) == ""
    assert aim_fault(0.6, 0.65) == ""


def test_a_wrong_answer_is_named(scene: Scene) -> None:
    right, values = seen_by(scene), parameter_values(scene)

    def turned(times: int) -> Correspondence:
        return replace(right, **{k: np.rot90(getattr(right, k), times).copy() for k in ("u", "v", "flags")})

    assert "upside down" in rest_fault(turned(2), scene)
    flipped = {name: getattr(right, name)[:, ::-1].copy() for name in ("u", "v", "flags")}
    assert "mirrored" in rest_fault(replace(right, **flipped), scene)
    wide = rest_fault(right, adjusted(scene, {"camera.f": values["camera.f"] / 2}))
    assert re.search(r"sees 0\.\d+ times as much .* width of the view", wide)
    assert "mm from where" in rest_fault(right, adjusted(scene, {"camera.ry": 0.15}))
    assert "mirror's size" in aim_fault(0.9, 0.4)


def test_a_coarse_camera_gets_a_coarser_fringe(tmp_path: Path) -> None:
    """60 degrees, a display of fine pixels: ten of them are 1.5 of the camera's, which `prepare` refuses."""
    prism = replace(RIGS["prism"], display=(480, 270), pitch=0.254, image=(120, 160), focal=138.6, bezel=0.0)
    (tmp_path / "rig.toml").write_text(rig_toml("rig", prism))
    rig = load(tmp_path / "rig.toml")
    found, shown = seen_by(rig), sequence("crossed", rig.pattern.rows, rig.pattern.cols, period=10.0)
    frames = np.repeat(capture(rig, dent("flat", rig), shown).frames, 8, axis=0)
    with pytest.raises(InputError, match="a period of 10 pattern pixels is too fine for the camera"):
        prepare(rig, frames, found, shown, bits=8, cell=1)
    each = np.nanmedian(np.where(found.good[:, 1:] & found.good[:, :-1], np.diff(found.u, axis=1), np.nan))
    assert fringe_period(rig) / abs(each) == pytest.approx(8, rel=0.1)
    (tmp_path / "fine.toml").write_text(rig_toml("fine", RIGS["prism"]))
    assert fringe_period(load(tmp_path / "fine.toml")) == 10


def test_a_camera_that_is_late_is_named_after_a_refusal(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every picture shows the image before."""
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    right = capture(scene, dent("flat", scene), shown)
    late = replace(right, frames=right.frames[[0, *range(len(shown) - 1)]])
    monkeypatch.setattr("optolever.cli.rig.start_steps.capture_rest", lambda *_: (late, late.frames))
    named = "most likely picture 0 is one too many, or every picture shows the image before"
    with pytest.raises(InputError, match=named):
        rest(Begun(tmp_path / "true.toml"), Mock())


def test_it_goes_on_where_it_was_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every default is taken; the user leaves at the step of the view, then of the aim."""
    monkeypatch.setattr("optolever.camera.cameras.find_cameras", lambda: ([], {}))
    monkeypatch.chdir(tmp_path)
    answers, said = list[dict[str, str]](), list[str]()

    def taken(page: Interviewer, form: int, wait: bool = True) -> _Answer:
        said.extend(text for text, _ in page._now["lines"])
        if not answers:
            raise click.Abort
        return _Answer(form, number=page._now["form"].get("default"), key="", fields=answers.pop(0))

    monkeypatch.setattr(Interviewer, "_taken", taken)
    for count, step in ((5, "view"), (1, "aim")):
        answers += [{}] * count
        assert run(["start", "--text"]) == 130
        assert f'step = "{step}"' in (tmp_path / "rig.toml").read_text()
    assert re.search(
        r"Start: (http://(127\.0\.0\.1:(\d+)))/.*\n.*: ssh -L \3:\2 \S+", capsys.readouterr().out
    )
    assert any("By these numbers 62 % of the pixels see the display" in line for line in said)
    assert load("rig.toml").accuracy.focal == 0.05  # type: ignore[union-attr]
    for width, focal, accuracy in (("520", 640 * 500 / 520, 0.05), ("?", 320 * 3**0.5, 0.1)):
        answers.append({"view_distance": "500", "view_width": width})
        assert run(["start", "--from", "view"]) == 130
        rig = load("rig.toml")
        assert parameter_values(rig)["camera.f"] == pytest.approx(focal)
        assert rig.accuracy.focal == accuracy  # type: ignore[union-attr]
    assert any("60 degrees are assumed" in line for line in said)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [0, 1])
def test_the_defaults_of_a_simulated_camera_lead_to_a_contact(
    kind: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a rig whose reflection fills 60 % of the picture; a depth within 5 %, its error of 2 and 5.5 %."""
    monkeypatch.setattr("optolever.camera.cameras.find_cameras", lambda: ([], {}))
    monkeypatch.chdir(tmp_path)

    def taken(page: Interviewer, form: int, wait: bool = True) -> _Answer:
        number = kind if page._now["step"] == "kind" else page._now["form"].get("default")
        return _Answer(form, number=number, key="")

    monkeypatch.setattr(Interviewer, "_taken", taken)
    assert run(["start", "--text", "--frames", "1"]) == 0
    assert visible_share(load("rig.toml")) == pytest.approx(0.6, abs=0.03)
    with live.open("rig.toml") as readings:
        finger = readings.source
        assert isinstance(finger, live.VirtualFinger)
        *_, last = live.follow(live.Live(readings.prepared), finger, 16)
    touch, reading = last.reading.touches[0], last.reading
    true = finger.surface(15).height(reading.x, reading.y).max()
    assert abs(touch.depth - true) < 0.02 * true
    assert readings.prepared.error is not None
    assert 0.005 < readings.prepared.error < 0.06


def test_other_devices_than_before_lead_back_to_their_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "rig.toml"
    file.write_text('[start]\nimage = "640x480"\n[devices]\ncamera = "world:1"\ndisplay = "window"\n')
    for size, found in (
        ("640x480", ""),
        ("1280x720", "camera: it has 1280x720 pixels, before it had 640x480"),
    ):
        monkeypatch.setattr("optolever.cli.rig.start_steps.image_size", lambda _, size=size: size)
        assert require_devices(Begun.load(file)) == found
    monkeypatch.undo()
    assert require_devices(Begun.load(file)).startswith("camera: camera: 'world:1'")


class Visitor:
    """Answers the forms of the page whose address `start` prints, as a browser does. said: the lines above
    them."""

    def __init__(self, program: "subprocess.Popen[str]") -> None:
        assert program.stdout is not None
        found = re.search(r"http://\S+/", program.stdout.readline())
        assert found
        self.address, self.said, self._form = found[0], list[str](), 0

    def wait(self, ready: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """The state as soon as it is ready."""
        count, end = -1, time.monotonic() + STUCK_S
        while True:
            state = json.loads(asked(self.address, f"/state?after={count}")[1])
            if ready(state):
                return dict(state)
            count = state["count"]
            assert time.monotonic() < end, state

    def answer(self, step: str, before: Callable[[], None] | None = None, **answer: Any) -> None:
        """A form of that step that was not answered before; before: a change of the world as it is there."""
        now = self.wait(lambda one: one["form"] and one["form"]["id"] > self._form)
        assert now["step"] == step, now
        self.said += [text for text, _ in now["lines"]]
        self._form = now["form"]["id"]
        if before is not None:
            before()
        assert answered(self.address, json.dumps({"id": self._form, **answer}))[0] == 200


def test_colours_are_measured_where_the_camera_has_them(tmp_path: Path) -> None:
    """Of a display with stripes that nobody named; the walk goes on in grey."""
    (tmp_path / "rig.toml").write_text(rig_toml("rig", RIGS["prism"]))
    rig = load(tmp_path / "rig.toml")
    replace(rig, pattern=replace(rig.pattern, stripes="bgr")).save(tmp_path / "rig.toml")
    write_sections(tmp_path / "rig.toml", {"devices": {"camera": "virtual"}})
    command = [sys.executable, "-u", "-c", "from optolever.cli import main; main()", "start", "--text"]
    command += ["--from", "colour", "--rig", str(tmp_path / "rig.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            page = Visitor(program)
            page.answer("colour", key="c")
            page.wait(lambda now: now["form"] and now["step"] == "rest")
        finally:
            program.kill()
    found = load_colours(tmp_path / "rig.toml")
    assert found is not None
    assert found.stripes == "bgr"
    exact = exact_response(NOMINAL_SENSOR).mix
    assert np.abs(found.mix / found.mix.sum() - exact / exact.sum()).max() < 0.003


@pytest.fixture
def screen(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """An X server and the folder of its frame buffer."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    with x_display("Xvfb", "-screen", "0", "640x480x24", "-fbdir", str(tmp_path)) as display:
        yield display, tmp_path


def world(folder: Path, kind: str, gamma: float = 1.0) -> Path:
    (folder / "true.toml").write_text(rig_toml("true", RIGS[kind]))
    file = folder / "world.json"
    file.write_text(json.dumps({"rig": str(folder / "true.toml"), "gamma": gamma}))
    return file


def change(file: Path, **changes: Any) -> None:
    """Of the world, in one piece: the camera reads it all the time."""
    new = file.with_suffix(".new")
    new.write_text(json.dumps(json.loads(file.read_text()) | changes))
    new.replace(file)


@contextmanager
def started(display: str, folder: Path, *more: str) -> "Iterator[subprocess.Popen[str]]":
    """`start` before the world of a folder; whatever fails: it ends, and its stacks are printed."""
    command = [sys.executable, "-u", str(WORLD), str(folder / "world.json"), str(folder), "--", "start"]
    command += [*more, "--rig", str(folder / "rig.toml"), "--frames", "4", "--json", str(folder / "n.json")]
    env = {**os.environ, "DISPLAY": display}
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as program:
        timer = threading.Timer(STUCK_S, program.send_signal, (signal.SIGUSR1,))
        timer.start()
        try:
            yield program
        except BaseException:
            program.send_signal(signal.SIGUSR1)
            with suppress(subprocess.TimeoutExpired):
                program.wait(2.0)
            raise
        finally:
            timer.cancel()
            program.kill()


@pytest.mark.slow
def test_keys_on_the_display_itself_go_on_and_faults_are_said(screen: tuple[str, Path]) -> None:
    """One monitor, no browser: a camera that looks elsewhere, then a mirror that is larger than typed."""
    display, folder = screen
    file = world(folder, "laptop")
    rig = replace(RIGS["laptop"], mirror=(80, 60))
    devices = '[devices]\ncamera = "world:1"\ndisplay = "screen"\n'
    (folder / "rig.toml").write_text(f"{rig_toml('rig', rig)}\n{devices}")
    change(file, blind=True)
    with started(display, folder, "--from", "aim") as program:
        page = Visitor(program)
        for share, said, answer in (
            (0.0, "Is 'screen' the display in front of the mirror?", ""),
            (0.6, "Check the mirror's size", "k"),
        ):
            page.wait(
                lambda now, share=share: now.get("aim") and share <= now["aim"]["sees_share"] < share + 0.1
            )
            page.wait(lambda now: now["form"])
            press(display, ENTER)
            asking = page.wait(lambda now: now["form"] and now["form"]["kind"] == "go")
            assert said in asking["lines"][-1][0]
            change(file, blind=False)
            page.answer("aim", key=answer)
        page.wait(lambda now: now["step"] == "expose")


def require_height(folder: Path) -> None:
    found = json.loads((folder / "n.json").read_text())
    assert found["trusted"]
    assert abs(found["depth_mm"] - 0.1) < 3 * found["depth_total_sigma_mm"] < 3 * 0.01


@pytest.mark.slow
def test_wrong_answers_are_said_before_the_live_view(screen: tuple[str, Path]) -> None:
    """One walk that makes every mistake, hears of each, and ends with a height."""
    display, folder = screen
    kind = "monitor"
    file = world(folder, kind, gamma=1.8)
    names = "mirror", "angle", "distance", "display_distance"
    right = dict(zip(names, PLACES[kind], strict=True))
    view = dict(zip(("view_distance", "view_width"), VIEW[kind], strict=True))
    first = dict(zip(("display", "diagonal"), SCREEN[kind], strict=True))
    script: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
        ("kind", {"number": 0}, {}),
        ("camera", {"number": 0}, {}),
        ("display", {"number": 1}, {}),
        ("display", {"fields": first}, {}),
        ("mirror", {"fields": right | {"mirror": "80x60"}}, {}),
        ("view", {"fields": view}, {"blind": True}),
        ("aim", {}, {}),
        ("aim", {"key": ""}, {"blind": False}),
        ("aim", {}, {}),
        ("aim", {"go": "mirror"}, {}),
        ("mirror", {"fields": right}, {}),
        ("view", {"fields": view | {"view_width": "360"}}, {}),
        ("aim", {}, {}),
        ("aim", {"go": "view"}, {}),
        ("view", {"fields": view}, {}),
        ("aim", {}, {}),
        ("rest", {"go": "response"}, {"gamma": 1.0}),
        ("rest", {"key": ""}, {"turned": True}),
        ("rest", {"key": ""}, {"turned": False, "dent": DENTS[kind]}),
        ("rest", {"key": ""}, {}),
        ("rest", {"key": ""}, {"dent": "flat"}),
        ("rest", {"key": ""}, {}),
        ("targets", {"key": ""}, {"dent": DENTS[kind]}),
    ]
    with started(display, folder) as program:
        page = Visitor(program)
        for step, answer, changes in script:
            page.answer(step, before=lambda changes=changes: change(file, **changes), **answer)
        program.wait(timeout=STUCK_S)
    said = [
        "Is 'window' the display in front of the mirror?", "Check the mirror's size",
        "Check the mirror's size, the width of the view", "Gamma 1.8", "does not take it off",
        "Gamma 1.0", "upside down", "Something touches the mirror", "of a height",
    ]  # fmt: skip
    lines = iter(page.said)
    for text in said:
        assert any(text in line for line in lines), f"{text!r}: {page.said}"
    require_height(folder)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["prism", "laptop"])
def test_a_page_leads_from_an_empty_folder_to_a_live_height(kind: str, screen: tuple[str, Path]) -> None:
    display, folder = screen
    file, typed = world(folder, kind), 0
    with started(display, folder) as program, Chromium(folder / "profile") as page:
        address = Visitor(program).address
        page.look(390, dark=False)
        page.open(address)

        def wait(title: str) -> None:
            text = f"document.getElementById('title')?.textContent === {json.dumps(title)}"
            page.wait(f"{text} && document.querySelector('#form button')", STUCK_S)

        def click(number: int = 0) -> None:
            page.value(f"document.querySelectorAll('#form button')[{int(number)}].click()")

        def fill(*texts: str) -> int:
            for k, text in enumerate(texts):
                page.value(f"document.querySelectorAll('#form input')[{k}].value = {json.dumps(text)}")
            click()
            return len(texts)

        wait("What do you build?")
        click(kind == "prism")
        wait("Camera")
        click()
        wait("Display")
        click(kind != "laptop")
        page.wait("document.querySelector('input[name=diagonal]')")
        typed += fill(*SCREEN[kind])
        wait("Sizes and places")
        page.open(address)  # a page that is opened again goes on
        wait("Sizes and places")
        page.wait("!document.getElementById('drawing').hidden")
        typed += fill(*PLACES[kind][:6])
        if kind == "prism":
            page.wait("document.querySelector('input[name=across]')")
            click()
            typed += 1
        wait("The camera's view")
        typed += fill(*VIEW[kind])
        wait("Aim and focus")
        page.wait("document.getElementById('picture').naturalWidth")
        if kind == "laptop":  # whose display lies over the page
            press(display, ESCAPE)
            wait("The camera's view")
            assert fill(*VIEW[kind])
            wait("Aim and focus")
            page.wait("document.getElementById('advice').textContent === 'Good.'")
            cv2.imwrite(str(folder / "sheet.png"), FrameBuffer(folder, 480, 640).colours)
            press(display, ENTER)
        else:
            click()
        wait("The mirror at rest")
        click()
        wait("Calibration")
        change(file, dent=DENTS[kind])
        click()
        if kind != "laptop":  # there the display itself has the readings
            page.wait("document.title === 'optolever live'", STUCK_S)
        program.wait(timeout=STUCK_S)
        errors = [one for one in page.messages if "ERR_CONNECTION" not in one]  # the program has ended
    assert not errors
    assert typed <= (14 if kind == "prism" else 12)
    require_height(folder)
