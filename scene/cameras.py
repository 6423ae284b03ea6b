"""Cameras: parallel rays from a grid of pixels, or a pinhole with OpenCV's five lens coefficients; a flat
refracting face between them and the medium in front of the mirror."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

import numpy as np

from optolever import InputError

from .fields import Float, Record, axis, integer, pair, positive, unit, vector  # noqa: F401  of Posed
from .pose import Posed, cross, rotate, transform

__all__ = [
    *("Camera", "Face", "PinholeCamera", "TelecentricCamera", "distort", "prism_camera", "refract"),
    "undistort",
]

_STEPS = 50
_CLOSE = 1e-15  # normalised image units: no further step
_SETTLED = 1e-12  # rounding error of the last step, where the lens nearly folds
_CHECKED = 33  # the distortion is tested for folds at this many rows and columns of the image


@dataclass(frozen=True, eq=False)
class Face(Record, section="camera.face"):
    """Plane through `point` (mm) with `normal` (3,); `index` behind it, `outside` on the camera's side."""

    point: Annotated[Float, vector, "point_mm"]
    normal: Annotated[Float, unit]
    index: Annotated[float, positive]
    outside: Annotated[float, positive] = 1.0

    def cross(self, origins: Float, directions: Float) -> tuple[Float, Float]:
        """Rays (..., 3) behind the face: they start on it, bent by Snell's law; NaN where none passes."""
        along = directions @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.point - origins) @ self.normal) / along
            distance = np.where((distance >= 0) & np.isfinite(distance), distance, np.nan)
        starts = origins + distance[..., None] * directions
        bent = refract(directions, self.normal, self.outside / self.index)
        return starts, np.where(np.isnan(distance)[..., None], np.nan, bent)


def refract(directions: Float, normal: Float, ratio: float) -> Float:
    """Snell's law in vectors: unit directions (..., 3) after a face; ratio = index before / index behind.

    d' = ratio d + (sqrt(1 - ratio^2 (1 - c^2)) - ratio c) n, c = n . d > 0; NaN beyond the critical angle.
    """
    cosine = directions @ normal
    side = np.where(cosine < 0, -1.0, 1.0)
    inside = 1 - ratio**2 * (1 - cosine**2)
    forward = np.sqrt(np.where(inside >= 0, inside, np.nan)) - ratio * np.abs(cosine)
    bent: Float = ratio * directions + (side * forward)[..., None] * normal
    return bent


class _Lens(Posed):
    """Rays of a camera's pixels, behind a refracting face if there is one."""

    rows: int
    cols: int
    face: Face | None

    def rays_at(self, row: Float | float, col: Float | float) -> tuple[Float, Float]:
        """Origins (..., 3) in mm and unit directions (..., 3) of the rays of (fractional) pixels."""
        origins, directions = self._rays(
            *np.broadcast_arrays(np.asarray(row, np.float64), np.asarray(col, np.float64))
        )
        return (origins, directions) if self.face is None else self.face.cross(origins, directions)

    def rays(self) -> tuple[Float, Float]:
        """Origins and directions (rows, cols, 3) of every pixel."""
        return self.rays_at(
            np.arange(self.rows, dtype=np.float64)[:, None], np.arange(self.cols, dtype=np.float64)
        )

    def _rays(self, row: Float, col: Float) -> tuple[Float, Float]:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class TelecentricCamera(_Lens, section="camera"):
    """Pixel (row, col) looks from origin + col pitch[0] u_axis + row pitch[1] v_axis along u_axis x v_axis.

    origin (3,) mm: centre of pixel (0, 0) in the mirror's frame; pitch (2,) mm: along columns, along rows;
    face: a refracting face that the rays cross on their way, or None.
    """

    pitch: Annotated[Float, pair, "pitch_mm"]
    rows: Annotated[int, integer, "size", 1]
    cols: Annotated[int, integer, "size", 0]
    face: Face | None = None

    def _rays(self, row: Float, col: Float) -> tuple[Float, Float]:
        local = np.stack([col * self.pitch[0], row * self.pitch[1], np.zeros_like(col)], axis=-1)
        origins = transform(self.rotation, self.origin, local)
        return origins, np.broadcast_to(cross(self.u_axis, self.v_axis), origins.shape)


@dataclass(frozen=True, eq=False)
class PinholeCamera(_Lens, section="camera"):
    """OpenCV's model: a point (x, y, 1) z in the camera's frame is imaged at (column, row) f (x'', y'') + c.

    origin (3,) mm: centre of projection in the mirror's frame; u_axis, v_axis (3,): directions of columns and
    rows, the camera looks along u_axis x v_axis; focal (2,) and centre (2,) in pixels (column, row);
    distortion (5,): k1 k2 p1 p2 k3; face: a refracting face that the rays cross, or None.
    """

    origin: Annotated[Float, vector, "position_mm"]
    focal: Annotated[Float, pair, "focal_px"]
    centre: Annotated[Float, partial(vector, size=2), "centre_px"]
    rows: Annotated[int, integer, "size", 1]
    cols: Annotated[int, integer, "size", 0]
    distortion: Annotated[Float, partial(vector, size=5)] = field(default_factory=lambda: np.zeros(5))
    face: Face | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = np.linspace(-0.5, self.rows - 0.5, _CHECKED)[:, None]
        cols = np.linspace(-0.5, self.cols - 0.5, _CHECKED)
        x, y = self._normalised(*np.broadcast_arrays(rows, cols))
        if not np.all(np.isfinite(x + y)):
            given = ", ".join(f"{one:.4g}" for one in self.distortion)
            what = "maps two points of the view to one pixel; give smaller coefficients"
            raise InputError(f"camera.distortion = [{given}]: {what}")

    def _rays(self, row: Float, col: Float) -> tuple[Float, Float]:
        x, y = self._normalised(row, col)
        local = np.stack([x, y, np.ones_like(x)], axis=-1)
        directions = rotate(self.rotation, local / np.sqrt(x * x + y * y + 1)[..., None])
        return np.broadcast_to(self.origin, directions.shape), directions

    def _normalised(self, row: Float, col: Float) -> tuple[Float, Float]:
        x = (col - self.centre[0]) / self.focal[0]
        y = (row - self.centre[1]) / self.focal[1]
        return undistort(x, y, self.distortion) if self.distortion.any() else (x, y)


#: Types of a scene's `camera`.
Camera = TelecentricCamera | PinholeCamera


def prism_camera(
    length: float, angle: float, rows: int, cols: int, pitch: Float, face: Face | None = None
) -> TelecentricCamera:
    """The camera on the prism face that rises at `angle` (rad) from x = length, looking along its normal.

    Column 0 is next to that edge, row 0 next to y = 0; pixel edges, not centres, lie on them.
    """
    u_axis, v_axis = np.array([-np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    origin = np.array([length, 0.0, 0.0]) + 0.5 * (pitch[0] * u_axis + pitch[1] * v_axis)
    return TelecentricCamera(origin, u_axis, v_axis, pitch, rows, cols, face)


def distort(x: Float, y: Float, k: Float) -> tuple[Float, Float]:
    """Normalised coordinates after the lens (OpenCV `calib3d`): radial k1 k2 k3, tangential p1 p2."""
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
        y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
    )


def undistort(x_seen: Float, y_seen: Float, k: Float) -> tuple[Float, Float]:
    """Inverse of `distort` by Newton's method to 1e-15; NaN where it folds or does not converge."""
    x, y = x_seen, y_seen
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            x_now, y_now = distort(x, y, k)
            a, b, d = _distortion_jacobian(x, y, k)
            determinant = a * d - b * b
            ex, ey = x_now - x_seen, y_now - y_seen
            dx, dy = (d * ex - b * ey) / determinant, (a * ey - b * ex) / determinant
            x, y = x - dx, y - dy
            if not np.any(np.abs(dx) + np.abs(dy) > _CLOSE * (1 + np.abs(x) + np.abs(y))):
                break
        settled = np.abs(dx) + np.abs(dy) <= _SETTLED * (1 + np.abs(x) + np.abs(y))
        valid = settled & (determinant > 0) & (a > 0)
    return np.where(valid, x, np.nan), np.where(valid, y, np.nan)


def _distortion_jacobian(x: Float, y: Float, k: Float) -> tuple[Float, Float, Float]:
    """d x''/dx, d x''/dy = d y''/dx, d y''/dy."""
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2 * (k[0] + r2 * (2 * k[1] + 3 * r2 * k[4]))  # d radial / d r2, times 2
    return (
        radial + slope * x * x + 2 * k[2] * y + 6 * k[3] * x,
        slope * x * y + 2 * k[2] * x + 2 * k[3] * y,
        radial + slope * y * y + 6 * k[2] * y + 2 * k[3] * x,
    )
