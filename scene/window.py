"""A part of the image, or every n-th pixel, as a camera, and how far the view moves across a pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cameras import Camera, PinholeCamera
from .record import changed
from .scene import Scene, pixel_units

__all__ = ["mean_beside", "movement", "scene_window", "strided"]

Float = NDArray[np.float64]


def scene_window(scene: Scene, row: float, col: float, rows: int, cols: int) -> Scene:
    """The scene with a camera whose pixel (0, 0) is at (row, col) of its camera, fractions allowed."""
    return replace(scene, camera=_window(scene.camera, row, col, rows, cols))


def strided(scene: Scene, step: int) -> Scene:
    """The scene with a camera of every step-th row and column, from pixel (0, 0) on."""
    camera, covariance = scene.camera, scene.covariance
    values: dict[str, Any] = {"rows": -(-camera.rows // step), "cols": -(-camera.cols // step)}
    if isinstance(camera, PinholeCamera):
        values |= {"focal": camera.focal / step, "centre": camera.centre / step}
    else:
        values |= {"pitch": camera.pitch * step}
    if covariance is not None:
        covariance = covariance.scaled(pixel_units(step, step))
    return changed(scene, camera=changed(camera, **values), covariance=covariance)


def movement(before: Float, centre: Float, behind: Float) -> Float:
    """Movement of a coordinate from one end of a pixel to the other; twice that of a half where one end sees
    nothing (NaN), 0 where both do."""
    half = np.where(np.isfinite(before), centre - before, behind - centre)
    whole = np.where(np.isfinite(before) & np.isfinite(behind), behind - before, 2.0 * half)
    moved: Float = np.nan_to_num(whole, nan=0.0)
    return moved


def mean_beside(coordinate: tuple[Float, Float, Float], light: tuple[Float, Float, Float]) -> Float:
    """Mean of a coordinate over a pixel's light less its value at the centre, by its values and the light at
    one end, the centre and the other end (Simpson's rule); 0 where one end sees nothing (NaN)."""
    (before, centre, behind), (first, middle, last) = coordinate, light
    with np.errstate(divide="ignore", invalid="ignore"):
        moment = first * (before - centre) + last * (behind - centre)
        apart: Float = np.nan_to_num(moment / (first + 4.0 * middle + last), nan=0.0, posinf=0.0, neginf=0.0)
    return apart


def _window(camera: Camera, row: float, col: float, rows: int, cols: int) -> Camera:
    if isinstance(camera, PinholeCamera):
        return replace(camera, centre=camera.centre - np.array([col, row]), rows=rows, cols=cols)
    shift = col * camera.pitch[0] * camera.u_axis + row * camera.pitch[1] * camera.v_axis
    return replace(camera, origin=camera.origin + shift, rows=rows, cols=cols)
