"""What drawn cases say together: silent errors pooled over pixels, the usual flagged share."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .hard_case import LIMIT, Result

__all__ = ["FLAGGED", "Pooled", "pooled"]

FLAGGED = 0.05
"""Median over the draws of the flagged share of the pixels that see the pattern, at most."""


@dataclass(frozen=True, slots=True)
class Pooled:
    """Draws of the decoder together.

    draws; failed: of these, by their own verdict; refused; silent_count, unflagged: pixels of all draws;
    silent: their share; median_flagged: over the draws, refused ones as 1; median_normalised: over the draws,
    rms error in units of sigma (see Result), which says whether a decoder hides behind large sigmas.
    """

    draws: int
    failed: int
    refused: int
    silent_count: int
    unflagged: int
    silent: float
    median_flagged: float
    median_normalised: float

    @property
    def fault(self) -> bool:
        """True if too many pixels are silently wrong, or too many flagged, over all draws."""
        return self.silent > LIMIT or self.median_flagged > FLAGGED

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "draws": self.draws,
            "failed": self.failed,
            "refused": self.refused,
            "silent_count": self.silent_count,
            "unflagged": self.unflagged,
            "silent": self.silent,
            "median_flagged": self.median_flagged,
            "median_normalised": self.median_normalised,
            "fault": self.fault,
        }


def pooled(results: Iterable[Result]) -> Pooled | None:
    """The drawn cases of the decoder among these; None if there are none."""
    drawn = [one for one in results if one.case.part == "decode"]
    if not drawn:
        return None
    count, total = sum(one.silent_count for one in drawn), sum(one.unflagged for one in drawn)
    normalised = [one.normalised for one in drawn if not math.isnan(one.normalised)]
    flagged = [1.0 if math.isnan(one.flagged) else one.flagged for one in drawn]
    return Pooled(
        len(drawn),
        sum(one.fault for one in drawn),
        sum(one.verdict == "refused" for one in drawn),
        count,
        total,
        count / total if total else 0.0,
        float(np.median(flagged)),
        float(np.median(normalised)) if normalised else math.nan,
    )
