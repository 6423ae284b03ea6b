"""`optolever camera replay`: check of a recording; a capture's recording as a capture folder.

$ optolever camera replay cap.recording
Recording cap.recording
  camera    virtual
  images    21, incomplete 0
  patterns  20 swaps
  span      0.1406 s, 135.2 images a second
"""

from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import Arg, Opt, program
from .options import Json
from .outputs import NewFolder
from .printing import number, print_notices, table, write_json
from .rig.recorded_capture import captured

OUT = Opt("--out DIR", "Capture folder to make from the recording of a capture.", NewFolder())


@program("replay", __doc__)
def command(
    folder: Annotated[Path, Arg("DIR")],
    out: Annotated[Path | None, OUT] = None,
    json_path: Json = None,
) -> None:
    """Check that every image of a recording is intact.

    --out selects the frames of a capture's recording anew, by the recorded times; an aborted capture gives
    the frames before it ended. Other commands replay with --set camera=replay:DIR. Readings that
    `live --record` wrote are computed again and compared bit by bit.
    """
    recording = ol.camera.Recording(folder)
    swaps, stamps, incomplete = 0, [], 0
    for event in recording:
        if isinstance(event, ol.camera.Logged):
            stamps.append(event.stamp_s)
            incomplete += not event.image.complete
        else:
            swaps += 1
    span = max(stamps) - min(stamps) if stamps else 0.0
    numbers = {"images": len(stamps), "incomplete": incomplete, "swaps": swaps, "span_s": span}
    again, same, seconds = 0, 0, 0.0
    for one in ol.live.replayed(folder) if ol.live.has_readings(folder) else ():
        again, same, seconds = again + 1, same + one.identical, seconds + one.followed.delay
    numbers |= {"readings": again, "identical": same} if again else {}
    with ol.files.together():
        if out is not None:
            numbers["frames"] = _capture(recording, out)
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


def _capture(recording: "ol.camera.Recording", out: Path) -> int:
    """Write the capture folder of a capture's recording; returns the number of frames."""
    from optolever.camera.cameras import Replay

    about, folder = recording.about, recording.folder
    if "sequence" not in about:
        cure = "must be the recording of a capture (camera measure --keep)"
        raise InputError(f"--out {out}: {folder} has no sequence, {cure}")
    shown = ol.patterns.Sequence.from_dict(about["sequence"], str(folder))
    timing = about.get("timing")
    if timing is not None:
        timing = ol.camera.Timing.from_table(timing, f"{folder}: [sync]")
    replay, taken = Replay(folder), list["ol.camera.Taken"]()
    clock, order = ol.camera.ClockMap(), range(shown.exposures)
    try:
        for one in ol.camera.acquire(replay, replay, timing, order, time=replay, clock=clock):
            taken.append(one)
    except InputError:
        if not taken:
            raise
    captured(taken, shown, recording.accepted).save(out)
    return len(taken)
