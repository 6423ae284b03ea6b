"""The context, and life without one."""

import os
import subprocess
import sys
import threading

import pytest

from optolever import InputError
from optolever.patterns import sequence
from optolever.projector import NoContextError, capture, chosen_renderer, context_info
from optolever.projector import context as module
from optolever.scene import dent, load, resize


def in_new_thread(work: object) -> list[object]:
    """Result or exception of work() in a thread that has no context yet."""
    found: list[object] = []

    def run() -> None:
        try:
            found.append(work())  # type: ignore[operator]
        except Exception as error:
            found.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return found


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """No library to load: what a machine without Mesa does."""
    monkeypatch.setattr(
        module, "_ATTEMPTS", ({"backend": "egl", "libgl": "libGL.so.1", "libegl": "libno-such-EGL.so"},)
    )


def test_without_gl_the_notice_is_one_line_and_names_the_packages(no_gl: None) -> None:
    (error,) = in_new_thread(context_info)
    assert isinstance(error, NoContextError)
    assert "\n" not in str(error)
    for word in ("apt-get install", "libegl1", "libgl1-mesa-dri"):
        assert word in str(error)


def test_without_gl_auto_takes_numpy_and_gl_is_refused(no_gl: None) -> None:
    scene = resize(load("paper-simulation"), 16, 16)
    shown = sequence("ramp", scene.pattern.rows, scene.pattern.cols)
    flat = dent("flat", scene)
    assert in_new_thread(lambda: chosen_renderer("auto")) == ["numpy"]
    (automatic,) = in_new_thread(lambda: capture(scene, flat, shown).frames.tolist())
    assert automatic == capture(scene, flat, shown, renderer="numpy").frames.tolist()
    (error,) = in_new_thread(lambda: capture(scene, flat, shown, renderer="gl"))
    assert isinstance(error, InputError)
    assert "apt-get install" in str(error)


def test_unknown_renderer_is_refused() -> None:
    with pytest.raises(InputError, match=r"'vulkan'.*auto, gl, numpy"):
        chosen_renderer("vulkan")


FORK = """
import multiprocessing
from optolever.patterns import sequence
from optolever.projector import capture, chosen_renderer
from optolever.scene import dent, load, resize
scene = resize(load("paper-simulation"), 16, 16)
shown = sequence("ramp", scene.pattern.rows, scene.pattern.cols)
drawn = capture(scene, dent("flat", scene), shown, renderer="gl").frames

def child():
    again = capture(scene, dent("flat", scene), shown).frames.astype(int)
    assert chosen_renderer("auto") == "numpy" and abs(again - drawn).max() <= 1

process = multiprocessing.get_context("fork").Process(target=child)
process.start()
process.join()
assert process.exitcode == 0
"""


@pytest.mark.usefixtures("gl")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_draws_with_numpy_and_does_not_wait_for_ever() -> None:
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORK], check=True, timeout=120)
