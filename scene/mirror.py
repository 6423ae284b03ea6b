"""The mirror at rest: the rectangle z = 0, 0 <= x <= length, 0 <= y <= width."""

from dataclasses import dataclass

from .record import Record, freeze, positive

__all__ = ["Mirror"]


@dataclass(frozen=True, eq=False)
class Mirror(Record):
    """Extent of the mirror in mm: `length` along x (L0), `width` along y."""

    length: float
    width: float

    def __post_init__(self) -> None:
        freeze(
            self, length=positive("mirror.length", self.length), width=positive("mirror.width", self.width)
        )
