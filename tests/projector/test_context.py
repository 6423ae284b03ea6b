"""The context, and life without one."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from optolever import InputError
from optolever.patterns import sequence
from optolever.projector import NoContextError, capture, chosen_renderer, context_info
from optolever.projector import context as module
from optolever.scene import dent, load, resize


def in_new_thread(work: Callable[[], Any]) -> Any:
    """Exception or result of work() in a thread that has no context yet."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(work)
    return done.exception() or done.result()


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """No library to load: what a machine without Mesa does."""
    monkeypatch.setattr(
        module, "_ATTEMPTS", ({"backend": "egl", "libgl": "libGL.so.1", "libegl": "libno-such-EGL.so"},)
    )


def test_without_gl_the_notice_is_one_line_and_names_the_packages(no_gl: None) -> None:
    error = in_new_thread(context_info)
    assert isinstance(error, NoContextError)
    assert "\n" not in str(error)
    for word in ("apt-get install", "libegl1", "libgl1-mesa-dri"):
        assert word in str(error)


def test_without_gl_auto_takes_numpy_and_gl_is_refused(no_gl: None) -> None:
    scene = resize(load("paper-simulation"), 16, 16)
    shown = sequence("ramp", scene.pattern.rows, scene.pattern.cols)
    flat = dent("flat", scene)
    assert in_new_thread(lambda: chosen_renderer("auto")) == "numpy"
    automatic = in_new_thread(lambda: capture(scene, flat, shown).frames.tolist())
    assert automatic == capture(scene, flat, shown, renderer="numpy").frames.tolist()
    error = in_new_thread(lambda: capture(scene, flat, shown, renderer="gl"))
    assert isinstance(error, InputError)
    assert "apt-get install" in str(error)


def test_unknown_renderer_is_refused() -> None:
    with pytest.raises(InputError, match=r"'vulkan'.*auto, gl, numpy"):
        chosen_renderer("vulkan")
