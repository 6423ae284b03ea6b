"""Pixels as drivers pack them."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.pictures import whole_jpeg

__all__ = ["binned", "from_jpeg", "mosaic_of", "no_format", "unpacked"]


def mosaic_of(name: str) -> str:
    """Order of colours in a format by GenICam's name, BayerRG8: "RGGB"; "RGB": three values; empty: grey."""
    if name.startswith("Bayer"):
        return {"RG": "RGGB", "GB": "GBRG", "GR": "GRBG", "BG": "BGGR"}[name[5:7]]
    return "RGB" if name.startswith("RGB") else ""


def no_format(camera: str, colour: bool, bits: int, offered: str = "") -> InputError:
    """That a camera has no format for what is wanted, and the cure."""
    what = f"camera: {camera} has no " + ("format of raw colours" if colour else "grey format")
    cure = "raw, or grey patterns"
    if not colour:
        cure = "of raw colours take patterns in colour: optolever camera measure --colour"
    return InputError(f"{what} of {bits} bits{offered and f', it has {offered}'}; {cure}")


def unpacked(data: NDArray[np.uint8], shape: tuple[int, int], name: str) -> NDArray[np.uint16]:
    """Mono10p, Mono12p, and Mono10Packed, Mono12Packed of GigE Vision 1, (H, W)."""
    bits, count = int(name[4:6]), shape[0] * shape[1]
    group = 5 if name == "Mono10p" else 3  # bytes of whole pixels
    padded = np.zeros(-(-data.size // group) * group, np.uint16)
    padded[: data.size] = data
    one = padded.reshape(-1, group).T
    if name == "Mono10p":
        parts = [one[k] >> 2 * k | (one[k + 1] & (1 << 2 * k + 2) - 1) << 8 - 2 * k for k in range(4)]
    elif name == "Mono12p":
        parts = [one[0] | (one[1] & 15) << 8, one[1] >> 4 | one[2] << 4]
    else:
        low = (1 << bits - 8) - 1
        parts = [one[0] << bits - 8 | one[1] & low, one[2] << bits - 8 | one[1] >> 4 & low]
    return np.stack(parts, axis=1).ravel()[:count].reshape(shape)


def from_jpeg(data: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8] | None:
    """Luminance (H, W) of a JPEG; None where a part of it is missing or it is of another size."""
    found = whole_jpeg(data.tobytes(), cv2.IMREAD_GRAYSCALE)
    return None if found is None or found.shape != shape else np.asarray(found, np.uint8)


def binned(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Means (H // 2, W // 2, 3) of 2 x 2 pixels."""
    rows, cols = (size // 2 for size in colours.shape[:2])
    whole = colours[: 2 * rows, : 2 * cols]
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)
