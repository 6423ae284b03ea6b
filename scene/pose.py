"""Poses: x_A = T_AB x_B takes coordinates in frame B to frame A; the mirror's frame is M, the camera's C.

A pose is an origin and two axes (u: columns, v: rows); the third axis is u x v, which for a camera is where
it looks (OpenCV's convention: x right, y down, z forward).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from optolever import InputError

from .fields import Float, Record, axis, vector

__all__ = [
    "Posed", "cross", "look_at", "rotate", "rotation_from_axes", "rotation_from_vector",
    "transform",
]  # fmt: skip

_RIGHT_ANGLE = 1e-9  # largest cosine between two axes that are called perpendicular


@dataclass(frozen=True, eq=False)
class Posed(Record):
    """In the mirror's frame: origin (3,) mm; u_axis (columns), v_axis (rows) (3,), unit, perpendicular."""

    origin: Annotated[Float, vector, "origin_mm"]
    u_axis: Annotated[Float, axis]
    v_axis: Annotated[Float, axis]

    def __post_init__(self) -> None:
        super().__post_init__()
        cosine = float(self.u_axis @ self.v_axis)
        if abs(cosine) > _RIGHT_ANGLE:
            angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
            name = f"{self.section}.v_axis = {self.v_axis.tolist()}"
            raise InputError(f"{name}: must be perpendicular to u_axis (is at {angle:.9g} deg)")

    @property
    def rotation(self) -> Float:
        """R (3, 3): coordinates along u, v, u x v to the mirror's."""
        return rotation_from_axes(self.u_axis, self.v_axis)


def transform(rotation: Float, origin: Float, points: Float) -> Float:
    """x_A = R_AB x_B + origin of B in A: points (..., 3) in frame B to frame A."""
    return rotate(rotation, points) + origin


def rotate(rotation: Float, vectors: Float) -> Float:
    """R_AB x_B of vectors (..., 3). Products, not a BLAS call: the same to the last bit for any shape."""
    x, y, z = (vectors[..., k, None] * rotation[:, k] for k in range(3))
    rotated: Float = x + y + z
    return rotated


def rotation_from_axes(u_axis: Float, v_axis: Float) -> Float:
    """R_AB (3, 3) whose columns are the axes u, v, u x v of B in A."""
    return np.stack([u_axis, v_axis, cross(u_axis, v_axis)], axis=-1)


def cross(one: Float, other: Float) -> Float:
    """one x other of two vectors (3,): `np.cross` takes far longer, and a calibration asks at every step."""
    (a, b, c), (d, e, f) = one, other
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])


def rotation_from_vector(rotation: Float) -> Float:
    """R_AB (3, 3) from a rotation vector (rad): Rodrigues' formula R = I + sin a K + (1 - cos a) K^2."""
    angle = float(np.linalg.norm(rotation))
    if angle == 0:
        return np.eye(3)
    x, y, z = rotation / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix: Float = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def look_at(name: str, position: Float, target: Float, row_axis: Float) -> tuple[Float, Float]:
    """Axes (u, v) of a camera at `position` that looks at `target`, rows running towards `row_axis`."""
    forward = target - position
    distance = np.linalg.norm(forward)
    if distance == 0:
        raise InputError(f"{name}.look_at_mm = {target.tolist()}: must differ from position_mm")
    forward = forward / distance
    rows = row_axis - (row_axis @ forward) * forward
    if np.linalg.norm(rows) <= 1e-9 * np.linalg.norm(row_axis):
        raise InputError(f"{name}.row_axis = {row_axis.tolist()}: must not be parallel to the line of sight")
    v_axis = rows / np.linalg.norm(rows)
    return np.cross(v_axis, forward), v_axis
