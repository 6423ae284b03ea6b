"""Readings beside their frames, and the same readings from the frames again.

A recording of `projector.Recorder` with two more files: prepared.npz, the rig, and readings.jsonl, the
figures of every reading and the CRC-32 of its height and sigma.
"""

import json
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from optolever.errors import InputError
from optolever.files import read_lines
from optolever.projector import Recorder, Recording

from .follow import Followed
from .prepared import Prepared
from .stream import Live

__all__ = ["ReadingRecorder", "Replayed", "has_readings", "replayed"]

_READINGS, _PREPARED = "readings.jsonl", "prepared.npz"


class ReadingRecorder:
    """Writes the readings of one `Live`, from its first frame on. A context manager. InputError if the folder
    is not empty; OSError on a full disk, all readings with a line are intact."""

    def __init__(self, folder: str | Path, prepared: Prepared, camera: str) -> None:
        self._frames = Recorder(folder, {"camera": camera})
        prepared.save(self._frames.folder / _PREPARED)
        self._lines = (self._frames.folder / _READINGS).open("w", encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lines.close()
        self._frames.close()

    def write(self, followed: Followed) -> None:
        """The frame, then its reading."""
        self._frames.image(followed.image, followed.image.arrived_s)
        self._lines.write(_line(followed) + "\n")
        self._lines.flush()


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A reading anew; identical: bit by bit to the recorded one, heights and sigmas included; recorded: False
    where the line of that frame is lost."""

    followed: Followed
    identical: bool
    recorded: bool = True


def has_readings(folder: str | Path) -> bool:
    """Whether a recording has readings."""
    return (Path(folder) / _READINGS).is_file()


def replayed(folder: str | Path) -> Iterator[Replayed]:
    """The readings of a recording, computed again in their order. A recording that was killed may lack the
    last lines; one in the middle may be lost. InputError of a damaged file."""
    recording, live = Recording(folder), Live(Prepared.load(Path(folder) / _PREPARED))
    path, done = Path(folder) / _READINGS, 0
    lines = read_lines(path, lambda line: {"frame", "crc32"} <= line.keys())
    for logged in recording.images():
        if done == len(lines):
            return
        start = time.perf_counter()
        reading = live.update(logged.image.pixels, logged.image.arrived_s)
        followed = Followed(reading, logged.image, time.perf_counter() - start)
        recorded = lines[done]["frame"] == logged.image.id
        yield Replayed(followed, recorded and _line(followed) == json.dumps(lines[done]), recorded)
        done += recorded
    if done < len(lines):
        raise InputError(f"{path}: frame {lines[done]['frame']} of line {done + 1} is not in the recording")


def _line(followed: Followed) -> str:
    numbers = followed.to_dict()
    del numbers["delay_s"]
    maps = (followed.reading.z, followed.reading.sigma)
    crc = [zlib.crc32(np.ascontiguousarray(one).tobytes()) for one in maps]
    return json.dumps(numbers | {"crc32": crc})
