"""`optolever rig new`: the TOML of a rig from sizes, angles, distances and lens.

$ optolever rig new --kind monitor --mirror 150x110 --display 1920x1080 --diagonal 24 \\
      --image 1280x1024 --view-distance 500 --view-width 120 --angle 36.87 --distance 500 \\
      --display-distance 400 --out rig.toml --json rig.json
Rig in rig.toml
  kind     monitor
  display  531.3 x 298.9 mm, pixels of 0.2767 mm
  visible  95.83 % of the pixels see the display in the mirror at rest
  drawing  rig.png
"""

from pathlib import Path
from typing import Annotated, Any

import click

import optolever as ol
from optolever import InputError

from ..arguments import Opt, program, sample
from ..options import Json
from ..outputs import OutputFile
from ..printing import number, table, write_json
from .questions import QUESTIONS, questions_of, typed_rig

DRAWN = OutputFile(".toml", bare=False, beside=(".png",))
OUT = Opt("--out RIG.toml", "File to write; RIG.png is its drawing.", DRAWN)
#: Of questions that need no answer: a centred display at the mirror's edge.
FREE = {"across": None, "bezel": 0.0}


@click.group("rig", epilog=sample(__doc__))
def command() -> None:
    """Describe a rig."""


@command.add_command
@program("new", __doc__, listed={each.name: each.option for each in QUESTIONS})
def new(out: Annotated[Path, OUT], json_path: Json = None, **answers: Any) -> None:
    """Write the TOML of a rig and draw it from the side.

    By the numbers for which `optolever start` asks. The camera points at the mirror's middle; a monitor is
    perpendicular to the reflected line of sight; a prism's face is perpendicular to the camera's. The view is
    as wide as the sensor times its distance over the focal length.
    """
    given = FREE | {name: value for name, value in answers.items() if value is not None}
    kind = str(given.get("kind", ""))
    for each in QUESTIONS:
        if kind and each.only not in ("", kind) and answers[each.name] is not None:
            wrong = f"applies to --kind {each.only}, --kind is {kind}; leave it out"
            raise InputError(f"{each.flag}: {wrong}")
    for each in questions_of(kind):
        if each.name not in given:
            raise InputError(f"{each.flag} is missing, must be given: {each.text} (optolever start asks)")
    typed, drawn = typed_rig(given), out.with_suffix(".png")
    with ol.files.together():
        with ol.files.atomic_file(out) as temporary:
            temporary.write_text(ol.scene.rig_toml(out.stem, typed), encoding="utf-8")
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
