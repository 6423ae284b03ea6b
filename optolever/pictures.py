"""The one place where pictures are read: PNG, TIFF and what else OpenCV reads; errors of one line."""

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["read_picture"]

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Samples of a pixel, by the colour type of a PNG's header.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
#: What deflate makes of zeros at most: https://zlib.net/zlib_tech.html
_DEFLATE = 1032
# what is wrong is said in one line, by whoever asks for the picture
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def read_picture(path: Path, how: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any]:
    """A picture (H, W) or (H, W, channels), as cv2.imdecode makes it. InputError if it is missing, damaged or
    something else."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    data = path.read_bytes()
    if data.startswith(_PNG_SIGNATURE):
        _require_whole_png(path, data)
    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error:  # a header that claims more than OpenCV takes
        image = None
    if image is None:
        raise InputError(f"{path}: not an image ({len(data)} bytes)")
    return np.asarray(image)


def _require_whole_png(path: Path, data: bytes) -> None:
    """Length and CRC of every chunk, and no more pixels than the file can hold: OpenCV hands out what it
    could read of a damaged file."""
    at = len(_PNG_SIGNATURE)
    view = memoryview(data)
    while at + 12 <= len(data):
        length = int.from_bytes(view[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data):
            break
        kind = bytes(view[at + 4 : at + 8])
        if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise InputError(
                f"{path}: damaged PNG (checksum of chunk {kind.decode('latin-1')!r} at byte {at})"
            )
        if kind == b"IHDR" and length == 13:
            _require_held(path, data, at + 8)
        if kind == b"IEND":
            return
        at = end
    raise InputError(f"{path}: truncated PNG ({len(data)} bytes, no end)")


def _require_held(path: Path, data: bytes, at: int) -> None:
    """InputError if the header at this byte claims more than deflate can have made of the file."""
    width, height, bits, colour = struct.unpack(">IIBB", data[at : at + 10])
    claimed = math.prod((width, height, bits, _SAMPLES.get(colour, 1))) // 8
    if claimed > _DEFLATE * len(data):
        raise InputError(f"{path}: claims {height}x{width} pixels, {claimed} bytes, in {len(data)} bytes")
