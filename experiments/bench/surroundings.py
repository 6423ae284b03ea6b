"""What is in the image around a mirror: where the mirror is, and the light of everything else.

The mirror's pixels are those of an image that it fills: same light, same noise, which
`expose` draws by place.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["AROUND", "FORMS", "mirror_mask", "surrounded"]

Mask = NDArray[np.bool_]
Light = NDArray[np.float32]

_GHOST = 0.04  # of a second reflection of the pattern
_SHIFT = (0.21, -0.34)  # by which it is shifted, shares of the image
_LAMP = 2.0  # light of the lamp in its middle, of a fully lit pixel


def mirror_mask(form: str, fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """Pixels (H, W) that a mirror of a form (FORMS) takes: the share `fill` of the image, somewhere in it."""
    return FORMS[form](fill, shape, rng)


def surrounded(light: Light, mask: Mask, around: str, rng: np.random.Generator) -> Light:
    """Light (N, H, W) of an image whose mirror fills `mask`; around it is what AROUND[around] makes."""
    return np.where(mask, light, AROUND[around](light, mask, rng)).astype(np.float32)


def _round(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """A disk; what the image would cut off of it is added elsewhere."""
    radius = np.sqrt(fill * shape[0] * shape[1] / np.pi)
    rows, cols = shape
    row = _between(rng, radius, rows - 1 - radius)
    col = _between(rng, radius, cols - 1 - radius)
    y, x = np.mgrid[:rows, :cols]
    distance = np.hypot(y - row, x - col)
    return np.asarray(distance <= np.quantile(distance, fill))


def _oblong(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """A rectangle three times as wide as high, or as wide as 0.95 of the image."""
    width = min(0.95, np.sqrt(3.0 * fill))
    return _rectangles([(width, fill / width)], shape, rng)


def _islands(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """Two rectangles side by side, 3 to 2."""
    width = min(0.9, np.sqrt(2.0 * fill))
    return _rectangles([(0.6 * width, fill / width), (0.4 * width, fill / width)], shape, rng)


def _rectangles(sizes: list[tuple[float, float]], shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """Rectangles (width, height; shares of the image) from left to right with gaps between them."""
    rows, cols = shape
    mask = np.zeros(shape, np.bool_)
    free = 1.0 - sum(width for width, _ in sizes)
    gap = max(free / (len(sizes) + 1), 0.02) * (len(sizes) > 1)
    at = float(rng.uniform(0.0, max(free - gap * (len(sizes) - 1), 0.0)))
    for width, height in sizes:
        top = float(rng.uniform(0.0, 1.0 - height))
        mask[
            round(top * rows) : round((top + height) * rows), round(at * cols) : round((at + width) * cols)
        ] = 1
        at += width + gap
    return mask


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high)) if high > low else 0.5 * (low + high)


def _dark(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """Nothing."""
    return np.zeros_like(light)


def _room(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """A lit room, constant in time: things large and small with edges, up to a fully lit pixel's light."""
    shape = mask.shape
    room = np.zeros(shape)
    for scale, share in ((24.0, 0.6), (3.0, 0.4)):
        smooth = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), scale)
        room += share * (0.5 + 0.25 * smooth / smooth.std())
    room[cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 12.0) > 0.01] *= 0.3
    return np.broadcast_to(np.clip(room, 0.0, 1.0).astype(np.float32), light.shape)


def _reflection(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """The pattern once more, dim and shifted, as from the surface of a cover glass."""
    shift = round(_SHIFT[0] * mask.shape[0]), round(_SHIFT[1] * mask.shape[1])
    return np.asarray(_GHOST * np.roll(light, shift, axis=(1, 2)), np.float32)


def _lamp(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """A lamp as far as possible from the mirror that saturates in its middle, and its glow."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    row, col = np.unravel_index(int(away.argmax()), mask.shape)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    distance = np.hypot(y - row, x - col) / (0.08 * np.sqrt(mask.size))
    lamp = _LAMP * np.exp(-np.minimum(distance, 50.0))
    return np.broadcast_to(lamp.astype(np.float32), light.shape)


FORMS: dict[str, Callable[[float, tuple[int, int], np.random.Generator], Mask]] = {
    "round": _round,
    "oblong": _oblong,
    "islands": _islands,
}
AROUND: dict[str, Callable[[Light, Mask, np.random.Generator], Light]] = {
    "dark": _dark,
    "room": _room,
    "reflection": _reflection,
    "lamp": _lamp,
}
