"""Pattern surfaces that are not flat: how far a cell's centre lies off the plane of `Pattern`.

Both shapes map pattern coordinates u, v (cells) to an offset (..., 3) in mm along the pattern's u axis, its v
axis and its normal. They live in cells, so that `mapped` follows a pattern that is cropped or resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Self

import numpy as np

from optolever import InputError

from .record import Float, Record, freeze, number, pair, vector

__all__ = ["Bow", "PatternShape", "PointTable"]

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
