"""Accuracy: standard deviations of a scene's numbers that were typed from drawings and data sheets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from .record import Record, non_negative

__all__ = ["TYPED", "Accuracy"]


@dataclass(frozen=True, eq=False)
class Accuracy(Record, section="accuracy"):
    """Standard deviations of typed numbers; 0: known exactly.

    angle: of every rotation, rad; distance: of every position, mm; scale: of pitches, relative; focal: of the
    focal length, relative, None: as scale; index: of refraction; centre: of the lens's centre, share of the
    image's columns; distortion: k1 of the lens; bow: of the display, mm at its ends; sag: of the mirror at
    rest, mm; glass: thickness of a cover glass over the display's cells, mm; centroid: of a cell's light,
    cells.
    """

    angle: Annotated[float, non_negative, "angle_deg"] = math.radians(1.0)
    distance: Annotated[float, non_negative, "distance_mm"] = 0.5
    scale: Annotated[float, non_negative] = 0.01
    focal: Annotated[float | None, non_negative] = None
    index: Annotated[float, non_negative] = 0.01
    centre: Annotated[float, non_negative] = 0.015
    distortion: Annotated[float, non_negative] = 0.08
    bow: Annotated[float, non_negative, "bow_mm"] = 0.2
    sag: Annotated[float, non_negative, "sag_mm"] = 0.01
    glass: Annotated[float, non_negative, "glass_mm"] = 1.0
    centroid: Annotated[float, non_negative, "centroid_px"] = 0.05
    edge: Annotated[float, non_negative, "edge_mm"] = 0.001


#: Of a rig that was set up by hand.
TYPED = Accuracy()
