"""Recordings: a folder of frames.tif (BigTIFF, a page an image, uncompressed) and log.jsonl, a line an event.

The line of an image is written after its page: a page without a line does not exist. A process that is
killed, or a disk that is full, leaves all images that have a line. Lines, by "event":

    recording: version, wall_less_monotonic_s, free text fields of who recorded; the first one
    configured: the settings that a camera accepted
    shown: index, swapped_s, late
    image: page, id, device_s, arrived_s, stamp_s, complete, why, crc32; reading, where somebody read it
"""

import errno
import json
import os
import queue
import threading
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import tifffile

from optolever.errors import InputError
from optolever.files import read_lines

from .devices import Accepted, Image, Shown, no_pixels

__all__ = ["BackgroundRecorder", "Logged", "Recorder", "Recording"]

_VERSION = 1
_WAITING = 256 << 20
_PAGES, _LOG = "frames.tif", "log.jsonl"
_NEEDED = {
    "recording": {"version"},
    "configured": {"exposure_s", "rows", "cols"},
    "shown": {"index", "swapped_s"},
    "image": {"id", "device_s", "arrived_s", "stamp_s", "complete", "why"},
}


class Recorder:
    """Writes a recording, event by event. A context manager."""

    def __init__(self, folder: str | Path, about: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise InputError(f"{self.folder}: exists and is no empty folder; name another")
        self.folder.mkdir(parents=True, exist_ok=True)
        self._log = (self.folder / _LOG).open("w", encoding="utf-8")
        self._file = (self.folder / _PAGES).open("w+b")
        self._pages = tifffile.TiffWriter(self._file, bigtiff=True)
        self.images = 0
        wall = time.time() - time.monotonic()
        self._line("recording", {"version": _VERSION, "wall_less_monotonic_s": wall, **about})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def configured(self, accepted: Accepted) -> None:
        """Settings that hold from now on."""
        self._line("configured", asdict(accepted))

    def shown(self, shown: Shown) -> None:
        """A frame came on."""
        self._line("shown", asdict(shown))

    def image(self, image: Image, stamp_s: float, reading: Mapping[str, Any] | None = None) -> None:
        """An image, its time, and plain values that were read from it; one that is not complete has no page.
        OSError of `folder` on a full disk."""
        line = {
            "id": image.id,
            "device_s": image.device_s,
            "arrived_s": image.arrived_s,
            "stamp_s": stamp_s,
            "complete": image.complete,
            "why": image.why,
        }
        if image.complete:
            pixels = np.ascontiguousarray(image.pixels)
            place = self._pages.write(
                pixels,
                contiguous=False,
                photometric="minisblack",
                metadata=None,
                returnoffset=True,
                description=f"id {image.id} stamp {stamp_s:.6f}",
            )
            self._file.flush()
            if place is None or os.fstat(self._file.fileno()).st_size < sum(place):  # a part may be written
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.folder))
            line |= {"page": self.images, "crc32": zlib.crc32(pixels.tobytes())}
            self.images += 1
        self._line("image", line if reading is None else line | {"reading": reading})

    def _line(self, event: str, values: Mapping[str, Any]) -> None:
        self._log.write(json.dumps({"event": event, **values}) + "\n")
        self._log.flush()

    def close(self) -> None:
        """All that has a line is readable without."""
        self._log.close()
        with suppress(OSError):  # of a full disk, again
            self._pages.close()
            self._file.close()


class BackgroundRecorder:
    """Writes in a separate thread, so that a slow disk does not delay the camera.

    At most 256 MB of images wait; those beyond are dropped, and counted. failure: the OSError that ended it.
    """

    def __init__(self, recorder: Recorder, image_bytes: int) -> None:
        self._recorder = recorder
        self._queue: queue.Queue[tuple[Image, float] | None] = queue.Queue(max(1, _WAITING // image_bytes))
        self.dropped = 0
        self.failure: OSError | None = None
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def image(self, image: Image, stamp_s: float) -> None:
        """Hand over an image. OSError once the disk is full."""
        if self.failure is not None:
            raise self.failure
        try:
            self._queue.put_nowait((image, stamp_s))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write the queue."""
        self._queue.put(None)
        self._thread.join()

    def _write(self) -> None:
        while (one := self._queue.get()) is not None:
            try:
                if self.failure is None:
                    self._recorder.image(*one)
            except OSError as error:
                self.failure = error


@dataclass(frozen=True, slots=True, eq=False)
class Logged:
    """An image of a recording, the time that was found for it, and what was read from it."""

    image: Image
    stamp_s: float
    reading: Mapping[str, Any] | None = None


class Recording:
    """Reads a recording, complete or cut off. InputError names the file and its fault.

    about: the first line; accepted: the last settings, None without.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        log = self.folder / _LOG
        if not log.is_file():
            raise InputError(f"{self.folder}: no recording, {_LOG} is missing")
        self._lines = read_lines(log, _is_whole)
        if not self._lines or self._lines[0].get("version") != _VERSION:
            raise InputError(f"{log}: the first line must state version {_VERSION}")
        self.about = self._lines[0]
        settings = [line for line in self._lines if line["event"] == "configured"]
        self.accepted = None if not settings else Accepted(**_plain(settings[-1], Accepted))

    def __len__(self) -> int:
        """Images, complete or not."""
        return sum(line["event"] == "image" for line in self._lines)

    def __iter__(self) -> Iterator[Shown | Logged]:
        """Swaps and images in their order. InputError of an image whose pixels are not those of its line."""
        with ExitStack() as open_files:
            pages = self._pages(open_files)
            for line in self._lines:
                if line["event"] == "shown":
                    yield Shown(**_plain(line, Shown))
                elif line["event"] == "image":
                    yield Logged(self._image(line, pages), line["stamp_s"], line.get("reading"))

    def images(self) -> Iterator[Logged]:
        """Images in their order."""
        return (event for event in self if isinstance(event, Logged))

    def _pages(self, open_files: ExitStack) -> tifffile.TiffPages | None:
        """Of the file, while it is open; None where no image has a page."""
        if not any("page" in line for line in self._lines):
            return None
        try:
            return open_files.enter_context(tifffile.TiffFile(self.folder / _PAGES)).pages
        except (OSError, tifffile.TiffFileError) as error:
            raise InputError(f"{self.folder / _PAGES}: not readable ({error})") from error

    def _image(self, line: Mapping[str, Any], pages: tifffile.TiffPages | None) -> Image:
        pixels = no_pixels()
        if "page" in line:
            page, where = line["page"], self.folder / _PAGES
            if pages is None or page >= len(pages):
                raise InputError(f"{where}: page {page} is missing, its line is there")
            try:
                pixels = pages[page].asarray()
            except (ValueError, tifffile.TiffFileError) as error:
                raise InputError(f"{where}: page {page} is damaged ({error})") from error
            if zlib.crc32(pixels.tobytes()) != line["crc32"]:
                raise InputError(f"{where}: page {page} is damaged, its crc32 is not {line['crc32']}")
        names = ("id", "device_s", "arrived_s", "complete", "why")
        return Image(pixels, **{name: line[name] for name in names})


def _is_whole(line: Any) -> bool:
    """Whether a line has the names that its event needs; an image that is complete has a page."""
    names = line.keys()
    return _NEEDED[line["event"]] <= names and (not line.get("complete") or {"page", "crc32"} <= names)


def _plain(line: Mapping[str, Any], record: type[Accepted | Shown]) -> dict[str, Any]:
    values = {field.name: line[field.name] for field in fields(record) if field.name in line}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
