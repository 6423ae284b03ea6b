"""Reflection of camera rays at a target of known form, for the adjustment: first intersection, no edges.

Intersection with z = h(x, y) by Newton's method, then reflection at the normal (-h_x, -h_y, 1). Checked
against `scene.trace`, which brackets the intersection and handles edges and shadows.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene

from .targets import Shape

__all__ = ["reflected"]

Floats = NDArray[np.float64]

_STEPS = 12
_SETTLED = 1e-11  # mm


def reflected(scene: Scene, shape: Shape, row: Floats, col: Floats) -> tuple[Floats, Floats]:
    """Points (3, n) on the mirror, mm, and directions (3, n) from there to the pattern."""
    origins, directions = scene.camera.rays_at(row, col)
    o, d = np.ascontiguousarray(origins.T), np.ascontiguousarray(directions.T)
    t = -o[2] / d[2]
    for _ in range(_STEPS):
        x, y, z = o + t * d
        h, hx, hy = shape(x, y)
        step = (z - h) / (d[2] - hx * d[0] - hy * d[1])
        t = t - step
        if np.nanmax(np.abs(step), initial=0.0) < _SETTLED:
            break
    normal = np.stack([-hx, -hy, np.ones_like(hx)]) / np.sqrt(1 + hx * hx + hy * hy)
    return o + t * d, d - 2 * (d * normal).sum(axis=0) * normal
