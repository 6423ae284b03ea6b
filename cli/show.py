"""`optolever show`: a sequence on a real display, frame by frame.

$ optolever show --sequence gray+phase --monitor 1 --seconds 0.5
Shown on monitor 1
  sequence   gray+phase
  frames     28 of 28, of 1080 x 1920
  each       0.5001 s on average
  described  capture.toml
"""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, Opt, program
from .doctor import print_monitors
from .options import Colour, Json, in_colour, pixels, shown_sequence
from .outputs import NewFolder, OutputFile
from .printing import number, print_notices, table, write_json

SEQUENCE = Opt("--sequence NAME[:KEY=VALUE,...]", "Sequence, or a .toml file by design or Sequence.save.")
PICTURES = Opt(
    "--pictures DIR", "Write 000.png, 001.png, ... and capture.toml there; show nothing.", NewFolder()
)
MONITOR = Opt("--monitor N|NAME", "Its number or name in --list; default: the second, or the only one.")
SECONDS = Opt("--seconds SECONDS", "Of each frame; default: arrows step, Escape closes.", ABOVE_0)
DESCRIBED = "Gets the description, for decode --description, in a new folder, too; default: capture.toml."
OUT = Opt("--out TOML", DESCRIBED, OutputFile(".toml", bare=False, folder=True))


@program("show", __doc__)
def command(
    sequence: Annotated[str, SEQUENCE] = "gray+phase",
    monitor: Annotated[str | None, MONITOR] = None,
    size: Annotated[tuple[int, int] | None, pixels("Size of the pattern; default: the full monitor.")] = None,
    seconds: Annotated[float | None, SECONDS] = None,
    out: Annotated[Path | None, OUT] = None,
    pictures: Annotated[Path | None, PICTURES] = None,
    colour: Colour = None,
    listing: Annotated[bool, Opt("--list", "List the monitors and show nothing.")] = False,
    json_path: Json = None,
) -> None:
    """Show a sequence on a monitor, for any camera.

    One pattern pixel per screen pixel. The pattern starts in the upper left corner; the rest of the screen is
    black. Take one picture of each frame, in this order. With --seconds, --json gets the start of every
    frame, seconds after the first.

    --pictures needs no display: show the pictures in this order, one pattern pixel per screen pixel, and take
    a picture of each; then decode these with --description DIR/capture.toml.

    --colour needs a third of the pictures, a colour camera with linear levels, and `response --colour` once.
    """
    if pictures is not None:
        _write(in_colour(shown_sequence(sequence, size), colour), sequence, pictures, json_path)
        return
    found = ol.projector.monitors()
    if listing:
        write_json(json_path, {"monitors": [asdict(monitor) for monitor in found]})
        print_monitors(found)
        return
    chosen = _chosen(found, monitor, size is None)
    print_notices(() if chosen is None else chosen.faults())
    if size is None and sequence.endswith(".toml"):
        shown = ol.patterns.Sequence.load(sequence)
    else:
        shape = size if size is not None or chosen is None else (chosen.rows, chosen.cols)
        if shape is None:
            raise InputError("--pixels: must be given for a plain window, such as 640x480")
        shown = ol.patterns.sequence_from_text(sequence, *shape)
    shown = in_colour(shown, colour)
    described, index = out or Path("capture.toml"), None if chosen is None else chosen.index
    times = list[float]()
    with ol.projector.PatternWindow(shown, monitor=index) as window:
        described.parent.mkdir(parents=True, exist_ok=True)
        ol.projector.write_description(described, shown)
        if seconds is None:
            window.run()
        else:
            times = window.play(seconds)
    if window.gone:
        count = f" after {len(times)} of {shown.exposures} frames" if seconds is not None else ""
        cure = "connect it and show the sequence again"
        raise InputError(f"display: monitor {index} was disconnected{count}; {cure}")
    numbers = {"sequence": sequence, "frames": shown.exposures, "size": shown.shape, "monitor": index}
    write_json(json_path, numbers | {"shown_s": times})
    if seconds is not None:
        mean = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else math.nan
        rows = {
            "sequence": sequence,
            "frames": f"{len(times)} of {shown.exposures}, of {shown.rows} x {shown.cols}",
            "each": f"{number(mean, 's')} on average",
            "described": str(described),
        }
        table("Shown in a window" if index is None else f"Shown on monitor {index}", rows)


def _chosen(
    found: "list[ol.projector.Monitor]", asked: str | None, full: bool
) -> "ol.projector.Monitor | None":
    """The monitor asked for, else the second one, else (full) the only one, else none: a plain window."""
    if asked is None:
        return found[1] if len(found) > 1 else found[0] if full and found else None
    if not asked.isdecimal():
        return ol.projector.choose_monitor(found, asked)
    if int(asked) >= len(found):
        most = f"0 to {len(found) - 1}" if len(found) > 1 else "0, the only one"
        raise InputError(f"--monitor {asked}: does not exist, must be {most} (see --list)")
    return found[int(asked)]


def _write(shown: "ol.patterns.Sequence", name: str, pictures: Path, json_path: Path | None) -> None:
    """--pictures: 000.png, 001.png, ... and their description."""
    with ol.files.together():
        with ol.files.atomic_folder(pictures) as folder:
            shown.save_png(folder)
            ol.projector.write_description(folder / "capture.toml", shown)
        write_json(json_path, {"sequence": name, "frames": shown.exposures, "size": shown.shape[1:]})
    rows = {
        "sequence": name,
        "pictures": f"{shown.exposures} of {shown.rows} x {shown.cols}",
        "description": str(pictures / "capture.toml"),
    }
    table(f"Patterns in {pictures}", rows)
