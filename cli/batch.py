"""Many captures by one command: each on a worker of one thread; their table; a second run goes on."""

import csv
import hashlib
import json
import os
import re
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import optolever as ol
from optolever import InputError

from .outputs import OutputFile, Program, files_named
from .show import number, progress
from .workers import Outcome, Run, Task, cluster, processes

#: Parameters that change no result.
_BESIDE = ("out", "json_path", "save_profile")
#: Columns of every table, around the numbers of the command itself.
_OF_CONTACT = ("depth", "depth_sigma", "area", "force")
_FIRST, _LAST = ("capture", "code", "notices", "good", *_OF_CONTACT), ("digest", "error")
#: Lines of capture.toml that differ between captures of one kind.
_OF_ONE_FRAME = re.compile(r"^(file|time) *=.*\n?", re.MULTILINE)
#: Share of good pixels of the mirror from which a capture makes the profile of others.
_GOOD = 0.5
#: Share of most captures' good pixels from which on a capture's are named.
_FEWER = 0.9


@dataclass(frozen=True)
class Row:
    """A line of the table, by its columns; as text the cells that were read."""

    values: Mapping[str, Any]

    @classmethod
    def of(cls, outcome: Outcome, digest: str) -> "Row":
        """Of a command that ended: the deepest contact's depth with sigma, area and force (mm, mm^2,
        N) among its numbers."""
        given = outcome.numbers
        contacts = [one for one in given.get("contacts", ()) if one.get("depth") is not None]
        deepest: dict[str, Any] = max(contacts, key=lambda one: abs(one["depth"]), default={})
        notices = [notice["name"] for notice in given.get("notices", ())]
        own = {name: value for name, value in given.items() if isinstance(value, int | float)}
        values = {"capture": outcome.name, "code": outcome.code, "notices": " | ".join(notices)}
        values |= {"good": own.pop("good_share", "")}
        values |= {name: deepest.get(name, "") for name in _OF_CONTACT}
        return cls(values | own | {"digest": digest, "error": outcome.error})

    @property
    def failed(self) -> bool:
        """Whether the command ended with an error."""
        return str(self.values.get("code")) != "0"

    def lines(self) -> Iterator[str]:
        """For the terminal: the numbers or the error."""
        name = self.values["capture"]
        shown = {key: value for key, value in self.values.items() if isinstance(value, float)}
        figures = ", ".join(f"{key} {number(value)}" for key, value in shown.items()) or "as before"
        yield f"{name}: {self.values['error'] if self.failed else figures}"


class Many(Program):
    """A command that takes one capture or many; many run on workers, and --out is a folder.

    NAME.npz and NAME.json of every capture lie there, and table.csv of all. A command with --profile decodes
    the first good capture of every kind (description, size of the pictures) by itself, the others by its
    profile. A capture that the table has, with the same files, options and version, is not done again.
    """

    def __init__(
        self, *args: Any, captures: str, imports: Sequence[str], folders: bool = False, **given: Any
    ) -> None:
        """captures: the parameter that names them; imports: parts that the command uses; folders: several
        files are the pictures of one capture."""
        super().__init__(*args, **given)
        self.captures, self.folders = captures, folders
        self.imports = [f"optolever.{part}" for part in imports]
        jobs = "Processes of one thread for several captures, whose results lie in the folder --out."
        address = "Dask cluster that takes several captures, in place of processes (extra cluster)."
        again = "Do captures again that table.csv has of an earlier run."
        self.params += [
            click.Option(["--jobs"], type=click.IntRange(1), default=1, metavar="N", help=jobs),
            click.Option(["--scheduler"], metavar="ADDRESS", help=address),
            click.Option(["--again"], is_flag=True, help=again),
        ]

    def invoke(self, ctx: click.Context) -> Any:
        """The command itself for one capture, else every capture's; 2 if one of them ended with an error."""
        jobs, scheduler, again = (ctx.params.pop(name) for name in ("jobs", "scheduler", "again"))
        captures = ctx.params[self.captures]
        if len(captures) < 2 or (self.folders and not all(capture.is_dir() for capture in captures)):
            return super().invoke(ctx)
        for parameter in self.params:
            output = isinstance(parameter.type, OutputFile) and parameter.name != "out"
            output |= parameter.name == "keep_rest"
            if output and ctx.params[parameter.name or ""]:
                text = f"{parameter.opts[0]}: is of one capture, not of {len(captures)}; leave it out"
                raise InputError(text)
        out = Path(ctx.params["out"])
        if out.suffix.lower() == ".npz":
            raise InputError(f"--out {out}: becomes a folder, of {len(captures)} captures; leave .npz out")
        before = _read_table(out / "table.csv")
        early = again or not before
        workers = processes(jobs, self.imports, early) if scheduler is None else cluster(scheduler)
        with workers as run, progress() as step:
            batch = Batch(self, ctx.params, _by_name(captures), out, again)
            ol.files.require_folder(out, "table.csv")
            from optolever.kernels import are_compiled

            out.mkdir(exist_ok=True)
            rows = dict[str, Row]()
            if scheduler is None and not any(map(are_compiled, self.imports)):
                step("compile kernels (once)")
            try:
                for row in batch.rows(run, before):
                    rows[row.values["capture"]] = row
                    step(str(self.name), len(rows), len(batch.captures))
                    with step.aside():
                        for line in row.lines():
                            click.echo(line, err=row.failed)
            finally:
                for line in _notices(rows.values()):
                    click.echo(line, err=True)
                _save_table(out / "table.csv", before | rows)
                done = sum(not row.failed for row in rows.values())
                click.echo(f"{done} of {len(batch.captures)} captures done; {out / 'table.csv'}")
        return 0 if done == len(batch.captures) else 2


@dataclass(frozen=True)
class Batch:
    """A command's parameters for captures by their names, sorted; out: the folder of their results; again:
    do also what is done. InputError where one profile is asked for of captures of several kinds."""

    command: Many
    given: Mapping[str, Any]
    captures: Mapping[str, Path]
    out: Path
    again: bool

    def __post_init__(self) -> None:
        kept = self.given.get("save_profile")
        if kept is not None and len(self._kinds()) > 1:
            what = f"captures of {len(self._kinds())} kinds (patterns, size of the pictures)"
            raise InputError(f"--save-profile {kept}: {what} have no common profile; leave it out")

    def rows(self, run: Run, before: Mapping[str, Row]) -> Iterator[Row]:
        """Of every capture, as it ends; a capture whose digest is in `before` is not run."""
        if "save_profile" not in self.given or self.given["profile"] is not None:
            yield from self._of(run, list(self.captures), before, None, {})
            return
        for same in self._kinds():
            yield from self._of_one_kind(run, same, before)

    def _kinds(self) -> list[list[str]]:
        """Names of captures by what one profile may hold for."""
        kinds = dict[str, list[str]]()
        for name, capture in self.captures.items():
            kinds.setdefault(_kind(capture), []).append(name)
        return list(kinds.values())

    def _of_one_kind(self, run: Run, names: list[str], before: Mapping[str, Row]) -> Iterator[Row]:
        """Those of one kind: the first good one makes the profile, which all others use."""
        left = list(names)
        for name in names:
            kept = Path(self.given["save_profile"] or self.out / f".{name}.profile.npz")
            known = before if kept.exists() else {}
            (row,) = self._of(run, [name], known, None, {"save_profile": kept})
            share = row.values.get("mirror_good_share", row.values["good"])
            if not row.failed and float(share or 0) >= _GOOD:
                left.remove(name)
                yield row
                own = {"profile": kept, "save_profile": None}
                yield from self._of(run, left, before, str(row.values["digest"]), own)
                return
            if self.result(name).is_dir():  # is measured again, by another's profile
                shutil.rmtree(self.result(name))
        yield from self._of(run, left, {}, None, {"save_profile": None})

    def _of(
        self,
        run: Run,
        names: Sequence[str],
        before: Mapping[str, Row],
        profile: str | None,
        own: dict[str, Any],
    ) -> Iterator[Row]:
        """Of some captures; profile: digest of the capture that made it; own: further parameters."""
        beside = (*_BESIDE, self.command.captures)
        options = {name: value for name, value in self.given.items() if name not in beside}
        common: list[Any] = [ol.__version__, profile, options]
        common += [_stamp(file) for value in options.values() for file in files_named(value)]
        digests = {name: _digest([*common, _stamp(self.captures[name])]) for name in names}
        tasks, stamps = [], {}
        for name in names:
            row, result = before.get(name), self.result(name)
            same = row is not None and not row.failed and row.values.get("digest") == digests[name]
            if row is not None and same and result.exists() and not self.again:
                yield row
                continue
            if row is not None and result.is_dir():
                shutil.rmtree(result)
            tasks.append(self.task(name, own))
            stamps[name] = _stamp(result)
        for outcome in run(tasks):
            result = self.result(outcome.name)
            if outcome.code and result.is_file() and _stamp(result) == stamps[outcome.name]:
                result.unlink()  # of an earlier run
            yield Row.of(outcome, digests[outcome.name])

    def result(self, name: str) -> Path:
        """The file or the folder that a capture's command writes."""
        (kind,) = (parameter.type for parameter in self.command.params if parameter.name == "out")
        return self.out / (f"{name}.npz" if isinstance(kind, OutputFile) else name)

    def task(self, name: str, own: Mapping[str, Any]) -> Task:
        """A capture's command, with parameters of its own."""
        assert self.command.callback is not None
        parameters = {**self.given, self.command.captures: (self.captures[name],), "out": self.result(name)}
        parameters = {**parameters, "json_path": self.out / f"{name}.json", **own}
        return Task(name, self.command.callback.__module__, parameters, os.getcwd())


def _notices(rows: Collection[Row]) -> Iterator[str]:
    """Notices of all captures; several that differ only in numbers are one line, by the first."""
    same = dict[str, list[str]]()
    shares = sorted(float(row.values["good"] or 0) for row in rows if not row.failed)
    for row in rows:
        notices = list(filter(None, str(row.values["notices"]).split(" | ")))
        if not row.failed and float(row.values["good"] or 0) < _FEWER * (usual := shares[len(shares) // 2]):
            good = 100 * float(row.values["good"] or 0)
            notices.append(f"{good:.0f} % of the pixels are good, {100 * usual:.0f} % of most captures'")
        for notice in notices:
            same.setdefault(re.sub(r"\d[\d.,]*", "", notice), []).append(
                f"{row.values['capture']}: notice: {notice}"
            )
    for first, *more in same.values():
        yield f"{len(more) + 1} captures: such as {first}" if more else first


def _by_name(captures: Sequence[Path]) -> dict[str, Path]:
    """Captures by the part of their paths in which they differ, without the suffix of a file, sorted.
    InputError if one is given twice."""
    paths = [Path(os.path.abspath(capture)) for capture in captures]
    common = Path(os.path.commonpath([path.parent for path in paths]))
    named = dict[str, Path]()
    for path, capture in zip(paths, captures, strict=True):
        name = "-".join((path if path.is_dir() else path.with_suffix("")).relative_to(common).parts)
        if name in named:
            raise InputError(f"{capture}: another capture is called {name}, too; leave one out")
        named[name] = capture
    return dict(sorted(named.items()))


def _kind(capture: Path) -> str:
    """What captures share that one profile may hold for: their description, the header of their pictures."""
    described, header, pictures = "", b"", list[Path]()
    with suppress(OSError, ValueError):
        text = (capture / "capture.toml").read_text("utf-8")
        described = _OF_ONE_FRAME.sub("", text)
        first = re.search(r'^file *= *"(.+)"', text, re.MULTILINE)
        pictures = [capture / first[1]] if first else []
    if not (pictures and pictures[0].is_file()):
        pictures = sorted(path for path in capture.iterdir() if path.is_file() and path.suffix != ".toml")
    with suppress(OSError, IndexError), pictures[0].open("rb") as file:
        header = file.read(26)  # of a PNG: its size and its bits
    return repr((described, header if header.startswith(b"\x89PNG") else b""))


def _stamp(path: Path) -> list[tuple[str, int, int]]:
    """Names, sizes and times of a file, or of all files in a folder."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    found = []
    for file in files:
        with suppress(OSError):
            about = file.stat()
            found.append((str(file), about.st_size, about.st_mtime_ns))
    return found


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, default=str, sort_keys=True).encode()).hexdigest()[:16]


def _read_table(path: Path) -> dict[str, Row]:
    """Rows of an earlier run by their captures; none of a table of another program."""
    if not path.is_file():
        return {}
    with suppress(OSError, UnicodeDecodeError, csv.Error, KeyError), path.open(encoding="utf-8") as file:
        return {row["capture"]: Row(row) for row in csv.DictReader(file)}
    return {}


def _save_table(path: Path, rows: Mapping[str, Row]) -> None:
    """One row a capture, sorted by name (CSV)."""
    names = dict.fromkeys(name for row in rows.values() for name in row.values)
    columns = [*_FIRST, *(name for name in names if name not in (*_FIRST, *_LAST)), *_LAST]
    lines = ([rows[name].values.get(column, "") for column in columns] for name in sorted(rows))
    ol.files.write_rows(path, columns, lines)
