"""The pattern surface: a grid of cells in any pose, flat or of a `shape`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from .pattern_shape import PatternShape
from .pose import Posed, cross
from .record import Float, axis, freeze, integer, non_negative, positive, vector  # noqa: F401  of Posed

__all__ = ["Pattern", "prism_pattern"]

_STEPS = 60
_SETTLED = 1e-12  # cells, of the last step


@dataclass(frozen=True, eq=False)
class Pattern(Posed, section="pattern"):
    """Cell (u, v) (column, row) has its centre at origin + u pitch u_axis + v pitch aspect v_axis.

    pitch mm; blur_px: rms radius, in cells, of the Gaussian through which the camera reads the pattern (0:
    none); shape: deviation from that plane, or None; aspect: height of a cell over its width.
    """

    pitch: Annotated[float, positive, "pitch_mm"]
    rows: Annotated[int, integer, "size", 1]
    cols: Annotated[int, integer, "size", 0]
    blur_px: Annotated[float, non_negative] = 0.0
    shape: PatternShape | None = None
    aspect: float = 1.0

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
        offset, normal = points - self.origin[:, None], self.normal
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            slant, height = normal @ directions, normal @ offset
            way = -height / slant
            u, v = self._along(offset + way * directions)
            width, tall = self._sides
            if self.shape is None:
                return u, v, way
            moved = np.full(u.shape, np.inf)
            for _ in range(_STEPS):
                off = self.shape.offset(u, v)
                way = (off[..., 2] - height) / slant
                u_next, v_next = self._along(offset + way * directions)
                u_next, v_next = u_next - off[..., 0] / width, v_next - off[..., 1] / tall
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

    def _along(self, landed: Float) -> tuple[Float, Float]:
        width, height = self._sides
        return self.u_axis @ landed / width, self.v_axis @ landed / height

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
