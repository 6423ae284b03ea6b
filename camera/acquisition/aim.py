"""Aim and focus of a camera at a display's reflection, by images of a white and of a black display."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .exposure import Pixels, swing_mask

__all__ = ["Aim", "aim"]

_LAG = 2  # pixels between the levels whose difference is sharpness: Brenner et al., doi 10.1177/24.1.1254907
_SMOOTH, _LIT = 2.0, 0.2  # pixels; share of the brightest pixels' swing: the outline of the reflection
_WIDE = 0.01  # share of the pixels that saturate: beyond, the level hides the edges to focus on
_OFF = 0.15  # of half the picture: the reflection's middle from the picture's
_FULL = 0.9  # share of the picture: a reflection as large as that needs no centring
_SMALL = 0.5  # share of the picture: a smaller reflection wastes pixels
_BLURRED = 0.9  # of the best sharpness so far


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """What a camera sees of a display in a mirror.

    seen: share of the pixels that see the display; centre: (x, y) of these, from -1 (left, top) to 1;
    saturated: share of the pixels at the top level while the display is white; sharpness: mean squared
    difference of levels two pixels apart over the squared mean level, free of noise; outline: contours
    (n, 2) of the reflection, x and y in pixels.
    """

    seen: float
    centre: tuple[float, float]
    saturated: float
    sharpness: float
    outline: tuple[NDArray[np.int32], ...]

    def advice(self, best: float) -> str:
        """The one thing to change next, empty where nothing is wrong. best: the highest sharpness so far."""
        x, y = self.centre
        if self.seen == 0:
            return (
                "The camera does not see the display: turn the camera or the mirror until the display's "
                "reflection lies in the picture."
            )
        if self.saturated > _WIDE:
            return (
                f"{100 * self.saturated:.0f} % of the pixels are saturated: close the lens, or shorten the "
                "exposure (exposure_ms in [devices])."
            )
        if self.seen < _FULL and max(abs(x), abs(y)) > _OFF:
            side = ("left", "right")[x > 0] if abs(x) >= abs(y) else ("top", "bottom")[y > 0]
            way = {"left": "to the left", "right": "to the right", "top": "up", "bottom": "down"}[side]
            where = "at the " + side if side in ("top", "bottom") else "on the " + side
            return f"The reflection lies {where}: turn the camera {way}."
        if self.seen < _SMALL:
            return (
                f"The reflection fills {100 * self.seen:.0f} % of the picture: move the camera nearer, or "
                "use a longer focal length or a larger display."
            )
        if self.sharpness < _BLURRED * best:
            return f"Sharpness is {100 * self.sharpness / best:.0f} % of its best: turn the focus back."
        return ""


def aim(white: Pixels, again: Pixels, black: Pixels, bits: int) -> Aim:
    """Aim by two images (H, W) of a white and one of a black display. Noise of the two white images is
    independent, so that it cancels in the product of their differences: sharpness holds the picture alone."""
    top = 2**bits - 1
    first, second = white.astype(np.float64), again.astype(np.float64)
    swing = cv2.GaussianBlur(0.5 * (first + second) - black, (0, 0), _SMOOTH)  # outlines without noise
    mask, rows, cols = swing_mask(np.asarray(swing, np.float64), top, _LIT), *white.shape
    found = np.argwhere(mask)
    row, col = found.mean(axis=0) if len(found) else (0.5 * (rows - 1), 0.5 * (cols - 1))
    outline = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    return Aim(
        seen=float(mask.mean()),
        centre=(float(2 * (col + 0.5) / cols - 1), float(2 * (row + 0.5) / rows - 1)),
        saturated=float((white >= top).mean()),
        sharpness=_sharpness(first, second),
        outline=tuple(np.asarray(one[:, 0], np.int32) for one in outline),
    )


def _sharpness(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    down = (first[_LAG:] - first[:-_LAG]) * (second[_LAG:] - second[:-_LAG])
    across = (first[:, _LAG:] - first[:, :-_LAG]) * (second[:, _LAG:] - second[:, :-_LAG])
    return max(float(down.mean() + across.mean()), 0.0) / max(float(first.mean() * second.mean()), 1.0)
