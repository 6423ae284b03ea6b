"""A capture of the mirror at rest as a reference:
its deviation from the scene's prediction is calibration.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import Scene

from ..arrays import Floats
from ..geometry import RayField, ray_field, rest_distance

__all__ = ["Form", "Pair3", "flat_mirror", "no_form", "rest_corrected", "same_capture"]

Pair3 = tuple[Floats, Floats, Floats]
#: Height of the mirror at rest over x and y (mm), and its derivatives by both.
Form = Callable[[Floats, Floats], Pair3]

_SAME = 0.02  # standard deviations of the noise
_FORM_STEPS = 4  # each leaves the form's slope times the ray's, some thousandths


def rest_corrected(correspondence: Correspondence, rest: Correspondence, scene: Scene) -> Correspondence:
    """The correspondence less the rest capture's deviation from the scene's prediction for a flat mirror,
    pixel by pixel.

    Right to first order in the dent: every pixel's error of pattern pose, scale and lens is taken as that at
    rest. The sigmas add in square. Pixels that the rest capture does not know are flagged INVALID.
    """
    if rest.u.shape != correspondence.u.shape:
        raise InputError(
            f"rest: {rest.u.shape[0]} x {rest.u.shape[1]} pixels, the correspondence has "
            f"{correspondence.u.shape[0]} x {correspondence.u.shape[1]}"
        )
    if correspondence.u.shape != (scene.camera.rows, scene.camera.cols):
        raise InputError(
            f"correspondence: {correspondence.u.shape[0]} x {correspondence.u.shape[1]} pixels, the scene's "
            f"camera has {scene.camera.rows} x {scene.camera.cols}"
        )
    flat_u, flat_v = flat_mirror(scene)
    rays = ray_field(scene.camera)
    with np.errstate(invalid="ignore"):
        ahead = rest_distance(rays.inner_origins, rays.inner_directions) > 0
    known = rest.good & ahead & np.isfinite(flat_u)
    unknown = np.where(~known & correspondence.good, int(Flag.INVALID), 0)
    return replace(
        correspondence,
        u=correspondence.u - np.where(known, rest.u - flat_u, 0.0),
        v=correspondence.v - np.where(known, rest.v - flat_v, 0.0),
        sigma_u=np.hypot(correspondence.sigma_u, np.where(known, rest.sigma_u, 0.0)),
        sigma_v=np.hypot(correspondence.sigma_v, np.where(known, rest.sigma_v, 0.0)),
        flags=(correspondence.flags | unknown).astype(np.uint16),
        notices=tuple(dict.fromkeys(correspondence.notices + rest.notices)),
    )


def no_form(x: Floats, y: Floats) -> Pair3:
    """The flat mirror."""
    return 0.0 * x, 0.0 * x, 0.0 * y


def flat_mirror(scene: Scene, form: Form = no_form, rays: RayField | None = None) -> Floats:
    """Place on the pattern's surface of every pixel by the mirror z = form(x, y), u and v (2, H, W); NaN
    where there is none. form: some micrometres high; rays: of the scene's camera, if they are known.

    Neither mirror nor pattern nor medium end: a scene that is a little wrong has its edges elsewhere, and the
    capture at rest shows where they are.
    """
    rays = ray_field(scene.camera) if rays is None else rays
    o, d = rays.inner_origins, rays.inner_directions
    away = rest_distance(o, d)
    for _ in range(_FORM_STEPS if form is not no_form else 0):
        x, y, _ = o + away * d
        away = (form(x, y)[0] - o[2]) / d[2]
    points = o + away * d
    _, hx, hy = form(points[0], points[1])
    normal = np.stack([-hx, -hy, np.ones_like(hx)]) / np.sqrt(1 + hx * hx + hy * hy)
    out = d - 2 * (d * normal).sum(axis=0) * normal
    u, v, way = scene.pattern.landing(points.reshape(3, -1), out.reshape(3, -1))
    with np.errstate(invalid="ignore"):
        seen = way.reshape(away.shape) > 0
    return np.stack([np.where(seen, at.reshape(away.shape), np.nan) for at in (u, v)])


def same_capture(pressed: Correspondence, rest: Correspondence) -> bool:
    """Whether both are one capture: they differ by less than a fiftieth of their noise, so that no second
    exposure can have made them."""
    both = pressed.good & rest.good
    if pressed.u.shape != rest.u.shape or not both.any():
        return False
    squares = [
        (getattr(pressed, axis)[both] - getattr(rest, axis)[both]).astype(np.float64) ** 2
        / (getattr(pressed, f"sigma_{axis}")[both] ** 2 + getattr(rest, f"sigma_{axis}")[both] ** 2)
        for axis in ("u", "v")
    ]
    known = [each[np.isfinite(each)] for each in squares]
    return all(float(np.mean(each)) < _SAME**2 for each in known if each.size)
