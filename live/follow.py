"""follow(): readings of a camera as an iterator; their figures as plain values; the mirror at rest anew."""

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from optolever.arrays import Frame
from optolever.camera import ClockMap
from optolever.camera.cameras import Replay
from optolever.errors import InputError
from optolever.projector import Image

from .fringe.chain import rest_state
from .probes import Probed, Probes
from .reading import Reading
from .rest.prepared import Prepared
from .source import Source
from .stream import Live

__all__ = ["Followed", "follow", "tared"]

_PATIENCE = 30.0  # s without a frame, after which the camera counts as lost


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A reading, its image, its latency after the image's arrival, s, and the probes; wall: the reading's
    time by the wall clock, s since 1970, one offset for all of a camera's."""

    reading: Reading
    image: Image
    delay: float
    probes: tuple[Probed, ...] = ()
    wall: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, no maps."""
        reading = self.reading
        depth, sigma = reading.deepest or (None, None)
        return {
            "frame": self.image.id,
            "time_s": reading.time,
            "wall_s": self.wall,
            "delay_s": self.delay,
            "trusted": reading.trusted,
            "reason": reading.reason,
            "notices": [str(notice) for notice in reading.notices],
            "depth_mm": depth,
            "depth_sigma_mm": sigma,
            "depth_total_sigma_mm": None if depth is None else reading.depth_total_sigma,
            "range_used": reading.figures.used,
            "touches": [touch.to_dict() for touch in reading.touches],
            "forces": [asdict(force) for force in reading.forces],
            "probes": [asdict(probe) for probe in self.probes],
        }


def follow(
    live: Live, source: Source, frames: int | None = None, probes: Probes | None = None
) -> Iterator[Followed]:
    """Readings of a camera's complete frames, `frames` of them, or without end; their time is the exposure's
    stamp, or where the camera has none, the arrival. InputError if no frame arrives."""
    done, last, clock, offset = 0, time.monotonic(), ClockMap(), _wall_less_monotonic(source)
    while frames is None or done < frames:
        image = source.next(1.0)
        if image is None or not image.complete:
            if time.monotonic() - last > _PATIENCE:
                raise InputError(f"camera: no frame for {_PATIENCE:g} s; is it plugged in?")
            continue
        reading = live.update(image.pixels, clock.stamp(image).time_s)
        last = time.monotonic()
        done += 1
        probed = probes.read(reading, image.id) if probes else ()
        yield Followed(reading, image, last - image.arrived_s, probed, offset + reading.time)


def _wall_less_monotonic(source: Source) -> float:
    """Of the clocks, s; of a recording, as it was recorded."""
    camera = getattr(source, "camera", None)
    now = time.time() - time.monotonic()
    return float(camera.recording.about["wall_less_monotonic_s"]) if isinstance(camera, Replay) else now


def tared(prepared: Prepared, frames: Frame) -> Prepared:
    """The rig with the mirror of these frames (N, H, W) as its rest, to correct a drift of zero. The measured
    noise stays. InputError of frames of another size, or of none."""
    carriers, size = prepared.rig.carriers, (prepared.rows, prepared.cols)
    if np.ndim(frames) != 3 or np.shape(frames)[1:] != size or not len(frames):
        raise InputError(f"frames: {np.shape(frames)}, must be (N, {size[0]}, {size[1]}), one or more")
    rows, cols = carriers.lit.shape
    mean = np.asarray(frames, np.float64)[:, :rows, :cols].mean(axis=0).astype(np.float32)
    state = rest_state(carriers, mean, prepared.rig.rest)
    return replace(prepared, rig=replace(prepared.rig, rest=state))
