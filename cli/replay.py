"""`optolever replay`: check of a recording; the recording of a capture becomes a capture folder again."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever import InputError

from .options import FILE, json_option, sample
from .outputs import OutputFile, Program
from .show import number, table, write_json

if TYPE_CHECKING:
    from optolever.projector import Recording

__all__ = ["command"]

SAMPLE = """
$ optolever replay cap.recording
Recording cap.recording
  camera    virtual
  images    20, incomplete 0
  patterns  20 swaps
  span      0.1406 s, 135.2 images a second
"""


@click.command("replay", cls=Program, epilog=sample(SAMPLE))
@click.argument("folder", type=FILE, metavar="DIR")
@click.option("--rig", type=FILE, metavar="RIG.toml", help="Whose [sync] decides; default: as it was taken.")
@click.option("--out", type=FILE, metavar="DIR", help="Capture folder to make of a capture's recording.")
@click.option(
    "--mcap", type=OutputFile(".mcap"), metavar="FILE.mcap", help="Also write it for ROS 2 (extra mcap)."
)
@json_option
def command(
    folder: Path, rig: Path | None, out: Path | None, mcap: Path | None, json_path: Path | None
) -> None:
    """Check a recording: every page against its line.

    --out takes the images of a capture once more, by the times that were recorded; one that broke off gives
    the frames until then. Other commands replay too: --camera replay:DIR.
    """
    import numpy as np

    from optolever.files import together
    from optolever.projector import Logged, Recording, write_mcap

    recording = Recording(folder)
    swaps, stamps, incomplete = 0, [], 0
    for event in recording:
        if isinstance(event, Logged):
            stamps.append(event.stamp_s)
            incomplete += not event.image.complete
        else:
            swaps += 1
    span = float(np.ptp(stamps)) if stamps else 0.0
    numbers = {"images": len(stamps), "incomplete": incomplete, "swaps": swaps, "span_s": span}
    with together():
        if out is not None:
            numbers["frames"] = _capture(recording, rig, out)
        if mcap is not None:
            numbers["exported"] = write_mcap(recording, mcap)
        write_json(json_path, numbers)
    rate = number((len(stamps) - 1) / span) if span > 0 else "-"
    rows = {
        "camera": str(recording.about.get("camera", "unknown")),
        "images": f"{len(stamps)}, incomplete {incomplete}",
        "patterns": f"{swaps} swaps",
        "span": f"{number(span, 's')}, {rate} images a second",
    }
    if out is not None:
        rows["capture"] = f"{numbers['frames']} frames in {out}"
    if mcap is not None:
        rows["mcap"] = f"{numbers['exported']} images in {mcap}"
    table(f"Recording {folder}", rows)


def _capture(recording: "Recording", rig: Path | None, out: Path) -> int:
    """Write the capture folder of a capture's recording; returns the number of frames."""
    import tomllib

    import numpy as np

    from optolever.patterns import Sequence
    from optolever.projector import CameraLost, Capture, ClockMap, Timing, acquire
    from optolever.projector.cameras import Replay

    about = recording.about
    if "sequence" not in about:
        raise InputError(f"{recording.folder}: has no sequence, must be the recording of a capture")
    shown = Sequence.from_dict(about["sequence"], str(recording.folder))
    section = (
        about.get("timing") if rig is None else tomllib.loads(rig.read_text(encoding="utf-8")).get("sync")
    )
    timing = None if section is None else Timing.from_table(section, f"{recording.folder}: [sync]")
    replay = Replay(recording.folder)
    taken = []
    try:
        for one in acquire(replay, replay, timing, range(len(shown)), time=replay, clock=ClockMap()):
            taken.append(one)
    except CameraLost:
        if not taken:
            raise
    frames = np.stack([one.image.pixels for one in taken])
    stamps = np.array([one.stamp_s for one in taken])
    bits = recording.accepted.bits if recording.accepted is not None else 8 * frames.dtype.itemsize
    Capture(frames, shown[: len(taken)], timestamps=stamps - stamps[0], bits=bits).save(out)
    return len(taken)
