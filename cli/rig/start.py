"""`optolever start`: from an unpacked camera to a live height, step by step.

$ optolever start --text --rig rig.toml
Start: http://127.0.0.1:...   (Ctrl-C ends it; the same command goes on)
From another machine: ssh -L ...:127.0.0.1:... ...   (then the same address in its browser)
...
"""

import os
import socket
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import click

import optolever as ol
from optolever import InputError
from optolever.quantities import quantity

from ..arguments import Opt, Rare, program
from ..options import Json, Port
from ..outputs import OutputFile
from ..printing import write_json
from .start_page import GoTo, Interviewer
from .start_steps import STEPS, Begun, require_devices
from .views import DisplayPreview, preview_on

BESIDE = (".png", ".live.npz", ".rest_places.npz", ".response.npz", ".calibration.npz")
WRITTEN = OutputFile(".toml", bare=False, updates=True, beside=BESIDE)
RIG = Opt("--rig RIG.toml", "File of the rig: written step by step, gone on with.", WRITTEN)
TEXT = Opt("--text", "Open no browser; print how another machine reaches the page, by ssh.")
STEP = Opt("--from STEP", f"Go on at this step: {', '.join(STEPS)}.", click.Choice([*STEPS]))
FRAMES = Rare("--frames N", "Of the live view, then stop.", click.IntRange(min=1))


@program("start", __doc__)
def command(
    rig: Annotated[Path, RIG] = Path("rig.toml"),
    text: Annotated[bool, TEXT] = False,
    step: Annotated[str | None, STEP] = None,
    frames: Annotated[int | None, FRAMES] = None,
    port: Port = 0,
    json_path: Json = None,
) -> None:
    """From an unpacked camera to a live height.

    Asks for the kind of rig, camera, display, sizes and the width of the camera's view, shows what the camera
    sees while you aim, then exposes, synchronises, measures the display's gamma and the mirror at rest,
    calibrates if you like, and measures live. Each step writes RIG.toml: leave, and come back, and it goes on
    where it was. Every other command takes that file.
    """
    begun = Begun.load(rig)
    titles = {name: title for name, (title, _) in STEPS.items()}
    with Interviewer(titles, port, "optolever start") as page:
        far = text or "SSH_CONNECTION" in os.environ
        _announce("Start", page.address, "Ctrl-C ends it; the same command goes on", far)
        if not far and sys.stdout.isatty():
            click.launch(page.address)
        while True:
            walk(begun, page, step)
            try:
                write_json(json_path, _live(begun, page, frames, far))
                return
            except InputError as error:
                page.say(str(error), fault=True)
                page.go("The live view has ended.", {"": "measure the mirror at rest again"})
                step = "rest"


def _announce(name: str, address: str, ends: str, far: bool) -> None:
    """Where a page is; far: how another machine reaches it, too."""
    click.echo(f"{name}: {address}   ({ends})")
    if far:
        place = address.removeprefix("http://").rstrip("/")
        tunnel = f"ssh -L {place.rpartition(':')[2]}:{place} {socket.gethostname()}"
        click.echo(f"From another machine: {tunnel}   (then the same address in its browser)")


def walk(begun: Begun, front: Interviewer, step: str | None) -> None:
    """All steps from the one where the walk was left, or from `step`."""
    names = [*STEPS]
    at = begun.answers.get("step", names[0]) if step is None else step
    if step is None and at not in names[:2] and at in names and (why := require_devices(begun)):
        front.say(f"Not as before. {why}", fault=True)
        at = why.partition(":")[0]
    number = names.index(at) if at in names else len(names)
    while number < len(names):
        name = names[number]
        title, run = STEPS[name]
        front.begin(name, title, begun.kind)
        try:
            try:
                run(begun, front)
                number += 1
            except InputError as error:
                front.say(str(error), fault=True)
                front.go("This step is not done.", {"": "try again"})
        except GoTo as other:
            number = names.index(other.args[0]) if other.args else max(number - 1, 0)
        begun.write(step=names[number] if number < len(names) else "live")


def _live(begun: Begun, front: Interviewer, frames: int | None, far: bool) -> dict[str, Any]:
    """The live view, on the page where the display leaves it visible; the figures of the last reading."""
    with ol.live.open(begun.rig, ol.live.Prepared.load(ol.live.kept_rest(begun.rig))) as readings:
        scene, name = ol.scene.load(begun.rig), begun.devices.get("display", "window")
        sheet = preview_on(readings.display, scene, name)
        if sheet is None:
            return _page(readings, front, frames, far)
        return _lines(readings, sheet, ol.calibration.load_rest(begun.rig), frames)


def _lines(
    readings: "ol.live.Readings",
    sheet: DisplayPreview,
    rest: "ol.decode.Correspondence | None",
    frames: int | None,
) -> dict[str, Any]:
    """A line of the live view a second, on the display itself beyond its part that is seen, too."""
    click.secho("\nLive (Ctrl-C ends it)", bold=True)
    said = -1.0
    for count, reading in enumerate(readings, 1):
        if time.monotonic() > said + 1 or count == frames:
            said, text = time.monotonic(), _depth(reading)
            click.echo(f"  {text}")
            if rest is not None:
                sheet.caption(f"{text}. Escape: back.", rest)
                if sheet.key == "escape":
                    raise InputError(f"The last reading: {text}")
        if count == frames:
            return _numbers(reading, readings.prepared)
    raise InputError("camera: no picture came; is it connected? (optolever doctor)")


def _page(readings: "ol.live.Readings", page: Interviewer, frames: int | None, far: bool) -> dict[str, Any]:
    """The page of `live`."""
    last: list[ol.live.Reading] = []
    with ol.live.LiveServer(
        readings.prepared, readings.source, heard=lambda one: last.__setitem__(slice(None), [one.reading])
    ) as server:
        _announce("Live", server.address, "Ctrl-C ends it", far)
        page.live(server.address)
        while not server.error and (frames is None or server.readings < frames):
            time.sleep(0.05)
        if server.error:
            raise InputError(server.error)
    return _numbers(last[0], readings.prepared)


def _numbers(reading: "ol.live.Reading", prepared: "ol.live.Prepared") -> dict[str, Any]:
    depth, sigma = reading.deepest or (None, None)
    return {
        "trusted": reading.trusted,
        "depth_mm": depth,
        "depth_sigma_mm": sigma,
        "depth_total_sigma_mm": None if depth is None else reading.depth_total_sigma,
        "rig_error": prepared.error,
    }


def _depth(reading: "ol.live.Reading") -> str:
    """Depth with its error, or why there is none."""
    if not reading.trusted:
        return f"not trusted: {reading.reason}"
    if reading.deepest is None:
        return "nothing touches"
    return f"depth {quantity(1e3 * reading.depth, 'µm', 1e3 * reading.depth_total_sigma)}"
