"""`optolever capture`: frames of a mirror by a rig's camera."""

from pathlib import Path
from typing import Annotated

import optolever as ol

from .arguments import Opt, Rare, program
from .options import Json, Shown
from .rig_capture import capture_rig
from .rig_devices import Changes, OpenedRig, sequence_of
from .show import number, table, write_json

SAMPLE = """
$ optolever capture --rig rig.toml --out press
Capture in press
  camera    virtual
  sequence  gray+phase
  frames    20 of 96 x 120
  images    0 lost, 0 incomplete
  patterns  0 shown again, 0 late
  time      0.1069 s
"""


@program("capture", SAMPLE)
def command(
    rig: OpenedRig,
    out: Annotated[Path, Opt("--out DIR", "Folder to make; it must be new or empty.")],
    sequence: Shown = "gray+phase",
    changes: Changes = (),
    keep: Annotated[bool, Rare("--keep", "Keep the recording of all images, DIR.recording.")] = False,
    json_path: Json = None,
) -> None:
    """Take a capture with the camera of a rig.

    The display shows the frames, and the camera takes the first image of each whose exposure began after the
    pattern had settled ([sync], else after 0.5 s). DIR receives capture.toml, frames/*.png and
    acquisition.jsonl: times and repeated frames. The recording of an aborted capture stays in DIR.recording
    (optolever camera replay).
    """
    shown, devices = sequence_of(rig, sequence), ol.projector.devices_of(rig, changes)
    with ol.files.together():
        done = capture_rig(rig, devices, shown, out, keep=keep)
        write_json(json_path, done.numbers())
    numbers, (rows, cols) = done.numbers(), done.capture.shape
    figures = {
        "camera": devices.camera,
        "sequence": sequence,
        "frames": f"{len(shown)} of {rows} x {cols}",
        "images": f"{done.lost} lost, {numbers['incomplete']} incomplete",
        "patterns": f"{numbers['repeats']} shown again, {numbers['late']} late",
        "time": number(done.seconds, "s"),
    }
    table(f"Capture in {out}", figures)
