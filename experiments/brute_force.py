"""Reflection by brute force: a ray is marched to the mirror and bisected, its mirror image is solved against
the pattern's plane. Slow, and shares no step with `scene.trace`, which it checks.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene, Surface

__all__ = ["brute_force"]

Array = NDArray[np.float64]
STEPS = 4096  # samples along a ray, between which a crossing is looked for
HALVINGS = 80  # more than float64 has bits


def brute_force(scene: Scene, surface: Surface, row: Array, col: Array) -> tuple[Array, Array]:
    """Pattern coordinates (u, v) of camera pixels (row, col), (n,); NaN where the ray misses the mirror.

    Neither shadows nor the pattern's extent are looked at: compare where `trace` says visible.
    """
    origin, direction = scene.camera.rays_at(row, col)
    points = origin + _distance(surface, origin, direction)[:, None] * direction
    slope_x, slope_y = surface.gradient(points[:, 0], points[:, 1])
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    householder = np.eye(3) - 2 * normal[:, :, None] * normal[:, None, :]
    leaving = np.einsum("nij,nj->ni", householder, direction)
    pattern = scene.pattern
    axes = np.broadcast_to([pattern.pitch * pattern.u_axis, pattern.pitch * pattern.v_axis], (len(row), 2, 3))
    system = np.concatenate([axes, -leaving[:, None, :]], axis=1).transpose(0, 2, 1)
    solved = np.full((len(row), 3), np.nan)
    known = np.isfinite(points).all(axis=1)
    solved[known] = np.linalg.solve(system[known], (points - pattern.origin)[known][..., None])[..., 0]
    return solved[:, 0], solved[:, 1]


def _distance(surface: Surface, origin: Array, direction: Array) -> Array:
    """Where the ray first goes below the mirror; NaN if it does not on its way to z = -1 mm."""
    reach = (-1.0 - origin[:, 2]) / direction[:, 2]
    share = np.linspace(0.0, 1.0, STEPS)
    below = np.stack([_above(surface, origin, direction, reach * part) < 0 for part in share], axis=1)
    first = np.argmax(below, axis=1)
    high = np.where(below.any(axis=1) & (first > 0), reach * share[first], np.nan)
    low = reach * share[np.maximum(first - 1, 0)]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        inside = _above(surface, origin, direction, middle) < 0
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    return np.asarray(0.5 * (low + high))


def _above(surface: Surface, origin: Array, direction: Array, distance: Array) -> Array:
    """Height of the ray's point over the mirror, mm."""
    point = origin + distance[:, None] * direction
    return np.asarray(point[:, 2] - surface.height(point[:, 0], point[:, 1]))
