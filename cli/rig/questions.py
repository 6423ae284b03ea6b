"""The questions about a rig, one list: the options of `rig new` and the fields of `start`."""

import math
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

import optolever as ol

from ..arguments import ABOVE_0, AT_LEAST_0, Finite, Opt, Shape

__all__ = [
    "BALL", "KINDS", "QUESTIONS", "TAPE", "UNKNOWN", "VIEW_60", "Question", "questions_of", "scene_of",
    "typed_rig",
]  # fmt: skip

KINDS = ("monitor", "prism")
#: Relative standard deviation of a focal length: by the width of the view by tape; by 60 degrees.
TAPE, VIEW_60 = 0.05, 0.1
UNKNOWN = "?"
#: Width of a simulated camera's view, mm, by kind: the reflection fills 60 % of its picture.
SIMULATED_VIEW = {"monitor": "330", "prism": "280"}
_MATERIALS = {"silicone": 1.41, "acrylic": 1.49, "epoxy": 1.5, "glass": 1.52, "polycarbonate": 1.585}


class _Lengths(click.ParamType[tuple[float, float]]):
    """LENGTHxWIDTH in mm."""

    name = "LENGTHxWIDTH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        match = re.fullmatch(r"(\d+\.?\d*)\s*[x×]\s*(\d+\.?\d*)", str(value).strip())
        if match is None or not (0 < float(match[1]) < 1e5 and 0 < float(match[2]) < 1e5):
            self.fail(f"{value!r} is not LENGTHxWIDTH in mm, such as 150x110", param, ctx)
        return float(match[1]), float(match[2])


class _Index(click.ParamType[float]):
    """An index of refraction, or a material's."""

    name = "N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if str(value).strip().lower() in _MATERIALS:
            return _MATERIALS[str(value).strip().lower()]
        if re.fullmatch(r"\d+\.?\d*", str(value).strip()) is None or not 1 <= float(value) <= 3:
            self.fail(f"{value!r} is neither 1 to 3 nor {', '.join(_MATERIALS)}", param, ctx)
        return float(value)


class _Width(click.ParamType[float]):
    """mm; 0: unknown."""

    name = "MM"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return 0.0 if str(value).strip() == UNKNOWN else ABOVE_0.convert(value, param, ctx)


@dataclass(frozen=True)
class Question:
    """An option of `rig new`, a field of `start`. text: with its unit; wrong: the effect of a wrong answer;
    defaults: of a monitor rig and of a prism, as typed; only: the kind of rig that has it; prism: its text
    there, where it differs."""

    name: str
    metavar: str
    kind: click.ParamType[Any]
    text: str
    wrong: str
    defaults: tuple[str, str]
    only: str = ""
    prism: str = ""

    @property
    def flag(self) -> str:
        """Of the command line."""
        return "--" + self.name.replace("_", "-")

    @property
    def option(self) -> Opt:
        """Of the command line."""
        text = f"{self.text}; {self.only} only" if self.only else self.text
        text = f"{text}; of a prism: {self.prism}" if self.prism else text
        return Opt(f"{self.flag} {self.metavar}", text, self.kind)

    def default(self, kind: str) -> str:
        """As typed; empty: none."""
        return self.defaults[KINDS.index(kind)]

    def typed(self, value: Any) -> str:
        """A converted answer, as it is typed."""
        if isinstance(value, tuple):
            pair = value[::-1] if isinstance(self.kind, Shape) else value
            return f"{pair[0]:g}x{pair[1]:g}"
        return UNKNOWN if isinstance(self.kind, _Width) and value == 0 else f"{value:.10g}"


_ACUTE = Finite(min=0, max=90, min_open=True, max_open=True)
_TURNED = "a degree changes heights by 3 to 12 %; the capture at rest corrects most of it"
#: In the order in which they are asked.
QUESTIONS: tuple[Question, ...] = (
    Question(
        "kind", "monitor|prism", click.Choice(KINDS),
        "Kind of rig: a mirror in open air before a monitor, or a prism with a display on one face",
        "nothing fits: the patterns are found elsewhere on the display", ("monitor", "prism"),
    ),
    Question(
        "mirror", "LENGTHxWIDTH", _Lengths(), "Mirror, length (along x) x width, mm",
        "the reflection ends elsewhere than drawn; heights start at another edge", ("150x110", "60x45"),
    ),
    Question(
        "display", "WIDTHxHEIGHT", Shape(), "Display, columns x rows",
        "the display cannot show the patterns", ("1920x1080", "1080x1920"),
    ),
    Question(
        "diagonal", "INCHES", ABOVE_0, "Diagonal of the display, inches",
        "all heights scale with it", ("24", "5.5"),
    ),
    Question(
        "image", "WIDTHxHEIGHT", Shape(), "Camera's image, columns x rows",
        "no capture is accepted", ("640x480", "640x480"),
    ),
    Question(
        "angle", "DEG", _ACUTE, "Camera's line of sight to the mirror's normal, degrees",
        _TURNED, ("30", "50"), prism="Camera's face to the mirror, degrees",
    ),
    Question(
        "distance", "MM", ABOVE_0, "Camera to the middle of the mirror, mm",
        "x, y and heights scale with it", ("250", "120"),
    ),
    Question(
        "display_distance", "MM", ABOVE_0, "Display's middle to the mirror's middle, mm",
        "twice as far halves all heights", ("400", ""), "monitor",
    ),
    Question(
        "display_angle", "DEG", _ACUTE, "Angle of the display's face with the mirror, degrees",
        _TURNED, ("", "48"), "prism",
    ),
    Question(
        "bezel", "MM", AT_LEAST_0, "From the mirror's edge to the display's first pixel, mm",
        "0.5 mm costs 2 % of a height", ("", "0"), "prism",
    ),
    Question(
        "across", "MM", Finite(), "From the mirror's side y = 0 to the display's first pixel, mm",
        "the patterns lie elsewhere; the capture at rest corrects it", ("", ""), "prism",
    ),
    Question(
        "index", "N", _Index(), f"Index of refraction, or {', '.join(_MATERIALS)}",
        "0.01 of it costs 0.1 % of a height", ("", "silicone"), "prism",
    ),
    Question(
        "view_distance", "MM", ABOVE_0, "Camera, in air, to a wall that it faces, mm",
        "twice as far halves x, y and heights", ("500", "500"),
    ),
    Question(
        "view_width", "MM", _Width(), f"Width of its view of that wall, mm; {UNKNOWN}: unknown, 60 degrees",
        "x, y and heights scale with it", (UNKNOWN, UNKNOWN),
    ),
)  # fmt: skip
#: Of a target of `calibrate`.
BALL = Question("radius", "MM", ABOVE_0, "Radius of the ball, mm", "heights scale with it", ("30", "30"))
_BY_NAME = {each.name: each for each in QUESTIONS}


def questions_of(kind: str, *names: str) -> list[Question]:
    """The questions of a kind of rig (with these names), in their order."""
    chosen = [_BY_NAME[name] for name in names] or QUESTIONS
    own = [each for each in chosen if each.only in ("", kind)]
    return [replace(each, text=each.prism) if each.prism and kind == "prism" else each for each in own]


def typed_rig(values: Mapping[str, Any]) -> "ol.scene.TypedRig":
    """The rig of answers by name."""
    kind, image = values["kind"], values["image"]
    if values["view_width"]:
        focal, accuracy = image[1] * values["view_distance"] / values["view_width"], TAPE
    else:
        focal, accuracy = image[1] / (2 * math.tan(math.radians(30))), VIEW_60
    parts: dict[str, Any] = {each.name: values.get(each.name) for each in QUESTIONS if each.only == kind}
    for name in ("angle", "display_angle"):
        parts |= {name: math.radians(values[name])} if name in parts or name == "angle" else {}
    return ol.scene.TypedRig(
        **{name: values[name] for name in ("mirror", "display", "image", "distance")},
        **parts,
        pitch=25.4 * values["diagonal"] / math.hypot(*values["display"]),
        focal=focal,
        focal_accuracy=accuracy,
    )


def scene_of(values: Mapping[str, Any]) -> "ol.scene.Scene":
    """The scene of answers."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rig.toml"
        file.write_text(ol.scene.rig_toml("rig", typed_rig(values)), encoding="utf-8")
        return ol.scene.load(file)
