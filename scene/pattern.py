"""The pattern surface: a flat grid of square cells in any pose."""

from dataclasses import dataclass

import numpy as np

from .record import Float, Record, freeze, integer, orthonormal, positive, vector

__all__ = ["Pattern", "prism_pattern"]


@dataclass(frozen=True, eq=False)
class Pattern(Record):
    """Cell (u, v) (column, row) has its centre at origin + u pitch u_axis + v pitch v_axis.

    In the mirror's frame: origin (3,) mm, u_axis and v_axis (3,) unit and perpendicular, pitch mm;
    blur_px: rms radius, in cells, of the Gaussian through which the camera reads the pattern (0: none).
    """

    origin: Float
    u_axis: Float
    v_axis: Float
    pitch: float
    rows: int
    cols: int
    blur_px: float = 0.0

    def __post_init__(self) -> None:
        u_axis, v_axis = orthonormal("pattern", self.u_axis, self.v_axis)
        freeze(self, origin=vector("pattern.origin", self.origin), u_axis=u_axis, v_axis=v_axis)
        freeze(self, pitch=positive("pattern.pitch", self.pitch))
        freeze(self, rows=integer("pattern.rows", self.rows), cols=integer("pattern.cols", self.cols))
        freeze(self, blur_px=positive("pattern.blur_px", self.blur_px, zero=True))

    @property
    def normal(self) -> Float:
        """u x v (3,), unit; away from a viewer who sees u to the right and v downwards."""
        return np.cross(self.u_axis, self.v_axis)

    def point(self, u: Float | float, v: Float | float) -> Float:
        """Points (..., 3) in mm of pattern coordinates u, v in cells."""
        du = self.pitch * np.asarray(u, np.float64)[..., None] * self.u_axis
        dv = self.pitch * np.asarray(v, np.float64)[..., None] * self.v_axis
        point: Float = self.origin + du + dv
        return point

    def coordinates(self, points: Float) -> tuple[Float, Float]:
        """Pattern coordinates (u, v) in cells of points (..., 3) in mm, projected along the normal."""
        offset = points - self.origin
        return offset @ self.u_axis / self.pitch, offset @ self.v_axis / self.pitch


def prism_pattern(angle: float, rows: int, cols: int, pitch: float, blur_px: float = 0.0) -> Pattern:
    """The pattern on the prism face that rises at `angle` (rad) from the mirror's edge x = 0."""
    u_axis, v_axis = np.array([np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    return Pattern(0.5 * pitch * (u_axis + v_axis), u_axis, v_axis, pitch, rows, cols, blur_px)
