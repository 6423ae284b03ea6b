"""The options of a rig's devices, and both opened with their notices printed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from ..arguments import Opt
from ..options import RigFile, in_colour
from ..printing import print_notices

OpenedRig = Annotated[Path, Opt("--rig RIG.toml", "The rig: its scene, [devices] and [sync].", RigFile())]
Changes = Annotated[
    tuple[str, ...],
    Opt(
        "--set KEY=VALUE",
        "Change [devices] for this run, such as camera=virtual or exposure_ms=10; repeatable.",
    ),
]


def sequence_of(rig: Path, text: str, colour: str | None = None) -> "ol.patterns.Sequence":
    """The sequence of that name on a rig's display; colour: of --colour."""
    pattern = ol.scene.load(rig).pattern
    return in_colour(ol.patterns.sequence_from_text(text, pattern.rows, pattern.cols), colour)


def levels_of(rig: Path, *kinds: str) -> "ol.patterns.Sequence":
    """A full display per kind (black, white)."""
    pattern = ol.scene.load(rig).pattern
    return ol.patterns.Sequence(tuple(map(ol.patterns.Frame, kinds)), pattern.rows, pattern.cols)


@contextmanager
def opened(
    rig: Path, devices: "ol.camera.Devices", shown: "ol.patterns.Sequence", *, running: bool = True
) -> "Iterator[ol.camera.Opened]":
    """`camera.opened`, with its notices printed."""
    with ol.camera.opened(rig, devices, shown, running=running) as now:
        print_notices(now.notices)
        yield now


def image_size(address: str) -> str:
    """WIDTHxHEIGHT of a camera's full image, by its driver. InputError if it cannot be opened."""
    accepted = _accepted(address)
    return f"{accepted.cols}x{accepted.rows}"


def has_colours(address: str) -> bool:
    """Whether a camera, or the virtual one, gives colours that can be unmixed."""
    try:
        return address == "virtual" or bool(_accepted(address, colour=True).mosaic)
    except InputError:
        return False


def _accepted(address: str, *, colour: bool = False) -> "ol.projector.Accepted":
    from optolever.camera.cameras import open_camera

    camera = open_camera(address)
    try:
        return camera.configure(ol.projector.Wanted(1 / 60, colour=colour))
    finally:
        camera.close()
