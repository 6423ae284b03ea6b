"""Readings beside their frames, and the same readings from the frames again.

A recording of `camera.Recorder` with the rig in prepared.npz; the line of an image has the figures of
its reading and the CRC-32 of its height and sigma."""

import json
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optolever.camera import Recorder, Recording

from .follow import Followed
from .rest.prepared import Prepared
from .stream import Live

__all__ = ["ReadingRecorder", "Replayed", "has_readings", "replayed"]

_PREPARED = "prepared.npz"


class ReadingRecorder(Recorder):
    """Writes the readings of one `Live`, from its first frame on. InputError if the folder is not empty;
    OSError on a full disk, all readings with a line are intact."""

    def __init__(self, folder: str | Path, prepared: Prepared, camera: str) -> None:
        super().__init__(folder, {"camera": camera})
        prepared.save(self.folder / _PREPARED)

    def write(self, followed: Followed) -> None:
        """The frame and its reading."""
        self.image(followed.image, followed.reading.time, _numbers(followed))


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A reading that was computed again; identical: whether it equals the recorded one bit by bit, with
    heights and sigmas."""

    followed: Followed
    identical: bool


def has_readings(folder: str | Path) -> bool:
    """Whether a recording has readings."""
    return (Path(folder) / _PREPARED).is_file()


def replayed(folder: str | Path) -> Iterator[Replayed]:
    """The readings of a recording, computed again in their order. InputError of a damaged file."""
    live = Live(Prepared.load(Path(folder) / _PREPARED))
    for logged in Recording(folder).images():
        start = time.perf_counter()
        reading = live.update(logged.image.pixels, logged.stamp_s)
        followed = Followed(reading, logged.image, time.perf_counter() - start)
        yield Replayed(followed, json.dumps(_numbers(followed)) == json.dumps(logged.reading))


def _numbers(followed: Followed) -> dict[str, Any]:
    numbers = followed.to_dict()
    del numbers["delay_s"], numbers["probes"], numbers["wall_s"]
    maps = (followed.reading.z, followed.reading.sigma)
    return numbers | {"crc32": [zlib.crc32(np.ascontiguousarray(one).tobytes()) for one in maps]}
