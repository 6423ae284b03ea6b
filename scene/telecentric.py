"""The telecentric camera: parallel rays from a grid of rectangular pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .face import Face
from .pose import cross, rotation_from_axes, transform
from .record import Float, Record, freeze, integer, orthonormal, positive, vector

__all__ = ["TelecentricCamera", "prism_camera"]


@dataclass(frozen=True, eq=False)
class TelecentricCamera(Record):
    """Pixel (row, col) looks from origin + col pitch[0] u_axis + row pitch[1] v_axis along u_axis x v_axis.

    origin (3,) mm: centre of pixel (0, 0) in the mirror's frame; pitch (2,) mm: along columns, along rows;
    face: a refracting face that the rays cross on their way, or None.
    """

    origin: Float
    u_axis: Float
    v_axis: Float
    pitch: Float
    rows: int
    cols: int
    face: Face | None = None

    def __post_init__(self) -> None:
        u_axis, v_axis = orthonormal("camera", self.u_axis, self.v_axis)
        pitch = vector("camera.pitch", self.pitch, 2)
        for component in pitch:
            positive("camera.pitch", component)
        freeze(self, origin=vector("camera.origin", self.origin), u_axis=u_axis, v_axis=v_axis, pitch=pitch)
        freeze(self, rows=integer("camera.rows", self.rows), cols=integer("camera.cols", self.cols))

    @property
    def rotation(self) -> Float:
        """R_MC (3, 3): camera coordinates to the mirror's."""
        return rotation_from_axes(self.u_axis, self.v_axis)

    def rays_at(self, row: Float | float, col: Float | float) -> tuple[Float, Float]:
        """Origins (..., 3) in mm and unit directions (..., 3) of the rays of (fractional) pixels."""
        row, col = np.broadcast_arrays(np.asarray(row, np.float64), np.asarray(col, np.float64))
        local = np.stack([col * self.pitch[0], row * self.pitch[1], np.zeros_like(col)], axis=-1)
        origins = transform(self.rotation, self.origin, local)
        directions = np.broadcast_to(cross(self.u_axis, self.v_axis), origins.shape)
        return (origins, directions) if self.face is None else self.face.cross(origins, directions)

    def rays(self) -> tuple[Float, Float]:
        """Origins and directions (rows, cols, 3) of every pixel."""
        return self.rays_at(
            np.arange(self.rows, dtype=np.float64)[:, None], np.arange(self.cols, dtype=np.float64)
        )


def prism_camera(
    length: float, angle: float, rows: int, cols: int, pitch: Float, face: Face | None = None
) -> TelecentricCamera:
    """The camera on the prism face that rises at `angle` (rad) from x = length, looking along its normal.

    Column 0 is next to that edge, row 0 next to y = 0; pixel edges, not centres, lie on them.
    """
    u_axis, v_axis = np.array([-np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    origin = np.array([length, 0.0, 0.0]) + 0.5 * (pitch[0] * u_axis + pitch[1] * v_axis)
    return TelecentricCamera(origin, u_axis, v_axis, pitch, rows, cols, face)
