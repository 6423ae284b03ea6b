"""The transparent medium in front of the mirror, and the reflectance of its boundary (Fresnel)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from .record import Float, Record, positive

__all__ = ["Medium"]

_index = partial(positive, below=10)


@dataclass(frozen=True, eq=False)
class Medium(Record, section="medium"):
    """Index of refraction inside, and `outside` behind the boundary; the boundary is the mirror."""

    index: Annotated[float, _index]
    outside: Annotated[float, _index] = 1.0

    @property
    def critical_angle(self) -> float:
        """Angle of incidence (rad) beyond which everything is reflected; pi/2 if there is none."""
        return math.asin(min(1.0, self.outside / self.index))

    def reflectance(self, cos_incidence: Float) -> Float:
        """Share of unpolarised light reflected at a cosine of incidence (any shape); 1: total reflection.

        Fresnel: R_s = ((n c - n' c')/(n c + n' c'))^2, R_p = ((n' c - n c')/(n' c + n c'))^2, c' by Snell's
        law (Born & Wolf, Principles of Optics, 1.5.2).
        """
        ratio = self.index / self.outside
        c = np.asarray(cos_incidence, np.float64)
        transmitted = 1 - ratio**2 * (1 - c * c)
        c_out = np.sqrt(np.maximum(transmitted, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            s = (ratio * c - c_out) / (ratio * c + c_out)
            p = (c - ratio * c_out) / (c + ratio * c_out)
        reflected: Float = np.where(
            transmitted > 0, 0.5 * (s * s + p * p), np.where(np.isnan(c), np.nan, 1.0)
        )
        return reflected
