"""A real window that displays a sequence, in a separate process: chosen monitor, full screen, vsync.

GLX of the window and EGL of the virtual sensor end a process that has both; a crash of GLFW or of a driver
takes this process only; the picture stays while Python decodes.
"""

import base64
import json
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from typing import Any, Self

from optolever.errors import InputError
from optolever.patterns import Sequence

from .devices import Shown
from .monitors import Monitor

__all__ = ["PatternWindow", "monitors"]

_CLOSING_S = 5.0
_COMMAND = (sys.executable, "-P", "-m", "optolever.projector.window")


class _Child:
    """The process, and one question after the other to it."""

    def __init__(self) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 # a pipe that nobody reads would stop it
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            _COMMAND, stdin=pipe, stdout=pipe, stderr=self._said, text=True, encoding="utf-8"
        )

    def ask(self, do: str, **words: Any) -> dict[str, Any]:
        """The answer. InputError says how it ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **words}) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise InputError(self._end())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def require(self) -> None:
        """InputError says how it ended."""
        if self._process.poll() is not None:
            raise InputError(self._end())

    def close(self) -> None:
        """End the process."""
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with suppress(BrokenPipeError):
                stream.close()
        self._wait()
        self._said.close()

    def _wait(self) -> int:
        try:
            return self._process.wait(_CLOSING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _end(self) -> str:
        """How it ended, and the last line that it or its libraries wrote."""
        code = self._wait()
        if code == 0:
            return "display: it is gone; its window was closed, or its monitor went away"
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip().splitlines()
        how = f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        last = f" ({said[-1].strip()})" if said else ""
        return f"display: the window's process {how}{last}; optolever doctor lists the displays"


def monitors() -> list[Monitor]:
    """The connected monitors, the primary one first; InputError in one line where there is no display."""
    child = _Child()
    try:
        answer = child.ask("monitors")
        if "error" in answer:
            raise InputError(answer["error"])
        return [Monitor(**plain) for plain in answer["monitors"]]
    finally:
        child.close()


class PatternWindow:
    """Shows frames of `sequence` (of one in colour its exposures), row 0 on top, column 0 on the left, one
    pattern pixel per screen pixel.

    monitor: index into `monitors()` for full screen, None for a plain window of the pattern's size. `show`
    returns once the frame before is off the screen, so that it can pace a camera. A context manager and a
    Display. As of the last call, index: the frame on show, -1 before the first; closed: the user asked for it
    (button or Escape); gone: the monitor went away. refresh_s: None where it is unknown.
    """

    def __init__(self, sequence: Sequence, *, monitor: int | None = None) -> None:
        self._count, self.index, self.closed, self.gone = sequence.exposures, -1, False, False
        self._child = _Child()
        try:
            opened = self._ask("open", sequence=sequence.to_dict(), monitor=monitor)
        except BaseException:
            self._child.close()
            raise
        self.refresh_s: float | None = opened["refresh_s"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, do: str, **words: Any) -> dict[str, Any]:
        answer = self._child.ask(do, **words)
        self.index, self.closed, self.gone = (
            answer.get(name, now)
            for name, now in (("index", self.index), ("closed", self.closed), ("gone", self.gone))
        )
        if "error" in answer:
            raise InputError(answer["error"])
        return answer

    def require_open(self) -> None:
        """InputError says how the window ended."""
        self._child.require()

    def show(self, index: int) -> Shown:
        """Put frame `index` on the screen. InputError once the monitor is gone."""
        if not 0 <= index < self._count:
            raise IndexError(f"frame {index} of a sequence of {self._count}")
        answer = self._ask("show", index=index)
        return Shown(index, answer["swapped_s"], answer["late"])

    def picture(self, jpeg: bytes, at: tuple[int, int] = (0, 0), over: int | None = None) -> list[str]:
        """Draw a JPEG, its corner at (row, column), over a frame or black. Returns the keys since the last
        ("enter", "escape", letters), which from now on neither step nor close."""
        answer = self._ask("picture", jpeg=base64.b64encode(jpeg).decode(), at=at, over=over)
        return list(answer["keys"])

    def run(self) -> None:
        """Show frames until the window is closed: right and left arrow step, Escape closes."""
        self._ask("run")

    def play(self, seconds: float) -> list[float]:
        """Show every frame once for so long, from the first; ends early if the window is closed or the
        monitor goes. Returns when each that stayed on came on, in seconds after the first.
        """
        times: list[float] = []
        for index in range(self._count):
            try:
                swapped = self.show(index).swapped_s
                self._ask("wait", until=swapped + seconds)
            except InputError:
                if not self.gone:
                    raise
            if self.gone:
                break
            times.append(swapped)
            if self.closed:
                break
        return [time - times[0] for time in times]

    def close(self) -> None:
        """Close the window; its process ends."""
        self._child.close()
