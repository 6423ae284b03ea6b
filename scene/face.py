"""A flat refracting face between a camera and the medium in front of the mirror."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from .record import Float, Record, positive, unit, vector

__all__ = ["Face", "refract"]


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
