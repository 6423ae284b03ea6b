"""V4L2's structures and numbers (linux/videodev2.h, 64 bit), and the device file that answers them."""

import fcntl
import mmap
import os
import select
import struct
from dataclasses import dataclass

__all__ = ["CaptureBuffer", "Control", "Format", "OpenDevice"]

_READ, _WRITE = 2, 1


def _number(direction: int, code: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("V") << 8 | code


QUERYCAP = _number(_READ, 0, 104)
ENUM_FMT = _number(_READ | _WRITE, 2, 64)
S_FMT = _number(_READ | _WRITE, 5, 208)
REQBUFS = _number(_READ | _WRITE, 8, 20)
QUERYBUF = _number(_READ | _WRITE, 9, 88)
QBUF = _number(_READ | _WRITE, 15, 88)
DQBUF = _number(_READ | _WRITE, 17, 88)
STREAMON = _number(_WRITE, 18, 4)
STREAMOFF = _number(_WRITE, 19, 4)
S_PARM = _number(_READ | _WRITE, 22, 204)
G_CTRL = _number(_READ | _WRITE, 27, 8)
S_CTRL = _number(_READ | _WRITE, 28, 8)
QUERYCTRL = _number(_READ | _WRITE, 36, 68)
ENUM_FRAMESIZES = _number(_READ | _WRITE, 74, 44)

_CAPTURE, _MMAP = 1, 1
_VIDEO_CAPTURE = 1  # of device_caps: the metadata node of a camera lacks it
BROKEN, MONOTONIC = 0x40, 0x2000  # flags of a buffer
_DISABLED = 1
_DISCRETE = 1  # sizes one by one


class OpenDevice:
    """A device file; tests replace it by recorded structures."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def ioctl(self, request: int, data: bytearray) -> None:
        """Fill `data`; OSError."""
        fcntl.ioctl(self._fd, request, data, True)

    def map(self, length: int, offset: int) -> memoryview:
        """Memory of a buffer."""
        return memoryview(mmap.mmap(self._fd, length, offset=offset))

    def readable(self, timeout_s: float) -> bool:
        """Whether a buffer is done in time."""
        return bool(select.select([self._fd], [], [], max(timeout_s, 0.0))[0])

    def close(self) -> None:
        """Give it back."""
        os.close(self._fd)


@dataclass(frozen=True, slots=True)
class Format:
    """The driver's format: fourcc, bytes a row."""

    rows: int
    cols: int
    fourcc: bytes
    stride: int


@dataclass(frozen=True, slots=True)
class Control:
    """A control's limits and default, in the driver's units."""

    low: int
    high: int
    default: int


@dataclass(frozen=True, slots=True)
class CaptureBuffer:
    """A filled buffer: its place, bytes, flags, stamp (s) and counter."""

    index: int
    used: int
    flags: int
    stamp_s: float
    sequence: int


def capabilities(device: OpenDevice) -> tuple[str, bool]:
    """Name of the card, and whether this node takes pictures."""
    data = bytearray(104)
    device.ioctl(QUERYCAP, data)
    (caps,) = struct.unpack_from("<I", data, 88)
    return data[16:48].split(b"\0")[0].decode(errors="replace"), bool(caps & _VIDEO_CAPTURE)


def formats(device: OpenDevice) -> list[bytes]:
    """Fourccs."""
    found: list[bytes] = []
    while True:
        data = bytearray(64)
        struct.pack_into("<II", data, 0, len(found), _CAPTURE)
        try:
            device.ioctl(ENUM_FMT, data)
        except OSError:
            return found
        found.append(bytes(data[44:48]))


def sizes(device: OpenDevice, fourcc: bytes) -> list[tuple[int, int]]:
    """(rows, cols) of a format, the largest first; none where the driver lists none."""
    found: list[tuple[int, int]] = []
    while True:
        data = bytearray(44)
        struct.pack_into("<I4s", data, 0, len(found), fourcc)
        try:
            device.ioctl(ENUM_FRAMESIZES, data)
        except OSError:
            return sorted(found, key=lambda size: -size[0] * size[1])
        kind, cols, rows = struct.unpack_from("<III", data, 8)
        if kind != _DISCRETE:
            return []
        found.append((rows, cols))


def set_format(device: OpenDevice, rows: int, cols: int, fourcc: bytes) -> Format:
    """The format nearest to that one that the driver has."""
    data = bytearray(208)
    struct.pack_into("<I", data, 0, _CAPTURE)
    struct.pack_into("<II4sI", data, 8, cols, rows, fourcc, 1)
    device.ioctl(S_FMT, data)
    width, height, kind, _, stride = struct.unpack_from("<II4sII", data, 8)
    return Format(height, width, kind, stride)


def set_rate(device: OpenDevice, fps: float) -> float | None:
    """The rate that the driver sets; None where it reports none."""
    data = bytearray(204)
    struct.pack_into("<I", data, 0, _CAPTURE)
    struct.pack_into("<II", data, 12, 1000, round(1000 * fps))
    device.ioctl(S_PARM, data)
    numerator, denominator = struct.unpack_from("<II", data, 12)
    return denominator / numerator if numerator else None


def control(device: OpenDevice, number: int) -> Control | None:
    """A control's limits; None where the driver has it not."""
    data = bytearray(68)
    struct.pack_into("<I", data, 0, number)
    try:
        device.ioctl(QUERYCTRL, data)
    except OSError:
        return None
    low, high, _, default, flags = struct.unpack_from("<iiiiI", data, 40)
    return None if flags & _DISABLED else Control(low, high, default)


def set_control(device: OpenDevice, number: int, value: int) -> int:
    """Set, and return the value read back; OSError."""
    device.ioctl(S_CTRL, bytearray(struct.pack("<Ii", number, value)))
    return get_control(device, number)


def get_control(device: OpenDevice, number: int) -> int:
    """Its value; OSError."""
    data = bytearray(struct.pack("<Ii", number, 0))
    device.ioctl(G_CTRL, data)
    read: int = struct.unpack("<Ii", data)[1]
    return read


def request_buffers(device: OpenDevice, count: int) -> int:
    """Ask for buffers (0: give them back); how many there are. OSError EBUSY: another program has them."""
    data = bytearray(20)
    struct.pack_into("<III", data, 0, count, _CAPTURE, _MMAP)
    device.ioctl(REQBUFS, data)
    given: int = struct.unpack_from("<I", data)[0]
    return given


def map_buffer(device: OpenDevice, index: int) -> memoryview:
    """Its memory."""
    data = _buffer(index)
    device.ioctl(QUERYBUF, data)
    (offset,), (length,) = struct.unpack_from("<I", data, 64), struct.unpack_from("<I", data, 72)
    return device.map(length, offset)


def enqueue(device: OpenDevice, index: int) -> None:
    """Hand a buffer to the driver."""
    device.ioctl(QBUF, _buffer(index))


def dequeue(device: OpenDevice) -> CaptureBuffer:
    """The oldest filled buffer; OSError."""
    data = _buffer(0)
    device.ioctl(DQBUF, data)
    index, _, used, flags = struct.unpack_from("<IIII", data)
    seconds, micros = struct.unpack_from("<qq", data, 24)
    (sequence,) = struct.unpack_from("<I", data, 56)
    return CaptureBuffer(index, used, flags, seconds + 1e-6 * micros, sequence)


def stream(device: OpenDevice, on: bool) -> None:
    """Begin or end; OSError."""
    device.ioctl(STREAMON if on else STREAMOFF, bytearray(struct.pack("<I", _CAPTURE)))


def _buffer(index: int) -> bytearray:
    data = bytearray(88)
    struct.pack_into("<II", data, 0, index, _CAPTURE)
    struct.pack_into("<I", data, 60, _MMAP)
    return data
