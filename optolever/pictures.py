"""The one place where pictures are read: PNG, TIFF (of several pages, too), NPY, video and what else OpenCV
reads, as they are stored (no turning by what a camera notes beside them); errors of one line."""

import logging
import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from optolever.errors import InputError, require_file
from optolever.memory import require_room

__all__ = [
    "CHANNELS",
    "PICTURES",
    "STACKS",
    "colours_of",
    "grey_of",
    "is_lossy",
    "read_grey",
    "read_mask",
    "read_picture",
    "read_pictures",
]

Picture = NDArray[Any]

#: Suffixes of pictures, and of files that may hold several.
PICTURES = (".png", ".bmp", ".pgm", ".pnm", ".ppm", ".tif", ".tiff", ".jpg", ".jpeg", ".jp2", ".webp", ".npy")
_VIDEOS = (".avi", ".mkv", ".mp4", ".mov", ".m4v", ".webm")
STACKS = (".tif", ".tiff", ".npy", *_VIDEOS)
_TIFF = (".tif", ".tiff")
#: Luminance of red, green, blue: ITU-R BT.601.
_LUMINANCE = (0.299, 0.587, 0.114)
#: What makes one value of a colour; the last is their luminance.
CHANNELS = ("red", "green", "blue", "luminance")
#: Channels that a picture may have, and the largest values of 8, 10, 12, 14 and 16 bits.
_CHANNELS, _WHITE = 4, (255, 1023, 4095, 16383, 65535)
_ANIMATED = 2  # of a WebP, flag of its VP8X chunk (RFC 9649, 2.7)
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Samples of a pixel, by the colour type of a PNG's header.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
#: What deflate makes of zeros at most: https://zlib.net/zlib_tech.html
_DEFLATE = 1032
# what is wrong is said in one line, by whoever asks for the picture
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
tifffile.logger().addHandler(logging.NullHandler())


def read_picture(path: Path) -> Picture:
    """A picture (H, W) or (H, W, channels): red, green, blue, alpha. InputError if it is missing, damaged,
    something else, or one of several in its file."""
    pictures = read_pictures(path)
    if len(pictures) != 1:
        raise InputError(f"{path}: holds {len(pictures)} pictures, must be one")
    return np.asarray(pictures[0])


def read_pictures(path: Path) -> Picture:
    """All pictures of a file, (N, H, W) or (N, H, W, channels). InputError as of `read_picture`."""
    require_file(path)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _from_npy(path)
    if suffix in _VIDEOS:
        return _from_video(path)
    data = path.read_bytes()
    if suffix in _TIFF:
        return _from_tiff(path, data)
    if data.startswith(_PNG_SIGNATURE):
        _require_whole_png(path, data)
    if data[12:16] == b"VP8X" and data[20] & _ANIMATED:
        raise InputError(f"{path}: holds several pictures (an animated WebP), must be one")
    return _decoded(path, data)[None]


def read_grey(path: Path) -> Picture:
    """A picture (H, W), colours as their luminance."""
    return grey_of(read_picture(path))


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Pixels (H, W) that a picture marks: the larger of its two values; of more values the upper half of what
    its type holds; of pixels of one colour those that are opaque. InputError if it marks none."""
    picture = read_picture(path)
    alpha = picture[..., -1] if picture.ndim == 3 and picture.shape[2] in (2, 4) else None
    values = grey_of(picture)
    if alpha is not None and np.ptp(values) == 0:
        values = alpha
    least, most = values.min(), values.max()
    if most == 0:
        raise InputError(
            f"{path}: every value is 0, so the mask leaves no pixel; paint white what is to be kept"
        )
    between = (values != least) & (values != most)
    if not between.any():
        return np.asarray(values == most)
    half = 0.5 * (np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1.0)
    if most <= half:
        raise InputError(f"{path}: has values between {least} and {most}, a mask must have two")
    return np.asarray(values > half)


def grey_of(picture: Picture, channel: str = "luminance") -> Picture:
    """A picture (..., H, W), or (..., H, W, channels) with 1 to 4 of them, as one value per pixel.

    channel: one of CHANNELS; of equal red, green and blue each is the value; alpha is dropped. In luminance a
    pixel whose red, green or blue is the largest value that there is (of 8, 10, 12, 14 or 16 bits) is white:
    what clips must not look like what does not.
    """
    colours = colours_of(picture)
    if colours is None:
        grey = picture[..., 0] if picture.ndim > 2 and picture.shape[-1] <= _CHANNELS else picture
        return np.ascontiguousarray(grey)
    if channel in CHANNELS[:3]:
        return np.ascontiguousarray(colours[..., CHANNELS.index(channel)])
    exact = colours.astype(np.float64) @ np.array(_LUMINANCE)
    if picture.dtype.kind == "f":
        return np.asarray(exact, picture.dtype)
    levels, most = np.rint(exact).astype(picture.dtype), colours.max()
    if most in _WHITE:
        levels[(colours == most).any(axis=-1)] = most
    return np.asarray(levels)


def colours_of(picture: Picture) -> Picture | None:
    """Red, green and blue (..., 3) of a picture; None where they are equal everywhere, or it has none."""
    if picture.ndim == 2 or not 2 < picture.shape[-1] <= _CHANNELS:
        return None
    colours = picture[..., :3]
    return colours if (colours != colours[..., :1]).any() else None


def is_lossy(path: Path) -> bool:
    """Whether a file's pictures are not what the camera took, by its suffix: JPEG and video."""
    return path.suffix.lower() in (".jpg", ".jpeg", ".webp", *_VIDEOS)


def _decoded(path: Path, data: bytes) -> Picture:
    """A picture by OpenCV, which has blue first."""
    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:  # a header that claims more than OpenCV takes
        image = None
    if image is None:
        raise InputError(f"{path}: not an image ({len(data)} bytes)")
    return _red_first(np.asarray(image))


def _red_first(image: Picture) -> Picture:
    return (
        image if image.ndim == 2 or image.shape[2] < 3 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
    )


def _from_tiff(path: Path, data: bytes) -> Picture:
    """Pages by tifffile; by OpenCV where that lacks a compression; grey levels of 0 are black."""
    try:
        with tifffile.TiffFile(path) as tiff:
            require_room(str(path), sum(series.nbytes for series in tiff.series))
            pages = [_pages(series) for series in tiff.series]
    except InputError:
        raise
    except Exception:  # a damaged file, or a compression that tifffile lacks: anything may be raised
        pages = _pages_by_opencv(data)
    if not pages:
        raise InputError(f"{path}: not an image ({len(data)} bytes)")
    if any(page.shape[1:] != pages[0].shape[1:] for page in pages):
        raise InputError(f"{path}: its pictures differ in size, must be alike")
    return np.concatenate(pages)


def _pages_by_opencv(data: bytes) -> list[Picture]:
    found: Any = ()
    if data:
        with suppress(cv2.error):
            _, found = cv2.imdecodemulti(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return [_red_first(np.asarray(page))[None] for page in found or ()]


def _pages(series: Any) -> Picture:
    """(N, H, W) or (N, H, W, samples) of a series of pages."""
    if series.keyframe.photometric == tifffile.PHOTOMETRIC.PALETTE:
        raise ValueError("colours by a table")
    pages = np.asarray(series.asarray())
    if pages.dtype == np.bool_:
        pages = pages.view(np.uint8) * np.uint8(255)
    if series.keyframe.photometric == tifffile.PHOTOMETRIC.MINISWHITE and pages.dtype.kind == "u":
        pages = np.iinfo(pages.dtype).max - pages
    axes, kept = series.axes, "YXS" if "S" in series.axes else "YX"
    pages = np.moveaxis(pages, [axes.index(axis) for axis in kept], range(-len(kept), 0))
    return pages.reshape(-1, *pages.shape[pages.ndim - len(kept) :])


def _from_npy(path: Path) -> Picture:
    try:
        stack = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, SyntaxError) as error:
        raise InputError(f"{path}: not a readable .npy ({error})") from error
    require_room(str(path), stack.nbytes)
    if stack.dtype.kind not in "biuf" or stack.ndim not in (2, 3, 4) or 0 in stack.shape:
        raise InputError(f"{path}: {stack.dtype} of shape {stack.shape}, must be numbers (N, H, W)")
    values = np.array(stack, np.uint8) * np.uint8(255) if stack.dtype == np.bool_ else np.array(stack)
    values = values.astype(values.dtype.newbyteorder("="))
    if values.ndim == 2 or (values.ndim == 3 and values.shape[2] <= 4 < min(values.shape[:2])):
        return values[None]
    return values


def _from_video(path: Path) -> Picture:
    frames = list(_video_frames(path))
    if not frames:
        raise InputError(f"{path}: not a video that OpenCV decodes here; save its frames as PNG")
    return np.stack(frames)


def _video_frames(path: Path) -> Iterator[Picture]:
    video = cv2.VideoCapture(str(path))
    try:
        while True:
            done, frame = video.read()
            if not done:
                return
            yield _red_first(np.asarray(frame))
    finally:
        video.release()


def _require_whole_png(path: Path, data: bytes) -> None:
    """Length and CRC of every chunk, one picture, and no more pixels than the file can hold: OpenCV hands
    out what it could read of a damaged file."""
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
        if kind == b"acTL" and (count := int.from_bytes(view[at + 8 : at + 12], "big")) > 1:
            raise InputError(f"{path}: holds {count} pictures (an animated PNG), must be one")
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
