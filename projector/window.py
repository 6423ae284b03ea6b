"""A real window that shows a sequence: chosen monitor, full screen, vsync, one frame at a time."""

import importlib
import time
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Any, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.processes import safe_path

from .renderer import FramePainter

__all__ = ["Monitor", "PatternWindow", "monitors"]

_WAIT_S = 0.1  # between looks at whether the window was closed


@lru_cache(maxsize=1)
def _library() -> Any:
    """GLFW's binding, imported for who has a window: it starts a Python for every libglfw that it finds."""
    with safe_path():
        return importlib.import_module("glfw")


class _Glfw:
    """The module glfw, from its first use on."""

    def __getattr__(self, name: str) -> Any:
        return getattr(_library(), name)


glfw: Any = _Glfw()


@dataclass(frozen=True, slots=True)
class Monitor:
    """A connected display: its index for PatternWindow, name, resolution in pixels and refresh rate in Hz."""

    index: int
    name: str
    rows: int
    cols: int
    refresh_hz: int


def monitors() -> list[Monitor]:
    """The connected monitors, the primary one first; InputError in one line where there is no display."""
    _initialise()
    found = []
    for index, handle in enumerate(glfw.get_monitors()):
        mode = glfw.get_video_mode(handle)
        name: Any = glfw.get_monitor_name(handle)
        text = name.decode() if isinstance(name, bytes) else str(name)
        found.append(Monitor(index, text, mode.size.height, mode.size.width, mode.refresh_rate))
    return found


class PatternWindow:
    """Shows frames of `sequence`, row 0 on top, column 0 on the left, one pattern pixel per screen pixel.

    monitor: index into `monitors()` for full screen, None for a plain window of the pattern's size.
    vsync: `show` returns when the frame before it has left the screen, so that a camera can be paced by it.
    A context manager; use it in the main thread.
    """

    def __init__(self, sequence: Sequence, *, monitor: int | None = None, vsync: bool = True) -> None:
        self._sequence = sequence
        self._window = _open(sequence, monitor)
        self._index = -1
        self._steps = 0  # asked for by keys
        try:
            glfw.make_context_current(self._window)
            glfw.swap_interval(1 if vsync else 0)
            glfw.set_key_callback(self._window, self._on_key)
            self._ctx = moderngl.create_context(require=330)
            self._painter = FramePainter(self._ctx, sequence)
        except BaseException:
            glfw.destroy_window(self._window)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def index(self) -> int:
        """The frame on show; -1 before the first."""
        return self._index

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the window's framebuffer in screen pixels."""
        width, height = glfw.get_framebuffer_size(self._window)
        return height, width

    @property
    def closed(self) -> bool:
        """True once the user asked to close the window (its button, or the Escape key)."""
        return bool(glfw.window_should_close(self._window))

    def show(self, index: int) -> None:
        """Put frame `index` on the screen."""
        if not 0 <= index < len(self._sequence):
            raise IndexError(f"frame {index} of a sequence of {len(self._sequence)}")
        glfw.make_context_current(self._window)
        target = self._ctx.screen
        self._painter.draw(index, target, top=self.shape[0])
        glfw.swap_buffers(self._window)
        self._ctx.finish()
        glfw.poll_events()
        self._index = index

    def step(self, by: int = 1) -> int:
        """Show the frame `by` further on, the first after the last; returns its index."""
        self.show((self._index + by) % len(self._sequence))
        return self._index

    def run(self) -> None:
        """Show frames until the window is closed: right and left arrow step, Escape closes."""
        if self._index < 0:
            self.show(0)
        while not self.closed:
            if self._steps:
                steps, self._steps = self._steps, 0
                self.step(steps)
            glfw.wait_events_timeout(_WAIT_S)

    def play(self, seconds: float) -> list[float]:
        """Show every frame once for so long, from the first; ends early if the window is closed.

        Returns when each came on, in seconds after the first.
        """
        times: list[float] = []
        start = 0.0
        for index in range(len(self._sequence)):
            self.show(index)
            now = time.monotonic()
            start = now if index == 0 else start
            times.append(now - start)
            while not self.closed and (left := times[-1] + start + seconds - time.monotonic()) > 0:
                glfw.wait_events_timeout(min(left, _WAIT_S))
            if self.closed:
                break
        return times

    def read(self) -> NDArray[np.uint8]:
        """What the window shows, (rows, cols) uint8, row 0 on top: drawn once more and read back."""
        height, width = self.shape
        self._painter.draw(self._index, self._ctx.screen, top=height)
        raw = self._ctx.screen.read(viewport=(0, 0, width, height), components=3, alignment=1)
        pixels = np.frombuffer(raw, np.uint8).reshape(height, width, 3)
        return np.ascontiguousarray(pixels[::-1, :, 0])

    def _on_key(self, window: Any, key: int, scancode: int, action: int, mods: int) -> None:
        """Note what the key asks for; GLFW forbids to draw and poll from here."""
        if action == glfw.RELEASE:
            return
        if key == glfw.KEY_ESCAPE:
            glfw.set_window_should_close(window, True)
        elif key in (glfw.KEY_RIGHT, glfw.KEY_LEFT):
            self._steps += 1 if key == glfw.KEY_RIGHT else -1

    def close(self) -> None:
        """Free the GL objects and close the window."""
        self._painter.release()
        self._ctx.release()
        glfw.destroy_window(self._window)


def _initialise() -> None:
    _library().ERROR_REPORTING = "exception"
    try:
        if not glfw.init():
            raise InputError("display: GLFW cannot start (is DISPLAY set?)")
    except glfw.GLFWError as error:
        raise InputError(
            f"display: GLFW cannot start ({error}); set DISPLAY, or use the offscreen renderer"
        ) from error


def _open(sequence: Sequence, monitor: int | None) -> Any:
    _initialise()
    for hint, value in (
        (glfw.CONTEXT_VERSION_MAJOR, 3),
        (glfw.CONTEXT_VERSION_MINOR, 3),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE),
        (glfw.OPENGL_FORWARD_COMPAT, True),
        (glfw.RESIZABLE, False),
        (glfw.DECORATED, False),
        (glfw.AUTO_ICONIFY, False),
        (glfw.SCALE_TO_MONITOR, False),
        (glfw.SAMPLES, 0),
    ):
        glfw.window_hint(hint, value)
    try:
        if monitor is None:
            return glfw.create_window(sequence.cols, sequence.rows, "optolever", None, None)
        return _open_full_screen(sequence, monitor)
    except glfw.GLFWError as error:
        raise InputError(f"display: no OpenGL 3.3 window ({error})") from error


def _open_full_screen(sequence: Sequence, monitor: int) -> Any:
    handles = glfw.get_monitors()
    if not 0 <= monitor < len(handles):
        raise InputError(f"monitor: {monitor} does not exist, the limit is {len(handles) - 1}")
    mode = glfw.get_video_mode(handles[monitor])
    cols, rows = mode.size
    if sequence.rows > rows or sequence.cols > cols:
        raise InputError(
            f"monitor: {monitor} has {rows}x{cols} pixels, the sequence needs {sequence.rows}x{sequence.cols}"
        )
    glfw.window_hint(glfw.REFRESH_RATE, mode.refresh_rate)
    window = glfw.create_window(cols, rows, "optolever", handles[monitor], None)
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    return window
