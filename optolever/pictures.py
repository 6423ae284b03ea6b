"""The one place where pictures are read: PNG, TIFF (of several pages, too), NPY, video and what else OpenCV
reads, as they are stored (no turning by what a camera notes beside them); errors of one line."""

import zlib
from contextlib import suppress
from io import BytesIO
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
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# what is wrong is said in one line, by whoever asks for the picture
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


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
    return _decoded(path, data)


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Pixels (H, W) that a picture marks: above the middle of its values; of pixels of one colour those that
    are opaque. InputError if it marks none."""
    picture = read_picture(path)
    values = grey_of(picture)
    if picture.ndim == 3 and picture.shape[2] in (2, 4) and np.ptp(values) == 0:
        values = picture[..., -1]
    least, most = float(values.min()), float(values.max())
    if most == 0:
        raise InputError(
            f"{path}: every value is 0, so the mask leaves no pixel; paint white what is to be kept"
        )
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
    """Whether a file's pictures are not what the camera took, by its suffix: JPEG and video."""
    return path.suffix.lower() in (".jpg", ".jpeg", ".webp", *_VIDEOS)


def _decoded(path: Path, data: bytes) -> Picture:
    """All pictures of a file by OpenCV, which has blue first."""
    coded, found = np.frombuffer(data, np.uint8), list[Any]()
    with suppress(cv2.error):  # a header that claims more than OpenCV takes
        if data and path.suffix.lower() in _TIFF:
            done, pages = cv2.imdecodemulti(coded, cv2.IMREAD_UNCHANGED)
            found = [*pages] if done else []
        elif data:
            found = [cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)]
    if not found or found[0] is None:
        raise InputError(f"{path}: not an image ({len(data)} bytes)")
    if path.suffix.lower() in _TIFF and found[0].dtype != np.uint8 and _white_is_zero(data):
        raise InputError(f"{path}: 0 is white (TIFF tag 262) in 16 bits; save it with 0 black")
    if any(page.shape != found[0].shape for page in found):
        raise InputError(f"{path}: its pictures differ in size, must be alike")
    return np.stack([_red_first(np.asarray(page)) for page in found])


def _white_is_zero(data: bytes) -> bool:
    """Whether a TIFF's first picture is said to be so; OpenCV turns it in 8 bits only."""
    with suppress(tifffile.TiffFileError), tifffile.TiffFile(BytesIO(data)) as file:
        return bool(file.pages.first.photometric == 0)
    return False


def _red_first(image: Picture) -> Picture:
    return (
        image if image.ndim == 2 or image.shape[2] < 3 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
    )


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
    video, frames = cv2.VideoCapture(str(path)), []
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
        if kind == b"IEND":
            return
        at = end
    raise InputError(f"{path}: truncated PNG ({len(data)} bytes, no end)")
