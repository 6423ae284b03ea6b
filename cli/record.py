"""`optolever camera record`: every image of a rig's camera, into a folder in common formats.

$ optolever camera record --rig rig.toml --seconds 0.5 --out film
Recording in film
  images      4, 8 a second
  lost        0 by the camera, 0 by the disk
  incomplete  0
"""

from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError
from optolever.errors import reason_of

from .arguments import ABOVE_0, Opt, program
from .options import Json
from .outputs import NewFolder
from .printing import number, table, write_json
from .rig.opened import Changes, OpenedRig, levels_of, opened


@program("record", __doc__)
def command(
    rig: OpenedRig,
    seconds: Annotated[float, Opt("--seconds SECONDS", "Duration.", ABOVE_0)],
    out: Annotated[Path, Opt("--out DIR", "Folder to make; new or empty.", NewFolder())],
    changes: Changes = (),
    json_path: Json = None,
) -> None:
    """Record images of a camera, with a white display.

    DIR gets frames.zst (images less the one before, compressed without loss) and log.jsonl, a line per image
    with its counter and times. After a kill or a full disk, all images with a line are intact.
    """
    devices = ol.camera.devices_of(rig, changes)
    numbers = dict.fromkeys(("images", "incomplete", "lost", "dropped"), 0)
    failure: BaseException | None = None
    with opened(rig, devices, levels_of(rig, "white")) as now:
        shown = now.display.show(0)
        size = now.accepted.rows * now.accepted.cols * (1 if now.accepted.bits == 8 else 2)
        about = {"camera": now.camera.identity.address, "refresh_s": now.display.refresh_s}
        with ol.camera.Recorder(out, about | {"rig": rig.read_text(encoding="utf-8")}) as recorder:
            recorder.configured(now.accepted)
            recorder.shown(shown)
            writer = ol.camera.BackgroundRecorder(recorder, size)
            arrivals = ol.camera.Arrivals(now.camera, now.time, now.clock, now.triggered, writer.image)
            try:
                for image, _ in arrivals.until(now.time.now() + seconds):
                    numbers["incomplete"] += not image.complete
            except (InputError, OSError, KeyboardInterrupt) as error:
                failure = error
            finally:
                writer.close()
            numbers |= {"images": recorder.images, "lost": now.camera.lost, "dropped": writer.dropped}
    failure = failure or writer.failure
    if failure is not None:
        there = f"{numbers['images']} images are in {out}"
        if isinstance(failure, KeyboardInterrupt):
            raise KeyboardInterrupt(there) from failure
        reason = reason_of(failure) if isinstance(failure, OSError) else failure
        raise InputError(f"{reason}; {there}") from failure
    write_json(json_path, numbers)
    rows = {
        "images": f"{numbers['images']}, {number(numbers['images'] / seconds)} a second",
        "lost": f"{numbers['lost']} by the camera, {numbers['dropped']} by the disk",
        "incomplete": str(numbers["incomplete"]),
    }
    table(f"Recording in {out}", rows)
