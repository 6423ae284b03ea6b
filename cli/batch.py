"""Many captures by one command: each in a process of one thread, or on the workers of a Dask cluster."""

import importlib
import json
import multiprocessing
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import click

from optolever.blocks import ONE_THREAD
from optolever.errors import InputError
from optolever.files import require_folder, write_rows
from optolever.processes import environment, safe_path

from .outputs import OutputFile, Program
from .show import number, progress

__all__ = ["Outcome", "Task", "captures_by_name", "run_tasks", "save_table"]

_OWN = {"out", "json_path", "jobs", "scheduler", "save_profile"}
_TRIES = 3  # of a task whose worker of a cluster was killed
_ONE_AT_A_TIME = threading.Lock()  # streams and the working folder belong to a whole process


@dataclass(frozen=True)
class Task:
    """One command for one capture. args: its whole command line; folder: where its relative paths begin."""

    name: str
    args: tuple[str, ...]
    numbers: Path
    folder: str = field(default_factory=os.getcwd)


@dataclass(frozen=True)
class Outcome:
    """How a command ended. error: its last line on stderr, if the exit code is not 0; numbers: of --json."""

    name: str
    code: int
    error: str
    numbers: dict[str, float]


def captures_by_name(captures: Sequence[Path]) -> dict[str, Path]:
    """Captures by the part of their paths in which they differ; InputError if one is given twice."""
    whole = [Path(os.path.abspath(capture)).with_suffix("") for capture in captures]
    common = Path(os.path.commonpath([path.parent for path in whole]))
    names = ["-".join(path.relative_to(common).parts) for path in whole]
    for place, name in enumerate(names):
        if name in names[:place]:
            raise InputError(f"{captures[place]}: another capture is called {name}, too; leave one out")
    return dict(zip(names, captures, strict=True))


def run_tasks(tasks: Sequence[Task], jobs: int, scheduler: str | None) -> Iterator[Outcome]:
    """Outcomes as they come: from `jobs` processes, or from the Dask cluster at the address `scheduler`.

    The numbers are the same to the last bit wherever they are made, if the cluster's workers have one thread
    each. A task whose worker was killed runs again elsewhere, three times at most. InputError: no cluster.
    """
    return _in_processes(tasks, jobs) if scheduler is None else _on_cluster(tasks, scheduler)


def save_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """One row a capture: name, exit code, every number of its command, error (CSV)."""
    columns = list(dict.fromkeys(name for outcome in outcomes for name in outcome.numbers))
    header = ["capture", "code", *columns, "error"]
    rows = (
        [one.name, one.code, *(one.numbers.get(name, "") for name in columns), one.error] for one in outcomes
    )
    write_rows(path, header, rows)


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
            click.Option(["--jobs"], type=click.IntRange(1), metavar="N", help=jobs, expose_value=False),
            click.Option(["--scheduler"], metavar="ADDRESS", help=address, expose_value=False),
        ]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keeps the texts of the options."""
        texts = self.make_parser(ctx).parse_args(self.renamed(args))[0]
        given = {name: text for name, text in texts.items() if isinstance(text, (str, bool, list, tuple))}
        ctx.meta["given"] = given
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """The command itself for one capture, else every capture's; 2 if one of them ended with an error."""
        captures = [Path(name) for name in ctx.params[self.captures]]
        if len(captures) < 2 or (self.folders and not all(capture.is_dir() for capture in captures)):
            return super().invoke(ctx)
        return _all(self, ctx, captures_by_name(captures))


def _run(task: Task) -> Outcome:
    from .app import run

    out, err = StringIO(), StringIO()
    with _ONE_AT_A_TIME, redirect_stdout(out), redirect_stderr(err):
        os.chdir(task.folder)
        task.numbers.unlink(missing_ok=True)
        code = run(task.args)
    lines = err.getvalue().splitlines()
    numbers: dict[str, Any] = json.loads(task.numbers.read_text("utf-8")) if task.numbers.exists() else {}
    scalars = {name: value for name, value in numbers.items() if isinstance(value, int | float)}
    return Outcome(task.name, code, lines[-1] if code and lines else "", scalars)


def _in_processes(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Tasks of a pool that broke run once more, then each by itself: which of them kills it shows."""
    left = {task.name: task for task in tasks}

    def run(some: Sequence[Task], workers: int) -> Iterator[Outcome]:
        with (
            safe_path(),
            environment(ONE_THREAD),
            ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool,
        ):
            for future in as_completed([pool.submit(_run, task) for task in some]):
                with suppress(BrokenProcessPool):
                    outcome = future.result()
                    del left[outcome.name]
                    yield outcome

    for _ in range(2):
        if left:
            yield from run(list(left.values()), jobs)
    for name, task in list(left.items()):
        yield from run([task], 1)
        if name in left:
            yield Outcome(name, 2, "its process was killed three times: too little memory?", {})


def _on_cluster(tasks: Sequence[Task], scheduler: str) -> Iterator[Outcome]:
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError("--scheduler: needs Dask; pip install 'optolever[cluster]'") from error
    try:
        client = dask.Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no answer ({error})") from error
    with client:
        futures = {client.submit(_run, task, pure=False, retries=_TRIES): task.name for task in tasks}
        for future in dask.as_completed(futures):
            lost = future.status == "error"
            yield Outcome(futures[future], 2, str(future.exception()), {}) if lost else future.result()


def _all(command: Many, ctx: click.Context, captures: dict[str, Path]) -> int:
    given: dict[str, Any] = ctx.meta["given"]
    out = Path(given["out"])
    for parameter in command.params:
        if isinstance(parameter.type, OutputFile) and given.get(parameter.name) and parameter.name != "out":
            raise InputError(f"{parameter.opts[0]}: is of one capture, not of {len(captures)}; leave it out")
    require_folder(out, "table.csv")
    out.mkdir(exist_ok=True)
    common = list(_options(command, {k: v for k, v in given.items() if k not in _OWN | {command.captures}}))
    outcomes: list[Outcome] = []
    with progress() as step:
        for outcome in _outcomes(ctx, given, common, captures, out):
            outcomes.append(outcome)
            step(str(command.name), len(outcomes), len(captures))
            with step.aside():
                click.echo(_line(outcome))
    outcomes.sort(key=lambda one: list(captures).index(one.name))
    save_table(out / "table.csv", outcomes)
    failed = sum(one.code != 0 for one in outcomes)
    click.echo(f"{len(outcomes) - failed} of {len(outcomes)} captures done; {out / 'table.csv'}")
    return 2 if failed else 0


def _outcomes(
    ctx: click.Context, given: dict[str, Any], options: list[str], captures: dict[str, Path], out: Path
) -> Iterator[Outcome]:
    """Those of all captures; where the command has a profile and none is given, one capture makes it."""
    jobs, scheduler = int(given.get("jobs") or 1), given.get("scheduler")
    command, path = ctx.command, ctx.command_path.split()[1:]
    (kind,) = (parameter.type for parameter in command.params if parameter.name == "out")
    suffix = ".npz" if isinstance(kind, OutputFile) else ""

    def task(name: str, *more: str) -> Task:
        numbers = out / f"{name}.json"
        words = (*path, str(captures[name]), *options, "--out", str(out / f"{name}{suffix}"))
        return Task(name, (*words, "--json", str(numbers), *more), numbers)

    left = list(captures)
    profile: tuple[str, ...] = ()
    if any(parameter.name == "save_profile" for parameter in command.params) and not given.get("profile"):
        kept = given.get("save_profile") or str(out / ".profile.npz")
        while left and not profile:
            (outcome,) = run_tasks([task(left.pop(0), "--save-profile", kept)], 1, scheduler)
            profile = () if outcome.code else ("--profile", kept)
            yield outcome
    yield from run_tasks([task(name, *profile) for name in left], jobs, scheduler)


def _options(command: click.Command, given: dict[str, Any]) -> Iterator[str]:
    """The words of options that were given."""
    for parameter in command.params:
        value = given.get(parameter.name or "")
        for each in value if isinstance(value, list | tuple) else [] if value is None else [value]:
            yield from [parameter.opts[0]] if each is True else [parameter.opts[0], str(each)]


def _line(outcome: Outcome) -> str:
    if outcome.code:
        return f"{outcome.name}: {outcome.error}"
    figures = (f"{name} {number(value)}" for name, value in outcome.numbers.items())
    return f"{outcome.name}: {', '.join(figures)}"
