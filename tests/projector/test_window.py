"""The real window, under Xvfb: what the window holds and what the X server's screen holds."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from ctypes.util import find_library
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.camera import Arrivals, ClockMap
from optolever.camera.cameras import StillCamera
from optolever.patterns import packed, sequence
from optolever.projector import Capture, ContextInfo, Identity, PatternWindow, RealTime, monitors

from .conftest import RUN, optolever, x_display
from .screen import ENTER, ESCAPE, LEFT, RIGHT, FrameBuffer, press

ROWS, COLS = 200, 320


@pytest.fixture(scope="module")
def x_server(tmp_path_factory: pytest.TempPathFactory, gl_info: ContextInfo) -> Iterator[tuple[str, Path]]:
    """(display, folder of its frame buffer file) of a server of our own; skips where nothing can draw."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    folder = tmp_path_factory.mktemp("xvfb")
    with x_display("Xvfb", "-screen", "0", f"{COLS}x{ROWS}x24", "-fbdir", str(folder)) as display:
        assert display, "Xvfb did not start"
        yield display, folder


def needs_keys() -> None:
    if find_library("Xtst") is None:
        pytest.skip("libXtst is absent: nobody presses keys")


@pytest.mark.parametrize("monitor", [None, 0], ids=["window", "full-screen"])
def test_window_shows_the_frames(
    x_server: tuple[str, Path], monkeypatch: pytest.MonkeyPatch, monitor: int | None
) -> None:
    """In full screen at the corner and black around, in a window somewhere."""
    monkeypatch.setenv("DISPLAY", x_server[0])
    shown, buffer = sequence("gray+phase", 48, 80), FrameBuffer(x_server[1], ROWS, COLS)
    with PatternWindow(shown, monitor=monitor) as window:
        for index, image in enumerate(shown.render()[:3]):
            window.show(index)
            screen = buffer.pixels.copy()
            assert screen.sum(dtype=int) == image.sum(dtype=int)
            top = left = 0
            if image.any() and monitor is None:
                top, left = np.argwhere(screen).min(axis=0) - np.argwhere(image).min(axis=0)
            np.testing.assert_array_equal(screen[top : top + 48, left : left + 80], image)


def test_window_shows_three_frames_at_once(
    x_server: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a sequence in colour: red, green and blue are its pictures, and none comes after the last."""
    monkeypatch.setenv("DISPLAY", x_server[0])
    shown, buffer = packed(sequence("gray+phase", 48, 80), "rgb"), FrameBuffer(x_server[1], 48, 80)
    with PatternWindow(shown, monitor=0) as window:
        for index, picture in enumerate(shown.pictures()):
            window.show(index)
            np.testing.assert_array_equal(buffer.colours[..., ::-1], picture)
        with pytest.raises(IndexError):
            window.show(shown.exposures)


def test_keys_step_and_close(x_server: tuple[str, Path], tmp_path: Path) -> None:
    """Of `show` that nobody hurries: right, right, left, Escape."""
    needs_keys()
    display, folder = x_server
    frames, buffer = sequence("gray+phase", 48, 80).render(), FrameBuffer(folder, 48, 80)
    words = [*RUN, "show", "--sequence", "gray+phase", "--pixels", "80x48", "--monitor", "0"]
    env, quiet = {**os.environ, "DISPLAY": display}, subprocess.DEVNULL
    with subprocess.Popen(words, env=env, cwd=tmp_path, stdout=quiet, stderr=quiet) as process:
        for key, index in ((None, 0), (RIGHT, 1), (RIGHT, 2), (LEFT, 1)):
            if key is not None:
                press(display, key)
            end = time.monotonic() + 120
            while not np.array_equal(buffer.pixels, frames[index]):
                assert time.monotonic() < end, index
                time.sleep(0.02)
        press(display, ESCAPE)
        assert process.wait(120) == 0


def test_a_window_that_dies_is_one_line(x_server: tuple[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process is killed, as by a crash of a driver: the caller goes on, with an InputError."""
    monkeypatch.setenv("DISPLAY", x_server[0])
    with PatternWindow(sequence("gray", 48, 80)) as window:
        window.show(0)
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        (child,) = [one for one in children if "projector.window" in Path(f"/proc/{one}/cmdline").read_text()]
        os.kill(int(child), signal.SIGSEGV)
        with pytest.raises(InputError, match=r"^display: the window's process ended by SIGSEGV"):
            window.show(1)


def test_escape_ends_who_waits_for_images(
    x_server: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `live --rig` does: it ends in one line."""
    needs_keys()
    monkeypatch.setenv("DISPLAY", x_server[0])
    shown = sequence("gray", 48, 80)
    camera = StillCamera(Capture(shown.render(), shown), Identity("still", "still", "", "still"))
    with PatternWindow(shown, monitor=0) as window:
        window.show(0)
        arrivals = Arrivals(camera, RealTime(), ClockMap(), display=window)
        assert arrivals.next(1.0) is not None
        press(x_server[0], ESCAPE)
        with pytest.raises(InputError, match="its window was closed"):
            deque(arrivals.until(time.monotonic() + 60), maxlen=0)


def test_pictures_over_a_frame_and_the_keys_pressed_meanwhile(
    x_server: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Escape no longer closes; a frame shown again leaves no trace of the picture."""
    needs_keys()
    display, folder = x_server
    monkeypatch.setenv("DISPLAY", display)
    shown, colour = sequence("gray", 48, 80), np.array([200, 40, 90], np.uint8)  # blue, green, red
    jpeg = cv2.imencode(".jpg", np.broadcast_to(colour, (16, 32, 3)).copy())[1].tobytes()
    with PatternWindow(shown, monitor=0) as window:
        buffer = FrameBuffer(folder, 48, 80)
        assert window.picture(jpeg) == []
        assert abs(buffer.colours[:16, :32].astype(int) - colour).max() < 8
        assert not buffer.colours[16:].any()
        for key in (ENTER, ESCAPE, ord("k")):
            press(display, key)
        keys = list[str]()
        end = time.monotonic() + 60
        while len(keys) < 3 and time.monotonic() < end:
            keys += window.picture(jpeg, (32, 40), 3)
        assert keys == ["enter", "escape", "k"]
        assert not window.closed
        frame = shown.render_frame(3)
        np.testing.assert_array_equal(buffer.pixels[:32], frame[:32])
        assert abs(buffer.colours[32:48, 40:72].astype(int) - colour).max() < 8
        window.show(3)
        np.testing.assert_array_equal(buffer.pixels, frame)


def test_show_puts_every_frame_on_the_screen(x_server: tuple[str, Path], tmp_path: Path) -> None:
    """The command: full screen, frame after frame, and the times at which they came on."""
    display, folder = x_server
    report = tmp_path / "shown.json"
    words = [*RUN, "show", "--sequence", "phase:steps=3,periods=8", "--pixels", "80x48", "--monitor", "0"]
    words += ["--seconds", "0.5", "--json", str(report)]
    expected = sequence("phase", 48, 80, steps=3, periods=8).render()
    seen, buffer = list[np.ndarray](), FrameBuffer(folder, 48, 80)
    env, pipe = {**os.environ, "DISPLAY": display}, subprocess.PIPE
    with subprocess.Popen(words, env=env, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        while process.poll() is None:
            image = buffer.pixels.copy()
            if image.any() and not (seen and np.array_equal(image, seen[-1])):
                seen.append(image)
            time.sleep(0.02)
        out, err = process.communicate()
    assert process.returncode == 0, err
    assert f"{len(expected)} of {len(expected)}" in out
    whole = [image for image in seen if any(np.array_equal(image, frame) for frame in expected)]
    np.testing.assert_array_equal(whole, expected)
    times = json.loads(report.read_text())["shown_s"]
    assert times[0] == 0
    assert np.all(np.diff(times) >= 0.5)


@pytest.mark.slow
def test_show_lists_monitors_and_refuses_others(x_server: tuple[str, Path]) -> None:
    display, _ = x_server
    assert f"{ROWS} x {COLS}" in optolever(display, "show", "--list").stdout
    for words, message in (
        (("--monitor", "3"), "does not exist, must be 0, the only one"),
        (("--monitor", "0", "--pixels", "4000x4000"), "the sequence needs 4000x4000"),
        (("--pixels", "4000x4000"), f"the largest monitor has {ROWS}x{COLS}"),
        (("--monitor", "nobody"), "is not connected, there is screen"),
    ):
        done = optolever(display, "show", *words)
        assert done.returncode == 2
        assert message in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_without_a_display_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    if sys.platform != "linux":
        pytest.skip("DISPLAY decides on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match=r"^display: GLFW cannot start"):
        monitors()
