"""Compiling in a second process at the same time: a compiler holds the interpreter's lock."""

import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any

from .blocks import threads

__all__ = ["ALONE", "Task", "compile_all", "is_kept"]

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


def is_kept(dispatcher: Any, types: tuple[Any, ...]) -> bool:
    """Whether its code for these types is there, or in its cache."""
    if types in dispatcher.overloads:
        return True
    cache = dispatcher._cache
    return cache._index_key(types, dispatcher.targetctx.codegen()) in cache._cache_file._load_index()


def compile_all(tasks: Sequence[Task], last: Task) -> None:
    """Compile what is not kept, from the first on; every other one, about, in another process, whose code is
    then in the cache, as is, if there was time, that of the `last` one. Should that process not come up or
    not go on, all but the last one is compiled here.
    """
    left = deque(task for task in tasks if not is_kept(*task))
    with _helper(left, last):
        while (task := _next_of(left)) is not None:
            dispatcher, types = task
            dispatcher.compile(types)


def _next_of(left: deque[Task]) -> Task | None:
    """Taken off a queue; None: there is none, as the other process has taken the last one, maybe."""
    with suppress(IndexError):
        return left.popleft()
    return None


def _helper(left: deque[Task], last: Task) -> AbstractContextManager[None]:
    """The other process, if it is worth while and there can be one."""
    known = "python" in Path(sys.executable or "").name.lower()  # and not a program with Python inside
    if len(left) > 1 and threads() > 1 and known:
        with suppress(OSError):
            return _Helper(left, last)
    return nullcontext()


class _Helper(AbstractContextManager[None]):
    """A process that does a task of its own and then takes some off a queue, until there are none."""

    def __init__(self, left: deque[Task], last: Task) -> None:
        self._left = left
        self._own = [last]
        self._ready = False
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
        """Hand it one task after the other, until it is gone."""
        told, heard = self._process.stdin, self._process.stdout
        assert told is not None
        assert heard is not None
        with suppress(OSError):
            told.write(pickle.dumps(sys.path))
            told.flush()
            self._ready = bool(heard.readline())
            while self._ready:
                task = self._own.pop() if self._own else _next_of(self._left)
                if task is None:
                    return
                function, types = task[0].py_func, task[1]
                told.write(pickle.dumps((function.__module__, function.__qualname__, types)))
                told.flush()
                self._ready = bool(heard.readline())

    def __enter__(self) -> None:
        pass

    def __exit__(self, failed: Any, *_: Any) -> None:
        """Wait for what it is at; if it is still starting, or all is to end, for nothing."""
        if failed or not self._ready:
            self._process.kill()
        self._thread.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self._process.wait()


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
