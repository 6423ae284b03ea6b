"""The process that owns GLFW, its window and the monitors: JSON lines, commands on stdin, answers on stdout.

    {"do": "monitors"} | {"do": "open", "sequence": ..., "monitor": ...}
    {"do": "show", "index": ...} | {"do": "wait", "until": ...} | {"do": "run"}
    {"do": "picture", "jpeg": base64, "at": [row, col], "over": index or null}

It ends when stdin does, or when the window is closed between two commands. Run by `display`, as `python -m
optolever.projector.window`: GLX of a window and EGL of the virtual sensor end a process that has both.
"""

import base64
import ctypes
import importlib
import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import cv2
import moderngl
import numpy as np

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.processes import SAFE_PATH, environment

from .context import free
from .devices import Shown
from .monitors import Monitor, edid_of
from .renderer import PicturePainter

__all__ = ["Window", "connected_monitors", "main"]

_POLL_S = 0.05  # between answers to the window system
_OPENING_S = 3.0  # until a full-screen window has the monitor's size
_DITHER = 0x0BD0  # GL_DITHER

# X11's library: that for Wayland crashes in some compositors, and can choose neither monitor nor pixels.
os.environ["PYGLFW_LIBRARY_VARIANT"] = "x11"
with environment(SAFE_PATH):
    glfw: Any = importlib.import_module("glfw")


def connected_monitors() -> list[Monitor]:
    """The connected monitors, the primary one first; InputError in one line where there is no display."""
    _initialise()
    return [_described(index, handle) for index, handle in enumerate(glfw.get_monitors())]


def _described(index: int, handle: Any) -> Monitor:
    mode, called = glfw.get_video_mode(handle), glfw.get_monitor_name(handle)
    name = called.decode() if isinstance(called, bytes) else str(called)
    model, serial = edid_of(name)
    width_mm, height_mm = glfw.get_monitor_physical_size(handle)
    return Monitor(
        index=index,
        name=name,
        model=model,
        serial=serial,
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

    monitor: index into `monitors()` for full screen, None for a plain window of the pattern's size. `show`
    returns once the frame before is off the screen, so that it can pace a camera.
    Use it in the main thread of a process that ends with it: nothing closes it.
    gone: the monitor was unplugged or switched off; index: the frame on show, -1 before the first.
    """

    def __init__(self, sequence: Sequence, monitor: int | None = None) -> None:
        self._sequence = sequence
        self._window, self._handle = _open(sequence, monitor)
        chosen = self._handle or glfw.get_primary_monitor()
        rate = glfw.get_video_mode(chosen).refresh_rate if chosen else 0
        self.refresh_s = 1 / rate if rate > 0 else None
        self.gone, self.index = False, -1
        self._steps = 0  # asked for by keys
        self._keys: list[str] | None = None  # pressed; from the first picture on they do nothing else
        glfw.set_monitor_callback(self._on_monitor)
        try:
            glfw.make_context_current(self._window)
            glfw.swap_interval(1)
            glfw.set_key_callback(self._window, self._on_key)
            self._ctx = moderngl.create_context(require=330)
            self._ctx.disable_direct(_DITHER)
            self._painter = PicturePainter(self._ctx, sequence)
        except BaseException:
            glfw.destroy_window(self._window)
            raise

    @property
    def closed(self) -> bool:
        """True once the user asked to close the window (its button, or the Escape key)."""
        return bool(glfw.window_should_close(self._window))

    def show(self, index: int) -> Shown:
        """Put frame `index` on the screen; when that was. InputError once the monitor is gone."""
        asked = time.monotonic()
        glfw.make_context_current(self._window)
        self._painter.draw(index, self._ctx.screen, top=glfw.get_framebuffer_size(self._window)[1])
        glfw.swap_buffers(self._window)
        self._ctx.finish()
        swapped = time.monotonic()
        glfw.poll_events()
        if self.gone:
            raise InputError(f"display: the monitor went away before frame {index} was shown")
        self.index = index
        return Shown(index, swapped, self.refresh_s is not None and swapped - asked > 1.5 * self.refresh_s)

    def picture(self, jpeg: bytes, at: tuple[int, int], over: int | None) -> list[str]:
        """Draw a picture, its corner at (row, column), over a frame or black; the keys since the last."""
        glfw.make_context_current(self._window)
        part = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
        assert part is not None
        size = glfw.get_framebuffer_size(self._window)
        levels = np.zeros((*size[::-1], 3), np.uint8)
        if over is not None:
            frame = self._sequence.render_frame(over)
            levels[: frame.shape[0], : frame.shape[1]] = frame[..., None]
        row, col = at
        levels[row : row + part.shape[0], col : col + part.shape[1]] = part
        texture = self._ctx.texture(size, 3, levels[::-1].tobytes(), alignment=1)
        drawn = self._ctx.framebuffer([texture])
        self._ctx.copy_framebuffer(self._ctx.screen, drawn)
        glfw.swap_buffers(self._window)
        free(self._ctx, drawn, texture)
        glfw.poll_events()
        keys, self._keys = self._keys or [], []
        return keys

    def wait(self, until: float) -> None:
        """Leave the frame on until a time, the end of the window or of the monitor."""
        while not self.closed and not self.gone and (left := until - time.monotonic()) > 0:
            glfw.wait_events_timeout(min(left, _POLL_S))

    def run(self) -> None:
        """Show frames until the window is closed: right and left arrow step, Escape closes."""
        self._steps += self.index < 0
        while not self.closed and not self.gone:
            if self._steps:
                steps, self._steps = self._steps, 0
                self.show((self.index + steps) % self._sequence.exposures)
            glfw.wait_events_timeout(_POLL_S)

    def _on_monitor(self, handle: Any, event: int) -> None:
        """Note that the monitor of the window was disconnected."""
        pointers = [
            ctypes.cast(one, ctypes.c_void_p).value for one in (handle, self._handle) if one is not None
        ]
        self.gone |= event == glfw.DISCONNECTED and len(pointers) == 2 and pointers[0] == pointers[1]

    def _on_key(self, window: Any, key: int, scancode: int, action: int, mods: int) -> None:
        """Note the key's command; GLFW forbids to draw and poll from here."""
        if action == glfw.RELEASE:
            return
        if self._keys is not None:
            names = {glfw.KEY_ENTER: "enter", glfw.KEY_KP_ENTER: "enter", glfw.KEY_ESCAPE: "escape"}
            self._keys.append(names.get(key) or str(glfw.get_key_name(key, scancode)))
        elif key == glfw.KEY_ESCAPE:
            glfw.set_window_should_close(window, True)
        elif key in (glfw.KEY_RIGHT, glfw.KEY_LEFT):
            self._steps += 1 if key == glfw.KEY_RIGHT else -1


def _initialise() -> None:
    glfw.ERROR_REPORTING = "exception"
    try:
        if not glfw.init():
            raise InputError(
                "display: GLFW cannot start (is DISPLAY set?); optolever show --pictures writes them"
            )
    except glfw.GLFWError as error:
        raise InputError(
            f"display: GLFW cannot start ({error}); set DISPLAY on a machine with a screen; optolever "
            "show --pictures writes them for another program"
        ) from error


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
        glfw.wait_events_timeout(_POLL_S / 5)
    return window, handle


class _Server:
    """Answers commands; holds the window."""

    def __init__(self) -> None:
        self.window: Window | None = None

    def reply(self, line: str) -> dict[str, Any]:
        """The answer, or the error, and how the window is."""
        try:
            answer = self._answer(json.loads(line))
        except InputError as error:
            answer = {"error": str(error)}
        window = self.window
        state = (
            {} if window is None else {name: getattr(window, name) for name in ("index", "closed", "gone")}
        )
        return state | answer

    def _answer(self, command: Mapping[str, Any]) -> dict[str, Any]:
        if command["do"] == "monitors":
            return {"monitors": [asdict(one) for one in connected_monitors()]}
        if command["do"] == "open":
            self.window = Window(Sequence.from_dict(command["sequence"]), command["monitor"])
            return {"refresh_s": self.window.refresh_s}
        assert self.window is not None
        match command["do"]:
            case "show":
                return asdict(self.window.show(command["index"]))
            case "picture":
                jpeg = base64.b64decode(command["jpeg"])
                return {"keys": self.window.picture(jpeg, command["at"], command["over"])}
            case "wait":
                self.window.wait(command["until"])
            case "run":
                self.window.run()
        return {}


def main() -> None:
    """Serve until stdin ends. Nothing but answers is written to stdout, whatever a driver prints."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's, who ends this process
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    commands: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_read, args=(commands,), daemon=True).start()
    server = _Server()
    while True:
        try:
            line = commands.get(timeout=_POLL_S)
        except queue.Empty:
            if server.window is not None:
                glfw.poll_events()
                if server.window.closed or server.window.gone:  # while nobody asks
                    os._exit(0)
            continue
        answers.write(json.dumps(server.reply(line)) + "\n")
        answers.flush()


def _read(commands: "queue.Queue[str]") -> None:
    for line in sys.stdin:
        commands.put(line)
    os._exit(0)  # whatever the main thread does: nobody listens any more


if __name__ == "__main__":
    main()
