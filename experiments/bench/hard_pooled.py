"""Figures over all draws of a family of hard cases: shares of draws, of faults, of pixels."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from .hard_case import LIMIT, Result

__all__ = ["Pooled", "pooled"]


@dataclass(frozen=True, slots=True)
class Pooled:
    """A share over `count` draws, faults or pixels, and its limit, if any, from below (at_least) or above."""

    name: str
    value: float
    limit: float | None
    at_least: bool
    count: int

    @property
    def met(self) -> bool:
        """True within the limit, or of nothing."""
        if self.limit is None or math.isnan(self.value):
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "met": self.met}


def pooled(results: Iterable[Result]) -> list[Pooled]:
    """The figures of scenes with edges; none without any."""
    drawn = [result for result in results if result.case.part == "edges"]
    if not drawn:
        return []
    clean = [one for one in drawn if one.frames is not None and not one.frames.fault]
    spoilt = [one.frames for one in drawn if one.frames is not None and one.frames.fault]
    right = [one.frames for one in clean if one.frames is not None]
    asked = [frames for frames in spoilt if frames.counts]
    pixels = sum(one.pixels for one in clean)
    wrong = [one for one in drawn if one.frames is not None and one.frames.counts]
    left = sum((1 - one.flagged) * one.pixels for one in wrong if one.pixels)
    good = sum((1 - one.flagged) * one.pixels for one in clean if one.pixels)
    silent = sum(one.silent_count for one in clean)
    return [
        _share("right frames accused, of draws", sum(one.accused > 0 for one in right), len(right), 0.0),
        _share(
            "wrong frames named, of faults that count",
            sum(one.named for one in asked),
            len(asked),
            0.95,
            True,
        ),
        _share("good pixels away from edges", good, pixels, 0.95, True),
        _share("silent errors there, of unflagged pixels", silent, round(good), LIMIT),
        _share(
            "draws with a finding, of right ones", sum(one.findings != () for one in right), len(right), None
        ),
        _share(
            "silent errors under faults that count", sum(one.silent_count for one in wrong), round(left), None
        ),
        _share("draws refused or failed", len(drawn) - len(spoilt) - len(right), len(drawn), 0.0),
    ]


def _share(name: str, some: float, count: int, limit: float | None, at_least: bool = False) -> Pooled:
    return Pooled(name, some / count if count else math.nan, limit, at_least, count)
