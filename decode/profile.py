"""RigProfile: common properties of the captures of one rig, estimated once, applied to further ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from .response import Response

__all__ = ["Effect", "RigProfile", "Settings"]


@dataclass(frozen=True, slots=True)
class Settings:
    """Parameters of `decode` that the caller knows or chooses."""

    noise: float | None = None
    gain: float = 0.0
    white_level: float | None = None
    response: Response | None = None
    blur_px: float | None = None
    lens_px: float | None = None
    on_cells: bool = True


class Effect(NamedTuple):
    """A row of a profile's table: value and standard deviation (NaN: not estimated) in a unit."""

    name: str
    value: float
    sigma: float
    unit: str


class RigProfile:
    """Skeleton."""
