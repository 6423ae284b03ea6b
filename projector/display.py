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
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence

from .devices import Shown
from .monitors import Monitor

__all__ = ["PatternWindow", "monitors"]

_CLOSING_S = 5.0
_COMMAND = (sys.executable, "-P", "-m", "optolever.projector.display_process")


class _Child:
    """The process, and one question after the other to it."""

    def __init__(self) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 # a pipe that nobody reads would stop it
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            _COMMAND, stdin=pipe, stdout=pipe, stderr=self._said, text=True, encoding="utf-8"
        )

    def ask(self, do: str, **words: Any) -> dict[str, Any]:
        """The answer. InputError: its error, or how it ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **words}) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise InputError(
                f"display: the window's process {self._end()}; optolever doctor tells what there is"
            )
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise InputError(answer["error"])
        return answer

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
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip().splitlines()
        how = f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        return f"{how} ({said[-1].strip()})" if said else how


def monitors() -> list[Monitor]:
    """The connected monitors, the primary one first; InputError in one line where there is no display."""
    child = _Child()
    try:
        return [Monitor(**plain) for plain in child.ask("monitors")["monitors"]]
    finally:
        child.close()


class PatternWindow:
    """Shows frames of `sequence`, row 0 on top, column 0 on the left, one pattern pixel per screen pixel.

    monitor: index into `monitors()` for full screen, None for a plain window of the pattern's size.
    vsync: `show` returns once the previous frame is off the screen, so that it can pace a camera.
    A context manager; a Display. `frames` and `late` count displayed and late frames.
    """

    def __init__(self, sequence: Sequence, *, monitor: int | None = None, vsync: bool = True) -> None:
        self._count, self._index, self._closed, self._gone = len(sequence), -1, False, False
        self.frames = self.late = 0
        self._child = _Child()
        try:
            opened = self._child.ask("open", sequence=sequence.to_dict(), monitor=monitor, vsync=vsync)
        except BaseException:
            self._child.close()
            raise
        self._shape = int(opened["shape"][0]), int(opened["shape"][1])
        self._refresh_s: float | None = opened["refresh_s"]

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
        return self._shape

    @property
    def refresh_s(self) -> float | None:
        """Period of the monitor; None where the window system does not know it."""
        return self._refresh_s

    @property
    def closed(self) -> bool:
        """True once the user asked to close the window (button or Escape), as of the last call."""
        return self._closed

    @property
    def gone(self) -> bool:
        """True once `play` or `run` ended because the monitor went away."""
        return self._gone

    def show(self, index: int) -> Shown:
        """Put frame `index` on the screen. InputError once the monitor is gone."""
        if not 0 <= index < self._count:
            raise IndexError(f"frame {index} of a sequence of {self._count}")
        answer = self._child.ask("show", index=index)
        self._index, self._closed = index, answer["closed"]
        return self._counted(Shown(index, answer["swapped_s"], answer["late"]))

    def step(self, by: int = 1) -> int:
        """Show the frame `by` further on, the first after the last; returns its index."""
        return self.show((self._index + by) % self._count).index

    def run(self) -> None:
        """Show frames until the window is closed: right and left arrow step, Escape closes."""
        answer = self._child.ask("run")
        self._index, self._gone, self._closed = answer["index"], answer["gone"], True

    def play(self, seconds: float) -> list[float]:
        """Show every frame once for so long, from the first; ends early if the window is closed or the
        monitor goes.

        Returns when each came on, in seconds after the first.
        """
        answer = self._child.ask("play", seconds=seconds)
        self._closed, self._gone = answer["closed"], answer["gone"]
        shown = [self._counted(Shown(**one)) for one in answer["shown"]]
        self._index = shown[-1].index if shown else self._index
        return [one.swapped_s - shown[0].swapped_s for one in shown]

    def read(self) -> NDArray[np.uint8]:
        """The window's content, (rows, cols) uint8, row 0 on top: drawn once more and read back."""
        answer = self._child.ask("read")
        return np.frombuffer(base64.b64decode(answer["pixels"]), np.uint8).reshape(answer["shape"])

    def close(self) -> None:
        """Close the window; its process ends."""
        self._child.close()

    def _counted(self, shown: Shown) -> Shown:
        self.frames += 1
        self.late += shown.late
        return shown
