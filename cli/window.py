"""`optolever show`: a sequence on a real display, frame by frame."""

import math
from pathlib import Path
from typing import Annotated

import click

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, Opt, program
from .options import Json, pixels
from .outputs import OutputFile
from .show import grid, number, print_notices, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever show --sequence gray+phase --monitor 1 --seconds 0.5
Shown on monitor 1
  sequence   gray+phase
  frames     28 of 28, of 1080 x 1920
  each       0.5001 s on average
  described  capture.toml
"""


SEQUENCE = Opt("--sequence NAME[:KEY=VALUE,...]", "Sequence, or a .toml file by design or Sequence.save.")
MONITOR = Opt(
    "--monitor N",
    "Full screen there, by its number in --list; default: the second one, or a plain window.",
    click.IntRange(min=0),
)
DISPLAY = Opt("--display NAME", "Full screen there, by its name in --list.")
SECONDS = Opt(
    "--seconds SECONDS",
    "Duration of each frame; default: right and left arrow step, Escape closes.",
    ABOVE_0,
)
OUT = Opt(
    "--out TOML",
    "Gets the description of the sequence, for decode --description; default: capture.toml.",
    OutputFile(".toml", bare=False),
)


@program("show", SAMPLE)
def command(
    sequence: Annotated[str, SEQUENCE] = "gray+phase",
    monitor: Annotated[int | None, MONITOR] = None,
    display: Annotated[str | None, DISPLAY] = None,
    size: Annotated[tuple[int, int] | None, pixels("Size of the pattern; default: the full monitor.")] = None,
    seconds: Annotated[float | None, SECONDS] = None,
    out: Annotated[Path | None, OUT] = None,
    listing: Annotated[bool, Opt("--list", "List the monitors and show nothing.")] = False,
    json_path: Json = None,
) -> None:
    """Show a sequence on a monitor, for any camera.

    One pattern pixel per screen pixel. The pattern starts in the upper left corner; the rest of the screen is
    black. Take one picture of each frame, in this order. With --seconds, --json gets the start of every
    frame, seconds after the first.
    """
    found = ol.projector.monitors()
    if listing:
        _list(found, json_path)
        return
    chosen = _chosen(found, monitor, display)
    print_notices(() if chosen is None else found[chosen].faults())
    shown = _sequence(sequence, size, found, chosen)
    described = out or Path("capture.toml")
    with ol.projector.PatternWindow(shown, monitor=chosen) as window:
        ol.projector.write_description(described, shown)
        if seconds is None:
            window.run()
            times: list[float] = []
        else:
            times = window.play(seconds)
    if window.gone:
        count = f" after {len(times)} of {len(shown)} frames" if seconds is not None else ""
        raise InputError(
            f"display: monitor {chosen} was disconnected{count}; connect it and show the sequence again"
        )
    where = "in a window" if chosen is None else f"on monitor {chosen}"
    record = {
        "sequence": sequence,
        "frames": len(shown),
        "size": shown.shape,
        "monitor": chosen,
        "shown_s": times,
    }
    write_json(json_path, record)
    if seconds is not None:
        table(
            f"Shown {where}",
            {
                "sequence": sequence,
                "frames": f"{len(times)} of {len(shown)}, of {shown.rows} x {shown.cols}",
                "each": f"{number(_mean_step(times), 's')} on average",
                "described": str(described),
            },
        )


def _list(found: "list[ol.projector.Monitor]", json_path: Path | None) -> None:
    from dataclasses import asdict

    write_json(json_path, {"monitors": [asdict(monitor) for monitor in found]})
    rows = [
        [str(m.index), m.name, f"{m.rows}x{m.cols}", number(m.refresh_hz or math.nan, "Hz")] for m in found
    ]
    grid("Monitors", ("number", "name", "size", "refresh"), rows)
    print_notices(fault for monitor in found for fault in monitor.faults())


def _chosen(found: "list[ol.projector.Monitor]", monitor: int | None, display: str | None) -> int | None:
    """The given monitor, else the second one, else none: a plain window."""
    if display is not None:
        return ol.projector.choose_monitor(found, display).index
    if monitor is None:
        return 1 if len(found) > 1 else None
    if monitor >= len(found):
        raise InputError(
            f"--monitor {monitor}: does not exist, must be 0 to {len(found) - 1} (--list shows them)"
        )
    return monitor


def _sequence(
    text: str, size: tuple[int, int] | None, found: "list[ol.projector.Monitor]", chosen: int | None
) -> "ol.patterns.Sequence":
    """The sequence in the given size, that of its file, or that of the monitor."""
    if size is None and text.endswith(".toml"):
        return ol.patterns.Sequence.load(text)
    if size is None:
        if chosen is None:
            raise InputError("--pixels: must be given for a plain window, such as 640x480")
        size = found[chosen].rows, found[chosen].cols
    return ol.patterns.sequence_from_text(text, *size)


def _mean_step(times: list[float]) -> float:
    return (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("nan")
