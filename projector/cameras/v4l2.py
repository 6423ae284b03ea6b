"""USB cameras on Linux, by V4L2: counter and monotonic stamp of every image, every control read back."""

import errno
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from ..devices import Accepted, CameraLost, Identity, Image, Wanted, no_pixels
from . import ioctl
from .ioctl import OpenDevice, VideoDevice

__all__ = ["V4L2Camera", "find", "open_named"]

_AUTO_EXPOSURE, _EXPOSURE, _EXPOSURE_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
_GAIN, _AUTO_GAIN, _AUTO_WHITE = 0x980913, 0x980912, 0x98090C
_MANUAL = 1  # of V4L2_CID_EXPOSURE_AUTO
_UNIT_S = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
_BUFFERS = 6
#: Formats whose grey values are read, best first, by bits: (fourcc, bytes a pixel, place of the grey byte).
_GREY = {
    8: ((b"GREY", 1, 0), (b"YUYV", 2, 0), (b"UYVY", 2, 1)),
    16: ((b"Y16 ", 2, 0), (b"Y12 ", 2, 0), (b"Y10 ", 2, 0)),
}
_BITS = {b"Y16 ": 16, b"Y12 ": 12, b"Y10 ": 10}
_BY_ID = Path("/dev/v4l/by-id")
_REASONS = {
    errno.EBUSY: "busy: another program has it",
    errno.EACCES: "no permission: add the user to the group video",
    errno.ENOENT: "no such path; optolever camera devices lists cameras",
    errno.ENODEV: "unplugged",
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


class V4L2Camera:
    """`lost` by gaps of the driver's counter; stamps where the driver says that they are monotonic."""

    def __init__(self, device: VideoDevice, name: str) -> None:
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
        self._layout, self._format = _GREY[8][0], ioctl.Format(0, 0, b"", 0)

    @property
    def identity(self) -> Identity:
        """Its card and path."""
        return Identity("v4l2", self._card, _serial(Path(self._name)), f"v4l2:{self._name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """InputError where no grey format fits, or a trigger is asked for."""
        if wanted.trigger != "free":
            raise InputError(f"camera: trigger {wanted.trigger!r}, of V4L2 it must be free")
        offered = ioctl.formats(self._device)
        fitting = [one for one in _GREY[8 if wanted.bits == 8 else 16] if one[0] in offered]
        if not fitting:
            names = " ".join(one.decode("latin1").strip() for one in offered)
            raise InputError(f"camera: {self._name} has no grey format of {wanted.bits} bits, it has {names}")
        self._layout = fitting[0]
        rows, cols = wanted.rows or 1 << 14, wanted.cols or 1 << 14  # the driver takes its largest
        try:
            self._format = ioctl.set_format(self._device, rows, cols, self._layout[0])
        except OSError as error:
            raise InputError(f"camera: {self._name}: {_reason(error)}") from error
        if self._format.fourcc != self._layout[0]:
            raise InputError(f"camera: {self._name} answers {self._format.fourcc!r} to {self._layout[0]!r}")
        unlocked: list[str] = []
        self._lock(_AUTO_EXPOSURE, _MANUAL, "exposure", unlocked)
        self._lock(_EXPOSURE_PRIORITY, 0, "frame rate", unlocked)
        self._lock(_AUTO_GAIN, 0, "gain", unlocked)
        self._lock(_AUTO_WHITE, 0, "white balance", unlocked)
        units = self._set(_EXPOSURE, round(wanted.exposure_s / _UNIT_S))
        if units is None:
            unlocked.append("exposure: the driver has no control")
        gain = None if wanted.gain is None else self._set(_GAIN, round(wanted.gain))
        try:
            fps = ioctl.set_rate(self._device, wanted.fps or 1000.0)
        except OSError:
            fps = None
        return Accepted(
            exposure_s=wanted.exposure_s if units is None else units * _UNIT_S,
            rows=self._format.rows,
            cols=self._format.cols,
            bits=_BITS.get(self._layout[0], 8),
            gain=gain,
            fps=fps,
            unlocked=tuple(unlocked),
        )

    def _set(self, number: int, value: int) -> int | None:
        """The control as it reads back; None where there is none, or it refuses."""
        limits = ioctl.control(self._device, number)
        if limits is None:
            return None
        try:
            return ioctl.set_control(self._device, number, min(max(value, limits.low), limits.high))
        except OSError:
            return None

    def _lock(self, number: int, value: int, what: str, unlocked: list[str]) -> None:
        """Switch an automatic control off; one that stays on is listed as unlocked."""
        if ioctl.control(self._device, number) is not None and self._set(number, value) != value:
            unlocked.append(f"{what}: automatic, the driver does not switch it off")

    def start(self) -> None:
        """InputError where another program has the camera."""
        try:
            count = ioctl.request_buffers(self._device, _BUFFERS)
            self._maps = [ioctl.map_buffer(self._device, index) for index in range(count)]
            for index in range(count):
                ioctl.enqueue(self._device, index)
            ioctl.stream(self._device, True)
        except OSError as error:
            raise InputError(f"camera: {self._name}: {_reason(error)}") from error
        self._running, self._last = True, -1

    def trigger(self) -> float:
        """InputError: V4L2 has none."""
        raise InputError("camera: V4L2 has no software trigger, trigger must be free")

    def next(self, timeout_s: float) -> Image | None:
        """The oldest image that waits; CameraLost where it was unplugged."""
        try:
            if not self._device.readable(timeout_s):
                return None
            one = ioctl.dequeue(self._device)
            arrived = time.monotonic()
            broken = bool(one.flags & ioctl.BROKEN) or one.used < self._format.stride * self._format.rows
            pixels = no_pixels() if broken else self._pixels(self._maps[one.index])
            ioctl.enqueue(self._device, one.index)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            raise CameraLost(f"camera: {self._name}: {_reason(error)}") from error
        if self._last >= 0:
            self.lost += (
                max((one.sequence - self._last - 1) % (1 << 32), 0) if one.sequence > self._last else 0
            )
        self._last = one.sequence
        stamp = one.stamp_s if one.flags & ioctl.MONOTONIC else None
        why = (
            f"{one.used} bytes, the driver's error flag is {bool(one.flags & ioctl.BROKEN)}" if broken else ""
        )
        return Image(pixels, one.sequence, stamp, arrived, not broken, why)

    def _pixels(self, memory: memoryview) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Grey values, copied: the buffer goes back."""
        one, (fourcc, width, place) = self._format, self._layout
        rows = np.frombuffer(memory, np.uint8, one.stride * one.rows).reshape(one.rows, one.stride)
        if fourcc in _BITS:
            return rows[:, : 2 * one.cols].copy().view("<u2").astype(np.uint16)
        return rows[:, place : width * one.cols : width].copy()

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
