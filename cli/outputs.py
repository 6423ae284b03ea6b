"""Outputs of commands: checks of every output before any work.

An output is an option of type `OutputFile` or `ReportFolder`; all other files are inputs.
"""

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

import optolever as ol
from optolever.errors import InputError

HDF5 = (".h5", ".hdf5")
#: Formats of a regular grid of heights, and of a height map (`reconstruct.HEIGHT_FORMATS`; a test compares).
GRID_SUFFIXES = (".npz", ".tif", ".tiff", ".x3p", ".sdf", ".dat", ".wft", ".csv", ".npy")
HEIGHT_SUFFIXES = (*GRID_SUFFIXES, ".ply", ".stl", ".xyz")


class OutputFile(click.Path):
    """A file to write. suffixes: of the formats that the command writes; bare: without a suffix, too; folder:
    the command makes the file's folder where there is none.

    A device needs no suffix.
    """

    def __init__(self, *suffixes: str, bare: bool = True, folder: bool = False) -> None:
        super().__init__(path_type=Path)
        self.suffixes, self.bare, self.folder = suffixes, bare, folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        known = path.suffix.lower() in self.suffixes or (self.bare and not path.suffix)
        if not known and (path.is_file() or not path.exists()):
            must = " or ".join(self.suffixes)
            raise InputError(f"{_option(param)} {path}: suffix {path.suffix!r}, must be {must}".strip())
        return path


class ReportFolder(click.Path):
    """A folder to write into, created if absent, and its files."""

    def __init__(self, *files: str) -> None:
        super().__init__(path_type=Path)
        self.files = files

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        if path.suffix in {Path(name).suffix for name in self.files} and not path.is_dir():
            raise InputError(f"{_option(param)} {path}: must be a folder, it gets {', '.join(self.files)}")
        return path


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
        outputs, inputs, made = list[Path](), list[str](), set[Path]()
        for kind, value in self._values(parameters):
            if isinstance(kind, ReportFolder):
                ol.files.require_folder(value, *kind.files)
                outputs += [value / name for name in kind.files]
                made.add(value.absolute())
            elif isinstance(value, str | Path) and not isinstance(kind, OutputFile):
                inputs.append(str(value))
        for kind, value in self._values(parameters):
            if isinstance(kind, OutputFile):
                outputs.append(value)
                if kind.folder:
                    ol.files.require_folder(value.parent, value.name)
                elif value.absolute().parent not in made or value.parent.exists():
                    ol.files.require_writable(value)
        _require_apart(outputs, inputs)
        assert self.callback is not None
        return self.callback(**parameters)

    def _values(self, parameters: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
        """Type and value of every argument, those given several times one by one."""
        for parameter in self.params:
            value = parameters.get(parameter.name or "")
            for each in value if isinstance(value, tuple) else (value,):
                if each is not None:
                    yield parameter.type, each


def _require_apart(outputs: list[Path], inputs: list[str]) -> None:
    """InputError if two outputs are one file, or an output is an input."""
    for place, path in enumerate(outputs):
        if path.exists() and not path.is_file():
            continue  # devices take whatever comes
        for text in inputs:
            if any(_same(each, path) for each in files_named(text)) or _is_within(path, text):
                raise InputError(f"{path}: is an input ({text}), which it would destroy; name another output")
        if any(_same(path, other) for other in outputs[:place]):
            raise InputError(f"{path}: is named for two outputs, each needs a file of its own")


def _is_within(path: Path, text: str) -> bool:
    """Whether a command that is given a folder in a text reads this TOML file in it."""
    folders = (Path(name).resolve() for name in _texts(text) if os.path.isdir(name))
    return path.suffix == ".toml" and path.exists() and any(map(path.resolve().is_relative_to, folders))


def files_named(value: Any) -> list[Path]:
    """Files that an option's value names, and files that its TOML names, as of a rig; sorted."""
    names = {name for each in (value if isinstance(value, tuple) else (value,)) for name in _texts(str(each))}
    files = {Path(name) for name in names if os.path.isfile(name)}
    for file in [file for file in files if file.suffix == ".toml"]:
        inside = (file.parent / name for name in _texts(file.read_text("utf-8", "replace")))
        files |= {each for each in inside if os.path.isfile(each)}
    return sorted(files)


def _texts(text: str) -> set[str]:
    """A text and its parts, as in relief:path=picture.png, or the strings of TOML."""
    return {text, *re.split("[:=,\"'\n]", text)} - {""}


def _same(one: Path, other: Path) -> bool:
    """Whether two names lead to one file, existing or not, after links are resolved."""
    if one.exists() and other.exists():
        return one.is_file() and one.samefile(other)
    return os.path.realpath(one) == os.path.realpath(other)
