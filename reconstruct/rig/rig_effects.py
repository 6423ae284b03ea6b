"""Errors of a rig that are no numbers of its scene: a cover glass, the sag of the mirror at rest, the
gauge."""

import numpy as np

from optolever.scene import TYPED, Scene

from ..arrays import Floats
from ..problem import Problem
from .calibration import Form, Pair3

__all__ = ["gauge_displacement", "glass_shift", "sag_forms"]

_GLASS_INDEX = 1.5  # of a display's cover


def glass_shift(scene: Scene, problem: Problem, w: Floats, at_rest: bool) -> Floats:
    """Change of u and v (2, rows, cols) by a cover glass of 1 mm, less that of the rest capture; w: the
    unknown of the solution."""
    data, index = problem.data, 1.0 if scene.medium is None else scene.medium.index
    rays = data.rays
    plane = data.plane
    mirror = rays.inner_origins + data.distance(w) * rays.inner_directions
    cell = plane[0] + data.u[..., None] * plane[1] + data.v[..., None] * plane[2]
    shift = _refracted(np.moveaxis(cell, -1, 0) - mirror, plane, index)
    if at_rest:
        reflected = rays.inner_directions * np.array([1.0, 1.0, -1.0])[:, None, None]
        shift = shift - _refracted(reflected, plane, index)
    return np.stack([np.nan_to_num(problem.to_image(part, 0.0)) for part in shift])


def _refracted(directions: Floats, plane: Floats, index: float) -> Floats:
    """Change of the places, in cells (2, rows, cols), where rays (3, rows, cols) meet the cells behind 1 mm
    of glass: by Snell's law, tan of the angle in the glass less tan of the angle outside."""
    pitch = np.linalg.norm(plane[1:], axis=1)
    axes = plane[1:] / pitch[:, None]
    local = np.tensordot(np.stack([*axes, np.cross(*axes)]), directions, 1)
    across = np.hypot(local[0], local[1])
    sine = index / _GLASS_INDEX * across / np.linalg.norm(local, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = sine / np.sqrt(1 - sine**2) / across - 1 / np.abs(local[2])
    shift: Floats = factor * local[:2] / pitch[:, None, None]
    return shift


def sag_forms(scene: Scene, sigma: float) -> tuple[Form, ...]:
    """Three shapes of the mirror at rest: Legendre polynomials of second order, at the corners sigma (mm) in
    all."""
    length, width, size = scene.mirror.length, scene.mirror.width, sigma / np.sqrt(3)

    def along(x: Floats, y: Floats) -> Pair3:
        s = 2 * x / length - 1
        return size * (1.5 * s * s - 0.5), size * 6 * s / length, 0 * s

    def twist(x: Floats, y: Floats) -> Pair3:
        s, t = 2 * x / length - 1, 2 * y / width - 1
        return size * s * t, size * 2 * t / length, size * 2 * s / width

    def across(x: Floats, y: Floats) -> Pair3:
        t = 2 * y / width - 1
        return size * (1.5 * t * t - 0.5), 0 * t, size * 6 * t / width

    return (along, twist, across) if sigma > 0 else ()


def gauge_displacement(scene: Scene) -> Floats:
    """Displacement (3, 2, 3), see `HeightMap`, by place (x, y) and turn about z of the rig over the mirror:
    no height depends on them."""
    known = TYPED if scene.accuracy is None else scene.accuracy
    x, y = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    shift_x, shift_y = [[known.distance, 0, 0], [0, 0, 0]], [[0, 0, 0], [known.distance, 0, 0]]
    turn = known.angle * np.array([[y, 0, -1], [-x, 1, 0]])
    return np.array([shift_x, shift_y, turn])
