"""Motion of the rig between rest and press: errors of its prior, limited by what the map shows (`load`); the
shift of the whole picture, as a map against rest holds it.

A motion of the rig changes the map by z(x, y), and with that the places in the picture by f z + b grad z: f
the change by a mirror that sinks evenly, b by its slopes. The free mode of the height changes no place, so
that the map before less the map after `less_sag` has the displacement of the motion alone. A shift along f
may as well be the mirror's own sinking, which a map of a typed rig takes for the rig's motion, one of an
exact rig for the mirror's.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.scene import Scene, Surface, adjusted, parameter_values, strided, trace

from ..geometry import flat_mirror, ray_field, traced_rays
from ..heightmap import HeightMap, Modes, coarse_step, filled
from ..problem import Problem
from ..solver.newton import State, response

__all__ = ["PictureShift", "motion_shifts", "picture_shift", "shift_modes"]

_IMAGE, _TURN, _SHIFT = 0.02, 2.4e-5, 1e-3  # of the prior: camera pixels, rad (5 arcsec), mm
_GROWTH = 1e-4  # of the picture: lens and display that warm by some kelvins
_WEAK = 1e-3  # of the largest mode
# of the picture's shift
_LEAST = 0.005  # pixels: of an exact rig
_CREPT, _USUAL = 5.0, 4.0  # standard deviations: of the fit, of a rig's usual motion
_LOWER, _TILT = 1e-3, 1e-6  # mm, rad: of differences
_PICTURE = 0.2  # pixels of the camera: standard deviation of a motion


def motion_shifts(press: Correspondence, scene: Scene, flat: Floats, step: int) -> Floats:
    """Changes of u and v (k, 2, rows, cols) by motions of one standard deviation, of a scene whose camera has
    every step-th pixel; press: of those pixels, which the image's motion and growth shift; flat (2, rows,
    cols): see `flat_mirror`. Gaps take the nearest values."""
    known, rays = parameter_values(scene), ray_field(scene.camera)
    sizes = {axis: _TURN if axis[0] == "r" else _SHIFT for axis in ("x", "y", "z", "rx", "ry", "rz")}
    poses = [(f"{part}.{axis}", size) for part in ("camera", "pattern") for axis, size in sizes.items()]
    scenes = [adjusted(scene, {name: size}, known) for name, size in poses]
    own = scene.camera
    seen = [rays if one.camera is own else traced_rays(one.camera) for one in scenes]
    fields = [flat_mirror(*pair) - flat for pair in zip(scenes, seen, strict=True)]
    places = np.stack([np.where(press.good, at, np.nan) for at in (press.u, press.v)])
    moved = [np.gradient(places, axis=axis) for axis in (1, 2)]
    fields += [_IMAGE / step * field for field in moved]
    rows, cols = places.shape[1:]
    grown = moved[0] * (np.arange(rows)[:, None] - rows / 2) + moved[1] * (np.arange(cols) - cols / 2)
    fields.append(_GROWTH * grown)
    whole = filled(np.reshape(fields, (-1, *flat.shape[1:])))
    rows = whole.reshape(len(fields), -1).astype(np.float64)
    squares, turns = np.linalg.eigh(rows @ rows.T)
    strong: Floats = turns[:, squares > _WEAK**2 * squares[-1]].T[::-1] @ rows  # the largest first
    return strong.reshape(-1, *flat.shape)


class PictureShift(NamedTuple):
    """pixels: of the camera; sigma: of the fit, prior: of a rig that moved as much as is usual, in pixels;
    sunk: the even sinking of the mirror that is the same picture, mm, sunk_sigma: of the fit."""

    pixels: float
    sigma: float
    prior: float
    sunk: float
    sunk_sigma: float

    @property
    def limit(self) -> float:
        """Pixels that neither the fit nor a rig's usual motion leaves unsure."""
        return max(_LEAST, _CREPT * self.sigma, _USUAL * self.prior)

    @property
    def unsure(self) -> float:
        """Standard deviation of the mirror's sinking by the fit, mm; of an exact rig beyond the limit."""
        if not self.prior and not self.pixels > self.limit:
            return 0.0
        return math.sqrt(max(self.sunk**2 - self.sunk_sigma**2, 0.0))


def picture_shift(before: HeightMap, after: HeightMap, scene: Scene) -> PictureShift:
    """Of the motion that a map after `less_sag` is without."""
    step, count = before.modes_step, 1 + before.own
    taken = (before.z - after.z)[None, ::step, ::step]
    maps = np.concatenate([taken, _own(before), _own(after)]).astype(np.float64)
    found, pixels = _shifts(maps, before, strided(scene, step))
    prior, sigma = (np.square(part).sum(axis=0) ** 0.5 for part in (found[1:count], found[count:]))
    shift = pixels * float(np.hypot(*found[0]))
    return PictureShift(
        shift, pixels * float(sigma.max()), pixels * float(prior.max()), float(found[0, 0]), float(sigma[0])
    )


def _own(height: HeightMap) -> Modes:
    """The modes of its motion."""
    assert height.modes is not None
    return height.modes[height.count - height.own :]


def _shifts(maps: Floats, height: HeightMap, scene: Scene) -> tuple[Floats, float]:
    """Of changes of a map (n, rows, cols), in units of a sinking (n, 2), along its displacement and across
    it; pixels of the camera by a unit."""
    step = height.modes_step
    few, flat = np.s_[::step, ::step], flat_mirror(scene)

    def change(by: float, along: float, across: float) -> Floats:
        at = trace(scene, Surface(lambda x, y: 0 * x * y + by, lambda x, y: (0 * x + along, 0 * y + across)))
        return np.stack([at.u, at.v]) - flat

    field = change(_LOWER, 0.0, 0.0) / _LOWER
    slopes = [change(0.0, *(_TILT * unit)) / _TILT for unit in np.eye(2)]
    at = np.stack([height.x[few], height.y[few]])
    (xr, xc), (yr, yc) = ([np.gradient(one, axis=axis) for axis in (0, 1)] for one in at)
    zr, zc = np.gradient(maps, axis=(1, 2))
    area = xr * yc - xc * yr
    p, q = (zr * yc - zc * yr) / area, (zc * xr - zr * xc) / area
    moved = field * maps[:, None] + slopes[0] * p[:, None] + slopes[1] * q[:, None]
    size, pixel = np.square(field).sum(axis=0), np.hypot(*np.gradient(flat, axis=2)) / step
    known = height.good[few] & np.isfinite(moved).all(axis=(0, 1)) & (size > 0) & (pixel > 0)  # not NaN
    if not known.any():
        return np.zeros((len(maps), 2)), 0.0
    across = np.stack([-field[1], field[0]])
    found = [np.einsum("ncij,cij->nij", moved, way)[:, known].sum(axis=1) for way in (field, across)]
    return np.stack(found, axis=1) / size[known].sum(), float(np.median((np.sqrt(size) / pixel)[known]))


def shift_modes(height: HeightMap, problem: Problem, state: State, press: Correspondence) -> HeightMap:
    """The map of a rig without motion with the changes by a shift of the picture along its columns and rows,
    as if these were its motion."""
    data, step, changes = problem.data, coarse_step(height.z.shape), []
    p, q, _, _ = data.slopes(state.w)
    places = np.stack([np.where(press.good, at, np.nan) for at in (press.u, press.v)])
    for axis in (2, 1):
        u, v = problem.to_grid(np.nan_to_num(np.gradient(places, axis=axis)))
        moved_p, moved_q, _, _ = replace(data, u=data.u + _PICTURE * u, v=data.v + _PICTURE * v).slopes(
            state.w
        )
        moved = response(data, problem.labels, state, (moved_p - p, moved_q - q))
        if data.rays.logarithmic:
            moved = moved * data.distance(state.w)
        image = problem.to_image(np.where(data.mask, moved, np.nan), np.nan)
        changes.append((image * problem.rays.inner_directions[2])[::step, ::step])
    shares = np.eye(2)[None]
    return replace(
        height, modes=filled(np.stack(changes)), modes_step=step, own=2, sources=("motion",), shares=shares
    )
