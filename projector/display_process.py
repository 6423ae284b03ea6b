"""The process that owns GLFW: a JSON line a command on stdin, a JSON line an answer on stdout.

    {"do": "monitors"} | {"do": "open", "sequence": ..., "monitor": ..., "vsync": ...}
    {"do": "show", "index": ...} | {"do": "play", "seconds": ...} | {"do": "run"} | {"do": "read"}

It ends when stdin does. Run by `display`, as `python -m optolever.projector.display_process`.
"""

import base64
import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TextIO

from optolever.errors import InputError
from optolever.patterns import Sequence

from .window import Window, connected_monitors

__all__ = ["main"]

_POLL_S = 0.05  # between answers to the window system


class _Server:
    """Answers commands; holds the window."""

    def __init__(self) -> None:
        self._window: Window | None = None

    def answer(self, command: Mapping[str, Any]) -> dict[str, Any]:
        match command["do"]:
            case "monitors":
                return {"monitors": [asdict(one) for one in connected_monitors()]}
            case "open":
                sequence = Sequence.from_dict(command["sequence"])
                self._window = Window(sequence, monitor=command["monitor"], vsync=command["vsync"])
                return {"shape": self._window.shape, "refresh_s": self._window.refresh_s}
        assert self._window is not None
        window = self._window
        match command["do"]:
            case "show":
                return asdict(window.show(command["index"])) | {"closed": window.closed}
            case "play":
                shown = [asdict(one) for one in window.play(command["seconds"])]
                return {"shown": shown, "closed": window.closed, "gone": window.gone}
            case "run":
                window.run()
                return {"index": window.index, "gone": window.gone}
            case "read":
                return {"shape": window.shape, "pixels": base64.b64encode(window.read().tobytes()).decode()}
        raise ValueError(command["do"])

    def poll(self) -> None:
        if self._window is not None:
            self._window.poll()


def main() -> None:
    """Serve until stdin ends. Nothing but answers is written to stdout, whatever a driver prints."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's, who ends this process
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    commands: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_read, args=(commands,), daemon=True).start()
    server = _Server()
    while True:
        try:
            line = commands.get(timeout=_POLL_S)
        except queue.Empty:
            server.poll()
            continue
        if line is None:
            return
        _reply(answers, server, line)


def _read(commands: "queue.Queue[str | None]") -> None:
    for line in sys.stdin:
        commands.put(line)
    os._exit(0)  # whatever the main thread does: nobody listens any more


def _reply(answers: TextIO, server: _Server, line: str) -> None:
    try:
        answer = server.answer(json.loads(line))
    except InputError as error:
        answer = {"error": str(error)}
    answers.write(json.dumps(answer) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
