"""`optolever live`: a camera's frames as heights, contacts and forces, on a page or as lines of JSON."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever import InputError

from .options import json_option, load_scene, noise_option, sample, seed_option, size_option
from .outputs import Program
from .show import number, print_notices, table, write_json

if TYPE_CHECKING:
    from optolever.live import Prepared, VirtualFinger

__all__ = ["command"]

SAMPLE = """
$ optolever live --size 120x160 --headless --frames 48
Live: prism48, 60 x 80 cells
  readings  48, 48 trusted
  deepest   170.2 ± 0.2 um
  rate      13.7 readings/s, median delay 72.2 ms
"""


@click.command("live", cls=Program, epilog=sample(SAMPLE))
@click.option(
    "--scene", "scene_name", metavar="PRESET_OR_TOML", default="prism48", show_default=True,
    help="Name of a preset (optolever names) or a scene's TOML file; its [layer] gives forces.",
)  # fmt: skip
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
@click.option("--json-lines", is_flag=True, help="Print a line of JSON for every reading.")
@click.option(
    "--port", type=click.IntRange(min=0, max=65535), default=0, metavar="N",
    help="Port of the page, on 127.0.0.1; default: a free one.",
)  # fmt: skip
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
    json_lines: bool,
    port: int,
    json_path: Path | None,
) -> None:
    """Measure every frame of a simulated camera: height, contacts, force.

    A finger presses on the scene's mirror, which reflects one crossed fringe; the mirror at rest is measured
    first. The page has the camera's image, height, sigma, contacts and their figures, with pause, tare and
    snapshot. An untrusted frame comes with the reason. --headless reads every frame, the page the newest one.
    Real cameras: `optolever.live.follow` in Python.
    """
    from optolever.live import virtual_rig

    if json_lines and not headless:
        raise InputError("--json-lines: must come with --headless")
    scene = load_scene(scene_name, size or (240, 320), exact=True)
    prepared, finger = virtual_rig(scene, cell=int(cell), noise=noise, seed=seed, rate=rate)
    print_notices(prepared.notices)
    if headless:
        write_json(json_path, _headless(scene.name, prepared, finger, frames, json_lines))
    else:
        write_json(json_path, {"readings": _page(prepared, finger, frames, port)})


def _page(prepared: "Prepared", finger: "VirtualFinger", frames: int | None, port: int) -> int:
    from optolever.live import LiveServer

    try:
        server = LiveServer(prepared, finger, port)
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
    name: str, prepared: "Prepared", finger: "VirtualFinger", frames: int | None, lines: bool
) -> dict[str, float]:
    import json

    import numpy as np

    from optolever.live import Live, follow

    delays, trusted, deepest, start = [], 0, (0.0, 0.0), time.perf_counter()
    for followed in follow(Live(prepared), finger, frames):
        numbers = followed.to_dict()
        delays.append(followed.delay)
        trusted += followed.reading.trusted
        if followed.reading.trusted and numbers["depth_mm"] > deepest[0]:
            deepest = numbers["depth_mm"], numbers["depth_sigma_mm"]
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
            "deepest": f"{number(1e3 * deepest[0])} ± {1e3 * deepest[1]:.2g} um",
            "rate": f"{len(delays) / spent:.3g} readings/s, median delay {1e3 * np.median(delays):.3g} ms",
        },
    )
    return record
