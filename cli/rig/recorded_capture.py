"""A capture by the camera of a rig: recorded while it is taken, then written as a capture folder."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import optolever as ol
from optolever import InputError
from optolever.errors import reason_of

from ..printing import print_notices
from .opened import opened, sequence_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class _Times(NamedTuple):
    """Of an image."""

    stamp_s: float
    swapped_s: float


@dataclass(frozen=True)
class RigCapture:
    """A capture, its images with their times, its duration, images lost by the camera; late: swaps over 1.5
    refreshes after their call."""

    capture: "ol.projector.Capture | ol.projector.ColourCapture"
    taken: tuple["ol.camera.Taken", ...]
    seconds: float
    lost: int
    late: int = 0

    def numbers(self) -> dict[str, Any]:
        """For --json."""
        return {
            "frames": len(self.taken),
            "seconds": self.seconds,
            "lost": self.lost,
            "late": self.late,
            "repeats": sum(one.repeats for one in self.taken),
            "early": sum(one.refused["early"] for one in self.taken),
            "incomplete": sum(one.refused["incomplete"] for one in self.taken),
        }


def capture_rig(
    rig: Path,
    devices: "ol.camera.Devices",
    shown: "ol.patterns.Sequence",
    out: Path,
    *,
    keep: bool,
    record: Path | None = None,
) -> RigCapture:
    """Show and take every frame; write `out` with acquisition.jsonl. record: the recording, OUT.recording;
    keep: do not delete it.

    InputError and CameraLost name the recording of the images so far, and the command that hands them out.
    """
    ol.files.require_new_folder(out)
    scene = ol.scene.load(rig)
    record = _new_name(out.with_name(f"{out.name}.recording") if record is None else record)
    with opened(rig, devices, shown) as now:
        now.require_size(scene)
        if (timing := now.wait(rig)) is None:
            wait = "every pattern gets 0.5 s to settle; optolever camera sync measures the time"
            print_notices([f"The rig has no [sync]: {wait}"])
        about: dict[str, Any] = {"camera": now.camera.identity.address, "refresh_s": now.display.refresh_s}
        about |= {"rig": rig.read_text(encoding="utf-8"), "sequence": shown.to_dict()}
        if timing is not None:
            about["timing"] = timing.to_table()
        begin, shows = now.time.now(), list[ol.projector.Shown]()
        try:
            with ol.camera.Recorder(record, about) as recorder:
                recorder.configured(now.accepted)

                def note(one: ol.projector.Shown) -> None:
                    shows.append(one)
                    recorder.shown(one)

                calls = {"on_image": recorder.image, "on_shown": note}
                taken = tuple(now.acquire(timing, range(shown.exposures), **calls))
        except (InputError, OSError, KeyboardInterrupt) as error:
            reason = reason_of(error) if isinstance(error, OSError) else str(error)
            there = f"what was taken so far is in {record} (optolever camera replay {record} --out DIR)"
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(there) from error
            raise InputError(f"{reason}; {there}") from error
        seconds, lost = now.time.now() - begin, now.camera.lost
    done = captured(taken, shown, now.accepted, scene)
    with ol.files.atomic_folder(out) as folder:
        done.save(folder)
        lines = (json.dumps(_line(one)) for one in taken)
        (folder / "acquisition.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if not keep:
        shutil.rmtree(record)
    return RigCapture(done, taken, seconds, lost, sum(one.late for one in shows))


def capture_rest(
    rig: Path, fringe: "ol.patterns.Sequence", count: int
) -> "tuple[ol.projector.Capture, NDArray[np.unsignedinteger]]":
    """A dense capture of the mirror at rest, and `count` frames of one fringe."""
    dense = sequence_of(rig, "gray+phase")
    shown = ol.patterns.Sequence((*dense.frames, *fringe.frames), dense.rows, dense.cols)
    taken = capture_now(rig, shown, (*range(len(dense)), *[len(dense)] * count))
    frames, bits, scene = taken.frames, taken.bits, taken.scene
    return ol.projector.Capture(frames[: len(dense)], dense, scene, bits=bits), frames[len(dense) :]


def capture_now(
    rig: Path, shown: "ol.patterns.Sequence", order: Sequence[int] | None = None
) -> "ol.projector.Capture":
    """Images of the frames of a sequence, or of some of them in an order, without a folder."""
    import numpy as np

    order, scene = range(len(shown)) if order is None else order, ol.scene.load(rig)
    with opened(rig, ol.camera.devices_of(rig), shown) as now:
        now.require_size(scene)
        frames = np.stack([one.image.pixels for one in now.acquire(now.wait(rig), order)])
        ordered = ol.patterns.Sequence(tuple(shown.frames[k] for k in order), shown.rows, shown.cols)
        return ol.projector.Capture(frames, ordered, scene, bits=now.accepted.bits)


def captured(
    taken: "Sequence[ol.camera.Taken]",
    shown: "ol.patterns.Sequence",
    accepted: "ol.projector.Accepted | None",
    scene: "ol.scene.Scene | None" = None,
) -> "ol.projector.Capture | ol.projector.ColourCapture":
    """A capture of the images of the first frames of a sequence, in colour of all its exposures; accepted:
    None, all bits of the pixels."""
    import numpy as np

    frames = np.stack([one.image.pixels for one in taken])
    stamps = np.array([one.stamp_s for one in taken])
    times, bits = stamps - stamps[0], 8 * frames.dtype.itemsize if accepted is None else accepted.bits
    if shown.packing is None:
        return ol.projector.Capture(frames, shown[: len(taken)], scene, times, bits)
    if len(taken) < shown.exposures:
        raise InputError(f"capture: {len(taken)} of {shown.exposures} pictures in colour; take it again")
    return ol.projector.ColourCapture(frames, shown, scene, times, bits, accepted.mosaic if accepted else "")


def _new_name(path: Path) -> Path:
    """The path, numbered where an earlier attempt left it."""
    names = (path, *(path.with_name(f"{path.stem}-{k}{path.suffix}") for k in range(2, 1000)))
    return next((one for one in names if not one.exists()), path)


def _line(one: "ol.camera.Taken") -> dict[str, Any]:
    """An image of acquisition.jsonl."""
    return {
        "index": one.index,
        "id": one.image.id,
        "device_s": one.image.device_s,
        "swapped_s": one.swapped_s,
        "stamp_s": one.stamp_s,
        "arrived_s": one.image.arrived_s,
        "repeats": one.repeats,
        **one.refused,
    }


def measured_lag(rig: Path, capture: Path) -> float:
    """Mean share of the frame before in a capture's images, by the rig's [sync] and the times in its
    acquisition.jsonl; 0 without either."""
    times = capture / "acquisition.jsonl"
    timing = ol.camera.timing_of(rig) if rig.suffix.lower() == ".toml" and times.is_file() else None
    if timing is None:
        return 0.0
    lines = ol.files.read_lines(times, lambda line: isinstance(line, dict))
    try:
        from optolever.schema import built  # NumPy

        taken = [built(_Times, line, f"line {number}") for number, line in enumerate(lines, 1)]
    except InputError as error:
        raise InputError(f"{times}: {error}") from error
    return sum(timing.lag(one.stamp_s - one.swapped_s) for one in taken) / max(len(taken), 1)
