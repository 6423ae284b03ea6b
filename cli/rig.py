"""`optolever rig new`: the TOML of a rig from sizes, angles, distances and lens."""

import math
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import click

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, AT_LEAST_0, Opt, Shape, program, sample
from .options import Json
from .outputs import OutputFile
from .show import number, table, write_json

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


class _Lengths(click.ParamType[tuple[float, float]]):
    """LENGTHxWIDTH in mm."""

    name = "LENGTHxWIDTH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        match = re.fullmatch(r"(\d+\.?\d*)\s*[x×]\s*(\d+\.?\d*)", str(value))
        if match is None:
            self.fail(f"{value!r} is not LENGTHxWIDTH in mm, such as 150x110", param, ctx)
        return float(match[1]), float(match[2])


#: Numbers that one kind of rig has.
ONLY = {
    "display_distance": "monitor",
    "display_angle": "prism",
    "bezel": "prism",
    "across": "prism",
    "index": "prism",
}
ACUTE = click.FloatRange(min=0, max=90, min_open=True, max_open=True)
MIRROR = Opt("--mirror LENGTHxWIDTH", "Mirror, length (along x) x width, mm", _Lengths())
DISTANCE = Opt("--distance MM", "Camera to the middle of the mirror, mm", ABOVE_0)
DIAGONAL = Opt("--diagonal INCHES", "Diagonal of the display, inches", ABOVE_0)
ANGLE = Opt("--angle DEG", "Line of sight to the mirror's normal; prism: camera's face to mirror", ACUTE)
AWAY = Opt("--display-distance MM", "Monitor: display's middle to the mirror's middle, mm", ABOVE_0)
FACE = Opt("--display-angle DEG", "Prism: angle of the display's face with the mirror, degrees", ACUTE)
BEZEL = Opt("--bezel MM", "Prism: from the mirror's edge to the display's first pixel, mm; 0", AT_LEAST_0)
ACROSS = Opt(
    "--across MM",
    "Prism: from the mirror's side y = 0 to the display's first pixel, mm; centred",
    click.FLOAT,
)
CAMERA = Opt("--camera ADDRESS", "[devices]: camera, as `optolever camera devices` lists it; empty: none")
SCREEN = Opt("--monitor NAME", "[devices]: display, as `optolever camera devices` lists it; empty: none")
INDEX = Opt("--index N", "Prism: index of refraction", click.FloatRange(min=1))
PITCH = Opt("--pitch MM", "Pitch of the display's pixels, in place of --diagonal.", ABOVE_0)
OUT = Opt("--out RIG.toml", "File to write.", OutputFile(".toml", bare=False))
PICTURE = Opt("--picture FILE", "Default: RIG.png.", OutputFile(".png", ".svg", bare=False))
Number: TypeAlias = float | None
Pair: TypeAlias = tuple[int, int] | None


@click.group("rig", epilog=sample(SAMPLE))
def command() -> None:
    """Describe a rig."""


@command.add_command
@program("new", SAMPLE)
def new(
    out: Annotated[Path, OUT],
    kind: Annotated[Literal["monitor", "prism"] | None, Opt("--kind monitor|prism", "Kind of rig")] = None,
    mirror: Annotated[Pair, MIRROR] = None,
    display: Annotated[Pair, Opt("--display WIDTHxHEIGHT", "Display, columns x rows", Shape())] = None,
    diagonal: Annotated[Number, DIAGONAL] = None,
    image: Annotated[Pair, Opt("--image WIDTHxHEIGHT", "Camera's image, columns x rows", Shape())] = None,
    focal: Annotated[Number, Opt("--focal MM", "Focal length, mm", ABOVE_0)] = None,
    pixel: Annotated[Number, Opt("--pixel MM", "Pitch of the camera's pixels, mm", ABOVE_0)] = None,
    angle: Annotated[Number, ANGLE] = None,
    distance: Annotated[Number, DISTANCE] = None,
    display_distance: Annotated[Number, AWAY] = None,
    display_angle: Annotated[Number, FACE] = None,
    bezel: Annotated[Number, BEZEL] = None,
    across: Annotated[Number, ACROSS] = None,
    index: Annotated[Number, INDEX] = None,
    pitch: Annotated[Number, PITCH] = None,
    camera: Annotated[str | None, CAMERA] = None,
    monitor: Annotated[str | None, SCREEN] = None,
    picture: Annotated[Path | None, PICTURE] = None,
    json_path: Json = None,
) -> None:
    """Write the TOML of a rig and draw it from the side.

    On a terminal, missing values are asked for, among them the devices to capture with ([devices]). The
    camera points at the mirror's middle; a monitor is perpendicular to the reflected line of sight; a prism's
    face is perpendicular to the camera's.
    """
    import matplotlib as mpl

    context = click.get_current_context()
    options = {each.name or "": each for each in context.command.params if isinstance(each, click.Option)}
    values = dict(context.params) | {"kind": kind or _asked(options["kind"])}
    kind = values["kind"]
    for name, only in ONLY.items():
        if only != kind and values[name] is not None:
            wrong = f"applies to --kind {only}, --kind is {kind}; leave it out"
            raise InputError(f"{options[name].opts[0]}: {wrong}")
    asked = ["mirror", "display", "diagonal", "image", "focal", "pixel", "angle", "distance"]
    for name in (*asked, *(name for name, only in ONLY.items() if only == kind)):
        if values[name] is None and name != "across" and (name != "diagonal" or pitch is None):
            values[name] = _asked(options[name], 0.0 if name == "bezel" else None)
    if pitch is None:
        values["pitch"] = 25.4 * values["diagonal"] / math.hypot(*values["display"])
    if kind == "prism" and across is None:
        values["across"] = _asked(options["across"], round(_typed(values).offset_across, 4))
    chosen = {"camera": camera, "display": monitor}
    for name, option in (("camera", "camera"), ("display", "monitor")):
        chosen[name] = _asked(options[option], "") if chosen[name] is None else chosen[name]
    devices = {name: address for name, address in chosen.items() if address}
    drawn = picture or out.with_suffix(".png")
    mpl.use("agg")
    with ol.files.together():
        with ol.files.atomic_file(out) as temporary:
            temporary.write_text(ol.scene.rig_toml(out.stem, _typed(values)), encoding="utf-8")
            if devices:
                ol.scene.write_sections(temporary, {"devices": devices})
            rig = ol.scene.load(temporary)
        few = ol.scene.resize(rig, *(min(size, 120) for size in values["image"]))
        seen = float(ol.scene.trace(few, ol.scene.dent("flat", few)).visible.mean())
        with ol.files.atomic_file(drawn) as temporary:
            rig.plot().figure.savefig(temporary)
        sides = [size * values["pitch"] for size in values["display"][::-1]]
        numbers = {"kind": kind, "visible_share": seen, "display_mm": sides, "pitch_mm": values["pitch"]}
        write_json(json_path, numbers)
    rows = {
        "kind": kind,
        "display": f"{number(sides[0])} x {number(sides[1])} mm, pixels of {number(values['pitch'])} mm",
        "visible": f"{number(100 * seen)} % of the pixels see the display in the mirror at rest",
        "drawing": str(drawn),
    }
    table(f"Rig in {out}", rows)


def _typed(values: Mapping[str, Any]) -> "ol.scene.TypedRig":
    names = ["mirror", "display", "pitch", "image", "focal", "pixel", "distance", "angle"]
    names += [name for name, only in ONLY.items() if only == values["kind"]]
    numbers: dict[str, Any] = {name: values[name] for name in names}
    numbers |= {name: math.radians(numbers[name]) for name in ("angle", "display_angle") if name in names}
    return ol.scene.TypedRig(**numbers)


def _asked(option: click.Option, default: Any = None) -> Any:
    """The answer of whoever sits at the terminal; without one the default. InputError if there is none."""
    if sys.stdin.isatty():
        return click.prompt(option.help or "", type=option.type, default=default)
    if default is None:
        raise InputError(f"{option.opts[0]} is missing, must be given: {option.help}")
    return default
