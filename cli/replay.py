"""`optolever camera replay`: check of a recording; a capture's recording as a capture folder."""

from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import Arg, Opt, Rare, program
from .options import Json
from .show import number, print_notices, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever camera replay cap.recording
Recording cap.recording
  camera    virtual
  images    20, incomplete 0
  patterns  20 swaps
  span      0.1406 s, 135.2 images a second
"""


OUT = Opt("--out DIR", "Capture folder to make from the recording of a capture.")
RIG = Rare("--rig RIG.toml", "Rig whose [sync] selects the images; default: the recording's timing.")


@program("replay", SAMPLE)
def command(
    folder: Annotated[Path, Arg("DIR")],
    out: Annotated[Path | None, OUT] = None,
    rig: Annotated[Path | None, RIG] = None,
    json_path: Json = None,
) -> None:
    """Check that every image of a recording is intact.

    --out selects the frames of a capture's recording anew, by the recorded times; an aborted capture gives
    the frames before it ended. Other commands replay with --set camera=replay:DIR. Readings that
    `live --record` wrote are computed again and compared bit by bit.
    """
    import numpy as np

    recording = ol.projector.Recording(folder)
    swaps, stamps, incomplete = 0, [], 0
    for event in recording:
        if isinstance(event, ol.projector.Logged):
            stamps.append(event.stamp_s)
            incomplete += not event.image.complete
        else:
            swaps += 1
    span = float(np.ptp(stamps)) if stamps else 0.0
    numbers = {"images": len(stamps), "incomplete": incomplete, "swaps": swaps, "span_s": span}
    again, same, seconds = 0, 0, 0.0
    for one in ol.live.replayed(folder) if ol.live.has_readings(folder) else ():
        again, same, seconds = again + 1, same + one.identical, seconds + one.followed.delay
    numbers |= {"readings": again, "identical": same} if again else {}
    with ol.files.together():
        if out is not None:
            numbers["frames"] = _capture(recording, rig, out)
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
    if again:
        rows["readings"] = f"{same} of {again} bit-identical, {number(1e3 * seconds / again, 'ms')} each"
    if same < again:
        name = f"{again - same} of {again} readings differ from the recorded ones"
        print_notices([f"{name}: another version of the program, of its libraries, or another processor"])
    table(f"Recording {folder}", rows)


def _capture(recording: "ol.projector.Recording", rig: Path | None, out: Path) -> int:
    """Write the capture folder of a capture's recording; returns the number of frames."""
    import tomllib

    import numpy as np

    from optolever.projector.cameras import Replay

    about = recording.about
    if "sequence" not in about:
        raise InputError(
            f"--out {out}: {recording.folder} has no sequence, must be the recording of a capture "
            "(capture --keep)"
        )
    shown = ol.patterns.Sequence.from_dict(about["sequence"], str(recording.folder))
    section = (
        about.get("timing") if rig is None else tomllib.loads(rig.read_text(encoding="utf-8")).get("sync")
    )
    timing = (
        None if section is None else ol.projector.Timing.from_table(section, f"{recording.folder}: [sync]")
    )
    replay = Replay(recording.folder)
    taken = []
    try:
        for one in ol.projector.acquire(
            replay, replay, timing, range(len(shown)), time=replay, clock=ol.projector.ClockMap()
        ):
            taken.append(one)
    except ol.projector.CameraLost:
        if not taken:
            raise
    frames = np.stack([one.image.pixels for one in taken])
    stamps = np.array([one.stamp_s for one in taken])
    bits = recording.accepted.bits if recording.accepted is not None else 8 * frames.dtype.itemsize
    ol.projector.Capture(frames, shown[: len(taken)], timestamps=stamps - stamps[0], bits=bits).save(out)
    return len(taken)
