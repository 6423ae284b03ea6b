"""`optolever live`: a camera's frames as heights, contacts and forces, on a page or as lines of JSON."""

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

import click

import optolever as ol
from optolever import InputError
from optolever.quantities import quantity

from .arguments import AT_LEAST_0, Opt, Rare, program
from .options import Json, Noise, RigFile, Seed, Size, load_scene, preset
from .rig_devices import Changes
from .rig_live import rig_at_rest
from .show import print_notices, table, write_json

SAMPLE = """
$ optolever live --pixels 160x120 --headless --frames 48
Live: prism48, 60 x 80 cells
  readings  48, 48 trusted
  deepest   0.1703 ± 0.0061 mm
  rate      9.61 readings/s, median delay 91.6 ms
"""


CELL = Rare("--cell 2|4", "Side of a cell, pixels; 4: less than half the time, fails on contacts that fold.")
RATE = Opt("--rate HZ", "Frames a second of the virtual camera; 0: as fast as they are read.", AT_LEAST_0)
STOP = Opt("--frames N", "Stop after so many readings; default: never.", click.IntRange(min=1))
RECORD = Opt("--record DIR", "Folder to make with every frame that is read, and its reading, for replay.")
PORT = Rare("--port N", "Port of the page, on 127.0.0.1; default: a free one.", click.IntRange(0, 65535))


@program("live", SAMPLE)
def command(
    rig: Annotated[Path | None, Opt("--rig RIG.toml", "Camera and display of this rig.", RigFile())] = None,
    changes: Changes = (),
    scene_name: Annotated[str, preset("; its [layer] gives forces")] = "prism48",
    size: Size = None,
    noise: Noise = 1.5,
    rate: Annotated[float, RATE] = 30.0,
    frames: Annotated[int | None, STOP] = None,
    headless: Annotated[bool, Opt("--headless", "Serve no page.")] = False,
    json_lines: Annotated[bool, Opt("--json-lines", "Print a line of JSON for every reading.")] = False,
    record: Annotated[Path | None, RECORD] = None,
    cell: Annotated[Literal["2", "4"], CELL] = "2",
    seed: Seed = 0,
    port: Annotated[int, PORT] = 0,
    json_path: Json = None,
) -> None:
    """Measure every frame of a camera: height, contacts, force.

    Of a rig (--rig) the mirror at rest is measured first, by gray+phase; its display then shows one crossed
    fringe. Without a rig a simulated finger presses on a scene's mirror. The page has the camera's image,
    height, sigma, contacts and their figures, with pause, tare and snapshot. An untrusted frame comes with
    the reason. --headless reads every frame, the page the newest one.
    """
    if json_lines and not headless:
        raise InputError("--json-lines: must come with --headless")
    if changes and rig is None:
        raise InputError("--set: needs --rig RIG.toml")
    if rig is not None:
        _require_real()
    with ExitStack() as stack:
        if rig is not None:
            name = str(rig)
            prepared, source = stack.enter_context(rig_at_rest(rig, int(cell), changes))
        else:
            scene = load_scene(scene_name, size or (240, 320), exact=True)
            name = scene.name
            prepared, source = ol.live.virtual_rig(scene, cell=int(cell), noise=noise, seed=seed, rate=rate)
        print_notices(prepared.notices)
        recorder = None
        if record is not None:
            camera = "virtual" if rig is None else str(rig)
            recorder = stack.enter_context(ol.live.ReadingRecorder(record, prepared, camera))
        if headless:
            numbers = _headless(name, prepared, source, frames, json_lines, recorder)
        else:
            numbers = {"readings": _page(prepared, source, frames, port, recorder)}
    write_json(json_path, numbers)


def _require_real() -> None:
    """InputError if an option of the simulated camera was given."""
    context = click.get_current_context()
    options = {"scene_name": "--scene", "size": "--pixels"}
    options |= {name: f"--{name}" for name in ("noise", "seed", "rate")}
    for name, option in options.items():
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(f"{option}: is of the simulated camera, leave it out with --rig")


def _page(
    prepared: "ol.live.Prepared",
    source: "ol.live.Source",
    frames: int | None,
    port: int,
    recorder: "ol.live.ReadingRecorder | None",
) -> int:
    try:
        server = ol.live.LiveServer(prepared, source, port, recorder)
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
    prepared: "ol.live.Prepared",
    source: "ol.live.Source",
    frames: int | None,
    lines: bool,
    recorder: "ol.live.ReadingRecorder | None",
) -> dict[str, float]:
    import json
    from statistics import median

    delays, trusted, deepest, start = [], 0, (0.0, 0.0), time.perf_counter()
    for followed in ol.live.follow(ol.live.Live(prepared), source, frames):
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
        "delay_s": median(delays),
    }
    if lines:
        return record
    rows, cols = prepared.rig.carriers.shape
    figures = {
        "readings": f"{len(delays)}, {trusted} trusted",
        "deepest": quantity(deepest[0], "mm", deepest[1]),
        "rate": f"{len(delays) / spent:.3g} readings/s, median delay {1e3 * record['delay_s']:.3g} ms",
    }
    table(f"Live: {name}, {rows} x {cols} cells", figures)
    return record
