"""Motion of the rig between rest and press: errors of its prior, limited by what the map shows (`load`)."""

import numpy as np

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.scene import Scene, adjusted, parameter_values

from ..geometry import flat_mirror, ray_field, traced_rays
from ..outputs.coarse_modes import filled

__all__ = ["motion_shifts"]

_IMAGE, _TURN, _SHIFT = 0.02, 2.4e-5, 1e-3  # of the prior: camera pixels, rad (5 arcsec), mm
_GROWTH = 1e-4  # of the picture: lens and display that warm by some kelvins
_WEAK = 1e-3  # of the largest mode


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
