"""Tasks of a batch on workers: processes of one thread, or a Dask cluster."""

import gc
import importlib
import json
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from io import StringIO
from multiprocessing.context import BaseContext
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


@dataclass(frozen=True)
class Task:
    """A command for one capture: its module and parameters, and the folder where relative paths begin."""

    name: str
    module: str
    parameters: dict[str, Any]
    folder: str


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
        numbers.unlink(missing_ok=True)
        try:
            code = exit_code(lambda: command.run(task.parameters), "optolever")
        except Exception as error:  # a fault of this program: the other captures go on
            return Outcome(task.name, 1, f"{type(error).__name__}: {error}")
    lines = err.getvalue().splitlines()
    written: dict[str, Any] = json.loads(numbers.read_text("utf-8")) if numbers.exists() else {}
    return Outcome(task.name, code, lines[-1] if code and lines else "", written)


def _begin() -> None:
    """Ctrl-C reaches every process of a terminal, but the first one alone decides; from it comes SIGTERM."""

    def end(*_: Any) -> None:
        _ended.set()
        raise SystemExit(130)

    gc.freeze()
    gc.enable()  # `warm` has stopped it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)


def _started(modules: Sequence[str]) -> BaseContext:
    """Start the process that imports the modules and from which others are forked, where the system has a
    fork; it is not waited for."""
    forks = "forkserver" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if forks else "spawn")
    if forks:
        from multiprocessing import forkserver

        context.set_forkserver_preload([f"{__package__}.warm", *modules])
        with _possible():
            forkserver.ensure_running()
    return context


@contextmanager
def _pool(jobs: int, modules: Sequence[str]) -> Iterator[ProcessPoolExecutor]:
    """Processes that have imported the modules. They end with an error inside. InputError where the system
    lacks what processes need."""
    with _possible():
        pool = ProcessPoolExecutor(jobs, _started(modules), _begin)
        pool.submit(os.getpid).result()
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        _end_processes()
        raise
    finally:
        pool.shutdown()


@contextmanager
def _possible() -> Iterator[None]:
    """InputError where processes cannot be started."""
    try:
        yield
    except BrokenProcessPool:
        raise
    except (OSError, ImportError) as error:
        raise _cannot_start(error) from error


def _cannot_start(error: Exception) -> InputError:
    folder, shared = tempfile.gettempdir(), Path("/dev/shm")
    if "AF_UNIX" in str(error):
        return InputError(f"TMPDIR {folder}: is too long for a socket in it; set another, TMPDIR=/tmp")
    if not os.access(shared, os.W_OK):
        cure = "mount a tmpfs there (Docker: --shm-size=64m)"
        return InputError(f"{shared}: is missing or not writable, processes need it; {cure}")
    return InputError(f"processes cannot be started ({error})")


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


def _results(pool: ProcessPoolExecutor, tasks: Sequence[Task]) -> Iterator[Outcome]:
    """Those of tasks whose process was not killed."""
    with suppress(BrokenProcessPool):
        for future in as_completed([pool.submit(run_task, task) for task in tasks]):
            with suppress(BrokenProcessPool):
                yield future.result()


@contextmanager
def processes(jobs: int, modules: Sequence[str], early: bool) -> Iterator[Run]:
    """One pool; what a killed process leaves runs once more together, then alone: which kills it shows.

    modules: what the command imports, once for all processes. early: there is work for sure, so this begins
    at once.
    """
    with environment(SAFE_PATH | ONE_THREAD), ExitStack() as stack:
        if early:
            _started(modules)
        pools = list[ProcessPoolExecutor]()  # none where nothing is left to do

        def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
            left = {task.name: task for task in tasks}
            if left and not pools:
                pools.append(stack.enter_context(_pool(jobs, modules)))
            for again in (False, True):
                if left:
                    with _pool(jobs, modules) if again else nullcontext(pools[0]) as pool:
                        for outcome in _results(pool, list(left.values())):
                            del left[outcome.name]
                            yield outcome
            killed = "its process was killed three times: too little memory?"
            for name, task in left.items():
                with _pool(1, modules) as alone:
                    yield next(_results(alone, [task]), Outcome(name, 2, killed))

        yield run


@contextmanager
def cluster(scheduler: str) -> Iterator[Run]:
    """Workers of a Dask cluster; a task whose worker was killed runs again elsewhere. InputError: none."""
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError("--scheduler: needs Dask; pip install 'optolever[cluster]'") from error
    try:
        client = dask.Client(scheduler, timeout="10s")
    except (OSError, ValueError, TypeError) as error:  # TypeError: tls:// without certificates
        raise InputError(f"--scheduler {scheduler}: no answer ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WITHOUT_WORKER)
        except TimeoutError:
            cure = f"start one: dask worker {scheduler}"
            click.echo(f"--scheduler {scheduler}: has no worker yet, waiting; {cure}", err=True)

        def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
            submitted: Mapping[Any, str] = {
                client.submit(run_task, task, pure=False, retries=_TRIES): task.name for task in tasks
            }
            try:
                for future in dask.as_completed(submitted):
                    lost = future.status == "error"
                    name = submitted[future]
                    yield Outcome(name, 2, str(future.exception())) if lost else future.result()
            except BaseException:
                client.cancel(list(submitted))
                raise

        yield run
