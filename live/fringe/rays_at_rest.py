"""Geometry of a rig at rest, on cells of pixels, for the linearised equations; the anchor."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Mask
from optolever.scene import Scene

__all__ = ["AnchorLine", "RestRays", "anchor_line", "rest_rays", "rim"]

_PAD = 2  # cells beyond the image: the reach of a 4th-order difference
_REACH = 4.0  # cells over which the slope is extrapolated to the mirror's edge
_RIM = 3  # cells from the border of the lit area


@dataclass(frozen=True, slots=True, eq=False)
class RestRays:
    """Rays of the cells' centres and the mirror at rest, mirror frame.

    planes (18, R, C): pattern point less mirror point at rest (mm), ray direction; along columns the change
    of the rest point o + t d at constant t, and of d, a cell; the same along rows. points (3, R, C): of the
    mirror, mm. step_u, step_v (3,): mm a turn."""

    planes: Floats
    points: Floats
    step_u: Floats
    step_v: Floats

    @property
    def directions(self) -> Floats:
        """(3, R, C), unit."""
        return self.planes[3:6]

    def regular(self, lit: Mask) -> "RestRays":
        """Cells that are not lit (R, C) lie no nearer to the pattern than those that are: the equations are
        singular where mirror and pattern meet, and their solution passes through all cells."""
        away = np.linalg.norm(self.planes[:3], axis=0)
        times = np.where(lit, 1.0, np.maximum(1.0, away[lit].min() / np.maximum(away, 1e-9)))
        return replace(self, planes=np.concatenate([self.planes[:3] * times, self.planes[3:]]))


@dataclass(frozen=True, slots=True, eq=False)
class AnchorLine:
    """A mean of heights that is zero: sum over cells of distance tau + per_col p + per_row q, with tau the
    distance along the ray less that at rest and p, q its slopes (mm a cell); (R, C) each. edge: it is the
    mirror's camera-side edge; else the rim of the lit area."""

    distance: Floats
    per_col: Floats
    per_row: Floats
    edge: bool


def rest_rays(scene: Scene, rows: int, cols: int, cell: int, period: float) -> RestRays:
    """rows, cols: of cells; period: pattern pixels a turn."""
    row, col = np.meshgrid(
        *(cell * np.arange(-_PAD, count + _PAD) + 0.5 * (cell - 1) for count in (rows, cols)), indexing="ij"
    )
    origins, directions = (np.moveaxis(part, -1, 0) for part in scene.camera.rays_at(row, col))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -origins[2] / directions[2]
        mirror = origins + distance * directions
    inner = (slice(None), slice(_PAD, -_PAD), slice(_PAD, -_PAD))
    d, points, t = directions[inner], mirror[inner], distance[_PAD:-_PAD, _PAD:-_PAD]
    reflected = d * np.array([1.0, 1.0, -1.0])[:, None, None]
    pattern = scene.pattern
    _, _, way = pattern.landing(points.reshape(3, -1), reflected.reshape(3, -1))
    changes = [
        part
        for axis in (2, 1)
        for part in (_change(origins, axis) + t * _change(directions, axis), _change(directions, axis))
    ]
    way = np.where(points[0] < 0, np.nan, way.reshape(t.shape))  # beyond the mirror, maybe beyond the display
    planes = np.concatenate([np.where(way > 0, way, np.nan) * reflected, d, *changes])
    step_u, step_v = period * pattern.steps
    return RestRays(_finite(planes), _finite(points), step_u, step_v)


def anchor_line(scene: Scene, rays: RestRays, lit: Mask) -> AnchorLine:
    """The line x = length, reached from the nearest lit cell of every row (or column); where none is near,
    the rim of the lit area."""
    x, length = rays.points[0], scene.mirror.length
    per_row, per_col = np.gradient(x)
    axis = int(np.median(np.abs(per_col[lit])) >= np.median(np.abs(per_row[lit])))
    step = per_col if axis == 1 else per_row
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = (length - x) / step  # cells from here to the line
        away = np.where(lit & (np.abs(offset) <= _REACH), np.abs(offset), np.inf)
    zero = np.zeros(lit.shape)
    lines = np.flatnonzero(np.isfinite(away.min(axis=axis)))
    if lines.size == 0:
        border = rim(lit)
        weight = border / max(float(border.sum()), 1.0)
        return AnchorLine(weight, zero, zero, False)
    at = np.argmin(away, axis=axis)[lines]
    place = (lines, at) if axis == 1 else (at, lines)
    weight, slope = zero.copy(), zero.copy()
    weight[place], slope[place] = 1 / lines.size, offset[place] / lines.size
    return AnchorLine(weight, slope if axis == 1 else zero, zero if axis == 1 else slope, True)


def rim(lit: Mask) -> Mask:
    """Lit cells within _RIM cells of the border of the lit area."""
    side = 2 * _RIM + 1
    return np.asarray(lit & ~scipy.ndimage.binary_erosion(lit, np.ones((side, side))))


def _change(field: Floats, axis: int) -> Floats:
    """4th-order central difference a cell, of the inner cells."""

    def at(shift: int) -> Floats:
        return np.roll(field, -shift, axis)

    change: Floats = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12
    return change[:, _PAD:-_PAD, _PAD:-_PAD]


def _finite(planes: Floats) -> Floats:
    """Cells whose ray meets no mirror or no pattern take the planes' medians: they are not lit."""
    bad = ~np.isfinite(planes).all(axis=0)
    if bad.any():
        planes = planes.copy()
        planes[:, bad] = np.median(planes[:, ~bad], axis=1)[:, None]
    return planes
