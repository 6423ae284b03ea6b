"""Tasks of a batch on workers: processes of one thread, or a Dask cluster."""

import gc
import importlib
import json
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, TypeAlias

import click

from optolever import InputError
from optolever.blocks import ONE_THREAD
from optolever.processes import SAFE_PATH, environment

from .outputs import Program

_TRIES = 3  # of a task whose worker was killed
_WITHOUT_WORKER = 10.0  # seconds until a cluster without a worker is named
_END = 3.0  # seconds that all processes have together to take their temporary files away
_ONE_AT_A_TIME = threading.Lock()  # streams and the working folder belong to a whole process
_ended = threading.Event()
_KILLED = "its process was killed twice: too little memory?"


@dataclass(frozen=True)
class Task:
    """A command for one capture: its module and parameters, the folder where relative paths begin, and
    the one to make for its results."""

    name: str
    module: str
    parameters: dict[str, Any]
    folder: str
    results: Path


@dataclass(frozen=True)
class Outcome:
    """How a command ended. error: its last line on stderr, if the exit code is not 0; numbers: of --json."""

    name: str
    code: int
    error: str = ""
    numbers: dict[str, Any] = field(default_factory=dict)


Run: TypeAlias = Callable[[Sequence[Task]], Iterator[Outcome]]


def run_task(task: Task) -> Outcome:
    """Run a command, and read the numbers that it wrote."""
    from .app import exit_code

    if _ended.is_set():
        return Outcome(task.name, 130, "interrupted")
    command: Program = importlib.import_module(task.module).command
    out, err, numbers = StringIO(), StringIO(), Path(task.parameters["json_path"])
    with _ONE_AT_A_TIME, redirect_stdout(out), redirect_stderr(err):
        os.chdir(task.folder)
        shutil.rmtree(task.results, ignore_errors=True)  # of a process that was killed
        task.results.mkdir()
        try:
            code = exit_code(lambda: command.run(task.parameters), "optolever")
        except Exception as error:  # a fault of this program: the other captures go on
            return Outcome(task.name, 1, f"{type(error).__name__}: {error}")
    lines = err.getvalue().splitlines()
    written: dict[str, Any] = json.loads(numbers.read_text("utf-8")) if numbers.exists() else {}
    return Outcome(task.name, code, lines[-1] if code and lines else "", written)


@contextmanager
def workers(jobs: str, modules: Sequence[str]) -> Iterator[Run]:
    """Runs tasks, on so many processes that have imported the modules, or on the cluster at an address.
    InputError: there are none."""
    with (
        environment(SAFE_PATH | ONE_THREAD),
        _pool(int(jobs), modules) if jobs.isdecimal() else _cluster(jobs) as pool,
    ):

        def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
            left = {task.name: task for task in tasks}
            for outcome in _outcomes(pool, tasks):
                del left[outcome.name]
                yield outcome
            for name, task in left.items():  # a kill ends the pool: alone, each shows whether it was it
                with _pool(1, modules) as alone:
                    yield next(_outcomes(alone, [task]), Outcome(name, 2, _KILLED))

        yield run


def _outcomes(pool: Executor, tasks: Sequence[Task]) -> Iterator[Outcome]:
    """Of tasks whose pool has not ended with a killed process."""
    names = dict[Future[Outcome], str]()
    with suppress(BrokenExecutor):
        try:
            names |= {pool.submit(run_task, task): task.name for task in tasks}
        except (OSError, ImportError) as error:
            raise _cannot_start(error) from error
    for future in as_completed(names):
        if (fault := future.exception()) is None:
            yield future.result()
        elif not isinstance(fault, BrokenExecutor):
            yield Outcome(names[future], 2, str(fault))


def _cannot_start(error: Exception) -> InputError:
    where = f"TMPDIR {tempfile.gettempdir()} must be short, /dev/shm writable (Docker: --shm-size=64m)"
    return InputError(f"processes cannot be started ({error}); {where}")


def _begin() -> None:
    """Ctrl-C reaches every process of a terminal, but the first one alone decides; from it comes SIGTERM."""

    def end(*_: Any) -> None:
        _ended.set()
        raise SystemExit(130)

    def end_with_parent() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(130)

    gc.freeze()
    gc.enable()  # `warm` has stopped it
    threading.Thread(target=end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)


@contextmanager
def _pool(jobs: int, modules: Sequence[str]) -> Iterator[Executor]:
    """They are forked from a process that imports the modules, where the system has a fork, and end with an
    error inside."""
    forks = "forkserver" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if forks else "spawn")
    if forks:
        multiprocessing.set_forkserver_preload([f"{__package__}.warm", *modules])
    try:
        pool = ProcessPoolExecutor(jobs, context, _begin)
    except (OSError, ImportError) as error:
        raise _cannot_start(error) from error
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        _end_processes()
        raise
    finally:
        pool.shutdown()


def _end_processes() -> None:
    """End the processes of this one's pools; what they write is taken away or left out."""
    left = multiprocessing.active_children()
    for process in left:
        process.terminate()
    end = time.monotonic() + _END
    for process in left:
        process.join(max(end - time.monotonic(), 0.0))
    for process in left:
        process.kill()


@contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    """A task whose worker was killed runs again elsewhere."""
    try:
        dask: Any = importlib.import_module("distributed")
        client = dask.Client(scheduler, timeout="10s")
    except ImportError as error:
        raise InputError(f"--jobs {scheduler}: needs Dask; pip install 'optolever[cluster]'") from error
    except (OSError, ValueError, TypeError) as error:  # TypeError: tls:// without certificates
        raise InputError(f"--jobs {scheduler}: no answer ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WITHOUT_WORKER)
        except TimeoutError:
            cure = f"start one: dask worker {scheduler}"
            click.echo(f"--jobs {scheduler}: has no worker yet, waiting; {cure}", err=True)
        pool: Executor = client.get_executor(pure=False, retries=_TRIES)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False)  # or it waits for all tasks
            raise
