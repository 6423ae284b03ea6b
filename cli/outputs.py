"""Outputs of commands: checks of every output before any work.

An output is an option of type `OutputFile` or `ReportFolder`; all other files are inputs.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import click

import optolever as ol
from optolever.errors import InputError

HDF5 = (".h5", ".hdf5")
#: Files of captures and of recordings, beside results of the same suffix.
_OF_CAPTURE = ("truth.npz", "prepared.npz")
#: Of a report's folder; in full.
PAGE = ("report.html", "figures.csv", "height.npz", "deviation.npz")
PAGE_IN_FULL = ("correspondence.npz", "slopes.npz")
#: Formats of a height map (`reconstruct.HEIGHT_FORMATS`; a test compares): regular grids, meshes, points.
HEIGHT_SUFFIXES = (
    ".npz", ".tif", ".tiff", ".x3p", ".sdf", ".dat", ".wft", ".csv", ".npy", ".ply", ".stl", ".xyz",
)  # fmt: skip


class OutputFile(click.Path):
    """A file to write. suffixes: of the formats that the command writes; bare: without a suffix, too; folder:
    the command makes the file's folder where there is none; updates: a .toml keeps all but a section; beside:
    suffixes of files that the command writes beside a .toml.

    A device needs no suffix.
    """

    def __init__(
        self,
        *suffixes: str,
        bare: bool = True,
        folder: bool = False,
        updates: bool = False,
        beside: Sequence[str] = (),
    ) -> None:
        super().__init__(path_type=Path)
        self.suffixes, self.bare, self.folder = suffixes, bare, folder
        self.updates, self.beside = updates, beside

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        known = path.suffix.lower() in self.suffixes or (self.bare and not path.suffix)
        if not known and (path.is_file() or not path.exists()):
            must = " or ".join(self.suffixes)
            raise InputError(f"{_option(param)} {path}: suffix {path.suffix!r}, must be {must}".strip())
        return path


class NewFolder(click.Path):
    """A folder to make; an empty one is filled."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)


class ReportFolder(click.Path):
    """A folder to write into, created if absent, and its files; full: further ones of --full."""

    def __init__(self, *files: str, full: Sequence[str] = ()) -> None:
        super().__init__(path_type=Path)
        self.files, self.full = files, full

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        if path.suffix in {Path(name).suffix for name in self.files} and not path.is_dir():
            raise InputError(f"{_option(param)} {path}: must be a folder, it gets {', '.join(self.files)}")
        return path


@dataclass(frozen=True)
class Output:
    """A file or a folder that a command writes. made: whether an earlier run made the file that lies
    there, of one that no option names; updates: a file that is there keeps its other content."""

    path: Path
    made: Callable[[Path], bool] | None = None
    updates: bool = False


def _option(param: click.Parameter | None) -> str:
    return param.opts[0] if isinstance(param, click.Option) else ""


class Option(click.Option):
    """An option; lists, rare: as in `arguments.Opt`."""

    lists = ""
    rare = False


class Program(click.Command):
    """A command that begins only if each of its outputs may be written and none of them is an input."""

    def invoke(self, ctx: click.Context) -> Any:
        return self.run(ctx.params)

    def run(self, parameters: Mapping[str, Any]) -> Any:
        """Check, then run. InputError names the output."""
        require_apart(*self.files(parameters))
        assert self.callback is not None
        return self.callback(**parameters)

    def files(self, parameters: Mapping[str, Any]) -> tuple[list[str], list[Output]]:
        """Inputs, as texts that name them, and outputs. InputError of an output that cannot be written."""
        outputs, inputs, folders = list[Output](), list[str](), set[Path]()
        for kind, value in self._values(parameters):
            if isinstance(kind, ReportFolder):
                names = (*kind.files, *(kind.full if parameters.get("full") else ()))
                ol.files.require_folder(value, *names)
                outputs += [Output(value / name, _of_page) for name in names]
                folders.add(value.absolute())
            elif isinstance(kind, NewFolder):
                ol.files.require_new_folder(value)
            elif isinstance(kind, OutputFile):
                outputs.append(Output(value, updates=kind.updates and value.suffix.lower() == ".toml"))
            elif isinstance(value, str | Path):
                inputs.append(str(value))
            for suffix in getattr(kind, "beside", ()) if Path(str(value)).suffix == ".toml" else ():
                outputs.append(Output(value.with_suffix(suffix), partial(_of_rig, value)))
        if parameters.get("keep_rest"):
            rig = Path(parameters["scene_name"])
            outputs.append(Output(rig.with_suffix(".rest_places.npz"), partial(_of_rig, rig)))
        for kind, value in self._values(parameters):
            if isinstance(kind, OutputFile) and kind.folder:
                ol.files.require_folder(value.parent, value.name)
            elif isinstance(kind, OutputFile) and (
                value.absolute().parent not in folders or value.parent.exists()
            ):
                ol.files.require_writable(value)
        return inputs, outputs

    def _values(self, parameters: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
        """Type and value of every argument, those given several times one by one."""
        for parameter in self.params:
            value = parameters.get(parameter.name or "")
            for each in value if isinstance(value, tuple) else (value,):
                if each is not None:
                    yield parameter.type, each


def require_apart(inputs: Sequence[str], outputs: Sequence[Output]) -> None:
    """InputError if two outputs are one file, an output is an input or a part of one, or if one that no
    option names would take the place of what no earlier run made."""
    texts = {name: text for text in inputs for name in _texts(text) if os.path.exists(name)}
    direct = {_identity(Path(name)): text for name, text in texts.items()}
    named = {_identity(file): text for text in inputs for file in files_named(text)}
    folders = {Path(name).resolve(): text for name, text in texts.items() if os.path.isdir(name)}
    seen = set[Any]()
    for output in outputs:
        path = output.path
        if path.exists() and not (path.is_file() or path.is_dir()):
            continue  # devices take whatever comes
        key = _identity(path)
        text = direct.get(key, None if output.made else named.get(key)) or _captured(path.resolve(), folders)
        if text is not None and not output.updates:
            raise InputError(f"{path}: is an input ({text}), which it would destroy; name another output")
        if key in seen:
            raise InputError(f"{path}: is named for two outputs, each needs a file of its own")
        if output.made and os.path.lexists(path) and not output.made(path):
            why = "was not made by this command, or changed since, and would be replaced"
            raise InputError(f"{path}: {why}; move it, or name another output")
        seen.add(key)


def _identity(path: Path) -> Any:
    """The same of two names of one file or folder, by links too; of what does not exist, its path."""
    try:
        about = path.stat()
    except OSError:
        return os.path.realpath(path)
    return about.st_dev, about.st_ino


def _captured(path: Path, folders: Mapping[Path, str]) -> str | None:
    """The text that names a folder, if a file in it is of a capture or of a recording, or a picture: all but
    results."""
    result = path.suffix in (".npz", ".json", ".csv", ".html") and path.name not in _OF_CAPTURE
    above = path.parents[1:] if result else path.parents
    return next((folders[each] for each in above if each in folders), None) if path.is_file() else None


def _of_rig(rig: Path, path: Path) -> bool:
    """Whether a file beside a rig's TOML is the rig's: the TOML names it; a picture, and the rest of `live`,
    has this program's mark."""
    if path.name.endswith((".png", ".live.npz")):
        return _marked(path)
    return rig.is_file() and path.name in _strings(rig)


def _of_page(path: Path) -> bool:
    """Whether a file is of a report: its folder has a page with this program's mark and a table of figures,
    and a file of arrays has the mark, too."""
    page, table = (path.with_name(name) for name in PAGE[:2])
    return (
        all(_marked(each) for each in {page, path} - {table})
        and table.is_file()
        and table.read_bytes().startswith(b"name,value,sigma,unit\n")
    )


def _marked(path: Path) -> bool:
    content = path.read_bytes() if path.is_file() else b""
    return ol.files.MARK in content[:512] + content[-64:]


def files_named(value: Any) -> list[Path]:
    """Files that an option's value names, and files that its TOML names, as of a rig; sorted."""
    names = {name for each in (value if isinstance(value, tuple) else (value,)) for name in _texts(str(each))}
    files = {Path(name) for name in names if os.path.isfile(name)}
    for file in [file for file in files if file.suffix == ".toml"]:
        files |= {file.parent / name for name in _strings(file) if os.path.isfile(file.parent / name)}
    return sorted(files)


def _strings(toml: Path) -> set[str]:
    """The strings of a TOML file, and their parts."""
    text = toml.read_text("utf-8", "replace")
    return {part for string in re.findall("[\"'](.+?)[\"']", text) for part in _texts(string)}


def _texts(text: str) -> set[str]:
    """All that stands between two marks at which commands split a text, as in relief:path=picture.png."""
    cuts = [-1, *(mark.start() for mark in re.finditer("[:=,@]", text)), len(text)]
    return {text[start + 1 : end] for start, end in combinations(cuts, 2)} - {""}
