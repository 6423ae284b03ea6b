"""`optolever rig new`: the TOML of a rig from sizes, angles, distances and lens."""

import sys
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import click

import optolever as ol
from optolever import InputError

from ..arguments import ABOVE_0, Opt, program, sample
from ..options import Json
from ..outputs import OutputFile
from ..printing import number, table, write_json
from .questions import QUESTIONS, Question, questions_of, typed_rig

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


QUESTION = {each.name: each for each in QUESTIONS}
CAMERA = Opt("--camera ADDRESS", "[devices]: camera, as `optolever camera devices` lists it; empty: none")
SCREEN = Opt("--monitor NAME", "[devices]: display, as `optolever camera devices` lists it; empty: none")
FOCAL = Opt("--focal MM", "Focal length, with --pixel in place of the view.", ABOVE_0)
PIXEL = Opt("--pixel MM", "Pitch of the camera's pixels, with --focal.", ABOVE_0)
PITCH = Opt("--pitch MM", "Pitch of the display's pixels, in place of --diagonal.", ABOVE_0)
DRAWN = OutputFile(".toml", bare=False, beside=(".png",))
OUT = Opt("--out RIG.toml", "File to write; RIG.png is its drawing.", DRAWN)
Number: TypeAlias = float | None


@click.group("rig", epilog=sample(SAMPLE))
def command() -> None:
    """Describe a rig."""


@command.add_command
@program("new", SAMPLE, listed={each.name: each.option for each in QUESTIONS})
def new(
    out: Annotated[Path, OUT],
    focal: Annotated[Number, FOCAL] = None,
    pixel: Annotated[Number, PIXEL] = None,
    pitch: Annotated[Number, PITCH] = None,
    camera: Annotated[str | None, CAMERA] = None,
    monitor: Annotated[str | None, SCREEN] = None,
    json_path: Json = None,
    **answers: Any,
) -> None:
    """Write the TOML of a rig and draw it from the side.

    On a terminal, missing values are asked for, among them the devices to capture with ([devices]). The
    camera points at the mirror's middle; a monitor is perpendicular to the reflected line of sight; a prism's
    face is perpendicular to the camera's.
    """
    values = answers | {"focal": focal, "pixel": pixel, "pitch": pitch}
    values["kind"] = kind = answers["kind"] or _asked(QUESTION["kind"], "monitor")
    for each in QUESTIONS:
        if each.only not in ("", kind) and values[each.name] is not None:
            wrong = f"applies to --kind {each.only}, --kind is {kind}; leave it out"
            raise InputError(f"{each.flag}: {wrong}")
    if (focal is None) != (pixel is None):
        raise InputError("--focal and --pixel: one is given, both must be")
    in_place = {"diagonal": pitch, "view_distance": focal, "view_width": focal}
    for each in questions_of(kind):
        if values[each.name] is None and each.name != "across" and in_place.get(each.name) is None:
            values[each.name] = _asked(each, kind)
    if kind == "prism" and answers["across"] is None:
        centred = round(typed_rig(values).offset_across, 4)
        values["across"] = _asked(QUESTION["across"], kind, str(centred))
    chosen = {"camera": camera, "display": monitor}
    for name, option in (("camera", CAMERA), ("display", SCREEN)):
        if chosen[name] is None:
            chosen[name] = click.prompt(option.help, default="") if sys.stdin.isatty() else ""
    devices = {name: address for name, address in chosen.items() if address}
    typed, drawn = typed_rig(values), out.with_suffix(".png")
    with ol.files.together():
        with ol.files.atomic_file(out) as temporary:
            temporary.write_text(ol.scene.rig_toml(out.stem, typed), encoding="utf-8")
            if devices:
                ol.scene.write_sections(temporary, {"devices": devices})
            rig = ol.scene.load(temporary)
        with ol.files.atomic_file(drawn) as temporary:
            draw_rig(rig, temporary)
        sides = [size * typed.pitch for size in typed.display[::-1]]
        visible = visible_share(rig)
        numbers = {"kind": kind, "visible_share": visible, "display_mm": sides, "pitch_mm": typed.pitch}
        write_json(json_path, numbers)
    rows = {
        "kind": kind,
        "display": f"{number(sides[0])} x {number(sides[1])} mm, pixels of {number(typed.pitch)} mm",
        "visible": f"{number(100 * visible)} % of the pixels see the display in the mirror at rest",
        "drawing": str(drawn),
    }
    table(f"Rig in {out}", rows)


def visible_share(rig: "ol.scene.Scene") -> float:
    """Share of the camera's pixels that see the display in the mirror at rest."""
    few = ol.scene.resize(rig, min(rig.camera.rows, 120), min(rig.camera.cols, 120))
    return float(ol.scene.trace(few, ol.scene.dent("flat", few)).visible.mean())


def draw_rig(rig: "ol.scene.Scene", out: Path) -> None:
    """The rig from the side, as a picture."""
    from matplotlib.figure import Figure

    from optolever.records import default_style

    with default_style():
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        rig.plot(figure.add_subplot())
        figure.savefig(out, metadata={"Software": ol.files.MARK.decode()})


def _asked(question: Question, kind: str, default: str = "") -> Any:
    """The answer of whoever sits at the terminal; elsewhere a default that is a number of zero or computed.
    InputError if there is none."""
    if sys.stdin.isatty():
        offered = default or question.default(kind)
        return click.prompt(
            question.text, type=question.kind, default=question.kind.convert(offered, None, None)
        )
    offered = default or ("0" if question.name == "bezel" else "")
    if not offered or question.name == "kind":
        raise InputError(f"{question.flag} is missing, must be given: {question.text}")
    return question.kind.convert(offered, None, None)
