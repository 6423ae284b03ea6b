"""Packing: which frame each channel of each exposure shows, on a display of three channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from optolever.errors import InputError
from optolever.schema import from_table

from .frame import Frame

__all__ = ["STRIPES", "Packing", "at_stripe"]

#: Centres along u of a cell's red, green and blue part, cells from the cell's centre, by their order.
STRIPES = {"rgb": (-1 / 3, 0.0, 1 / 3), "bgr": (1 / 3, 0.0, -1 / 3), "none": (0.0, 0.0, 0.0)}
STRIPES["unknown"] = STRIPES["none"]


@dataclass(frozen=True, slots=True)
class Packing:
    """exposures: numbers of the frames that red, green and blue show, (E, 3), in the order of time.

    stripes: order of the coloured parts of a cell along u, 'rgb' or 'bgr'; 'none' where all lie at its centre
    (projectors), 'unknown' where they are taken to lie there. A frame that several exposures show is the mean
    of them. leak: of frames unmixed from pictures, standard deviation of the share of another channel that
    remains; wider: factor on sigma where their noise is no longer white. Both are no part of a description.
    """

    exposures: tuple[tuple[int, int, int], ...]
    stripes: str = "none"
    leak: float = 0.0
    wider: float = 1.0

    def __post_init__(self) -> None:
        if self.stripes not in STRIPES:
            raise InputError(f"packing: stripes is {self.stripes!r}, must be one of {', '.join(STRIPES)}")
        for k, own in enumerate(self.exposures):
            if len(own) != 3:
                raise InputError(f"packing: exposure {k} is {own!r}, must be three numbers of frames")

    def require(self, count: int) -> None:
        """InputError unless the exposures show each of `count` frames."""
        used = {i for own in self.exposures for i in own}
        wrong = sorted(used ^ set(range(count)))
        if wrong:
            what = "is in no exposure" if 0 <= wrong[0] < count else f"does not exist, there are {count}"
            raise InputError(f"packing: frame {wrong[0]} {what}")

    def to_dict(self) -> dict[str, Any]:
        """Plain TOML types."""
        return {"stripes": self.stripes, "exposures": [list(own) for own in self.exposures]}

    @classmethod
    def from_dict(cls, plain: Any, where: str) -> Packing:
        """Inverse of to_dict; InputError names `where`."""
        if not isinstance(plain, Mapping) or set(plain) != {"stripes", "exposures"}:
            raise InputError(f"{where}: packing must be a table of stripes and exposures")
        return from_table(cls, plain, f"{where}: packing")


def at_stripe(frame: Frame, channel: int, stripes: str) -> Frame:
    """The frame as a channel must show it: a fringe along u is drawn for the place of that colour's stripes.

    A stripe at s cells from the centre of its cell shows the level of its cell; the fringe's level there is
    that of the coordinate u + s: the shift is less by 2 pi s / period.
    """
    if frame.kind != "phase" or frame.axis != "u" or frame.shift is None or frame.period_px is None:
        return frame
    return replace(frame, shift=frame.shift - 2 * math.pi * STRIPES[stripes][channel] / frame.period_px)
