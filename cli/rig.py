"""`optolever rig new`: the TOML of a rig from sizes, angles, distances and lens."""

import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from optolever import InputError

from .options import DISPLAY, json_option, sample
from .outputs import OutputFile, Program
from .show import number, table, write_json

if TYPE_CHECKING:
    from optolever.scene import TypedRig

__all__ = ["command"]

SAMPLE = """
$ optolever rig new --kind monitor --mirror 150x110 --display 1920x1080 --diagonal 24 \\
      --image 1280x1024 --focal 25.5 --pixel 0.0048 --angle 36.87 --distance 500 \\
      --display-distance 400 --out rig.toml --json rig.json
Rig in rig.toml
  kind     monitor
  display  531.3 x 298.9 mm, pixels of 0.2767 mm
  visible  95.83 % of the pixels see the display in the mirror at rest
  drawing  rig.png
"""

TWO = re.compile(r"([\d.]+)\s*[x×]\s*([\d.]+)")


class _Lengths(click.ParamType[tuple[float, float]]):
    """LENGTHxWIDTH in mm."""

    name = "LENGTHxWIDTH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        match = TWO.fullmatch(str(value)) if not isinstance(value, tuple) else None
        try:
            length, width = value if match is None else match.groups()
            return float(length), float(width)
        except ValueError:
            self.fail(f"{value!r} is not LENGTHxWIDTH in mm, such as 150x110", param, ctx)


LENGTHS, ABOVE_0 = _Lengths(), click.FloatRange(min=0, min_open=True)
ACUTE = click.FloatRange(min=0, max=90, min_open=True, max_open=True)


@dataclass(frozen=True, slots=True)
class _Item:
    """A number of a rig: what to ask, how it is read, which kind of rig has it, what it is by default."""

    question: str
    read: click.ParamType[Any]
    metavar: str
    kinds: tuple[str, ...] = ("monitor", "prism")
    default: Any = None


#: By option.
ITEMS: Mapping[str, _Item] = {
    "mirror": _Item("Mirror, length (along x) x width, mm", LENGTHS, "LENGTHxWIDTH"),
    "display": _Item("Display, columns x rows", DISPLAY, "COLSxROWS"),
    "diagonal": _Item("Diagonal of the display, inches", ABOVE_0, "INCHES"),
    "image": _Item("Camera's image, columns x rows", DISPLAY, "COLSxROWS"),
    "focal": _Item("Focal length, mm", ABOVE_0, "MM"),
    "pixel": _Item("Pitch of the camera's pixels, mm", ABOVE_0, "MM"),
    "angle": _Item(
        "Monitor: angle of the line of sight with the mirror's normal; prism: of the camera's face with the "
        "mirror; degrees",
        ACUTE,
        "DEG",
    ),
    "distance": _Item("Camera to the middle of the mirror, mm", ABOVE_0, "MM"),
    "display_distance": _Item("Display's middle to the mirror's middle, mm", ABOVE_0, "MM", ("monitor",)),
    "display_angle": _Item("Angle of the display's face with the mirror, degrees", ACUTE, "DEG", ("prism",)),
    "bezel": _Item(
        "From the mirror's edge to the display's first pixel, mm",
        click.FloatRange(min=0),
        "MM",
        ("prism",),
        0.0,
    ),
    "index": _Item("Index of refraction of the prism", click.FloatRange(min=1), "N", ("prism",)),
}
Command = Callable[..., Any]


def _items(function: Command) -> Command:
    for name, item in reversed(list(ITEMS.items())):
        only = f" ({item.kinds[0]} only)" if len(item.kinds) == 1 else ""
        also = f", default {item.default:g}" if item.default is not None else ""
        option = click.option(
            f"--{name.replace('_', '-')}",
            name,
            type=item.read,
            metavar=item.metavar,
            help=item.question + also + only + ".",
        )
        function = option(function)
    return function


@click.group("rig", epilog=sample(SAMPLE))
def command() -> None:
    """Describe a rig."""


@command.command("new", cls=Program, epilog=sample(SAMPLE))
@click.option("--kind", type=click.Choice(["monitor", "prism"]), help="Mirror in open air, or a prism.")
@_items
@click.option(
    "--pitch", type=ABOVE_0, metavar="MM", help="Pitch of the display's pixels, in place of --diagonal."
)
@click.option("--out", type=OutputFile(".toml", bare=False), required=True, metavar="RIG.toml")
@click.option(
    "--picture", type=OutputFile(".png", ".svg", bare=False), metavar="FILE", help="Default: RIG.png."
)
@json_option
def new(
    kind: str | None,
    pitch: float | None,
    out: Path,
    picture: Path | None,
    json_path: Path | None,
    **given: Any,
) -> None:
    """Write the TOML of a rig and draw it from the side.

    On a terminal, missing values are asked for. The camera points at the mirror's middle; a monitor is
    perpendicular to the reflected line of sight; a prism's face is perpendicular to the camera's.
    """
    import matplotlib as mpl

    from optolever.files import atomic_file, together
    from optolever.scene import dent, load, resize, rig_toml, trace

    kind = kind or _asked("kind", "monitor or prism", click.Choice(["monitor", "prism"]), None)
    values = {**given, "pitch": pitch}
    for name, item in ITEMS.items():
        if kind not in item.kinds and given[name] is not None:
            raise InputError(
                f"--{name.replace('_', '-')}: applies to --kind {item.kinds[0]}, --kind is {kind}; "
                "leave it out"
            )
    for name, item in ITEMS.items():
        if kind not in item.kinds:
            continue
        if values[name] is None and not (name == "diagonal" and pitch is not None):
            values[name] = _asked(name, item.question, item.read, item.default)
    if values["pitch"] is None:
        rows, cols = values["display"]
        values["pitch"] = 25.4 * values["diagonal"] / math.hypot(rows, cols)
    drawn = picture or out.with_suffix(".png")
    mpl.use("agg")
    with together():
        with atomic_file(out) as temporary:
            temporary.write_text(rig_toml(out.stem, _typed(kind, values)), encoding="utf-8")
            rig = load(temporary)
        few = resize(rig, *(min(size, 120) for size in values["image"]))
        seen = float(trace(few, dent("flat", few)).visible.mean())
        with atomic_file(drawn) as temporary:
            rig.plot().figure.savefig(temporary)
        rows, cols = values["display"]
        sides = [size * values["pitch"] for size in (cols, rows)]
        numbers = {"kind": kind, "visible_share": seen, "display_mm": sides, "pitch_mm": values["pitch"]}
        write_json(json_path, numbers)
    table(
        f"Rig in {out}",
        {
            "kind": kind,
            "display": f"{number(sides[0])} x {number(sides[1])} mm, pixels of {number(values['pitch'])} mm",
            "visible": f"{number(100 * seen)} % of the pixels see the display in the mirror at rest",
            "drawing": str(drawn),
        },
    )


def _typed(kind: str, values: Mapping[str, Any]) -> "TypedRig":
    from optolever.scene import TypedRig

    names = ("mirror", "display", "pitch", "image", "focal", "pixel", "distance")
    common = {name: values[name] for name in names} | {"angle": math.radians(values["angle"])}
    if kind == "monitor":
        return TypedRig(**common, display_distance=values["display_distance"])
    face = math.radians(values["display_angle"])
    return TypedRig(**common, display_angle=face, bezel=values["bezel"], index=values["index"])


def _asked(name: str, question: str, read: click.ParamType[Any], default: Any) -> Any:
    """The answer of whoever sits at the terminal; without one the default. InputError if there is none."""
    if sys.stdin.isatty():
        return click.prompt(question, type=read, default=default)
    if default is None:
        raise InputError(f"--{name.replace('_', '-')} is missing, must be given: {question}")
    return default
