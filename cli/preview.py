"""`optolever camera preview`: the camera's picture with the display's reflection, to aim and to focus."""

import time
from collections.abc import Iterator
from typing import Annotated

import click

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, Opt, program
from .options import Json, Port
from .rig_devices import Changes, OpenedRig, levels_of, opened
from .show import write_json
from .start_page import PageFront
from .views import View, sheet_on, views_of

SAMPLE = """
$ optolever camera preview --rig rig.toml --text --seconds 2
sees the display  100 %; saturated 0 %; sharpness 100 % of its best. Good.
"""

TEXT = Opt("--text", "Print a line a second instead of serving a page.")
SECONDS = Opt("--seconds SECONDS", "Stop after so long; default: Ctrl-C.", ABOVE_0)


@program("preview", SAMPLE)
def command(
    rig: OpenedRig,
    changes: Changes = (),
    text: Annotated[bool, TEXT] = False,
    seconds: Annotated[float | None, SECONDS] = None,
    port: Port = 0,
    json_path: Json = None,
) -> None:
    """Aim and focus a rig's camera.

    The display is white, and black for a moment every three seconds: white less black outlines its reflection
    in the mirror. A sentence says what to turn next. Sharpness has no unit: turn the focus through its best.
    Focus on the mirror, not on the reflection of the display. Where there is no other display, that shows all
    this itself, until Enter. Next: optolever camera expose.
    """
    devices, scene = ol.projector.devices_of(rig, changes), ol.scene.load(rig)
    end = None if seconds is None else time.monotonic() + seconds
    with opened(rig, devices, levels_of(rig, "black", "white")) as now:
        views = _until(views_of(now, None if text else sheet_on(now.display, scene, devices.display)), end)
        last = _print_lines(views) if text else _serve(views, port)
    if last is None:
        raise InputError("camera: no picture came; is the camera running? (optolever camera devices)")
    write_json(json_path, last.numbers())


def _until(views: Iterator[View], end: float | None) -> Iterator[View]:
    for view in views:
        yield view
        if end is not None and time.monotonic() > end:
            return


def _print_lines(views: Iterator[View]) -> View | None:
    said, last = -1.0, None
    for last in views:
        if time.monotonic() > said + 1:
            click.echo(last.text())
            said = time.monotonic()
    return last


def _serve(views: Iterator[View], port: int) -> View | None:
    """The page of `start` with this step alone; the last view."""
    with PageFront({"aim": "Aim and focus"}, port, "optolever camera preview") as page:
        click.echo(f"Preview: {page.address}   (Ctrl-C ends it)")
        page.begin("aim", "", "")
        return page.look(views)
