"""The pattern surface: a grid of cells in any pose, flat or of a shape.

Shapes map pattern coordinates u, v (cells) to an offset (..., 3) in mm along the pattern's u axis, its v axis
and its normal: how far a cell's centre lies off the plane. They live in cells, so that `mapped` follows a
pattern that is cropped or resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Self

import numpy as np

from optolever import InputError

from .fields import Float, Record, freeze, integer, non_negative, number, pair, positive, vector
from .pose import Posed, cross

__all__ = ["Bow", "Pattern", "PatternShape", "PointTable", "prism_pattern"]

_STEPS = 60
_SETTLED = 1e-12  # cells, of the last step
_LEAST = 3  # places that make a triangle


@dataclass(frozen=True, eq=False)
class Bow(Record, section="pattern.bow"):
    """A quadratic bow of a display: w = b20 U^2 + b11 U V + b02 V^2 (mm, along the normal).

    U = (u - centre[0]) / half[0], V likewise (cells): with the pattern's middle and half its sides, b20 is
    the sag of the left and right edges' middles (Bartsch et al., doi:10.1186/s41476-019-0116-1).
    """

    b20: Annotated[float, number]
    b11: Annotated[float, number]
    b02: Annotated[float, number]
    centre: Annotated[Float, partial(vector, size=2), "centre_px"]
    half: Annotated[Float, pair, "half_px"]

    @classmethod
    def of_pattern(cls, rows: int, cols: int, b20: float = 0.0, b11: float = 0.0, b02: float = 0.0) -> Self:
        """About the middle of a pattern of that many cells."""
        size = np.array([cols, rows], np.float64)
        return cls(b20, b11, b02, 0.5 * (size - 1), 0.5 * size)

    def offset(self, u: Float, v: Float) -> Float:
        """Offsets (..., 3) mm."""
        x, y = (u - self.centre[0]) / self.half[0], (v - self.centre[1]) / self.half[1]
        w = (self.b20 * x + self.b11 * y) * x + self.b02 * y * y
        return np.stack([np.zeros_like(w), np.zeros_like(w), w], axis=-1)

    def mapped(self, scale: float, shift: float) -> Self:
        """The same surface in cells u' = scale u + shift, v' = scale v + shift."""
        return replace(self, centre=scale * self.centre + shift, half=scale * self.half)


def _rows(name: str, value: Any) -> Float:
    """Lists of finite numbers, all of one length."""
    try:
        rows = np.array(value, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: must be a list of lists of numbers, all of one length") from error
    if not np.isfinite(rows).all():
        raise InputError(f"{name}: has places or points that are not finite")
    rows.flags.writeable = False
    return rows


@dataclass(frozen=True, eq=False)
class PointTable(Record, section="pattern.table"):
    """A measured surface: places (n, 2) in cells (u, v) and their offsets (n, 3) in mm.

    Linear between them, on the Delaunay triangulation of the places (as OpenCSP's screens); NaN outside.
    """

    places: Annotated[Float, _rows, "places_px"]
    offsets: Annotated[Float, _rows, "offsets_mm"]
    _linear: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import LinearNDInterpolator
        from scipy.spatial import QhullError

        super().__post_init__()
        places, offsets = self.places, self.offsets
        if places.ndim != 2 or places.shape[1] != 2 or len(places) < _LEAST:
            raise InputError(
                f"pattern.table: places have shape {places.shape}, must be (n, 2), n >= {_LEAST}"
            )
        if offsets.shape != (len(places), 3):
            raise InputError(
                f"pattern.table: points have shape {offsets.shape}, must be ({len(places)}, 3) as the places"
            )
        try:
            linear = LinearNDInterpolator(places, offsets)
        except QhullError as error:
            raise InputError("pattern.table: places lie on one line, must span an area") from error
        freeze(self, _linear=linear)

    def offset(self, u: Float, v: Float) -> Float:
        """Offsets (..., 3) mm; NaN outside the measured places."""
        offset: Float = self._linear(np.stack([u, v], axis=-1))
        return offset

    def mapped(self, scale: float, shift: float) -> Self:
        """The same surface in cells u' = scale u + shift, v' = scale v + shift."""
        return replace(self, places=scale * self.places + shift)


#: Types of a pattern's `shape`, if it is not flat.
PatternShape = Bow | PointTable


def _stripes(name: str, value: Any) -> str:
    if value not in ("rgb", "bgr"):
        raise InputError(f"{name} = {value!r}: must be rgb or bgr; leave it out if red, green, blue coincide")
    return str(value)


@dataclass(frozen=True, eq=False)
class Pattern(Posed, section="pattern"):
    """Cell (u, v) (column, row) has its centre at origin + u pitch u_axis + v pitch aspect v_axis.

    pitch mm; blur_px: rms radius, in cells, of the Gaussian through which the camera reads the pattern (0:
    none); shape: deviation from that plane, or None; aspect: height of a cell over its width; stripes: order
    along u of the red, green and blue third of a cell, 'rgb' or 'bgr'; None: each fills its cell.
    """

    pitch: Annotated[float, positive, "pitch_mm"]
    rows: Annotated[int, integer, "size", 1]
    cols: Annotated[int, integer, "size", 0]
    blur_px: Annotated[float, non_negative] = 0.0
    shape: PatternShape | None = None
    aspect: float = 1.0
    stripes: Annotated[str | None, _stripes] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, aspect=positive("pattern.aspect", self.aspect))

    @property
    def normal(self) -> Float:
        """u x v (3,), unit; away from a viewer who sees u to the right and v downwards."""
        return cross(self.u_axis, self.v_axis)

    @property
    def steps(self) -> Float:
        """Steps (2, 3) in mm from a cell to the next one along u and along v."""
        return self._sides[:, None] * np.stack([self.u_axis, self.v_axis])

    @property
    def _sides(self) -> Float:
        """Width and height (2,) of a cell, mm."""
        return self.pitch * np.array([1.0, self.aspect])

    def point(self, u: Float | float, v: Float | float) -> Float:
        """Points (..., 3) in mm of pattern coordinates u, v in cells."""
        step_u, step_v = self.steps
        du = np.asarray(u, np.float64)[..., None] * step_u
        dv = np.asarray(v, np.float64)[..., None] * step_v
        point: Float = self.origin + du + dv
        if self.shape is None:
            return point
        off = self.shape.offset(*np.broadcast_arrays(np.asarray(u, np.float64), np.asarray(v, np.float64)))
        return point + off @ np.stack([self.u_axis, self.v_axis, self.normal])

    def landing(self, points: Float, directions: Float) -> tuple[Float, Float, Float]:
        """Where rays (3, n) meet the pattern: coordinates u, v in cells and way (mm, < 0: behind).

        Off the plane by fixed-point steps, each to the plane through the last place's cell; they contract by
        the surface's slope times the tangent of incidence. NaN where they do not settle.
        """
        (width, tall), axes = self._sides, self.rotation.T
        from_origin, ahead = axes @ (points - self.origin[:, None]), axes @ directions
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            way = -from_origin[2] / ahead[2]
            met = from_origin + way * ahead
            u, v = met[0] / width, met[1] / tall
            if self.shape is None:
                return u, v, way
            moved = np.full(u.shape, np.inf)
            for _ in range(_STEPS):
                off = np.moveaxis(self.shape.offset(u, v), -1, 0)
                way = (off[2] - from_origin[2]) / ahead[2]
                met = from_origin + way * ahead - off
                u_next, v_next = met[0] / width, met[1] / tall
                moved = np.abs(u_next - u) + np.abs(v_next - v)
                u, v = u_next, v_next
                if not np.any(moved > _SETTLED):
                    break
        settled = moved <= 1e3 * _SETTLED
        return np.where(settled, u, np.nan), np.where(settled, v, np.nan), way

    def resampled(self, rows: int, cols: int, scale: float, shift: float) -> Pattern:
        """The surface in rows x cols cells scale u + shift, scale v + shift; blur in cells stays."""
        start = self.origin - shift / scale * self.steps.sum(axis=0)
        shape = None if self.shape is None else self.shape.mapped(scale, shift)
        return replace(self, rows=rows, cols=cols, pitch=self.pitch / scale, origin=start, shape=shape)

    def coordinates(self, points: Float) -> tuple[Float, Float]:
        """Pattern coordinates (u, v) in cells of points (..., 3) in mm, projected along the normal."""
        offset = points - self.origin
        width, height = self._sides
        return offset @ self.u_axis / width, offset @ self.v_axis / height


def prism_pattern(
    angle: float, rows: int, cols: int, pitch: float, blur_px: float = 0.0, aspect: float = 1.0
) -> Pattern:
    """The pattern on the prism face that rises at `angle` (rad) from the mirror's edge x = 0."""
    u_axis, v_axis = np.array([np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    start = 0.5 * pitch * (u_axis + aspect * v_axis)
    return Pattern(start, u_axis, v_axis, pitch, rows, cols, blur_px, aspect=aspect)
