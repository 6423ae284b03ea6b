"""Reflection of camera rays at a target of known form, for the adjustment: first intersection, no edges.

Intersection with z = h(x, y) by Newton's method, then reflection at the normal (-h_x, -h_y, 1). Checked
against `scene.trace`, which brackets the intersection and handles edges and shadows.
"""

import numpy as np

from optolever.arrays import Floats
from optolever.scene import Scene

from .targets import Shape

__all__ = ["rays_of", "reflected"]


_STEPS = 12
_SETTLED = 1e-11  # mm


def rays_of(scene: Scene, row: Floats, col: Floats) -> tuple[Floats, Floats]:
    """Origins and directions (3, n) of the rays of a scene's pixels."""
    origins, directions = scene.camera.rays_at(row, col)
    return np.ascontiguousarray(origins.T), np.ascontiguousarray(directions.T)


def reflected(rays: tuple[Floats, Floats], shape: Shape) -> tuple[Floats, Floats]:
    """Points (3, n) on the mirror, mm, and directions (3, n) from there to the pattern."""
    o, d = rays
    t = -o[2] / d[2]
    for _ in range(_STEPS):
        x, y, z = o + t * d
        h, hx, hy = shape(x, y)
        fall = d[2] - hx * d[0] - hy * d[1]
        step = (z - h) / fall
        t = t - step
        if not (np.abs(step) >= _SETTLED).any():
            break
    twice = 2 * fall / (1 + hx * hx + hy * hy)
    return o + t * d, np.stack([d[0] + twice * hx, d[1] + twice * hy, d[2] - twice])
