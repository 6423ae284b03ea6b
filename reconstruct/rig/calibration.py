"""A capture of the mirror at rest as a reference: its deviation from the prediction is calibration."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import Scene

from ..arrays import Floats, some_rows
from ..geometry import RayField, ray_field, rest_distance, rest_height

__all__ = ["flat_mirror", "rest_corrected", "same_capture"]

_SAME = 0.02  # standard deviations of the noise
_BLOCK = 1 << 14  # pixels at once: what they need stays in the cache
_FORM_STEPS = 4  # each leaves the form's slope times the ray's, some thousandths


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


def flat_mirror(scene: Scene, rays: RayField | None = None) -> Floats:
    """Place on the pattern's surface of every pixel by the mirror at rest, u and v (2, H, W); NaN where there
    is none. rays: of the scene's camera, if they are known.

    Neither mirror nor pattern nor medium end: a scene that is a little wrong has its edges elsewhere, and the
    capture at rest shows where they are.
    """
    rays = ray_field(scene.camera) if rays is None else rays
    (rows, cols), found = rays.shape, np.empty((2, *rays.shape))

    def block(start: int, stop: int) -> None:
        parts = (part[:, start:stop] for part in (rays.inner_origins, rays.inner_directions))
        found[:, start:stop] = _reflected(scene, *parts)

    over_rows(block, rows, max(1, _BLOCK // cols))
    return found


def _added(one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.floating]:
    """Root of the sum of squares: `hypot` is three times slower."""
    return np.asarray(np.sqrt(np.square(one) + np.square(other)))


def _reflected(scene: Scene, o: Floats, d: Floats) -> Floats:
    """`flat_mirror` of rays (3, n, W)."""
    away = rest_distance(o, d)
    ahead = away > 0
    out = d * np.array([1.0, 1.0, -1.0])[:, None, None]
    if scene.rest_form is not None and scene.rest_form.coefficients.any():
        for _ in range(_FORM_STEPS):
            x, y, _ = o + away * d
            away = (rest_height(x, y, scene) - o[2]) / d[2]
        hx, hy = scene.rest_form.slopes(x, y, scene.mirror)
        normal = np.stack([-hx, -hy, np.ones_like(hx)])
        out = d - 2 * (d * normal).sum(axis=0) / (normal * normal).sum(axis=0) * normal
    u, v, way = scene.pattern.landing((o + away * d).reshape(3, -1), out.reshape(3, -1))
    with np.errstate(invalid="ignore"):
        seen = (way.reshape(away.shape) > 0) & ahead
    return np.stack([np.where(seen, at.reshape(away.shape), np.nan) for at in (u, v)])


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
