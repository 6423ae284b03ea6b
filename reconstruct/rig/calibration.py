"""What captures of one rig have in common, and its scene does not know: the deviation of a capture of the
mirror at rest from the prediction, a cover glass, the gauge."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats, some_rows
from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import TYPED, Scene

from ..geometry import flat_mirror
from ..problem import Problem

__all__ = ["gauge_displacement", "glass_shift", "rest_corrected", "same_capture"]

_SAME = 0.02  # standard deviations of the noise
_GLASS_INDEX = 1.5  # of a display's cover


def rest_corrected(correspondence: Correspondence, rest: Correspondence, scene: Scene) -> Correspondence:
    """The correspondence less the rest capture's deviation from the scene's prediction for a flat mirror,
    pixel by pixel.

    Right to first order in the dent: every pixel's error of pattern pose, scale and lens is taken as that at
    rest. The sigmas add in square. Pixels that the rest capture does not know are flagged INVALID.
    """
    size = " x ".join(map(str, correspondence.u.shape))
    camera = scene.camera.rows, scene.camera.cols
    for name, shape in (("rest", rest.u.shape), ("the scene's camera", camera)):
        if shape != correspondence.u.shape:
            raise InputError(f"{name}: {shape[0]} x {shape[1]} pixels, the correspondence has {size}")
    flat_u, flat_v = flat_mirror(replace(scene, rest_form=None))
    known = rest.good & np.isfinite(flat_u)
    unknown = np.where(~known & correspondence.good, int(Flag.INVALID), 0)
    return replace(
        correspondence,
        u=correspondence.u - np.where(known, rest.u - flat_u, 0.0),
        v=correspondence.v - np.where(known, rest.v - flat_v, 0.0),
        sigma_u=_added(correspondence.sigma_u, np.where(known, rest.sigma_u, np.float32(0))),
        sigma_v=_added(correspondence.sigma_v, np.where(known, rest.sigma_v, np.float32(0))),
        flags=(correspondence.flags | unknown).astype(np.uint16),
        notices=tuple(dict.fromkeys(correspondence.notices + rest.notices)),
    )


def _added(one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.floating]:
    """Root of the sum of squares: `hypot` is three times slower."""
    return np.asarray(np.sqrt(np.square(one) + np.square(other)))


def same_capture(pressed: Correspondence, rest: Correspondence) -> bool:
    """Whether both are one capture: they differ by less than a fiftieth of their noise, so that no second
    exposure can have made them."""
    few = some_rows(rest.u)
    both = pressed.good[few] & rest.good[few] if pressed.u.shape == rest.u.shape else np.zeros(1, np.bool_)
    if not both.any():
        return False
    for axis in ("u", "v"):
        one, other = (getattr(each, axis)[few][both].astype(np.float64) for each in (pressed, rest))
        noise = np.hypot(*(getattr(each, f"sigma_{axis}")[few][both] for each in (pressed, rest)))
        if not np.nanmean(np.square((one - other) / noise)) < _SAME**2:
            return False
    return True


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
