"""Recordings: a folder of frames.zst and log.jsonl, a line an event.

frames.zst holds a block for every complete image, each a Zstandard frame: the pixels less those of the
image before, modulo 2^8 or 2^16, little endian, of 16 bits all low bytes first; a key block holds the pixels
themselves, once a second. The line of an image is written after its block: a block without a line does not
exist. A process that is killed, or a disk that is full, leaves all images that have a line. Lines are
numbered from 0 ("line"), so that a lost or exchanged one is named. By "event":

    recording: version, wall_less_monotonic_s, free text fields of who recorded; the first one
    configured: the settings that a camera accepted
    shown: index, swapped_s, late
    image: id, device_s, arrived_s, stamp_s, complete, why; if complete page (its number), at and bytes (place
        of its block), key, rows, cols, planes (3 of colours), bits, crc32 (of the pixels); reading, where
        somebody read it
"""

import json
import queue
import threading
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal, Self

import numpy as np
import zstandard
from numpy.typing import NDArray

from optolever.errors import InputError, damage_of, reason_of
from optolever.files import growing_file, read_lines, require_new_folder
from optolever.projector import Accepted, Image, Shown, no_pixels
from optolever.schema import built

__all__ = ["BackgroundRecorder", "Logged", "Recorder", "Recording"]

_VERSION = 2
_WAITING = 256 << 20
_PAGES, _LOG = "frames.zst", "log.jsonl"
_KEY_S = 1.0  # from key to key
_LEVEL = 1  # of Zstandard: 3.6 bits a pixel of a still picture with photon noise; higher ones are no smaller
_OF_IMAGE = ("id", "device_s", "arrived_s", "complete", "why")
_MOST = 1 << 40  # bytes of a file


@dataclass(frozen=True, slots=True)
class _Block:
    """Where the pixels of an image are, and of what kind."""

    page: int
    at: int
    bytes: int
    key: bool
    rows: int
    cols: int
    bits: Literal[8, 16]
    crc32: int
    planes: Literal[1, 3] = 1

    def __post_init__(self) -> None:
        numbers = self.at, self.bytes, self.rows, self.cols
        if min(numbers) < 0 or max(*numbers, self.size) > _MOST:
            wrong = f"at {self.at}, {self.bytes} bytes, {self.rows} x {self.cols} pixels"
            raise InputError(f"page {self.page}: {wrong}: no place of an image")

    @property
    def size(self) -> int:
        """Bytes of the pixels."""
        return self.rows * self.cols * self.planes * self.bits // 8


@dataclass(frozen=True, slots=True)
class _ImageLine:
    """Fields of an image's line."""

    id: int | None
    device_s: float | None
    arrived_s: float
    stamp_s: float
    complete: bool
    why: str
    reading: Mapping[str, Any] | None = None
    block: _Block | None = None


@dataclass(frozen=True, slots=True)
class _About:
    """What every recording says first; others' fields are theirs."""

    wall_less_monotonic_s: float
    camera: str = ""
    refresh_s: float | None = None
    rig: str = ""
    sequence: Mapping[str, Any] | None = None
    timing: Mapping[str, Any] | None = None


_EVENTS: dict[str, Any] = {"recording": _About, "configured": Accepted, "shown": Shown, "image": _ImageLine}


class Recorder:
    """Writes a recording, event by event. A context manager."""

    def __init__(self, folder: str | Path, about: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        require_new_folder(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._log, self._file = growing_file(self.folder / _LOG), growing_file(self.folder / _PAGES, "wb")
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._before: NDArray[Any] | None = None
        self._at, self._lines, self._key_s = 0, 0, 0.0
        self.images = 0
        wall = time.time() - time.monotonic()
        try:
            self._line("recording", {"version": _VERSION, "wall_less_monotonic_s": wall, **about})
        except OSError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
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
            line |= self._block(image)
        self._line("image", line if reading is None else line | {"reading": reading})

    def _block(self, image: Image) -> dict[str, Any]:
        """Write the pixels; the fields of their line."""
        pixels = np.ascontiguousarray(image.pixels)
        before, bits = self._before, 8 * pixels.itemsize
        key = before is None or before.shape != pixels.shape or before.dtype != pixels.dtype
        key = key or not 0 <= image.arrived_s - self._key_s < _KEY_S
        block = self._compressor.compress(_packed(pixels if key else pixels - before))
        with self._blamed():
            self._file.seek(self._at)  # a part of one may be written
            self._file.write(block)
            self._file.flush()
        rows, cols, *planes = pixels.shape
        place = {"page": self.images, "at": self._at, "bytes": len(block), "key": key}
        self._before, self._at, self.images = pixels.copy(), self._at + len(block), self.images + 1
        self._key_s = image.arrived_s if key else self._key_s
        size = {"rows": rows, "cols": cols, "planes": planes[0] if planes else 1, "bits": bits}
        return place | size | {"crc32": zlib.crc32(pixels.data)}

    def _line(self, event: str, values: Mapping[str, Any]) -> None:
        with self._blamed():
            self._log.write(json.dumps({"event": event, "line": self._lines, **values}) + "\n")
            self._log.flush()
        self._lines += 1

    @contextmanager
    def _blamed(self) -> Iterator[None]:
        """Errors of the system become errors of the folder."""
        try:
            yield
        except OSError as error:
            raise OSError(error.errno, reason_of(error), str(self.folder)) from error

    def close(self) -> None:
        """Close the files; a recording that was not closed is readable up to its last line."""
        for each in (self._log, self._file):
            with suppress(OSError):  # of a full disk, again
                each.close()


def _packed(pixels: NDArray[Any]) -> bytes:
    """Little endian; of 16 bits all low bytes first."""
    size = pixels.itemsize
    return pixels.astype(f"<u{size}", copy=False).view(np.uint8).reshape(-1, size).T.tobytes()


def _unpacked(data: bytes, line: _Block) -> NDArray[Any]:
    """Inverse of _packed. ValueError of another size."""
    size = line.bits // 8
    planes = np.frombuffer(data, np.uint8).reshape(size, -1).T
    pixels = np.ascontiguousarray(planes).view(f"<u{size}").reshape(line.rows, line.cols, -1)
    pixels = pixels[..., 0] if line.planes == 1 else pixels
    return pixels.astype(f"u{size}")


class BackgroundRecorder:
    """Writes in a separate thread, so that a slow disk does not delay the camera.

    At most 256 MB of images wait; those beyond are dropped, and counted. failure: the error that ended it.
    """

    def __init__(self, recorder: Recorder, image_bytes: int) -> None:
        self._recorder = recorder
        self._queue: queue.Queue[tuple[Image, float] | None] = queue.Queue(max(1, _WAITING // image_bytes))
        self.dropped = 0
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def image(self, image: Image, stamp_s: float) -> None:
        """Hand over an image. Raises `failure`, as on a full disk."""
        if self.failure is not None:
            raise self.failure
        try:
            self._queue.put_nowait((image, stamp_s))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write all images that wait, and close."""
        self._queue.put(None)
        self._thread.join()

    def _write(self) -> None:
        while (one := self._queue.get()) is not None:
            try:
                if self.failure is None:
                    self._recorder.image(*one)
            except Exception as error:  # whatever it is: nobody else empties the queue
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
        lines = read_lines(log, _is_event)
        self._decompressor = zstandard.ZstdDecompressor()
        self.about: Mapping[str, Any] = lines[0] if lines else {}
        if self.about.get("version", _VERSION) != _VERSION:
            raise InputError(f"{log}: the first line must state version {_VERSION}")
        try:
            self._events = [_event(line, number) for number, line in enumerate(lines)]
        except InputError as error:
            raise InputError(f"{log}: {error}") from error
        if not len(self):
            raise InputError(f"{self.folder}: stopped before its first image; record again")
        settings = [event for event in self._events if isinstance(event, Accepted)]
        self.accepted = settings[-1] if settings else None

    def __len__(self) -> int:
        """Images, complete or not."""
        return sum(isinstance(event, _ImageLine) for event in self._events)

    def __iter__(self) -> Iterator[Shown | Logged]:
        """Swaps and images in their order. InputError of an image whose pixels are not those of its line."""
        with ExitStack() as open_files:
            blocks, before = self._blocks(open_files), None
            for event in self._events:
                if isinstance(event, Shown):
                    yield event
                elif isinstance(event, _ImageLine):
                    pixels = no_pixels()
                    if event.block is not None and blocks is not None:
                        pixels = before = self._pixels(event.block, blocks, before)
                    values = {name: getattr(event, name) for name in _OF_IMAGE}
                    yield Logged(Image(pixels, **values), event.stamp_s, event.reading)

    def images(self) -> Iterator[Logged]:
        """Images in their order."""
        return (event for event in self if isinstance(event, Logged))

    def _blocks(self, open_files: ExitStack) -> BinaryIO | None:
        """The file, open; None where no image has a block."""
        if not any(isinstance(event, _ImageLine) and event.complete for event in self._events):
            return None
        try:
            return open_files.enter_context((self.folder / _PAGES).open("rb"))
        except OSError as error:
            raise InputError(f"{self.folder / _PAGES}: not readable ({damage_of(error)})") from error

    def _pixels(self, line: _Block, blocks: BinaryIO, before: NDArray[Any] | None) -> NDArray[Any]:
        page, where = line.page, self.folder / _PAGES
        blocks.seek(line.at)
        block = blocks.read(line.bytes)
        if len(block) < line.bytes:
            raise InputError(f"{where}: page {page} is missing, its line is there")
        try:
            pixels = _unpacked(self._decompressor.decompress(block, max_output_size=line.size), line)
            if not line.key:
                if before is None or before.shape != pixels.shape:
                    raise ValueError("the image before it is another one")
                pixels = before.astype(pixels.dtype) + pixels
        except (ValueError, zstandard.ZstdError) as error:
            raise InputError(f"{where}: page {page} is damaged") from error
        if zlib.crc32(pixels.tobytes()) != line.crc32:
            raise InputError(f"{where}: page {page} is damaged, its crc32 is not {line.crc32}")
        return pixels


def _is_event(line: Any) -> bool:
    return line["event"] in _EVENTS


def _event(line: Mapping[str, Any], number: int) -> Any:
    """A line as a record. InputError, which begins with its place in the log (from 0)."""
    where = f"line {number + 1}"
    stated = built(int, line.get("line", -1), f"{where}.line")
    if stated != number:
        what = "is missing" if stated > number else "has been moved"
        raise InputError(f"{where} {what}: the one there states {stated}, not {number}")
    found = built(_EVENTS[line["event"]], line, where)
    return replace(found, block=built(_Block, line, where)) if getattr(found, "complete", False) else found
