"""Rays by the way they go while the mirror rests.

That way is known in float64; trace.glsl follows in float32 only how a dent changes it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.scene import Pattern, Scene, TelecentricCamera

__all__ = ["ParallelRays", "RestingRays", "exact_sums", "parallel_rays", "resting_rays"]

_FLOAT_BITS = 24  # of a float32's integers that are exact


@dataclass(frozen=True, slots=True, eq=False)
class RestingRays:
    """Rays (...,), and where the resting mirror z = 0 sends them; all 0 where one does not come down to it.

    directions (..., 3): unit. foot (..., 4): x, y (mm) on the mirror, the way (mm) there from the ray's
    origin, and the way (mm) on to the end. end (..., 3): u, v (cells) and height over the pattern's plane
    (mm, along its normal); that is on the plane, or at the foot where the ray does not land near the pattern.
    """

    directions: Floats
    foot: Floats
    end: Floats
    comes: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ParallelRays:
    """Rays of one direction (3,) whose foot (6, 4) and end (6, 3) are linear in the pixel: see exact_sums."""

    direction: Floats
    foot: Floats
    end: Floats


def parallel_rays(scene: Scene) -> ParallelRays | None:
    """The rays of a telecentric camera; None for another, or where not all of them come down."""
    camera, size = scene.camera, (scene.camera.rows, scene.camera.cols)
    if not isinstance(camera, TelecentricCamera):
        return None
    ends = np.array([[0, 0], [0, camera.cols], [camera.rows, 0], size], np.float64) - 0.5
    outermost = resting_rays(scene, *ends.T)
    if not outermost.comes.all():
        return None
    lands = bool((outermost.end[:, 2] == 0.0).all())
    steps = np.array([[0, 0], [0, 1], [1, 0]], np.float64)
    rays = resting_rays(scene, *steps.T, lands=lands)
    return ParallelRays(rays.directions[0], exact_sums(rays.foot, *size), exact_sums(rays.end, *size))


def exact_sums(values: Floats, rows: int, cols: int) -> Floats:
    """(3, n) at pixels (0, 0), (0, 1), (1, 0) -> (6, n): value, step per column and per row, and their rests.

    The first three are so round that value + col step + row step is exact in float32, at half pixels too; the
    rests are so small that their sum is as good as exact.
    """
    terms = np.stack([values[0], values[1] - values[0], values[2] - values[0]])
    largest = np.abs(terms[0]) + (cols + 1) * np.abs(terms[1]) + (rows + 1) * np.abs(terms[2])
    unit = 2.0 ** (np.frexp(largest)[1] + 2 - _FLOAT_BITS)
    high = np.rint(terms / unit) * unit
    return np.concatenate([high, terms - high])


def resting_rays(scene: Scene, row: Floats, col: Floats, *, lands: bool | None = None) -> RestingRays:
    """The rays at (row, col), fractions allowed.

    lands: whether they end on the pattern's plane or at the foot; None: on the plane where that is near.
    """
    origins, directions = scene.camera.rays_at(row, col)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        way = -origins[..., 2] / directions[..., 2]
        at = origins + way[..., None] * directions
        comes = np.isfinite(at).all(axis=-1) & (directions[..., 2] < 0)
        u, v, height, onward = _landings(scene.pattern, at, directions * np.array([1.0, 1.0, -1.0]), lands)
    foot = np.stack([at[..., 0], at[..., 1], way, onward], axis=-1)
    end = np.stack([u, v, height], axis=-1)
    directions, foot, end = (np.where(comes[..., None], values, 0.0) for values in (directions, foot, end))
    return RestingRays(directions, foot, end, comes)


def _landings(
    pattern: Pattern, feet: Floats, leaving: Floats, lands: bool | None
) -> tuple[Floats, Floats, Floats, Floats]:
    """Ends of the ways that leave feet (..., 3): u, v, height, and the way to there."""
    height = (feet - pattern.origin) @ pattern.normal
    onward = -height / (leaving @ pattern.normal)
    u, v = pattern.coordinates(feet + onward[..., None] * leaving)
    near = _is_near(u, pattern.cols) & _is_near(v, pattern.rows)
    on = near if lands is None else np.full(near.shape, lands)
    if not on.all():
        u_foot, v_foot = pattern.coordinates(feet)
        u, v = np.where(on, u, u_foot), np.where(on, v, v_foot)
    return u, v, np.where(on, 0.0, height), np.where(on, onward, 0.0)


def _is_near(at: Floats, cells: int) -> NDArray[np.bool_]:
    """Within a pattern's size of the pattern: farther ways would bring more rounding than they save."""
    near: NDArray[np.bool_] = np.abs(at - 0.5 * (cells - 1)) <= 1.5 * cells
    return near
