"""`optolever live`: a camera's frames as heights, contacts and forces, on a page or as lines of JSON.

$ optolever live --pixels 160x120 --headless --frames 300
Live: prism48, 60 x 80 cells
  readings  300, 300 trusted
  deepest   0.1707 ± 0.0022 mm
  rate      21.6 readings/s, median delay 23.1 ms
  noise     148 nm a frame, 45 nm/sqrt(Hz)
"""

import json
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import click

import optolever as ol
from optolever import InputError
from optolever.numbers import listed
from optolever.quantities import quantity

from .arguments import AT_LEAST_0, Opt, program
from .options import Json, Noise, Port, RigFile, Size, load_scene, preset
from .outputs import NewFolder, OutputFile
from .printing import print_notices, table, write_json
from .rig.opened import Changes

_RATED = 120  # readings: the rate is that of the last 60, the first ones are slow
RATE = Opt("--rate HZ", "Frames a second of the virtual camera; 0: as fast as they are read.", AT_LEAST_0)
STOP = Opt("--frames N", "Stop after so many readings; default: never.", click.IntRange(min=1))
RIG = Opt("--rig RIG.toml", "Camera and display of this rig.", RigFile(".live.npz"))
RECORD = Opt("--record DIR", "Folder to make with every frame and its reading, for replay.", NewFolder())
PROBE = Opt("--probe X,Y", "Follow the height there, mm, with its spectrum; repeatable.")
REST = Opt(
    "--rest FILE", "Rest of the mirror to use; default: the newest, kept beside the rig. new: measure it."
)
TABLE = Opt("--csv FILE", "Contacts and forces over time, a row each.", OutputFile(".csv"))
SOCKET = Opt(
    "--socket PATH",
    "Unix socket that sends every reading: a line of JSON, then the heights.",
    click.Path(path_type=Path),
)


@program("live", __doc__)
def command(
    rig: Annotated[Path | None, RIG] = None,
    changes: Changes = (),
    rest: Annotated[str | None, REST] = None,
    scene_name: Annotated[str, preset("; its [layer] gives forces")] = "prism48",
    size: Size = None,
    noise: Noise = 1.5,
    rate: Annotated[float, RATE] = 30.0,
    frames: Annotated[int | None, STOP] = None,
    headless: Annotated[bool, Opt("--headless", "Serve no page.")] = False,
    json_lines: Annotated[bool, Opt("--json-lines", "Print a line of JSON for every reading.")] = False,
    record: Annotated[Path | None, RECORD] = None,
    csv: Annotated[Path | None, TABLE] = None,
    socket: Annotated[Path | None, SOCKET] = None,
    probe: Annotated[tuple[str, ...], PROBE] = (),
    port: Port = 0,
    json_path: Json = None,
) -> None:
    """Measure every frame of a camera: height, contacts, force.

    Of a rig (--rig) the mirror at rest is measured first, by gray+phase; its display then shows one crossed
    fringe. Without a rig a simulated finger presses on a scene's mirror. The page has the camera's image,
    height, sigma, contacts, forces and probes (a click on the map) over time, with pause, tare, record and
    snapshot. An untrusted frame comes with the reason. --headless reads every frame, the page the newest one.
    """
    for name, given in (("--set", changes), ("--rest", rest)):
        if given and rig is None:
            raise InputError(f"{name}: needs --rig RIG.toml")
    if rig is not None:
        _require_real()
    with ExitStack() as stack:
        if rig is not None:
            name = str(rig)
            prepared, source, exposure_s = _rig(rig, changes, rest, stack)
        else:
            scene = load_scene(scene_name, size or (240, 320), exact=True)
            name, exposure_s = scene.name, 0.0
            prepared, source = ol.live.virtual_rig(scene, noise=noise, rate=rate)
        print_notices(prepared.notices)
        probes = ol.live.Probes(prepared, exposure_s)
        for text in probe:
            probes.add(*listed("--probe", text, "X,Y in mm, such as 30,22.5", 2))
        sinks: list[Any] = [] if csv is None else [stack.enter_context(ol.live.ContactTable(csv))]
        sinks += [] if socket is None else [stack.enter_context(ol.live.ReadingSocket(socket))]
        run = _Run(prepared, probes, json_lines, sinks)
        try:
            if headless:
                _headless(run, source, frames, stack, record)
            else:
                _page(run, source, frames, port, record)
        finally:  # Ctrl-C is how most runs end
            if run.readings:
                numbers = run.numbers()
                if not json_lines:
                    run.print(name, numbers)
                write_json(json_path, numbers)


def _rig(
    rig: Path, changes: Changes, rest: str | None, stack: ExitStack
) -> "tuple[ol.live.Prepared, ol.live.Source, float]":
    """The rig at rest, its running camera, its exposure."""
    named = None
    if rest not in (None, "new"):
        named = ol.live.Prepared.load(str(rest))
    elif rest == "new" or not ol.live.kept_rest(rig).is_file():
        click.echo("The mirror at rest is measured: keep everything still.", err=True)
    readings = stack.enter_context(ol.live.open(rig, named, changes=changes, anew=rest == "new"))
    print_notices(readings.notices)
    return readings.prepared, readings.source, readings.exposure_s


def _require_real() -> None:
    """InputError if an option of the simulated camera was given."""
    context = click.get_current_context()
    options = {"scene_name": "--scene", "size": "--pixels"}
    options |= {name: f"--{name}" for name in ("noise", "rate")}
    for name, option in options.items():
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(f"{option}: is of the simulated camera, leave it out with --rig")


class _Run:
    """Counts the readings of a run, and prints each as a line of JSON."""

    def __init__(
        self, prepared: "ol.live.Prepared", probes: "ol.live.Probes", lines: bool, sinks: list[Any]
    ) -> None:
        self.prepared, self.probes, self.lines, self._sinks = prepared, probes, lines, sinks
        self._delays: list[float] = []
        self._trusted, self._deepest = 0, (0.0, 0.0)
        self._start = time.perf_counter()

    def __call__(self, followed: "ol.live.Followed") -> None:
        reading = followed.reading
        self._delays.append(followed.delay)
        self._trusted += reading.trusted
        if reading.trusted and reading.deepest:
            self._deepest = max(self._deepest, reading.deepest)
        for sink in self._sinks:
            sink.write(followed)
        if self.lines:
            click.echo(json.dumps(followed.to_dict()))

    @property
    def readings(self) -> int:
        return len(self._delays)

    def numbers(self) -> dict[str, Any]:
        count = self.readings
        rate = count / max(time.perf_counter() - self._start, 1e-9)
        frame, density = ol.live.noise_floor(self.prepared, rate)
        probes: list[dict[str, Any]] = [{"x_mm": each.x, "y_mm": each.y} for each in self.probes.each]
        for trace in ol.live.TRACES:
            name = "spectrum" if trace == "raw" else f"spectrum_{trace}"
            for one, found in zip(probes, self.probes.spectra(trace=trace), strict=True):
                one[name] = None if found is None else found.to_dict()
        return {
            "readings": count,
            "trusted": self._trusted,
            "depth_mm": self._deepest[0] or None,
            "depth_sigma_mm": self._deepest[1] or None,
            "readings_per_s": rate,
            "delay_s": median(self._delays),
            "noise_nm": 1e6 * frame,
            "noise_nm_per_sqrt_hz": 1e6 * density,
            "probes": probes,
        }

    def print(self, name: str, numbers: dict[str, Any]) -> None:
        rows, cols = self.prepared.rig.carriers.shape
        depth, delay = numbers["depth_mm"], 1e3 * numbers["delay_s"]
        figures = {
            "readings": f"{numbers['readings']}, {numbers['trusted']} trusted",
            "deepest": quantity(depth, "mm", numbers["depth_sigma_mm"]) if depth else "none beyond 5 sigma",
            "rate": f"{numbers['readings_per_s']:.3g} readings/s, median delay {delay:.3g} ms",
            "noise": _noise(self.prepared, numbers["readings_per_s"]),
        }
        for probe in numbers["probes"]:
            place = f"probe {probe['x_mm']:.3g},{probe['y_mm']:.3g}"
            for trace, words in ol.live.TRACES.items():
                found = probe["spectrum" if trace == "raw" else f"spectrum_{trace}"]
                if trace == "raw" or found:
                    text = found["text"] if found else "too few frames"
                    figures[place if trace == "raw" else f"{place} {words}"] = text
        table(f"Live: {name}, {rows} x {cols} cells", figures)


def _noise(prepared: "ol.live.Prepared", rate: float) -> str:
    frame, density = (1e6 * one for one in ol.live.noise_floor(prepared, rate))
    return f"{frame:.3g} nm a frame, {density:.3g} nm/sqrt(Hz)"


def _page(run: _Run, source: "ol.live.Source", frames: int | None, port: int, record: Path | None) -> None:
    with ol.live.LiveServer(
        run.prepared, source, port, record=record, probes=run.probes, heard=run
    ) as server:
        click.echo(f"Live: {server.address}   (Ctrl-C ends it)", err=run.lines)
        said = False
        while not server.error and (frames is None or server.readings < frames):
            time.sleep(0.05)
            if not said and server.readings >= _RATED:
                click.echo(f"Noise: {_noise(run.prepared, server.rate)}", err=run.lines)
                said = True
        if server.error:
            raise InputError(server.error)


def _headless(
    run: _Run, source: "ol.live.Source", frames: int | None, stack: ExitStack, record: Path | None
) -> None:
    recorder = None
    if record is not None:
        recorder = stack.enter_context(ol.live.ReadingRecorder(record, run.prepared, "live"))
    for followed in ol.live.follow(ol.live.Live(run.prepared), source, frames, run.probes):
        run(followed)
        if recorder is not None:
            recorder.write(followed)
