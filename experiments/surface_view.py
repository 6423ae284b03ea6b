"""The data of the surface that can be turned: coarse heights and colour layers as base64 of float32."""

import base64
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from .images import robust_limits
from .maps import MirrorGrid

__all__ = ["surface_data"]

Array = NDArray[np.float64]
VERTICES = 150  # on the longer side


def surface_data(
    x: Array, y: Array, z: Array, layers: dict[str, tuple[Array, str, str, bool]]
) -> dict[str, Any]:
    """What report/viewer.js reads, from mirror points x, y, z in mm (any shape, NaN where unknown).

    layers: name -> (values, unit, colour map, symmetric), one per way of colouring the surface.
    """
    grid = MirrorGrid.around(np.where(np.isfinite(z), x, np.nan), y, VERTICES)
    heights = grid.place(z)
    left, right, bottom, top = grid.extent
    span = float(np.nanmax(heights) - np.nanmin(heights)) if np.isfinite(heights).any() else 0.0
    size = max(right - left, top - bottom)
    return {
        "nx": grid.shape[1],
        "ny": grid.shape[0],
        "x0": round(left + grid.pitch / 2, 6),
        "y0": round(bottom + grid.pitch / 2, 6),
        "dx": round(grid.pitch, 9),
        "dy": round(grid.pitch, 9),
        "z": _base64(heights),
        "exaggeration": round(0.25 * size / span, 3) if span > 0 else 1.0,
        "label": "z",
        "layers": [_layer(grid, name, *layer) for name, layer in layers.items()],
    }


def _layer(
    grid: MirrorGrid, name: str, values: Array, unit: str, colours: str, symmetric: bool
) -> dict[str, Any]:
    low, high = robust_limits(values, 0.995 if symmetric else 0.9999, symmetric)
    lut = np.round(matplotlib.colormaps[colours](np.linspace(0, 1, 256))[:, :3] * 255).astype(np.uint8)
    return {
        "name": name,
        "unit": unit,
        "low": low,
        "high": high,
        "data": _base64(np.nan_to_num(grid.place(values), nan=low)),
        "lut": base64.b64encode(lut.tobytes()).decode("ascii"),
    }


def _base64(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
