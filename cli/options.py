"""Common arguments of several commands, and checks before any work."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from optolever import InputError

from .outputs import OutputFile

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from optolever.decode import Correspondence
    from optolever.patterns import Sequence
    from optolever.scene import Scene

__all__ = [
    "DISPLAY",
    "FILE",
    "SIZE",
    "RigFile",
    "blame",
    "correspondence_of",
    "dent_option",
    "json_option",
    "load_scene",
    "mask_from",
    "mask_option",
    "noise_option",
    "pitch_option",
    "preset_option",
    "renderer_option",
    "rest_option",
    "rig_option",
    "sample",
    "scene_option",
    "seed_option",
    "sequence_option",
    "shown_sequence",
    "size_option",
]

Command = TypeVar("Command", bound=Callable[..., Any])
FILE = click.Path(path_type=Path)


class _Size(click.ParamType[tuple[int, int]]):
    """ROWSxCOLS, both at least 8."""

    name = "ROWSxCOLS"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d+)x(\d+)", str(value))
        if match is None or min(int(match[1]), int(match[2])) < 8:
            self.fail(f"{value!r} is not ROWSxCOLS with at least 8 each, such as 480x640", param, ctx)
        return int(match[1]), int(match[2])


class _Display(click.ParamType[tuple[int, int]]):
    """COLSxROWS of a display, as its maker says; the value is (rows, cols)."""

    name = "COLSxROWS"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d+)[x×](\d+)", str(value))
        if match is None or not all(1 <= int(number) <= 1 << 16 for number in match.groups()):
            self.fail(f"{value!r} is not COLSxROWS, such as 1920x1080", param, ctx)
        return int(match[2]), int(match[1])


SIZE = _Size()
DISPLAY = _Display()


def json_option(command: Command) -> Command:
    """--json FILE: the numbers of the run for other programs; by the suffix as CSV."""
    text = "Write the numbers too: JSON, or CSV (figure, value)."
    return click.option("--json", "json_path", type=OutputFile(".json", ".csv"), metavar="FILE", help=text)(
        command
    )


def size_option(command: Command) -> Command:
    """--size ROWSxCOLS."""
    text = "Resample camera and pattern together to this camera size; the field of view stays."
    return click.option("--size", type=SIZE, metavar="ROWSxCOLS", help=text)(command)


def preset_option(
    default: str | None = None, *, required: bool = False, text: str = ""
) -> Callable[[Command], Command]:
    """--scene PRESET_OR_TOML; text: in addition to what it is."""
    what = f"Name of a preset (optolever names) or a scene's TOML file{text}."
    return click.option(
        "--scene", "scene_name", metavar="PRESET_OR_TOML", default=default, show_default=default is not None,
        required=required, help=what,
    )  # fmt: skip


def scene_option(command: Command, *, required: bool = True) -> Command:
    """--scene PRESET_OR_TOML."""
    return preset_option(required=required)(command)


def sequence_option(text: str) -> Callable[[Command], Command]:
    """--sequence NAME, with a default."""
    name, default = "NAME[:KEY=VALUE,...]", "gray+phase"
    return click.option("--sequence", metavar=name, default=default, show_default=True, help=text)


def dent_option(command: Command) -> Command:
    """--dent NAME."""
    text = "Shape of the dent; default: the scene's, or none."
    return click.option("--dent", metavar="NAME[:KEY=VALUE,...]", help=text)(command)


def mask_option(text: str) -> Callable[[Command], Command]:
    """--mask PNG; text: what happens to its pixels."""
    what = f"{text}: white in an image of the camera's size."
    return click.option("--mask", "mask_path", type=FILE, metavar="PNG", help=what)


def rest_option(text: str) -> Callable[[Command], Command]:
    """--rest REST.npz; text: what it changes."""
    what = f"Correspondence of the mirror at rest: {text}."
    return click.option("--rest", "rest_path", type=FILE, metavar="REST.npz", help=what)


def pitch_option(command: Command) -> Command:
    """--pitch MM."""
    text = "Pitch of the regular grid; default: about that of the camera's pixels."
    above_0 = click.FloatRange(min=0, min_open=True)
    return click.option("--pitch", type=above_0, metavar="MM", help=text)(command)


class RigFile(click.Path):
    """The file of a rig, which exists."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not Path(value).exists():
            self.fail(f"{value}: no such file; `optolever rig new` writes one, a preset has none", param, ctx)
        return super().convert(value, param, ctx)


def rig_option(command: Command) -> Command:
    """--scene RIG.toml: the file of a rig, in which the result is stored."""
    return click.option(
        "--scene",
        "rig",
        type=RigFile(),
        required=True,
        metavar="RIG.toml",
        help="Rig in which the result is stored.",
    )(command)


def sample(text: str) -> str:
    """A sample session for the end of --help, kept line by line."""
    return "\b\nSample:\n" + "\n".join("  " + line for line in text.strip("\n").splitlines())


def noise_option(default: float) -> Callable[[Command], Command]:
    """--noise LEVELS."""
    text = "Standard deviation of Gaussian noise added to that of the scene's sensor, in 8-bit levels."
    levels = click.FloatRange(min=0)
    return click.option(
        "--noise", type=levels, default=default, show_default=True, metavar="LEVELS", help=text
    )


def seed_option(command: Command) -> Command:
    """--seed N."""
    whole = click.IntRange(min=0)
    return click.option(
        "--seed", type=whole, default=0, show_default=True, metavar="N", help="Seed of the random numbers."
    )(command)


def renderer_option(command: Command) -> Command:
    """--renderer."""
    kind = click.Choice(["auto", "gl", "numpy", "rays"])
    text = "auto: OpenGL where there is a context, else NumPy; rays: 36 a pixel, where mirrors bend in it."
    return click.option("--renderer", type=kind, default="auto", show_default=True, help=text)(command)


def virtual_sensor(scene: str | None, noise: float, *, required: bool = True) -> Callable[[Command], Command]:
    """Options of a virtual sensor: --scene (required without a default), --dent, --sequence, ..."""
    options = (
        preset_option(scene, required=required and scene is None),
        dent_option,
        sequence_option("Displayed sequence."),
        noise_option(noise),
        seed_option,
        renderer_option,
        size_option,
    )

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def shown_sequence(text: str, display: tuple[int, int] | None) -> "Sequence":
    """The sequence of that name on a display (rows, cols), or of a file, whose size the display must have.
    InputError without a size, or if both differ."""
    from optolever.patterns import Sequence, sequence_from_text

    if display is not None:
        return sequence_from_text(text, *display)
    if text.endswith(".toml"):
        return Sequence.load(text)
    raise InputError(f"--display is missing, must be COLSxROWS of what showed {text}, such as 1920x1080")


def dent_of(scene: "Scene", dent: str | None) -> str:
    """The given dent, else the scene's, else 'flat'."""
    return dent or scene.dent or "flat"


def load_scene(name: str, size: tuple[int, int] | None = None, *, exact: bool = False) -> "Scene":
    """The scene of a preset or file, resampled if a size is given; exact: for simulations. InputError if
    there is none."""
    from optolever.scene import load, resize

    scene = load(name, exact=exact)
    return scene if size is None else resize(scene, *size)


def mask_from(path: Path, shape: tuple[int, ...], others: str) -> "NDArray[np.bool_]":
    """Pixels marked in an image of the given shape; InputError if there are none, or if its size differs from
    that of `others`."""
    from optolever.pictures import read_mask

    mask = read_mask(path)
    if mask.shape != shape:
        raise InputError(f"{path}: is {mask.shape[0]}x{mask.shape[1]}, {others} {shape[0]}x{shape[1]}")
    return mask


@contextmanager
def blame(path: Path) -> Iterator[None]:
    """Prefix an InputError about a file's content with the file's name."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from error


def correspondence_of(path: Path) -> "Correspondence":
    """The correspondence in an .npz, or of a folder of frames, decoded now."""
    from optolever.decode import Correspondence, decode
    from optolever.projector import Capture

    if not path.is_dir():
        return Correspondence.load(path)
    capture = Capture.load(path)
    with blame(path):
        return decode(capture.frames, capture.sequence)
