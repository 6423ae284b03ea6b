"""Accuracy: standard deviations of a scene's numbers that were typed from drawings and data sheets."""

import math
from dataclasses import dataclass, fields
from typing import ClassVar

from .record import Record, freeze, positive

__all__ = ["TYPED", "Accuracy"]


@dataclass(frozen=True, eq=False)
class Accuracy(Record):
    """Standard deviations of typed numbers; 0: known exactly.

    angle: of every rotation, rad; distance: of every position, mm; scale: of focal length and pitches,
    relative; index: of refraction; centre: of the lens's centre, share of the image's columns; distortion: k1
    of the lens; bow: of the display, mm at its ends; sag: of the mirror at rest, mm; glass: thickness of a
    cover glass over the display's cells, mm; centroid: of a cell's light, cells.
    """

    angle: float = math.radians(1.0)
    distance: float = 0.5
    scale: float = 0.01
    index: float = 0.01
    centre: float = 0.015
    distortion: float = 0.08
    bow: float = 0.2
    sag: float = 0.01
    glass: float = 1.0
    centroid: float = 0.05

    #: Field -> key of the TOML table [accuracy]; angle_deg is in degrees there.
    KEYS: ClassVar[dict[str, str]] = {
        "angle": "angle_deg",
        "distance": "distance_mm",
        "bow": "bow_mm",
        "sag": "sag_mm",
        "glass": "glass_mm",
        "centroid": "centroid_px",
    }

    def __post_init__(self) -> None:
        for field in fields(self):
            checked = positive(f"accuracy.{self.key(field.name)}", getattr(self, field.name), zero=True)
            freeze(self, **{field.name: checked})

    @classmethod
    def key(cls, name: str) -> str:
        """Key of a field in the TOML table [accuracy]."""
        return cls.KEYS.get(name, name)

    def table(self) -> dict[str, float]:
        """As the TOML table [accuracy]; angles in degrees."""
        values = {self.key(field.name): getattr(self, field.name) for field in fields(self)}
        return values | {"angle_deg": math.degrees(self.angle)}


#: Of a rig that was set up by hand.
TYPED = Accuracy()
