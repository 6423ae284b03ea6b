"""The one place where pictures are read: PNG, TIFF (of several pages, too), NPY, video and what else OpenCV
reads, as they are stored (tags of orientation are ignored); errors of one line."""

import logging
import struct
import zlib
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from optolever.arrays import require_room
from optolever.errors import InputError, damage_of, require_file

__all__ = [
    "CHANNELS", "PICTURES", "STACKS", "colours_of", "grey_of", "is_lossy", "read_mask",
    "read_picture", "read_pictures", "whole_jpeg",
]  # fmt: skip

Picture = NDArray[Any]

#: Suffixes of pictures, and of files that may hold several.
PICTURES = (".png", ".bmp", ".pgm", ".pnm", ".ppm", ".tif", ".tiff", ".jpg", ".jpeg", ".jp2", ".webp", ".npy")
_VIDEOS = (".avi", ".mkv", ".mp4", ".mov", ".m4v", ".webm")
_LOSSLESS = ("FFV1", "HFYU", "FFVH", "\0\0\0\0")
STACKS = (".tif", ".tiff", ".npy", *_VIDEOS)
_TIFF = (".tif", ".tiff")
#: Luminance of red, green, blue: ITU-R BT.601.
_LUMINANCE = (0.299, 0.587, 0.114)
#: What makes one value of a colour; the last is their luminance.
CHANNELS = ("red", "green", "blue", "luminance")
#: Channels that a picture may have, and the largest values of 8, 10, 12, 14 and 16 bits.
_CHANNELS, _WHITE = 4, (255, 1023, 4095, 16383, 65535)
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_ORIENTATION = 274  # a tag of TIFF
# what is wrong is said in one line, by whoever asks for the picture
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
logging.getLogger("tifffile").addHandler(logging.NullHandler())


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
    if data.startswith(_PNG_SIGNATURE):
        _require_whole_png(path, data)
    if data[:2] in (b"P2", b"P3"):  # which OpenCV scales
        raise InputError(f"{path}: a PNM whose numbers are text; save it as PNG")
    return _from_tiff(path, data) if suffix in _TIFF else _decoded(path, data)


def read_mask(path: Path, shape: tuple[int, ...], others: str) -> NDArray[np.bool_]:
    """Pixels (H, W) that a picture marks: above the middle of its values; of pixels of one colour those that
    are opaque. InputError if it marks none, or is not of this shape, as `others` are."""
    picture = read_picture(path)
    values = grey_of(picture)
    if picture.ndim == 3 and picture.shape[2] in (2, 4) and np.ptp(values) == 0:
        values = picture[..., -1]
    least, most = float(values.min()), float(values.max())
    if most == 0:
        raise InputError(
            f"{path}: every value is 0, so the mask leaves no pixel; paint white what is to be kept"
        )
    if values.shape != shape:
        sizes = "is {}x{} pixels, must be {}x{}".format(*values.shape[::-1], *shape[::-1])
        raise InputError(f"{path}: {sizes} as {others}; draw it on an image of this camera")
    return np.asarray(values >= most if least == most else values > 0.5 * (least + most))


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
    """Whether a file's pictures are not what the camera took: JPEG, and video of any but a lossless codec."""
    suffix = path.suffix.lower()
    return suffix in (".jpg", ".jpeg", ".webp") or (suffix in _VIDEOS and not _is_lossless(path))


def _is_lossless(path: Path) -> bool:
    code = int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    return code.to_bytes(4, "little").decode("latin-1").upper() in _LOSSLESS


def whole_jpeg(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> Picture | None:
    """A JPEG as OpenCV reads it; None where a part of it is missing, even if its end was written.

    libjpeg draws what is missing in grey (128) and ignores what follows a picture that is whole: only one
    that ends in grey and that further bytes change is incomplete.
    """
    data = data.rstrip(b"\0")
    if not data.startswith(_JPEG_START) or not data.endswith(_JPEG_END):
        return None
    found = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if found is None or (found[-1, -1] != 128).any():
        return None if found is None else np.asarray(found)
    more = bytes(range(1, 255))
    restarts = b"".join(bytes([0xFF, 0xD0 + k]) + more for k in range(8))
    longer = data[:-2] + more + restarts + _JPEG_END
    again = cv2.imdecode(np.frombuffer(longer, np.uint8), flags)
    return np.asarray(found) if again is not None and np.array_equal(found, again) else None


def _decoded(path: Path, data: bytes) -> Picture:
    """The picture of a file by OpenCV, which has blue first."""
    found: Any = []
    with suppress(cv2.error):  # a header that claims more than OpenCV takes
        if data.startswith(_JPEG_START):
            found = [each for each in (whole_jpeg(data),) if each is not None]
        elif data:
            found = cv2.imdecodemulti(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[1]
    if not len(found):
        what = "a JPEG that is cut off" if data.startswith(_JPEG_START) else "not an image"
        raise InputError(f"{path}: {what} ({len(data)} bytes); save it again")
    if len(found) > 1:
        raise InputError(f"{path}: is an animation of {len(found)} pictures; save each as a PNG of its own")
    return _red_first(np.asarray(found[0]))[None]


def _from_tiff(path: Path, data: bytes) -> Picture:
    """All pages of a TIFF by OpenCV, by tifffile where that fails (small tiles, half precision)."""
    turned, inverse = _unturned(data)
    found: Any = []
    with suppress(cv2.error):
        done, pages = cv2.imdecodemulti(np.frombuffer(turned, np.uint8), cv2.IMREAD_UNCHANGED)
        found = [_red_first(np.asarray(page)) for page in pages] if done else []
    by_opencv = bool(found)
    if not by_opencv:
        found = _by_tifffile(path, turned)
    if inverse and not (by_opencv and found[0].dtype == np.uint8):  # those OpenCV turns
        raise InputError(f"{path}: 0 is white (TIFF tag 262); save it with 0 black")
    if any(page.shape != found[0].shape for page in found):
        raise InputError(f"{path}: its pictures differ in size, must be alike")
    if not found[0].size:
        raise InputError(f"{path}: its picture has no pixel; the file is damaged, save it again")
    return np.stack(found)


def _unturned(data: bytes) -> tuple[bytes, bool]:
    """A TIFF whose tags of orientation are those of a picture as stored (libtiff would turn it), and whether
    0 is said to be white."""
    copy, inverse = bytearray(data), False
    # of a damaged file tifffile raises whatever its numbers lead to; the reader that follows names it
    with suppress(Exception), tifffile.TiffFile(BytesIO(data)) as file:
        for page in file.pages:
            tag = page.aspage().tags.get(_ORIENTATION)
            if tag is not None and tag.valueoffset + 2 <= len(copy):
                copy[tag.valueoffset : tag.valueoffset + 2] = struct.pack(f"{file.byteorder}H", 1)
        inverse = bool(file.pages.first.photometric == 0)
    return bytes(copy), inverse


def _by_tifffile(path: Path, data: bytes) -> list[Picture]:
    """Pages of grey values or of red, green and blue."""
    try:
        with tifffile.TiffFile(BytesIO(data)) as file:
            pages = [each.aspage() for each in file.pages]
            pages = [page for page in pages if page.photometric in (0, 1, 2)]
            require_room(str(path), sum(page.nbytes for page in pages))
            found = [
                np.moveaxis(page.asarray(), 0, -1) if page.axes.startswith("S") else page.asarray()
                for page in pages
            ]
    except InputError:
        raise
    except Exception as error:  # of a damaged file tifffile raises whatever its numbers lead to
        why = f"{len(data)} bytes; {damage_of(error)}"
        raise InputError(f"{path}: not an image ({why}); save it again") from error
    if not found or found[0].ndim > 3:
        raise InputError(f"{path}: not an image ({len(data)} bytes; no picture in it); save it again")
    return [page.astype(np.float32) if page.dtype == np.float16 else page for page in found]


def _red_first(image: Picture) -> Picture:
    return (
        image if image.ndim == 2 or image.shape[2] < 3 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
    )


def _from_npy(path: Path) -> Picture:
    try:
        stack = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # its header is an expression of Python
        raise InputError(f"{path}: not a readable .npy ({damage_of(error)})") from error
    require_room(str(path), stack.nbytes)
    end = stack.offset + stack.nbytes if isinstance(stack, np.memmap) else path.stat().st_size
    if path.stat().st_size != end:
        raise InputError(f"{path}: {path.stat().st_size} bytes, its header says {end}")
    if stack.dtype.kind not in "biuf" or stack.ndim not in (2, 3, 4) or 0 in stack.shape:
        raise InputError(f"{path}: {stack.dtype} of shape {stack.shape}, must be numbers (N, H, W)")
    values = np.array(stack, np.uint8) * np.uint8(255) if stack.dtype == np.bool_ else np.array(stack)
    values = values.astype(values.dtype.newbyteorder("="))
    if values.ndim == 2 or (values.ndim == 3 and values.shape[2] <= 4 < min(values.shape[:2])):
        return values[None]
    return values


def _from_video(path: Path) -> Picture:
    video, frames = cv2.VideoCapture(str(path)), []
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    while (read := video.read())[0]:
        frames.append(_red_first(np.asarray(read[1])))
    video.release()
    if not frames:
        raise InputError(f"{path}: not a video that OpenCV decodes here; save its frames as PNG")
    return np.stack(frames)


def _require_whole_png(path: Path, data: bytes) -> None:
    """Length and CRC of every chunk: OpenCV hands out what it could read of a damaged file."""
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
        if (kind == b"IHDR") != (at == len(_PNG_SIGNATURE)):
            raise InputError(f"{path}: damaged PNG (chunk {kind.decode('latin-1')!r} at byte {at})")
        if kind == b"IEND":
            return
        at = end
    raise InputError(f"{path}: truncated PNG ({len(data)} bytes, no end)")
