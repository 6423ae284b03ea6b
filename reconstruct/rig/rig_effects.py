"""Errors of a rig that are no numbers of its scene: a cover glass, the gauge."""

import numpy as np

from optolever.scene import TYPED, Scene

from ..arrays import Floats
from ..problem import Problem

__all__ = ["gauge_displacement", "glass_shift"]

_GLASS_INDEX = 1.5  # of a display's cover


def glass_shift(scene: Scene, problem: Problem, w: Floats, at_rest: bool) -> Floats:
    """Change of u and v (2, rows, cols) by a cover glass of 1 mm, less that of the rest capture; w: the
    unknown of the solution."""
    data, index = problem.data, 1.0 if scene.medium is None else scene.medium.index
    shift = _refracted(data.to_pattern(w), data.plane, index)
    if at_rest:
        reflected = data.rays.inner_directions * np.array([1.0, 1.0, -1.0])[:, None, None]
        shift = shift - _refracted(reflected, data.plane, index)
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


def gauge_displacement(scene: Scene) -> Floats:
    """Displacement (3, 2, 3), see `HeightMap`, by place (x, y) and turn about z of the rig over the mirror:
    no height depends on them.

    A calibration in open air replaces the typed pose of the camera by one relative to its flats, which stood
    anywhere: where the mirror lies is known by the typed aim, an angle over the camera's distance.
    """
    known = TYPED if scene.accuracy is None else scene.accuracy
    x, y = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    place = known.distance
    if scene.covariance is not None and scene.medium is None:
        away = float(np.linalg.norm(scene.camera.origin - [x, y, 0.0]))
        place = float(np.hypot(place, known.angle * away))
    turn = known.angle * np.array([[y, 0, -1], [-x, 1, 0]])
    shifts = place * np.eye(2)[..., None] * [1, 0, 0]
    return np.array([*shifts, turn])
