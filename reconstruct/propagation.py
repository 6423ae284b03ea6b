"""What the errors of a calibrated rig do to a height map.

M_j = (z(theta + h L_j) - z(theta))/h, L a root of the covariance of the scene's numbers: one solve per row of
L; h is small, since a rig that is off by a whole sigma of a wide prior may have no solution.
The modes are smooth: they are solved on a coarse grid of the camera's pixels and interpolated linearly.
Pixels that the map itself did not settle (next to the pattern) have no derivative and are left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import Scene, adjusted, parameter_values, strided

from .anchors import Anchors, DistanceAnchor, PixelAnchor
from .arrays import Floats, Mask
from .heightmap import HeightFlag, HeightMap

__all__ = ["Measurement", "calibration_modes", "interpolated"]

Solver = Callable[["Measurement", Scene, HeightMap | None], HeightMap]

_UNSETTLED = np.uint16(HeightFlag.NOT_CONVERGED | HeightFlag.SINGULAR)
_STEP = 0.05  # of a standard deviation
_LINES = 96  # rows or columns of the coarse grid, at least


@dataclass(frozen=True, slots=True)
class Measurement:
    """What `reconstruct` was given."""

    correspondence: Correspondence
    anchor: Anchors
    mask: Mask | None
    rest: Correspondence | None
    method: str

    def strided(self, step: int) -> "Measurement":
        """Every step-th row and column of it."""
        return Measurement(
            _strided(self.correspondence, step),
            _anchors(self.anchor, step),
            None if self.mask is None else np.asarray(self.mask)[::step, ::step],
            None if self.rest is None else _strided(self.rest, step),
            self.method,
        )


def calibration_modes(
    solve: Solver, measured: Measurement, scene: Scene, height: HeightMap
) -> NDArray[np.float32]:
    """Modes (r, H, W) in mm; NaN where the map has no height. Where the coarse grid holds no solution (few
    pixels, ragged masks), all pixels are solved.
    """
    assert scene.covariance is not None
    step = max(1, min(height.z.shape) // _LINES)
    settled = np.isfinite(height.z) & ((height.flags & _UNSETTLED) == 0)
    if settled.any():
        measured = replace(measured, mask=settled if measured.mask is None else settled & measured.mask)
    for each in dict.fromkeys((step, 1)):
        try:
            coarse = _modes(solve, measured.strided(each), scene, each)
        except InputError:
            if each == 1:
                raise
            continue
        return interpolated(coarse, each, np.isfinite(height.z))
    raise AssertionError


def _modes(solve: Solver, measured: Measurement, scene: Scene, step: int) -> Floats:
    assert scene.covariance is not None
    names, own = scene.covariance.names, parameter_values(scene)

    def height(change: Floats, start: HeightMap | None = None) -> HeightMap:
        values = {name: own[name] + moved for name, moved in zip(names, change, strict=True)}
        return solve(measured, strided(adjusted(scene, values), step), start)

    first = height(np.zeros(len(names)))
    # what further steps from there would still change is no mode
    own_z = height(np.zeros(len(names)), first).z
    return np.stack([(height(_STEP * row, first).z - own_z) / _STEP for row in scene.covariance.root])


def interpolated(coarse: Floats, step: int, known: Mask) -> NDArray[np.float32]:
    """From every step-th pixel to all; gaps from their nearest neighbours."""
    rows, cols = (np.arange(size) / step for size in known.shape)
    place = np.meshgrid(rows, cols, indexing="ij")
    modes = np.full((len(coarse), *known.shape), np.nan, np.float32)
    for mode, found in zip(modes, coarse, strict=True):
        gaps = ~np.isfinite(found)
        if gaps.all():
            raise InputError("calibration: no height is left where a number of the scene is off by its sigma")
        nearest = scipy.ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
        filled = scipy.ndimage.map_coordinates(found[tuple(nearest)], place, order=1, mode="nearest")
        mode[known] = filled[known]
    return modes


def _strided(c: Correspondence, step: int) -> Correspondence:
    u, v, su, sv = (np.ascontiguousarray(part[::step, ::step]) for part in (c.u, c.v, c.sigma_u, c.sigma_v))
    return Correspondence(u, v, su, sv, np.ascontiguousarray(c.flags[::step, ::step]))


def _anchors(anchor: Anchors, step: int) -> Anchors:
    if isinstance(anchor, PixelAnchor | DistanceAnchor):
        return replace(anchor, row=anchor.row / step, col=anchor.col / step)
    if isinstance(anchor, Sequence) and not isinstance(anchor, str):
        return [_anchors(part, step) for part in anchor]  # type: ignore[arg-type, misc]
    return anchor
