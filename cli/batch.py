"""Many captures by one command: each on a worker of one thread; their table; a second run goes on."""

import csv
import hashlib
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import click

import optolever as ol
from optolever import InputError
from optolever.errors import reason_of
from optolever.quantities import quantity

from .outputs import Output, OutputFile, Program, files_named, require_apart
from .printing import progress
from .workers import Outcome, Run, Task, workers

#: Parameters that change no result.
_BESIDE = ("out", "json_path", "save_profile", "verbose")
#: Columns of every table, around the numbers of the command itself: of the deepest contact, by its fields.
_OF_CONTACT = {
    "depth_mm": "depth", "depth_sigma_mm": "depth_sigma", "area_mm2": "area", "force_n": "force",
    "force_sigma_n": "force_sigma",
}  # fmt: skip
_FIRST, _LAST = ("capture", "code", "notices", "good_share", *_OF_CONTACT), ("digest", "files", "error")
#: Lines of capture.toml that differ between captures of one kind.
_OF_ONE_FRAME = re.compile(r"^(file|time) *=.*\n?", re.MULTILINE)
#: Share of good pixels of the mirror from which a capture makes the profile of others.
_GOOD = 0.5
#: Share of most captures' good pixels from which on a capture's are named.
_FEWER = 0.9


@dataclass(frozen=True)
class Row:
    """A line of the table, by its columns; as text the cells that were read. new: of this run."""

    values: Mapping[str, Any]
    new: bool = True

    @classmethod
    def of(cls, outcome: Outcome, digest: str, files: Mapping[str, Any]) -> "Row":
        """Of a command that ended, with the deepest contact among its numbers; files: `stamps` of its
        results by their names."""
        given = outcome.numbers
        contacts = [one for one in given.get("contacts", ()) if one.get("depth") is not None]
        deepest: dict[str, Any] = max(contacts, key=lambda one: abs(one["depth"]), default={})
        notices = [notice["name"] for notice in given.get("notices", ())]
        own = {name: value for name, value in given.items() if isinstance(value, int | float)}
        values = {"capture": outcome.name, "code": outcome.code, "notices": " | ".join(notices)}
        values |= {"good_share": own.pop("good_share", "")}
        values |= {name: deepest.get(field, "") for name, field in _OF_CONTACT.items()}
        return cls(values | own | {"digest": digest, "files": json.dumps(files), "error": outcome.error})

    @property
    def name(self) -> str:
        """Of the capture."""
        return str(self.values["capture"])

    @property
    def failed(self) -> bool:
        """Whether the command ended with an error."""
        return str(self.values.get("code")) != "0"

    @property
    def files(self) -> dict[str, Any]:
        """Sizes and times of the results, by their names."""
        with suppress(ValueError, TypeError):
            return dict(json.loads(self.values["files"]))
        return {}  # of a line that was cut

    def number(self, column: str) -> float:
        """Of a column; NaN of an empty one."""
        with suppress(ValueError, TypeError):
            return float(self.values.get(column, ""))
        return math.nan

    def text(self) -> str:
        """For the terminal: depth and force of the deepest contact, share of good pixels, or the error."""
        if self.failed:
            return f"{self.name}  {self.values['error']}"
        figures = [
            f"{what} {quantity(value, unit, self.number(f'{what}_sigma_{unit.lower()}'))}"
            for what, unit in (("depth", "mm"), ("force", "N"))
            if not math.isnan(value := self.number(f"{what}_{unit.lower()}"))
        ]
        figures += [f"{100 * self.number('good_share'):.1f} % good", *([] if self.new else ["as before"])]
        return f"{self.name}  {', '.join(figures)}"


class Table:
    """table.csv: a row a capture, each written as it comes. rows: by capture, of earlier runs, too; known:
    the file there is such a table."""

    def __init__(self, path: Path) -> None:
        self.path, self.known, self._columns, self.rows = path, False, list[str](), dict[str, Row]()
        with (
            suppress(OSError, UnicodeDecodeError, csv.Error),
            path.open(encoding="utf-8", newline="") as file,
        ):
            read = csv.DictReader(file)
            self.known = {*_FIRST, *_LAST} <= set(read.fieldnames or ())
            self.rows = {row["capture"]: Row(row, new=False) for row in read if self.known}

    def add(self, row: Row) -> None:
        """Write a row; a new column writes all anew."""
        self.rows[row.name] = row
        if not row.values.keys() <= set(self._columns):
            self.save()
            return
        try:
            with self.path.open("a", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, self._columns, lineterminator="\n")
                writer.writerow(row.values)
        except OSError as error:
            raise InputError(f"{self.path}: {reason_of(error)}") from error

    def save(self) -> None:
        """All rows, sorted by name."""
        names = dict.fromkeys(str(name) for row in self.rows.values() for name in row.values if name)
        self._columns = [*_FIRST, *(name for name in names if name not in (*_FIRST, *_LAST)), *_LAST]
        rows = (self.rows[name].values for name in sorted(self.rows))
        ol.files.write_rows(
            self.path, self._columns, ([row.get(each, "") for each in self._columns] for row in rows)
        )


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
        jobs = "Of several captures, whose results lie in the folder --out: processes of one thread each, or "
        jobs += "the address of a Dask cluster (extra cluster)."
        again = "Do captures again that table.csv has of an earlier run."
        self.params += [
            click.Option(["--jobs"], default="1", metavar="N|ADDRESS", help=jobs),
            click.Option(["--again"], is_flag=True, help=again),
        ]

    def invoke(self, ctx: click.Context) -> Any:
        """The command itself for one capture, else every capture's; 2 if one of them ended with an error."""
        jobs, again = (ctx.params.pop(name) for name in ("jobs", "again"))
        if ":" not in jobs and not (jobs.isdecimal() and int(jobs)):
            raise InputError(f"--jobs {jobs}: must be a number from 1 or an address, such as tcp://host:8786")
        captures = ctx.params[self.captures]
        if len(captures) < 2 or (self.folders and not all(capture.is_dir() for capture in captures)):
            return super().invoke(ctx)
        for parameter in self.params:
            output = isinstance(parameter.type, OutputFile) and parameter.name not in ("out", "save_profile")
            output |= parameter.name == "keep_rest"
            if output and ctx.params[parameter.name or ""]:
                text = f"{parameter.opts[0]}: is of one capture, not of {len(captures)}; leave it out"
                raise InputError(text)
        out = Path(ctx.params["out"])
        if out.suffix.lower() == ".npz":
            raise InputError(f"--out {out}: becomes a folder, of {len(captures)} captures; leave .npz out")
        batch = Batch(self, ctx.params, _by_name(captures), out, again, Table(out / "table.csv"))
        inputs, outputs = self.files({**ctx.params, "out": None})
        require_apart(inputs, [*batch.outputs(), *outputs])
        for capture in captures:
            if capture.is_dir() and out.resolve().is_relative_to(capture.resolve()):
                raise InputError(f"--out {out}: lies in the capture {capture}; name another folder")
        ol.files.require_folder(out, "table.csv")
        out.mkdir(exist_ok=True)
        rows = dict[str, Row]()
        try:
            with workers(jobs, self.imports) as run, progress() as step:
                from optolever.kernels import are_compiled

                if jobs.isdecimal() and not any(map(are_compiled, self.imports)):
                    step("compile kernels (once)")
                for row in batch.rows(run):
                    rows[row.name] = row
                    step(str(self.name), len(rows), len(batch.captures))
                    with step.aside():
                        click.echo(row.text(), err=row.failed)
        finally:
            for name in batch.captures:
                shutil.rmtree(batch.hidden(name), ignore_errors=True)
            for line in _notices(rows.values()):
                click.echo(line, err=True)
            batch.table.save()
            done = sum(not row.failed for row in rows.values())
            click.echo(f"{done} of {len(batch.captures)} captures done; {batch.table.path}")
        return 0 if done == len(batch.captures) else 2


@dataclass(frozen=True)
class Batch:
    """A command's parameters for captures by their names, sorted; out: the folder of their results; again:
    do also what is done; table: of the folder. InputError where one profile is asked for of captures of
    several kinds.

    A result is made in a hidden folder beside its place, and takes that once its row is written."""

    command: Many
    given: Mapping[str, Any]
    captures: Mapping[str, Path]
    out: Path
    again: bool
    table: Table
    token: str = field(default_factory=lambda: secrets.token_hex(4))

    def __post_init__(self) -> None:
        kept = self.given.get("save_profile")
        if kept is not None and len(self._kinds()) > 1:
            what = f"captures of {len(self._kinds())} kinds (patterns, size of the pictures)"
            raise InputError(f"--save-profile {kept}: {what} have no common profile; leave it out")

    def outputs(self) -> list[Output]:
        """The table, and results of every capture; an older one is of an earlier run if its row has all its
        names."""
        made = [Output(self.table.path, lambda _: self.table.known)]
        for name in self.captures:
            known = self.table.rows[name].files if name in self.table.rows else {}
            files = self.files(name).values()
            made += [Output(self.out / file, partial(_has, known.get(file, {}))) for file in files]
        return made

    def files(self, name: str) -> dict[str, str]:
        """Names of the results that a capture's command may write, by its parameters."""
        (kind,) = (parameter.type for parameter in self.command.params if parameter.name == "out")
        made = {"out": f"{name}.npz" if isinstance(kind, OutputFile) else name, "json_path": f"{name}.json"}
        return made | ({"save_profile": f".{name}.profile.npz"} if "save_profile" in self.given else {})

    def hidden(self, name: str) -> Path:
        """Folder of a capture's unfinished results, under their final names."""
        return self.out / f".{self.token}.{name}"

    def rows(self, run: Run) -> Iterator[Row]:
        """Of every capture, as it ends; a capture whose results agree with its row is not run."""
        if "save_profile" not in self.given or self.given["profile"] is not None:
            yield from self._of(run, list(self.captures), None, {})
            return
        for same in self._kinds():
            yield from self._of_one_kind(run, same)

    def _kinds(self) -> list[list[str]]:
        """Names of captures by what one profile may hold for."""
        kinds = dict[str, list[str]]()
        for name, capture in self.captures.items():
            kinds.setdefault(_kind(capture), []).append(name)
        return list(kinds.values())

    def _of_one_kind(self, run: Run, names: list[str]) -> Iterator[Row]:
        """Those of one kind: the first good one makes the profile, which all others use."""
        left = list(names)
        for name in names:
            given, file = self.given["save_profile"], self.files(name)["save_profile"]
            kept, anew = given or self.out / file, given is not None and not given.exists()
            (row,) = self._of(run, [name], None, {"save_profile": given or self.hidden(name) / file}, anew)
            share = row.values.get("mirror_good_share", row.values["good_share"])
            if not row.failed and float(share or 0) >= _GOOD:
                left.remove(name)
                yield row
                own = {"profile": kept, "save_profile": None}
                yield from self._of(run, left, str(row.values["digest"]), own)
                return
        yield from self._of(run, left, None, {"save_profile": None}, anew=True)

    def _of(
        self, run: Run, names: Sequence[str], profile: str | None, own: dict[str, Any], anew: bool = False
    ) -> Iterator[Row]:
        """Of some captures; profile: digest of the capture that made it; own: further parameters; anew: do
        also what is done."""
        beside = (*_BESIDE, self.command.captures)
        options = {name: value for name, value in self.given.items() if name not in beside}
        common: list[Any] = [ol.__version__, profile, options]
        common += [_stamp(file) for value in options.values() for file in files_named(value)]
        digests = {name: _digest([*common, _stamp(self.captures[name])]) for name in names}
        tasks = []
        for name in names:
            row = self.table.rows.get(name)
            same = row is not None and not row.failed and row.values.get("digest") == digests[name]
            if row is not None and same and not (anew or self.again) and self._unchanged(row):
                yield row
            else:
                tasks.append(self.task(name, own))
        for outcome in run(tasks):
            yield self._placed(outcome, digests[outcome.name])

    def _unchanged(self, row: Row) -> bool:
        """Whether results are there as they were made."""
        return {file: ol.files.stamps(self.out / file) for file in row.files} == row.files

    def _placed(self, outcome: Outcome, digest: str) -> Row:
        """Its row, and then its results to their places. An older one that has no successor is set aside."""
        name, hidden = outcome.name, self.hidden(outcome.name)
        older = self.table.rows[name].files if name in self.table.rows else {}
        made = {file: of for file in self.files(name).values() if (of := ol.files.stamps(hidden / file))}
        row = Row.of(replace(outcome, error=outcome.error.replace(f"{hidden.name}/", "")), digest, made)
        self.table.add(row)
        for file in self.files(name).values():
            if file in made:
                ol.files.put(hidden / file, self.out / file, older.get(file, {}))
            else:
                ol.files.aside(self.out / file)
        shutil.rmtree(hidden, ignore_errors=True)
        return row

    def task(self, name: str, own: Mapping[str, Any]) -> Task:
        """A capture's command, with parameters of its own."""
        assert self.command.callback is not None
        hidden = self.hidden(name)
        files = {key: hidden / file for key, file in self.files(name).items() if key != "save_profile"}
        parameters = {**self.given, self.command.captures: (self.captures[name],), **files, **own}
        return Task(name, self.command.callback.__module__, parameters, os.getcwd(), hidden)


def _has(known: Mapping[str, Any], path: Path) -> bool:
    """Whether all names of a result are known."""
    return bool(ol.files.stamps(path).keys() <= known.keys())


def _notices(rows: Collection[Row]) -> Iterator[str]:
    """Notices of all captures; several that differ only in numbers are one line, by the first."""
    same = dict[str, list[str]]()
    shares = sorted(row.number("good_share") for row in rows if not row.failed)
    for row in rows:
        notices = list(filter(None, str(row.values["notices"]).split(" | ")))
        good, usual = row.number("good_share"), shares[len(shares) // 2] if shares else 0.0
        if not row.failed and good < _FEWER * usual:
            notices.append(
                f"{100 * good:.0f} % of the pixels are good, {100 * usual:.0f} % of most captures'"
            )
        for notice in notices:
            same.setdefault(re.sub(r"\d[\d.,]*", "", notice), []).append(f"{row.name}: notice: {notice}")
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
