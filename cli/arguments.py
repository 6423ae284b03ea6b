"""Commands from functions: typed parameters are the arguments, the docstring is the help.

    @program("form", __doc__)
    def command(h: Annotated[Path, Arg("H.npz")], pitch: Annotated[float, Opt("--pitch MM", "...")] = 1.0):

Defaults are shown; an option without one is required. A tuple repeats, a bool is a flag, a Literal a choice.
"""

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import click

from .outputs import Option, Program

FILE = click.Path(path_type=Path)


class Finite(click.FloatRange):
    """A number, neither NaN nor infinite, in a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return found


ABOVE_0, AT_LEAST_0 = Finite(min=0, min_open=True), Finite(min=0)


@dataclass(frozen=True)
class Arg:
    """A positional argument."""

    metavar: str
    kind: click.ParamType[Any] | None = None
    required: bool = True

    def parameter(self, name: str, annotation: Any, _: Any) -> click.Parameter:
        """The argument of a function's parameter."""
        kind, many = _kind(annotation)
        count: dict[str, Any] = {"nargs": -1 if many else 1, "required": self.required}
        return click.Argument([name], type=self.kind or kind, metavar=self.metavar, **count)


@dataclass(frozen=True)
class Opt:
    """An option, "--flag METAVAR". rare: in --help-all only; lists: kind of names that --list prints
    (`names`)."""

    flag: str
    help: str = ""
    kind: click.ParamType[Any] | None = None
    rare: bool = False
    lists: str = ""

    def parameter(self, name: str, annotation: Any, default: Any) -> click.Parameter:
        """The option of a function's parameter."""
        flag, _, metavar = self.flag.partition(" ")
        kind, many = _kind(annotation)
        required = default is inspect.Parameter.empty
        shown = not required and default is not None and default is not False and default != ()
        made = Option(
            [flag, name],
            type=self.kind or (None if kind is bool else kind),
            is_flag=True if kind is bool else None,  # False would let its value be left out
            multiple=many,
            metavar=metavar or None,
            help=self.help,
            hidden=self.rare,
            **({"required": True} if required else {"default": default, "show_default": shown}),
        )
        made.lists, made.rare = self.lists, self.rare
        return made


@dataclass(frozen=True)
class Rare(Opt):
    """An option of --help-all."""

    rare: bool = True


def _kind(annotation: Any) -> tuple[Any, bool]:
    """Type of a value for click, and whether there may be several."""
    parts = [part for part in get_args(annotation) if part is not NoneType]
    origin = get_origin(annotation)
    if origin is Literal:
        return click.Choice(parts), False
    if origin is tuple and parts[-1] is Ellipsis:
        return _kind(parts[0])[0], True
    if origin in (Union, UnionType):
        return _kind(parts[0])
    return FILE if annotation is Path else annotation, False


def program(
    name: str,
    doc: str | None,
    kind: Callable[..., Program] = Program,
    listed: Mapping[str, Opt] | None = None,
) -> Callable[[Callable[..., Any]], Program]:
    """A command of a kind from a function; doc: of its module, ending in a sample session; listed: options of
    the values that the function takes as **; None where they are not given."""

    def made(function: Callable[..., Any]) -> Program:
        params = [mark.parameter(key, str, None) for key, mark in (listed or {}).items()]
        for each in inspect.signature(function).parameters.values():
            if each.kind is inspect.Parameter.VAR_KEYWORD:
                continue
            annotation, mark = get_args(each.annotation)
            params.append(mark.parameter(each.name, annotation, each.default))
        params += helping([each for each in params if isinstance(each, Option)])
        helped = inspect.getdoc(function)
        return kind(name, callback=function, params=params, help=helped, epilog=sample(doc))

    return made


def helping(options: list[Option]) -> list[click.Parameter]:
    """--list and --help-all of a command, where it has names or rare options."""
    listed, made = {each.lists: each.opts[0] for each in options if each.lists}, list[click.Parameter]()

    def names(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value:
            from .names import print_names

            scene_name = ctx.params.get("scene_name") or "paper-simulation"
            print_names(listed, scene_name, ctx.params.get("json_path"))
            ctx.exit()

    def all_options(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value:
            for each in options:
                each.hidden = False
            click.echo(ctx.get_help())
            for each in options:
                each.hidden = each.rare
            ctx.exit()

    if listed:
        text = f"Print the names of {', '.join(listed.values())}."
        made.append(click.Option(["--list"], is_flag=True, expose_value=False, callback=names, help=text))
    if any(each.rare for each in options):
        text = "Show this message with all options."
        settings: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False, "help": text}
        made.append(click.Option(["--help-all"], callback=all_options, **settings))
    return made


def sample(doc: str | None) -> str:
    """The session that a module's docstring ends in, for the end of --help, kept line by line."""
    _, prompt, session = (doc or "").partition("\n$ ")
    return "\b\nSample:\n" + "\n".join("  " + line for line in f"{prompt[1:]}{session}".splitlines())


class Shape(click.ParamType[tuple[int, int]]):
    """WIDTHxHEIGHT in pixels, as makers of cameras and displays say it; the value is (rows, cols)."""

    name = "WIDTHxHEIGHT"

    def __init__(self, least: int = 1) -> None:
        self.least = least

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        width, _, height = str(value).replace("×", "x").partition("x")
        if not (width.isdecimal() and height.isdecimal()):
            self.fail(f"{value!r} is not WIDTHxHEIGHT, such as 640x480", param, ctx)
        shape = int(height), int(width)
        if not all(self.least <= number <= 1 << 16 for number in shape):
            self.fail(f"{value!r} is not WIDTHxHEIGHT with {self.least} to 65536 each", param, ctx)
        return shape
