"""The mirror at rest: the rectangle z = 0, 0 <= x <= length, 0 <= y <= width."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .record import Record, positive

__all__ = ["Mirror"]


@dataclass(frozen=True, eq=False)
class Mirror(Record, section="mirror"):
    """Extent of the mirror in mm: `length` along x (L0), `width` along y."""

    length: Annotated[float, positive, "size_mm", 0]
    width: Annotated[float, positive, "size_mm", 1]
