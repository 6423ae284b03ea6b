"""Arguments that several commands share, and what they name, loaded."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

import optolever as ol
from optolever import InputError
from optolever.numbers import listed

from .arguments import AT_LEAST_0, Opt, Rare, Shape
from .outputs import OutputFile
from .printing import print_notices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class RigFile(click.Path):
    """The file of a rig, which exists; beside: suffixes of files that the command keeps beside it."""

    def __init__(self, *beside: str) -> None:
        super().__init__(dir_okay=False, path_type=Path)
        self.beside = beside

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not Path(value).exists():
            self.fail(f"{value}: no such file; `optolever rig new` writes one, a preset has none", param, ctx)
        return super().convert(value, param, ctx)


class Anchored(click.ParamType[Any]):
    """edge, middle, border, a known point of the mirror X,Y,Z in mm; none, for methods without an anchor."""

    name = "edge|middle|border|X,Y,Z"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("edge", "middle", "border", "none"):
            return value
        return tuple(listed("--anchor", str(value), "edge, middle, border or X,Y,Z (mm)", 3))


def pixels(text: str) -> Opt:
    """--pixels WIDTHxHEIGHT."""
    return Opt("--pixels WIDTHxHEIGHT", text, Shape(8))


def preset(text: str = "") -> Opt:
    """--scene PRESET_OR_TOML; text: more of its help."""
    return Opt("--scene PRESET_OR_TOML", f"A preset or a scene's TOML file{text}.", lists="scenes")


_NAMED = "NAME[:KEY=VALUE,...]"
_NUMBERS = "Write the numbers too: JSON, or CSV (figure, value)."
_SENSOR = "Standard deviation of Gaussian noise added to that of the scene's sensor, in 8-bit levels."
_ANCHOR = (
    "The known height: edge, the camera-side edge at rest (default); where that is not in view border, of "
    "the view (default with --rest), or middle, of the mirror (default in open air); or a point in mm "
    "(SOFAST: its datum)."
)
_SCREEN = "Size of the display of the sequence, such as 1920x1080."
_SIZE = "Resample camera and pattern together to this camera size; the field of view stays."
_RENDERER = "auto: OpenGL where there is a context, else NumPy."

_FULL = "Also write correspondence.npz and slopes.npz, which are large."

Full = Annotated[bool, Opt("--full", _FULL)]
Json = Annotated[Path | None, Opt("--json FILE", _NUMBERS, OutputFile(".json", ".csv"))]
NoRest = Annotated[bool, Opt("--no-rest", "Absolute heights, without the rest capture that the rig holds.")]
Size = Annotated[tuple[int, int] | None, pixels(_SIZE)]
SceneName = Annotated[str, preset()]
Shown = Annotated[str, Opt(f"--sequence {_NAMED}", "Sequence, or a .toml file of one.", lists="sequences")]
Dent = Annotated[
    str | None, Opt(f"--dent {_NAMED}", "Shape of the dent; default: the scene's, or none.", lists="dents")
]
Noise = Annotated[float, Opt("--noise LEVELS", _SENSOR, AT_LEAST_0)]
Seed = Annotated[int, Rare("--seed N", "Seed of the random numbers.", click.IntRange(min=0))]
Port = Annotated[
    int, Opt("--port N", "Port of the page, on 127.0.0.1; default: a free one.", click.IntRange(0, 65535))
]
Renderer = Annotated[Literal["auto", "gl", "numpy"], Rare("--renderer auto|gl|numpy", _RENDERER)]
Anchor = Annotated[Any, Opt("--anchor edge|middle|border|X,Y,Z", _ANCHOR, Anchored())]
Pictured = Annotated[
    str | None,
    Opt(f"--sequence {_NAMED}", "Sequence of the pictures, in the order of their names.", lists="sequences"),
]
#: How a display's colours are shown.
Colour = Annotated[
    Literal["rgb", "bgr", "none", "unknown"] | None,
    Opt(
        "--colour rgb|bgr|none|unknown",
        "Three frames in each picture, one per colour; order of the coloured stripes in a cell of the "
        "display, from the left (none: its colours coincide, as a projector's; unknown: places share an "
        "error of a third of a cell, which a rest capture cancels).",
    ),
]
#: Size of the pictures of a display.
Display = Annotated[tuple[int, int] | None, Opt("--pixels WIDTHxHEIGHT", _SCREEN, Shape())]


def stored_in(suffix: str) -> Opt:
    """--scene RIG.toml; suffix: of the file beside it."""
    return Opt("--scene RIG.toml", "Rig in which the result is stored.", RigFile(suffix))


def rest_file(text: str) -> Opt:
    """--rest REST.npz; text: its effect."""
    return Opt("--rest REST.npz", f"Correspondence of the mirror at rest: {text}.")


def shown_sequence(text: str, display: tuple[int, int] | None) -> "ol.patterns.Sequence":
    """The sequence of that name on a display (rows, cols), or of a file, whose size the display must have.
    InputError without a size, or if both differ."""
    if display is not None:
        return ol.patterns.sequence_from_text(text, *display)
    if text.endswith(".toml"):
        return ol.patterns.Sequence.load(text)
    raise InputError(f"--pixels is missing, must be WIDTHxHEIGHT of what showed {text}, such as 1920x1080")


def in_colour(shown: "ol.patterns.Sequence", colour: str | None) -> "ol.patterns.Sequence":
    """The sequence, packed for a display whose stripes have that order (--colour)."""
    return shown if colour is None else ol.patterns.packed(shown, colour)


def load_scene(name: str, size: tuple[int, int] | None = None, *, exact: bool = False) -> "ol.scene.Scene":
    """The scene of a preset or file, resampled if a size is given; exact: for simulations. InputError if
    there is none."""
    scene = ol.scene.load(name, exact=exact)
    return scene if size is None else ol.scene.resize(scene, *size)


@contextmanager
def blame(path: Path) -> Iterator[None]:
    """Prefix an InputError about a file's content with the file's name."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from error


def correspondence_of(path: Path, rig: Path | str) -> "ol.decode.Correspondence":
    """The correspondence in an .npz, or of a folder of frames, decoded now by the [response] of a rig."""
    if not path.is_dir():
        return ol.decode.Correspondence.load(path)
    if ol.projector.in_colour(path / "capture.toml"):
        capture = ol.projector.load_capture(path, colours=colours_of(rig))
        with blame(path):
            return ol.decode.decode(capture.frames, capture.sequence)
    capture = ol.projector.Capture.load(path)
    with blame(path):
        return decoded_by_response(capture, response_of(rig))


def response_of(rig: Path | str) -> "ol.decode.Response | None":
    """[response] of a rig's file; None of a preset, or without one."""
    return ol.calibration.load_response(rig).response if "response" in sections(rig) else None


def colours_of(rig: Path | str) -> "ol.projector.ColourResponse | None":
    """[colour] of a rig's file; None of a preset, or without one."""
    return ol.calibration.load_colours(rig) if "colour" in sections(rig) else None


def sections(rig: Path | str) -> Mapping[str, Any]:
    """Sections of a rig's file, none of a preset: without one of other parts these need not be imported."""
    return ol.scene.rig_table(rig) if Path(rig).is_file() else {}


def decoded_by_response(
    capture: "ol.projector.Capture", light: "ol.decode.Response | None"
) -> "ol.decode.Correspondence":
    """The correspondence by a response, checked by that without it."""
    settings = ol.decode.Settings(response=light)
    found = ol.decode.decode(capture.frames, capture.sequence, response=light)
    return checked_response(found, capture, settings)


def checked_response(
    found: "ol.decode.Correspondence",
    capture: "ol.projector.Capture",
    settings: "ol.decode.Settings",
    mask: "NDArray[np.bool_] | None" = None,
) -> "ol.decode.Correspondence":
    """A correspondence by the response of settings, checked by that without it where the frames contradict
    it."""
    if settings.response is None or not found.notices:
        return found
    plain = ol.decode.Decoder(capture.sequence, settings=replace(settings, response=None))
    return ol.calibration.with_better_fit(found, plain.decode(capture.frames, mask=mask))


def name_unused(rig: Path | str, command: str, **reasons: str) -> None:
    """A line for each of these sections (name=why) that a rig's file has: the command does not use it."""
    table = sections(rig)
    for name, why in reasons.items():
        if name in table:
            print_notices([f"{rig}: {command} does not use [{name}]: {why}"])
