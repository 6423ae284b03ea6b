"""Pattern surfaces that are not flat: how far a cell's centre lies off the plane of `Pattern`.

Both shapes map pattern coordinates u, v (cells) to an offset (..., 3) in mm along the pattern's u axis, its v
axis and its normal. They live in cells, so that `mapped` follows a pattern that is cropped or resampled.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from optolever import InputError

from .record import Float, Record, finite, freeze, positive, vector

__all__ = ["Bow", "PatternShape", "PointTable"]

_LEAST = 3  # places that make a triangle


@dataclass(frozen=True, eq=False)
class Bow(Record):
    """A quadratic bow of a display: w = b20 U^2 + b11 U V + b02 V^2 (mm, along the normal).

    U = (u - centre[0]) / half[0], V likewise (cells): with the pattern's middle and half its sides, b20 is
    the sag of the left and right edges' middles (Bartsch et al., doi:10.1186/s41476-019-0116-1).
    """

    b20: float
    b11: float
    b02: float
    centre: Float
    half: Float

    def __post_init__(self) -> None:
        for name in ("b20", "b11", "b02"):
            freeze(self, **{name: finite(f"pattern.bow.{name}", getattr(self, name))})
        freeze(self, centre=vector("pattern.bow.centre", self.centre, 2))
        half = vector("pattern.bow.half", self.half, 2)
        for part in half:
            positive("pattern.bow.half", float(part))
        freeze(self, half=half)

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

    def table(self) -> dict[str, Any]:
        """As plain TOML types."""
        names = {name: getattr(self, name) for name in ("b20", "b11", "b02")}
        return names | {"centre_px": self.centre.tolist(), "half_px": self.half.tolist()}


@dataclass(frozen=True, eq=False)
class PointTable(Record):
    """A measured surface: places (n, 2) in cells (u, v) and their offsets (n, 3) in mm.

    Linear between them, on the Delaunay triangulation of the places (as OpenCSP's screens); NaN outside.
    """

    places: Float
    offsets: Float
    _linear: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import LinearNDInterpolator
        from scipy.spatial import QhullError

        places, offsets = (np.array(part, dtype=np.float64) for part in (self.places, self.offsets))
        if places.ndim != 2 or places.shape[1] != 2 or len(places) < _LEAST:
            raise InputError(
                f"pattern.table: places have shape {places.shape}, must be (n, 2), n >= {_LEAST}"
            )
        if offsets.shape != (len(places), 3):
            raise InputError(
                f"pattern.table: points have shape {offsets.shape}, must be ({len(places)}, 3) as the places"
            )
        if not (np.isfinite(places).all() and np.isfinite(offsets).all()):
            raise InputError("pattern.table: has places or points that are not finite")
        places.flags.writeable = offsets.flags.writeable = False
        try:
            linear = LinearNDInterpolator(places, offsets)
        except QhullError as error:
            raise InputError("pattern.table: places lie on one line, must span an area") from error
        freeze(self, places=places, offsets=offsets, _linear=linear)

    def _key(self) -> tuple[Any, ...]:
        return tuple(self.places.ravel().tolist()), tuple(self.offsets.ravel().tolist())

    def offset(self, u: Float, v: Float) -> Float:
        """Offsets (..., 3) mm; NaN outside the measured places."""
        offset: Float = self._linear(np.stack([u, v], axis=-1))
        return offset

    def mapped(self, scale: float, shift: float) -> Self:
        """The same surface in cells u' = scale u + shift, v' = scale v + shift."""
        return replace(self, places=scale * self.places + shift)

    def table(self) -> dict[str, Any]:
        """As plain TOML types."""
        return {"places_px": self.places.tolist(), "offsets_mm": self.offsets.tolist()}


#: Types of a pattern's `shape`, if it is not flat.
PatternShape = Bow | PointTable
