"""Many captures by one command: each in a process of one thread, or on the workers of a Dask cluster."""

import importlib
import json
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, TypeAlias

import click

import optolever as ol
from optolever import InputError
from optolever.blocks import ONE_THREAD
from optolever.processes import SAFE_PATH, environment

from .outputs import OutputFile, Program
from .show import number, progress

#: Imported once, by the process from which all others are forked.
_PARTS = ["optolever.calibration", "optolever.decode", "optolever.experiments", "optolever.projector"]
_TRIES = 3  # of a task whose worker was killed
_ONE_AT_A_TIME = threading.Lock()  # streams and the working folder belong to a whole process


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
    error: str
    numbers: dict[str, float]

    def __str__(self) -> str:
        figures = (f"{name} {number(value)}" for name, value in self.numbers.items())
        return f"{self.name}: {self.error if self.code else ', '.join(figures)}"


Run: TypeAlias = Callable[[Sequence[Task]], Iterator[Outcome]]


class Many(Program):
    """A command that takes one capture or many; many run in processes of their own, and --out is a folder.

    NAME.npz and NAME.json of every capture lie there, and table.csv of all. A command with --profile decodes
    the first capture by itself and the others by its profile.
    """

    def __init__(self, *args: Any, captures: str, folders: bool = False, **given: Any) -> None:
        """captures: the parameter that names them; folders: several files are the pictures of one capture."""
        super().__init__(*args, **given)
        self.captures, self.folders = captures, folders
        jobs = "Processes of one thread for several captures, whose results lie in the folder --out."
        address = "Dask cluster that takes several captures, in place of processes (extra cluster)."
        self.params += [
            click.Option(["--jobs"], type=click.IntRange(1), default=1, metavar="N", help=jobs),
            click.Option(["--scheduler"], metavar="ADDRESS", help=address),
        ]

    def invoke(self, ctx: click.Context) -> Any:
        """The command itself for one capture, else every capture's; 2 if one of them ended with an error."""
        jobs, scheduler = ctx.params.pop("jobs"), ctx.params.pop("scheduler")
        captures = ctx.params[self.captures]
        if len(captures) < 2 or (self.folders and not all(capture.is_dir() for capture in captures)):
            return super().invoke(ctx)
        for parameter in self.params:
            output = isinstance(parameter.type, OutputFile) and parameter.name != "out"
            if output and ctx.params[parameter.name or ""]:
                text = f"{parameter.opts[0]}: is of one capture, not of {len(captures)}; leave it out"
                raise InputError(text)
        named, out = _by_name(captures), Path(ctx.params["out"])
        ol.files.require_folder(out, "table.csv")
        outcomes: list[Outcome] = []
        workers = _processes(jobs) if scheduler is None else _cluster(scheduler)
        with progress() as step, workers as run:
            out.mkdir(exist_ok=True)
            for outcome in self._outcomes(ctx, named, run):
                outcomes.append(outcome)
                step(str(self.name), len(outcomes), len(named))
                with step.aside():
                    click.echo(str(outcome), err=outcome.code != 0)
        outcomes.sort(key=lambda one: list(named).index(one.name))
        _save_table(out / "table.csv", outcomes)
        failed = sum(one.code != 0 for one in outcomes)
        click.echo(f"{len(outcomes) - failed} of {len(outcomes)} captures done; {out / 'table.csv'}")
        return 2 if failed else 0

    def _outcomes(self, ctx: click.Context, captures: dict[str, Path], run: Run) -> Iterator[Outcome]:
        """Those of all captures; where the command has a profile and none is given, one capture makes it."""
        given, out = ctx.params, Path(ctx.params["out"])
        (kind,) = (parameter.type for parameter in self.params if parameter.name == "out")
        suffix = ".npz" if isinstance(kind, OutputFile) else ""

        def task(name: str, **others: Any) -> Task:
            own = {self.captures: (captures[name],), "json_path": out / f"{name}.json"}
            own |= {"out": out / f"{name}{suffix}"}
            return Task(name, self.callback.__module__, given | own | others, os.getcwd())

        left, profile = list(captures), dict[str, Any]()
        if "save_profile" in given and given["profile"] is None:
            kept = given["save_profile"] or out / ".profile.npz"
            while left and not profile:
                (outcome,) = run([task(left.pop(0), save_profile=kept)])
                profile = {} if outcome.code else {"profile": kept, "save_profile": None}
                yield outcome
        yield from run([task(name, **profile) for name in left])


def _by_name(captures: Sequence[Path]) -> dict[str, Path]:
    """Captures by the part of their paths in which they differ; InputError if one is given twice."""
    paths = [Path(os.path.abspath(capture)).with_suffix("") for capture in captures]
    common = Path(os.path.commonpath([path.parent for path in paths]))
    named = dict[str, Path]()
    for path, capture in zip(paths, captures, strict=True):
        name = "-".join(path.relative_to(common).parts)
        if name in named:
            raise InputError(f"{capture}: another capture is called {name}, too; leave one out")
        named[name] = capture
    return named


def _save_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """One row a capture: name, exit code, every number of its command, error (CSV)."""
    columns = list(dict.fromkeys(name for outcome in outcomes for name in outcome.numbers))
    rows = (
        [one.name, one.code, *(one.numbers.get(name, "") for name in columns), one.error] for one in outcomes
    )
    ol.files.write_rows(path, ["capture", "code", *columns, "error"], rows)


def _run(task: Task) -> Outcome:
    from .app import exit_code

    command: Program = importlib.import_module(task.module).command
    out, err, numbers = StringIO(), StringIO(), Path(task.parameters["json_path"])
    with _ONE_AT_A_TIME, redirect_stdout(out), redirect_stderr(err):
        os.chdir(task.folder)
        numbers.unlink(missing_ok=True)
        code = exit_code(lambda: command.run(task.parameters), "optolever")
    lines = err.getvalue().splitlines()
    written: dict[str, Any] = json.loads(numbers.read_text("utf-8")) if numbers.exists() else {}
    scalars = {name: value for name, value in written.items() if isinstance(value, int | float)}
    return Outcome(task.name, code, lines[-1] if code and lines else "", scalars)


def _pool(jobs: int) -> ProcessPoolExecutor:
    """Processes forked from one that has imported the parts, where the system has a fork."""
    forks = "forkserver" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if forks else "spawn")
    if forks:
        context.set_forkserver_preload(_PARTS)
    return ProcessPoolExecutor(jobs, context)


def _results(pool: ProcessPoolExecutor, tasks: Sequence[Task]) -> Iterator[Outcome]:
    """Those of tasks whose process was not killed."""
    with suppress(BrokenProcessPool):
        for future in as_completed([pool.submit(_run, task) for task in tasks]):
            with suppress(BrokenProcessPool):
                yield future.result()


@contextmanager
def _processes(jobs: int) -> Iterator[Run]:
    """One pool; what a killed process leaves runs once more together, then alone: which kills it shows."""
    with environment(SAFE_PATH | ONE_THREAD), _pool(jobs) as pool:

        def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
            left = {task.name: task for task in tasks}
            for each in (nullcontext(pool), _pool(jobs)):
                with each as some:
                    for outcome in _results(some, list(left.values())):
                        del left[outcome.name]
                        yield outcome
            killed = "its process was killed three times: too little memory?"
            for name, task in left.items():
                with _pool(1) as alone:
                    yield next(_results(alone, [task]), Outcome(name, 2, killed, {}))

        yield run


@contextmanager
def _cluster(scheduler: str) -> Iterator[Run]:
    """Workers of a Dask cluster; a task whose worker was killed runs again elsewhere. InputError: none."""
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError("--scheduler: needs Dask; pip install 'optolever[cluster]'") from error
    try:
        client = dask.Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no answer ({error})") from error
    with client:

        def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
            futures = {client.submit(_run, task, pure=False, retries=_TRIES): task.name for task in tasks}
            for future in dask.as_completed(futures):
                lost = future.status == "error"
                yield Outcome(futures[future], 2, str(future.exception()), {}) if lost else future.result()

        yield run
