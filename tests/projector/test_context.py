"""The context, and life without one."""

import os
import subprocess
import sys
import threading

import moderngl
import pytest

from optolever import InputError
from optolever.patterns import sequence
from optolever.projector import (
    ContextInfo,
    NoContextError,
    capture,
    chosen_renderer,
    context_info,
    release_context,
)
from optolever.projector import context as module
from optolever.scene import dent, load, resize


def in_new_thread(work: object) -> list[object]:
    """Run work() in a thread that has no context yet; its result or its exception."""
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


def test_info_describes_the_context(gl_info: ContextInfo) -> None:
    assert gl_info.renderer in str(gl_info)
    assert gl_info.max_attachments >= 8
    assert gl_info.max_texture >= 1637


def test_each_thread_has_its_own_context_and_can_release_it(gl: moderngl.Context) -> None:
    def work() -> bool:
        other = module.context()
        release_context()
        return other is not gl and module._local.context is None

    assert in_new_thread(work) == [True]
    assert module.context() is gl


def test_without_gl_the_notice_is_one_line_and_names_the_packages(no_gl: None) -> None:
    (error,) = in_new_thread(context_info)
    assert isinstance(error, NoContextError)
    assert "\n" not in str(error)
    for word in ("apt-get install", "libegl1", "libgl1-mesa-dri"):
        assert word in str(error)
    # where the machine itself has no libGL, that is what is missed first
    assert "libno-such-EGL.so" in str(error) or "libGL" in str(error)


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
import multiprocessing, os
from optolever import InputError
from optolever.patterns import sequence
from optolever.projector import capture, chosen_renderer, release_context
from optolever.scene import dent, load, resize
scene = resize(load("paper-simulation"), 16, 16)
shown = sequence("ramp", scene.pattern.rows, scene.pattern.cols)
flat = dent("flat", scene)
drawn = capture(scene, flat, shown, renderer="gl").frames

def child(queue):
    try:
        capture(scene, flat, shown, renderer="gl")
    except InputError as error:
        queue.put(str(error))
    again = capture(scene, flat, shown).frames.astype(int)
    queue.put((chosen_renderer("auto"), int(abs(again - drawn).max())))
    release_context()

def fork():
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    process = context.Process(target=child, args=(queue,))
    process.start()
    print(queue.get(timeout=60), queue.get(timeout=60), sep="|")
    process.join()
    assert process.exitcode == 0

fork()
assert (capture(scene, flat, shown, renderer="gl").frames == drawn).all()
"""


@pytest.mark.usefixtures("gl")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_draws_with_numpy_and_does_not_wait_for_ever() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK], check=True, capture_output=True, text=True, timeout=120
    )
    refused, found = done.stdout.strip().split("|")
    assert "spawn" in refused
    assert found in ("('numpy', 0)", "('numpy', 1)")
