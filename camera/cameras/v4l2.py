"""USB cameras on Linux, by V4L2: counter and monotonic stamp of every image, every control read back."""

import errno
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Identity, Image, Wanted, no_pixels

from . import ioctl
from .ioctl import OpenDevice
from .pixel_formats import binned, from_jpeg, no_format
from .webcam import Untriggered, locked, require_free

__all__ = ["V4L2Camera", "find", "open_named"]

_EXPOSURE, _GAIN, _FOCUS, _GAMMA = 0x9A0902, 0x980913, 0x9A090A, 0x980910
_LINEAR = 100  # of V4L2_CID_GAMMA
#: Controls that move or distort: number, name, value; None: the least.
_LOCKS = (
    (0x9A0901, "exposure", 1),  # V4L2_EXPOSURE_MANUAL
    (0x9A0903, "frame rate", 0),
    (0x980912, "gain", 0),
    (0x98090C, "white balance", 0),
    (0x9A090C, "focus", 0),
    (0x98091B, "sharpness", None),
    (0x98091C, "backlight compensation", None),
    (0x980918, "power line filter", 0),
    (0x9A0915, "wide dynamic range", 0),
)
_UNIT_S = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
_BUFFERS = 6
_SLOW_FPS = 10.0  # below, the next smaller size is taken
_JPEG = b"MJPG"
#: Formats whose grey values are read, best first, by bits: fourcc -> (bytes a pixel, grey byte).
_GREY: dict[int, dict[bytes, tuple[int, int]]] = {
    8: {
        **dict.fromkeys((b"GREY", b"NV12"), (1, 0)),
        b"YUYV": (2, 0),
        b"UYVY": (2, 1),
        _JPEG: (1, 0),
    },
    16: dict.fromkeys((b"Y16 ", b"Y12 ", b"Y10 "), (2, 0)),
}
_YUYV = b"YUYV"
#: Formats of colours, best first, and their mosaic.
_COLOURED = {
    **{one: one.decode() for one in (b"RGGB", b"GRBG", b"GBRG")},
    b"BA81": "BGGR",
    **dict.fromkeys((b"RGB3", b"BGR3"), "RGB"),
    _YUYV: "YUYV",
}
_BITS = {b"Y16 ": 16, b"Y12 ": 12, b"Y10 ": 10}
_BY_ID = Path("/dev/v4l/by-id")
_REASONS = {
    errno.EBUSY: "busy: another program has it",
    errno.EACCES: "no permission: add the user to the group video",
    errno.ENOENT: "no such path; optolever doctor lists cameras",
    errno.ENODEV: "gone: unplugged, or without power",
    errno.EIO: "input/output error",
}


def find() -> list[Identity]:
    """Cameras under /dev; a node of metadata is none."""
    if sys.platform != "linux":
        return []
    found = []
    named = {one.resolve(): one for one in sorted(_BY_ID.glob("*"))} if _BY_ID.is_dir() else {}
    for path in sorted(Path("/dev").glob("video*")):
        name = named.get(path, path)
        try:
            device = OpenDevice(str(path))
        except OSError as error:
            found.append(Identity("v4l2", "", _serial(name), f"v4l2:{name}", _reason(error)))
            continue
        try:
            card, takes = ioctl.capabilities(device)
            kinds = tuple(one.decode("latin1").strip() for one in ioctl.formats(device))
        except OSError:
            takes = False
        finally:
            device.close()
        if takes:
            found.append(Identity("v4l2", card, _serial(name), f"v4l2:{name}", "", kinds))
    return found


def open_named(name: str) -> "V4L2Camera":
    """By path. InputError says why not."""
    try:
        return V4L2Camera(OpenDevice(name), name)
    except OSError as error:
        raise InputError(f"camera: {name}: {_reason(error)}") from error


class V4L2Camera(Untriggered):
    """`lost` by gaps of the driver's counter; stamps where the driver says that they are monotonic."""

    def __init__(self, device: OpenDevice, name: str) -> None:
        self._device, self._name, self.lost = device, name, 0
        try:
            self._card, takes = ioctl.capabilities(device)
            if not takes:
                raise InputError(f"camera: {name}: takes no pictures; it is the camera's node for metadata")
        except BaseException:
            device.close()
            raise
        self._maps: list[memoryview] = []
        self._running, self._last = False, -1
        self._format, self._wanted = ioctl.Format(0, 0, b"", 0), Wanted(0.0)

    @property
    def identity(self) -> Identity:
        """Its card and path."""
        return Identity("v4l2", self._card, _serial(Path(self._name)), f"v4l2:{self._name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """InputError where no format fits, or a trigger is asked for."""
        require_free(wanted)
        offered, known = ioctl.formats(self._device), tuple(_GREY[8 if wanted.bits == 8 else 16])
        if wanted.colour:
            known = tuple(_COLOURED) if wanted.bits == 8 else ()
        if wanted.format:
            known = tuple(one for one in known if one.decode("latin1").strip() == wanted.format)
        fourcc = next((one for one in known if one in offered), None)
        if fourcc is None:
            names = " ".join(one.decode("latin1").strip() for one in offered)
            if wanted.format and not wanted.colour:
                raise InputError(f"camera: format is {wanted.format!r}, {self._name} has {names}")
            raise no_format(self._name, wanted.colour, wanted.bits, names)
        try:
            fps = self._choose_size(wanted, fourcc)
            faster = self._compressed_rate(wanted, fps) if fourcc != _JPEG and _JPEG in offered else None
        except OSError as error:
            raise InputError(f"camera: {self._name}: {_reason(error)}") from error
        if self._format.fourcc != fourcc:
            raise InputError(f"camera: {self._name} answers {self._format.fourcc!r} to {fourcc!r}")
        self._wanted = replace(wanted, focus=self._get(_FOCUS) if wanted.focus is None else wanted.focus)
        moves = any(ioctl.control(self._device, number) is not None for number, _, _ in _LOCKS)
        unlocked = locked(self, self._lock) if moves else tuple(self._lock())
        if faster is not None:
            offer = f"{faster:g} as MJPG, compressed with loss: --set format=MJPG"
            unlocked = (*unlocked, f"frame rate: {fps:g} images a second raw, {offer}")
        units, binned = self._get(_EXPOSURE), 1
        if wanted.colour and fourcc == _YUYV:
            unlocked, binned = (*unlocked, "colours: YUYV has them in every other pixel, binned 2 x 2"), 2
        return Accepted(
            exposure_s=wanted.exposure_s if units is None else units * _UNIT_S,
            rows=self._format.rows // binned,
            cols=self._format.cols // binned,
            bits=_BITS.get(fourcc, 8),
            gain=None if wanted.gain is None else self._get(_GAIN),
            fps=fps,
            unlocked=unlocked,
            focus=self._get(_FOCUS),
            format=fourcc.decode("latin1").strip(),
            colour=wanted.colour,
            mosaic=_COLOURED[fourcc] if wanted.colour else "",
        )

    def _choose_size(self, wanted: Wanted, fourcc: bytes) -> float | None:
        """Set the size that is asked for, else the largest that is not slow; its rate."""
        largest = 1 << 14  # the driver takes its own
        sizes = ioctl.sizes(self._device, fourcc) or [(largest, largest)]
        if wanted.rows or wanted.cols:
            sizes = [(wanted.rows or largest, wanted.cols or largest)]
        for size in (*sizes, sizes[0]):
            self._format = ioctl.set_format(self._device, *size, fourcc)
            try:
                fps = ioctl.set_rate(self._device, wanted.fps or 1000.0)
            except OSError:
                fps = None
            if fps is None or fps >= min(_SLOW_FPS, wanted.fps or _SLOW_FPS):
                break
        return fps

    def _compressed_rate(self, wanted: Wanted, fps: float | None) -> float | None:
        """Images a second of this size as JPEG, where that is at least twice as many; the format stays."""
        raw = self._format
        if fps is None or fps >= (wanted.fps or math.inf):
            return None
        try:
            other = ioctl.set_format(self._device, raw.rows, raw.cols, _JPEG)
            rate = ioctl.set_rate(self._device, wanted.fps or 1000.0)
        except OSError:
            return None
        finally:
            self._format = ioctl.set_format(self._device, raw.rows, raw.cols, raw.fourcc)
            ioctl.set_rate(self._device, wanted.fps or 1000.0)
        same = (other.rows, other.cols, other.fourcc) == (raw.rows, raw.cols, _JPEG)
        return rate if same and rate is not None and rate >= 2 * fps else None

    def _get(self, number: int) -> int | None:
        """A control's value; None where there is none."""
        if ioctl.control(self._device, number) is None:
            return None
        return ioctl.get_control(self._device, number)

    def _lock(self) -> list[str]:
        wanted, unlocked = self._wanted, []
        values = [*_LOCKS, (_EXPOSURE, "exposure", round(wanted.exposure_s / _UNIT_S))]
        values += [] if wanted.gain is None else [(_GAIN, "gain", round(wanted.gain))]
        values += [] if wanted.focus is None else [(_FOCUS, "focus", wanted.focus)]
        values += [(_GAMMA, "gamma", _LINEAR)]
        for number, what, value in values:
            limits = ioctl.control(self._device, number)
            if limits is None:
                unlocked += [f"{what}: the driver has no control"] if number == _EXPOSURE else []
                continue
            asked = min(max(limits.low if value is None else value, limits.low), limits.high)
            if number == _GAMMA and asked != value:
                asked = limits.default
            try:
                held = ioctl.set_control(self._device, number, asked)
            except OSError:
                held = None
            rounded = held is not None and number in (_EXPOSURE, _GAIN)
            if held != asked and not rounded and not any(one.startswith(what) for one in unlocked):
                unlocked.append(f"{what}: the driver does not hold {asked}")
        return unlocked

    def start(self) -> None:
        """InputError where another program has the camera."""
        try:
            count = ioctl.request_buffers(self._device, _BUFFERS)
            self._maps = [ioctl.map_buffer(self._device, index) for index in range(count)]
            for index in range(count):
                ioctl.enqueue(self._device, index)
            ioctl.stream(self._device, True)
            self._lock()
        except OSError as error:
            raise InputError(f"camera: {self._name}: {_reason(error)}") from error
        self._running, self._last = True, -1

    def next(self, timeout_s: float) -> Image | None:
        """The oldest image that waits; CameraLost where it was unplugged."""
        try:
            if not self._device.readable(timeout_s):
                return None
            one = ioctl.dequeue(self._device)
            arrived = time.monotonic()
            pixels = None if one.flags & ioctl.BROKEN else self._pixels(self._maps[one.index], one.used)
            ioctl.enqueue(self._device, one.index)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            if error.errno == errno.EIO:  # of a signal that was disturbed
                return Image(no_pixels(), None, None, time.monotonic(), False, _reason(error))
            raise CameraLost(f"camera: {self._name} is {_reason(error)}") from error
        self.lost += max(one.sequence - self._last - 1, 0) if self._last >= 0 else 0
        self._last = one.sequence
        stamp = one.stamp_s if one.flags & ioctl.MONOTONIC else None
        if pixels is not None:
            return Image(pixels, one.sequence, stamp, arrived)
        why = f"{one.used} bytes, the driver's error flag is {bool(one.flags & ioctl.BROKEN)}"
        return Image(no_pixels(), one.sequence, stamp, arrived, False, why)

    def _pixels(self, memory: memoryview, used: int) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
        """Values, copied: the buffer goes back. None where some are missing."""
        one, fourcc = self._format, self._format.fourcc
        if fourcc == _JPEG:
            return from_jpeg(np.frombuffer(memory, np.uint8, used), (one.rows, one.cols))
        if used < one.stride * one.rows:
            return None
        rows = np.frombuffer(memory, np.uint8, one.stride * one.rows).reshape(one.rows, one.stride)
        if fourcc in _BITS:
            return rows[:, : 2 * one.cols].copy().view("<u2").astype(np.uint16)
        if not self._wanted.colour:
            width, place = _GREY[8][fourcc]
            return rows[:, place : width * one.cols : width].copy()
        if fourcc == _YUYV:
            pairs = np.ascontiguousarray(rows[:, : 2 * one.cols]).reshape(one.rows, one.cols, 2)
            return binned(cv2.cvtColor(pairs, cv2.COLOR_YUV2RGB_YUYV))
        if _COLOURED[fourcc] != "RGB":
            return rows[:, : one.cols].copy()
        colours = rows[:, : 3 * one.cols].reshape(one.rows, one.cols, 3)
        return colours[..., :: 1 if fourcc == b"RGB3" else -1].copy()

    def stop(self) -> None:
        """Give the buffers back; an unplugged camera has none."""
        if not self._running:
            return
        self._running = False
        try:
            ioctl.stream(self._device, False)
            self._maps = []
            ioctl.request_buffers(self._device, 0)
        except OSError:
            self._maps = []

    def close(self) -> None:
        """Give the camera back."""
        self.stop()
        self._device.close()


def _serial(path: Path) -> str:
    """Of a by-id name, usb-MAKER_MODEL_SERIAL-video-index0, the last word."""
    stem = path.name.partition("-video-index")[0]
    return stem.rpartition("_")[2] if stem.startswith("usb-") and "_" in stem else ""


def _reason(error: OSError) -> str:
    return _REASONS.get(error.errno or 0, error.strerror or str(error))
