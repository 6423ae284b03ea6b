"""GLFW in this process: the window and the monitors. Only `display_process` calls it (its GLX and the virtual
sensor's EGL end a process that has both).
"""

import ctypes
import importlib
import os
import time
from functools import lru_cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.processes import safe_path

from .devices import Shown
from .monitors import Monitor
from .renderer import FramePainter

__all__ = ["Window", "connected_monitors"]

_WAIT_S = 0.1  # between looks at whether the window was closed
_OPENING_S = 3.0  # until a full-screen window has the monitor's size
_DITHER = 0x0BD0  # GL_DITHER


@lru_cache(maxsize=1)
def _library() -> Any:
    """GLFW's binding, imported for who has a window: it starts a Python for every libglfw that it finds.

    X11's library: that for Wayland crashes in some compositors, and can choose neither monitor nor pixels.
    """
    os.environ["PYGLFW_LIBRARY_VARIANT"] = "x11"
    with safe_path():
        return importlib.import_module("glfw")


class _Glfw:
    """The module glfw, from its first use on."""

    def __getattr__(self, name: str) -> Any:
        return getattr(_library(), name)


glfw: Any = _Glfw()


def connected_monitors() -> list[Monitor]:
    """The connected monitors, the primary one first; InputError in one line where there is no display."""
    _initialise()
    return [_described(index, handle) for index, handle in enumerate(glfw.get_monitors())]


def _described(index: int, handle: Any) -> Monitor:
    mode, name = glfw.get_video_mode(handle), glfw.get_monitor_name(handle)
    width_mm, height_mm = glfw.get_monitor_physical_size(handle)
    return Monitor(
        index=index,
        name=name.decode() if isinstance(name, bytes) else str(name),
        rows=mode.size.height,
        cols=mode.size.width,
        refresh_hz=mode.refresh_rate,
        rows_mm=height_mm,
        cols_mm=width_mm,
        scale=round(float(max(glfw.get_monitor_content_scale(handle))), 3),
        bits=min(mode.bits.red, mode.bits.green, mode.bits.blue),
        bend=_bend(handle),
    )


def _bend(handle: Any) -> float:
    """Largest departure of the level ramp (0 to 1) from a straight line; 0 where there is none."""
    try:
        ramp = glfw.get_gamma_ramp(handle)
    except glfw.GLFWError:
        return 0.0
    channels = np.array([ramp.red, ramp.green, ramp.blue], np.float64)
    if channels.shape[1] < 2 or not channels.any() or (np.diff(channels) < 0).any():
        return 0.0  # a server without a ramp answers zeros, or whatever lies in memory
    return float(np.abs(channels - np.linspace(0, 1, channels.shape[1])).max())


class Window:
    """Shows frames of `sequence`, row 0 on top, column 0 on the left, one pattern pixel per screen pixel.

    monitor: index into `monitors()` for full screen, None for a plain window of the pattern's size.
    vsync: `show` returns once the previous frame is off the screen, so that it can pace a camera.
    Use it in the main thread of a process that ends with it: nothing closes it.
    """

    def __init__(self, sequence: Sequence, *, monitor: int | None = None, vsync: bool = True) -> None:
        self._sequence = sequence
        self._window, self._handle = _open(sequence, monitor)
        self._gone = False
        self._refresh_s = _refresh(self._handle)
        glfw.set_monitor_callback(self._on_monitor)
        self._index = -1
        self._steps = 0  # asked for by keys
        try:
            glfw.make_context_current(self._window)
            glfw.swap_interval(1 if vsync else 0)
            glfw.set_key_callback(self._window, self._on_key)
            self._ctx = moderngl.create_context(require=330)
            self._ctx.disable_direct(_DITHER)
            self._painter = FramePainter(self._ctx, sequence)
        except BaseException:
            glfw.destroy_window(self._window)
            raise

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

    @property
    def gone(self) -> bool:
        """True once the monitor was unplugged or switched off."""
        return self._gone

    @property
    def refresh_s(self) -> float | None:
        """Period of the monitor, None where the window system does not know it."""
        return self._refresh_s

    def show(self, index: int) -> Shown:
        """Put frame `index` on the screen; when that was. InputError once the monitor is gone."""
        asked = time.monotonic()
        if not 0 <= index < len(self._sequence):
            raise IndexError(f"frame {index} of a sequence of {len(self._sequence)}")
        glfw.make_context_current(self._window)
        target = self._ctx.screen
        self._painter.draw(index, target, top=self.shape[0])
        glfw.swap_buffers(self._window)
        self._ctx.finish()
        swapped = time.monotonic()
        self.poll()
        if self._gone:
            raise InputError(f"display: the monitor went away before frame {index} was shown")
        self._index = index
        return Shown(index, swapped, self._refresh_s is not None and swapped - asked > 1.5 * self._refresh_s)

    def poll(self) -> None:
        """Answer the window system."""
        glfw.poll_events()

    def step(self, by: int = 1) -> int:
        """Show the frame `by` further on, the first after the last; returns its index."""
        self.show((self._index + by) % len(self._sequence))
        return self._index

    def run(self) -> None:
        """Show frames until the window is closed: right and left arrow step, Escape closes."""
        if self._index < 0:
            self.show(0)
        while not self.closed and not self._gone:
            if self._steps:
                steps, self._steps = self._steps, 0
                self.step(steps)
            glfw.wait_events_timeout(_WAIT_S)

    def play(self, seconds: float) -> list[Shown]:
        """Show every frame once for so long, from the first; returns the frames that stayed on for all of it.

        Ends early if the window is closed or the monitor goes away.
        """
        shown: list[Shown] = []
        for index in range(len(self._sequence)):
            try:
                one = self.show(index)
            except InputError:
                break
            while not self.closed and not self._gone:
                left = one.swapped_s + seconds - time.monotonic()
                if left <= 0:
                    break
                glfw.wait_events_timeout(min(left, _WAIT_S))
            if self._gone:
                break
            shown.append(one)
            if self.closed:
                break
        return shown

    def read(self) -> NDArray[np.uint8]:
        """The window's content, (rows, cols) uint8, row 0 on top: drawn once more and read back."""
        height, width = self.shape
        self._painter.draw(self._index, self._ctx.screen, top=height)
        raw = self._ctx.screen.read(viewport=(0, 0, width, height), components=3, alignment=1)
        pixels = np.frombuffer(raw, np.uint8).reshape(height, width, 3)
        return np.ascontiguousarray(pixels[::-1, :, 0])

    def _on_monitor(self, handle: Any, event: int) -> None:
        """Note that the monitor of the window was disconnected."""
        if event == glfw.DISCONNECTED and self._handle is not None and _same(handle, self._handle):
            self._gone = True

    def _on_key(self, window: Any, key: int, scancode: int, action: int, mods: int) -> None:
        """Note the key's command; GLFW forbids to draw and poll from here."""
        if action == glfw.RELEASE:
            return
        if key == glfw.KEY_ESCAPE:
            glfw.set_window_should_close(window, True)
        elif key in (glfw.KEY_RIGHT, glfw.KEY_LEFT):
            self._steps += 1 if key == glfw.KEY_RIGHT else -1


def _initialise() -> None:
    _library().ERROR_REPORTING = "exception"
    try:
        if not glfw.init():
            raise InputError("display: GLFW cannot start (is DISPLAY set?)")
    except glfw.GLFWError as error:
        raise InputError(
            f"display: GLFW cannot start ({error}); set DISPLAY, or use the offscreen renderer"
        ) from error


def _same(one: Any, other: Any) -> bool:
    return bool(ctypes.cast(one, ctypes.c_void_p).value == ctypes.cast(other, ctypes.c_void_p).value)


def _refresh(handle: Any) -> float | None:
    """Period of a monitor, of the primary one for a plain window; None where it is unknown."""
    chosen = handle or glfw.get_primary_monitor()
    rate = glfw.get_video_mode(chosen).refresh_rate if chosen else 0
    return 1 / rate if rate > 0 else None


def _open(sequence: Sequence, monitor: int | None) -> tuple[Any, Any]:
    """The window and its monitor (None: a plain window). InputError if it does not fit."""
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
            _require_room(sequence)
            return glfw.create_window(sequence.cols, sequence.rows, "optolever", None, None), None
        return _open_full_screen(sequence, monitor)
    except glfw.GLFWError as error:
        raise InputError(f"display: no OpenGL 3.3 window ({error})") from error


def _require_room(sequence: Sequence) -> None:
    """InputError if a plain window fits on no monitor: the window system would cut it without a word."""
    sizes = [glfw.get_video_mode(handle).size for handle in glfw.get_monitors()]
    if sizes and not any(sequence.rows <= size.height and sequence.cols <= size.width for size in sizes):
        largest = max(sizes, key=lambda size: size.height * size.width)
        raise InputError(
            f"window: {sequence.rows}x{sequence.cols} pixels, the largest monitor has "
            f"{largest.height}x{largest.width}"
        )


def _open_full_screen(sequence: Sequence, monitor: int) -> tuple[Any, Any]:
    handles = glfw.get_monitors()
    if not 0 <= monitor < len(handles):
        raise InputError(f"monitor: {monitor} does not exist, must be 0 to {len(handles) - 1}")
    handle = handles[monitor]
    mode = glfw.get_video_mode(handle)
    cols, rows = mode.size
    if sequence.rows > rows or sequence.cols > cols:
        raise InputError(
            f"monitor: {monitor} has {rows}x{cols} pixels, the sequence needs {sequence.rows}x{sequence.cols}"
        )
    scale = max(glfw.get_monitor_content_scale(handle))
    if scale != 1 and "WAYLAND_DISPLAY" in os.environ:
        raise InputError(
            f"monitor: {monitor} is scaled by {scale:g} under Wayland, must be 1: set its scale to 1"
        )
    glfw.window_hint(glfw.REFRESH_RATE, mode.refresh_rate)
    window = glfw.create_window(cols, rows, "optolever", handle, None)
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    limit = time.monotonic() + _OPENING_S
    while tuple(glfw.get_framebuffer_size(window)) != (cols, rows):
        if time.monotonic() > limit:
            width, height = glfw.get_framebuffer_size(window)
            glfw.destroy_window(window)
            raise InputError(f"monitor: {monitor} has {rows}x{cols} pixels, the window got {height}x{width}")
        glfw.wait_events_timeout(_WAIT_S / 10)
    return window, handle
