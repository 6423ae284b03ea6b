"""Parts of an image as cameras of their own, and rays by their feet: where they meet the resting mirror."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Camera, PinholeCamera, Scene, TelecentricCamera

__all__ = ["ParallelRays", "feet", "parallel_rays", "scene_window"]

Float = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ParallelRays:
    """Rays of one direction (3,) whose feet are linear in the pixel: foot + col foot_col + row foot_row.

    A foot (3,) is x, y (mm) on the plane z = 0, and the distance (mm) from the ray's origin to it.
    """

    foot: Float
    foot_col: Float
    foot_row: Float
    direction: Float


def scene_window(scene: Scene, row: float, col: float, rows: int, cols: int) -> Scene:
    """The scene seen by a camera whose pixel (0, 0) is at (row, col) of its camera, fractions allowed."""
    return replace(scene, camera=_window(scene.camera, row, col, rows, cols))


def _window(camera: Camera, row: float, col: float, rows: int, cols: int) -> Camera:
    if isinstance(camera, PinholeCamera):
        return replace(camera, centre=camera.centre - np.array([col, row]), rows=rows, cols=cols)
    shift = col * camera.pitch[0] * camera.u_axis + row * camera.pitch[1] * camera.v_axis
    return replace(camera, origin=camera.origin + shift, rows=rows, cols=cols)


def parallel_rays(camera: Camera) -> ParallelRays | None:
    """The rays of a telecentric camera; None for another, or where not all of them come down."""
    if not isinstance(camera, TelecentricCamera):
        return None
    corners = np.array([[0, 0], [0, 1], [1, 0], [camera.rows - 1, camera.cols - 1]], np.float64)
    at, directions, comes = feet(camera, corners[:, 0], corners[:, 1])
    if not comes.all():
        return None
    return ParallelRays(at[0], at[1] - at[0], at[2] - at[0], directions[0])


def feet(camera: Camera, row: Float, col: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Feet (..., 3), unit directions (..., 3) of the rays at (row, col), and which come down to z = 0."""
    origins, directions = camera.rays_at(row, col)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -origins[..., 2] / directions[..., 2]
        at = origins + distance[..., None] * directions
    at[..., 2] = distance
    comes = np.isfinite(at).all(axis=-1) & (directions[..., 2] < 0)
    return at, directions, comes
