"""Frames whose pixels average the places that they see, drawn without the product's optics."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

from .conftest import F64, Map

#: Places of a pixel along either axis.
FINE = 8


def footprints(
    shown: Sequence,
    u: F64,
    v: F64,
    *,
    blur: float = 0.5,
    noise: float = 1.0,
    dark: Any = None,
    lens: float = 0.0,
    fill: float = 1.0,
) -> NDArray[Any]:
    """Frames of pixels that average FINE x FINE places each, cells blurred, darkness beyond the border.

    u, v (FINE H, FINE W): where the parts of the pixels look; dark: parts that see nothing; lens: blur on
    the sensor, camera pixels rms; fill: side of what a pixel averages over its pitch.
    """
    per_cell, pad = 8, 24

    def light(table: NDArray[np.uint8], place: F64) -> F64:
        cells = np.repeat(np.pad(table / 255.0, pad), per_cell)
        far = int(5 * max(blur, 1.0)) * per_cell
        reach = np.arange(-far, far + 1) / per_cell
        gauss = np.exp(-0.5 * (reach / max(blur, 1e-3)) ** 2)
        soft = np.convolve(cells, gauss / gauss.sum(), mode="same")
        at = (np.arange(len(soft)) + 0.5) / per_cell - 0.5 - pad
        return np.asarray(np.interp(place, at, soft))

    rng = np.random.default_rng(3)
    along, across = shown.tables()
    height, width = u.shape[0] // FINE, u.shape[1] // FINE
    frames = np.empty((len(shown), height, width), np.uint8)
    seen = 1.0 if dark is None else 1.0 - dark
    for i in range(len(shown)):
        parts = light(along[i], u) * light(across[i], v) * seen
        if lens > 0:
            parts = cv2.GaussianBlur(parts, (0, 0), lens * FINE)
        rim = round(FINE * (1 - fill) / 2)
        inner = slice(rim, FINE - rim)
        mean = parts.reshape(height, FINE, width, FINE)[:, inner, :, inner].mean(axis=(1, 3))
        frames[i] = np.clip(np.rint(20 + 200 * mean + noise * rng.standard_normal(mean.shape)), 0, 255)
    return frames


def places(height: int, width: int) -> Map:
    """Rows and columns of the parts of pixels, pixel units, integer = pixel centre."""
    row, col = np.mgrid[: height * FINE, : width * FINE]
    return (row + 0.5) / FINE - 0.5, (col + 0.5) / FINE - 0.5


def centres(parts: F64) -> F64:
    """Value at the pixels' centres, by linear interpolation of the four parts around each."""
    half = FINE // 2
    four = [parts[half - 1 + i :: FINE, half - 1 + j :: FINE] for i in (0, 1) for j in (0, 1)]
    return np.asarray(np.mean(four, axis=0))
