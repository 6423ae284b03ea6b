"""How far contacts make the surface around them sink: an anchor there, which counts as at rest, is too high.

On an elastic half-space the surface at distance r from a contact of radius a and depth d sinks by

    4 / (3 pi) d a / r

(Hertz' far field; K. L. Johnson, Contact Mechanics, 1985, eq. 3.42; within 6 % from r = 1.5 a on; of a flat
punch 2 / pi d asin(a / r)); contacts add. On a bonded incompressible layer of thickness h: that times
max(.25, 1 - 1.45 r / h)."""

import math

import numpy as np

from optolever.contact import basins
from optolever.scene import Layer

from ..arrays import Floats
from ..heightmap import HeightMap

__all__ = ["sink_around", "sinks"]

_SIGNIFICANT = 6.0  # standard deviations of the height
_MOST = 16  # contacts
_COLUMNS = 256  # on which they are looked for
_HALF = 0.5  # of the depth: where a ball's contact ends
_LEAST = 0.25


def sink_around(depth: float, radius: float, away: Floats, layer: Layer | None) -> Floats:
    """How far the surface sinks at distances from a contact, mm; layer: elastic; None: a half-space."""
    thickness = math.inf if layer is None or layer.thickness_mm is None else layer.thickness_mm
    far = 4 / (3 * math.pi) * depth * radius / np.maximum(away, radius)
    return np.asarray(far * np.maximum(_LEAST, 1 - 1.45 * away / thickness))


def sinks(height: HeightMap, x: Floats, y: Floats, layer: Layer | None) -> Floats:
    """How far the surface at places x, y (n,) sinks under the contacts of a map less rest, mm."""
    step = max(1, height.z.shape[1] // _COLUMNS)
    few = slice(None, None, step), slice(None, None, step)
    z, known = np.nan_to_num(height.z[few]), height.good[few] & np.isfinite(height.z[few])
    sigma = np.where(known, height.sigma[few], 0.0)
    total = np.zeros(x.size)
    if min(z.shape) < 2 or not known.any():
        return total
    (x_row, x_col), (y_row, y_col) = (np.gradient(part[few]) for part in (height.x, height.y))
    area = float(np.nanmedian(np.abs(x_col * y_row - x_row * y_col)[known]))
    labels, peaks = basins(z, sigma, known, _SIGNIFICANT)
    for number, peak in enumerate(peaks[:_MOST]):
        at = np.unravel_index(int(peak), z.shape)
        depth = float(z[at])
        if not depth > _SIGNIFICANT * sigma[at]:
            continue
        pressed = (labels == number) & (z > _HALF * depth)
        radius = math.sqrt(np.count_nonzero(pressed) * area / math.pi)
        middle = float(height.x[few][pressed].mean()), float(height.y[few][pressed].mean())
        total += sink_around(depth, radius, np.hypot(x - middle[0], y - middle[1]), layer)
    return total
