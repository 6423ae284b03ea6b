"""What neighbours tell of a pixel: its footprint, what the display's cells shift in it, and whether it fits.

A pixel that looks at two places at once (at the edge of an object, of a shadow, of the mirror) reads neither. Edges
show as second differences that no single place can have: more than a quarter of the finest period, or two cells of a
code, between neighbours. A pixel beside one that sees nothing may itself see only in part; its lost amplitude tells how
much, and half of that share of the footprint is how far its centre of light may be off.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact

from .correspondence import Flag
from .display import PLACES, WIDTHS, Pixelation

__all__ = ["Raw", "check_rows"]

_OUTLIER, _OFF = int(Flag.OUTLIER), int(Flag.OFF_PATTERN)
#: Deviations beyond which a neighbour contradicts.
_SURE = 6.0
#: Share of the light that may be lost beyond the border of the surface.
_LOST = 0.25


@dataclass(frozen=True, slots=True)
class Raw:
    """One axis before its neighbours are asked, (H, W) float32: coordinate and variance, px and px^2."""

    coordinate: Any
    variance: Any


def check_rows(
    rows: tuple[int, int],
    raw: Raw,
    common: tuple[NDArray[np.uint16], Any],
    pixelation: Pixelation,
    limits: tuple[float, float, float],
    out: tuple[Any, Any, NDArray[np.uint16]],
) -> None:
    """Rows start..stop of one axis.

    common: flags (H, W) so far, amplitude (H, W). limits: extent of the surface (0: it has no border), largest
    second difference (px), least sigma (px). out: coordinate, sigma, flags (H, W), the last or-ed.
    """
    extent, jump, least = limits
    _check(
        *(*rows, raw.coordinate, raw.variance, *common, pixelation.shift, pixelation.variance),
        *(np.float32(pixelation.reach), np.float32(extent), np.float32(jump), np.float32(least), *out),
    )


@exact
def _check(
    start: Any,
    stop: Any,
    coord: Any,
    variance: Any,
    flags: Any,
    amplitude: Any,
    shift: Any,
    unsure: Any,
    reach: Any,
    extent: Any,
    jump: Any,
    least: Any,
    out: Any,
    sigma: Any,
    out_flags: Any,
) -> None:
    rows, cols = coord.shape
    per_width = np.float32(1 / WIDTHS[1])
    half, zero = np.float32(0.5), np.float32(0)
    for y in range(start, stop):
        up, down = max(y - 1, 0), min(y + 1, rows - 1)
        for x in range(cols):
            c, var = coord[y, x], variance[y, x]
            flag = np.uint16(0)
            if flags[y, x] == 0:
                before, after = max(x - 1, 0), min(x + 1, cols - 1)
                left, right, above, below = coord[y, before], coord[y, after], coord[up, x], coord[down, x]
                has_left, has_right = flags[y, before] == 0, flags[y, after] == 0
                has_above, has_below = flags[up, x] == 0, flags[down, x] == 0
                lost = zero
                gx = right - left if has_left and has_right else zero
                gy = below - above if has_above and has_below else zero
                gx = gx * half if 0 < x < cols - 1 else gx
                gy = gy * half if 0 < y < rows - 1 else gy
                if not (has_left and has_right):
                    lost, gx = _beside(
                        has_left, has_right, c, left, right, amplitude[y, x], amplitude[y, before], amplitude[y, after]
                    )
                if not (has_above and has_below):
                    more, gy = _beside(
                        has_above, has_below, c, above, below, amplitude[y, x], amplitude[up, x], amplitude[down, x]
                    )
                    lost += more
                if has_left + has_right + has_above + has_below <= 1 and rows > 2 and cols > 2:
                    flag |= np.uint16(_OUTLIER)
                across = has_left and has_right and 0 < x < cols - 1
                along = has_above and has_below and 0 < y < rows - 1
                beyond_x, beyond_y = zero, zero
                if across:
                    noise = _SURE * np.sqrt(variance[y, before] + np.float32(4) * var + variance[y, after])
                    bend = abs(left + right - np.float32(2) * c)
                    if bend > max(jump, noise):
                        flag |= np.uint16(_OUTLIER)
                    beyond_x = max(min(left, right) - c, c - max(left, right)) - noise
                if along:
                    noise = _SURE * np.sqrt(variance[up, x] + np.float32(4) * var + variance[down, x])
                    bend = abs(above + below - np.float32(2) * c)
                    if bend > max(jump, noise):
                        flag |= np.uint16(_OUTLIER)
                    beyond_y = max(min(above, below) - c, c - max(above, below)) - noise
                if across and along and beyond_x > zero and beyond_y > zero:
                    flag |= np.uint16(_OUTLIER)
                width = np.sqrt(gx * gx + gy * gy)
                k = min(np.int32(width * per_width + half), np.int32(shift.shape[0] - 1))
                at = (c - np.floor(c)) * np.float32(PLACES)
                i = min(np.int32(at), np.int32(PLACES - 1))
                j = i + 1 if i + 1 < PLACES else 0
                part = at - np.float32(i)
                c = c + (np.float32(1) - part) * shift[k, i] + part * shift[k, j]
                var = var + unsure[k, i] + lost
                if extent > zero:
                    deviation = np.sqrt(reach * reach + width * width * np.float32(1 / 12))
                    away = min(c + half, extent - half - c)
                    if away < np.float32(3) * deviation:
                        dark = half * np.float32(math.erfc(away / (deviation * np.float32(1.4142135))))
                        var += dark * dark * deviation * deviation
                        if dark > np.float32(_LOST):
                            flag |= np.uint16(_OFF)
            out[y, x] = c
            sigma[y, x] = max(np.sqrt(var), least)
            out_flags[y, x] |= flag


@exact
def _beside(
    has_one: Any, has_other: Any, c: Any, one: Any, other: Any, amplitude: Any, of_one: Any, of_other: Any
) -> Any:
    """Squared shift of a pixel's centre of light that its lost amplitude allows, and the step to its neighbour."""
    if not (has_one or has_other):
        return np.float32(0), np.float32(0)
    step = (c - one) if has_one else (other - c)
    whole = of_one if has_one else of_other
    share = max(np.float32(1) - amplitude / max(whole, np.float32(1e-6)), np.float32(0))
    off = np.float32(0.5) * share * step
    return off * off, step
