"""Pixels as drivers pack them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.pictures import whole_jpeg

__all__ = ["from_jpeg", "unpacked"]


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
