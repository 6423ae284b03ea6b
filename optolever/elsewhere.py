"""Compiling in a second process at the same time: a compiler holds the interpreter's lock."""

import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from threading import Condition, Thread
from typing import Any

from .blocks import threads
from .compiling import uncollected

__all__ = ["ALONE", "Task", "claim", "compile_all", "compiling_ahead", "is_kept"]

#: Name of what compiles a dispatcher whose code is used by another process.
ALONE = "compile_alone"
#: A dispatcher that caches on disk, and the types of its arguments.
Task = tuple[Any, tuple[Any, ...]]
#: What the other process runs: first it is told where modules are.
_PROGRAM = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from optolever.elsewhere import _serve
_serve()
"""
#: Seconds that one kernel may take there: ten times the largest one's on a slow machine.
_PATIENCE = 120.0
#: The other process, while there is one.
_helper: "_Helper | None" = None


def is_kept(dispatcher: Any, types: tuple[Any, ...]) -> bool:
    """Whether its code for these types is there, or in its cache."""
    if types in dispatcher.overloads:
        return True
    cache = dispatcher._cache
    return cache._index_key(types, dispatcher.targetctx.codegen()) in cache._cache_file._load_index()


@contextmanager
def compiling_ahead(tasks: Sequence[Task]) -> Iterator[None]:
    """Within, another process compiles what is not kept of these, and what compile_all leaves to it, if there
    is any. Should it not come up or not go on, all is compiled here.
    """
    global _helper
    missing = [task for task in tasks if _helper is None and not is_kept(*task)]
    started = _started() if missing else None
    if started is None:
        yield
        return
    started.add(missing)
    _helper = started
    try:
        yield
    finally:
        _helper = None
        started.end()


def compile_all(tasks: Sequence[Task], last: Task) -> None:
    """Compile what is not kept, from the first on, with another process if there is more than one; that does
    the `last` one first, if it comes up in time: nobody else does.
    """
    left = [task for task in tasks if not is_kept(*task)]
    with compiling_ahead(left[1:]):
        helper = _helper
        if helper is not None:
            helper.add(left, last)
        for dispatcher, types in left if helper is None else iter(helper.take, None):
            dispatcher.compile(types)
        if helper is not None:
            helper.wait()


def claim(dispatcher: Any, types: tuple[Any, ...]) -> None:
    """To be called before it is compiled here: the other process will not do it, too, or has done it."""
    if _helper is not None:
        _helper.claim((dispatcher, types))


def _started() -> "_Helper | None":
    """The other process, if it is worth while and there can be one."""
    known = "python" in Path(sys.executable or "").name.lower()  # and not a program with Python inside
    if threads() > 1 and known:
        with suppress(OSError):
            return _Helper()
    return None


class _Helper:
    """A process that does tasks, one after the other, from the first on."""

    def __init__(self) -> None:
        self._left: deque[Task] = deque()
        self._alone: Task | None = None
        self._at: Task | None = None
        self._closing = False
        self._changed = Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        self._thread = Thread(target=self._feed, name="optolever-compiling", daemon=True)
        self._thread.start()

    def _feed(self) -> None:
        """Hand it one task after the other, until it is gone or there will be no more."""
        told, heard = self._process.stdin, self._process.stdout
        assert told is not None
        assert heard is not None
        try:
            told.write(pickle.dumps(sys.path))
            told.flush()
            while heard.readline() and (task := self._next()) is not None:
                function, types = task[0].py_func, task[1]
                told.write(pickle.dumps((function.__module__, function.__qualname__, types)))
                told.flush()
        except Exception:  # it is gone, or cannot be told: what is left is compiled here
            self._process.kill()
        with self._changed:
            self._at = None
            self._changed.notify_all()

    def _next(self) -> Task | None:
        """Wait for one, while it is ready; None: there will be none."""
        with self._changed:
            self._at = None
            self._changed.notify_all()
            while not (self._alone or self._left or self._closing):
                self._changed.wait()
            if not self._closing:
                self._at, self._alone = self._alone or self._left.popleft(), None
            return self._at

    def add(self, tasks: Sequence[Task], alone: Task | None = None) -> None:
        """Do these before others, those excepted that it has already; and first one that nobody else does."""
        with self._changed:
            self._alone = alone
            new = [task for task in tasks if task != self._at and task not in self._left]
            self._left.extendleft(reversed(new))
            self._changed.notify_all()

    def take(self) -> Task | None:
        """The next one, which it does not do then; None: there is none."""
        with self._changed:
            return self._left.popleft() if self._left else None

    def claim(self, task: Task) -> None:
        """Take this one, if it is not begun, and wait for it, if it is."""
        with self._changed:
            if task in self._left:
                self._left.remove(task)
            while self._at == task:
                self._wait()

    def wait(self) -> None:
        """Until it is done with what it is at; it begins nothing that nobody else does."""
        with self._changed:
            self._alone = None
            while self._at is not None:
                self._wait()

    def _wait(self) -> None:
        """For a change; should there be none, it is not waited for any more."""
        if not self._changed.wait(_PATIENCE):
            self._process.kill()

    def end(self) -> None:
        """Give up what it has not done."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._process.kill()
        self._thread.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self._process.wait()


@uncollected()
def _serve() -> None:
    """What the other process does: compile what it is told, and answer a line each time."""
    told, heard = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # so that nothing else gets among the answers
    while True:
        heard.write(b"\n")
        heard.flush()
        try:
            module, name, types = pickle.load(told)
        except EOFError:
            return
        found = getattr(import_module(module), name)
        dispatcher = getattr(found, "dispatcher", found)
        getattr(dispatcher, ALONE, dispatcher.compile)(types)
