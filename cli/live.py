"""`optolever live`: a camera's frames as heights, contacts and forces, on a page or as lines of JSON."""

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from optolever import InputError
from optolever.quantities import quantity

from .options import (
    FILE,
    json_option,
    load_scene,
    noise_option,
    preset_option,
    sample,
    seed_option,
    size_option,
)
from .outputs import Program
from .rig_devices import DEVICE_OPTIONS, device_options
from .rig_live import rig_at_rest
from .show import print_notices, table, write_json

if TYPE_CHECKING:
    from optolever.live import Prepared, ReadingRecorder, Source

__all__ = ["command"]

SAMPLE = """
$ optolever live --size 120x160 --headless --frames 48
Live: prism48, 60 x 80 cells
  readings  48, 48 trusted
  deepest   0.1703 ± 0.0061 mm
  rate      9.61 readings/s, median delay 91.6 ms
"""


@click.command("live", cls=Program, epilog=sample(SAMPLE))
@preset_option("prism48", text="; its [layer] gives forces")
@size_option
@click.option(
    "--cell", type=click.Choice(["2", "4"]), default="2", show_default=True,
    help="Side of a cell, pixels: 4 takes less than half the time, and fails on contacts that fold.",
)  # fmt: skip
@noise_option(1.5)
@seed_option
@click.option(
    "--rate", type=click.FloatRange(min=0), default=30.0, show_default=True, metavar="HZ",
    help="Frames a second of the virtual camera; 0: as fast as they are read.",
)  # fmt: skip
@click.option(
    "--frames", type=click.IntRange(min=1), metavar="N", help="Stop after so many readings; default: never."
)
@click.option("--headless", is_flag=True, help="Serve no page.")
@click.option(
    "--record", "record", type=FILE, metavar="DIR",
    help="Folder to make with every frame that is read, and its reading, for replay.",
)  # fmt: skip
@click.option("--json-lines", is_flag=True, help="Print a line of JSON for every reading.")
@click.option(
    "--port", type=click.IntRange(min=0, max=65535), default=0, metavar="N",
    help="Port of the page, on 127.0.0.1; default: a free one.",
)  # fmt: skip
@partial(device_options, required=False)
@json_option
def command(
    scene_name: str,
    size: tuple[int, int] | None,
    cell: str,
    noise: float,
    seed: int,
    rate: float,
    frames: int | None,
    headless: bool,
    record: Path | None,
    json_lines: bool,
    port: int,
    rig: Path | None,
    json_path: Path | None,
    **given: Any,
) -> None:
    """Measure every frame of a camera: height, contacts, force.

    Of a rig (--rig) the mirror at rest is measured first, by gray+phase; its display then shows one crossed
    fringe. Without a rig a simulated finger presses on a scene's mirror. The page has the camera's image,
    height, sigma, contacts and their figures, with pause, tare and snapshot. An untrusted frame comes with
    the reason. --headless reads every frame, the page the newest one.
    """
    from optolever.live import ReadingRecorder, virtual_rig

    if json_lines and not headless:
        raise InputError("--json-lines: must come with --headless")
    _require_one_camera(rig is not None)
    with ExitStack() as stack:
        if rig is not None:
            name = str(rig)
            prepared, source = stack.enter_context(rig_at_rest(rig, int(cell), given))
        else:
            scene = load_scene(scene_name, size or (240, 320), exact=True)
            name = scene.name
            prepared, source = virtual_rig(scene, cell=int(cell), noise=noise, seed=seed, rate=rate)
        print_notices(prepared.notices)
        recorder = None
        if record is not None:
            camera = "virtual" if rig is None else str(given["camera"] or rig)
            recorder = stack.enter_context(ReadingRecorder(record, prepared, camera))
        if headless:
            numbers = _headless(name, prepared, source, frames, json_lines, recorder)
        else:
            numbers = {"readings": _page(prepared, source, frames, port, recorder)}
    write_json(json_path, numbers)


def _require_one_camera(real: bool) -> None:
    """InputError if an option of the other kind of camera was given."""
    context = click.get_current_context()
    simulated = {name: f"--{name}" for name in ("size", "noise", "seed", "rate")}
    simulated["scene_name"] = "--scene"
    devices = {name: f"--{name.replace('_', '-')}" for name in DEVICE_OPTIONS}
    for name, option in (simulated if real else devices).items():
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            said = "is of the simulated camera, leave it out with --rig" if real else "needs --rig RIG.toml"
            raise InputError(f"{option}: {said}")


def _page(
    prepared: "Prepared",
    source: "Source",
    frames: int | None,
    port: int,
    recorder: "ReadingRecorder | None",
) -> int:
    from optolever.live import LiveServer

    try:
        server = LiveServer(prepared, source, port, recorder)
    except OSError as error:
        raise InputError(f"--port {port}: {error.strerror or error}; name another") from error
    with server:
        click.echo(f"Live: {server.address}   (Ctrl-C ends it)")
        while not server.error and (frames is None or server.readings < frames):
            time.sleep(0.05)
        if server.error:
            raise InputError(server.error)
        return server.readings


def _headless(
    name: str,
    prepared: "Prepared",
    source: "Source",
    frames: int | None,
    lines: bool,
    recorder: "ReadingRecorder | None",
) -> dict[str, float]:
    import json

    import numpy as np

    from optolever.live import Live, follow

    delays, trusted, deepest, start = [], 0, (0.0, 0.0), time.perf_counter()
    for followed in follow(Live(prepared), source, frames):
        numbers = followed.to_dict()
        delays.append(followed.delay)
        trusted += followed.reading.trusted
        if followed.reading.trusted and numbers["depth_mm"] > deepest[0]:
            deepest = numbers["depth_mm"], numbers["depth_sigma_mm"]
        if recorder is not None:
            recorder.write(followed)
        if lines:
            click.echo(json.dumps(numbers))
    spent = time.perf_counter() - start
    record = {
        "readings": len(delays),
        "trusted": trusted,
        "depth_mm": deepest[0],
        "depth_sigma_mm": deepest[1],
        "readings_per_s": len(delays) / spent,
        "delay_s": float(np.median(delays)),
    }
    if lines:
        return record
    rows, cols = prepared.rig.carriers.shape
    table(
        f"Live: {name}, {rows} x {cols} cells",
        {
            "readings": f"{len(delays)}, {trusted} trusted",
            "deepest": quantity(deepest[0], "mm", deepest[1]),
            "rate": f"{len(delays) / spent:.3g} readings/s, median delay {1e3 * np.median(delays):.3g} ms",
        },
    )
    return record
