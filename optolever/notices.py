"""Notices: findings for the user of a result, as data that is saved with it, printed and drawn.

Judged: the test that a notice comes from.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optolever.schema import from_json

__all__ = ["Judged", "Notice", "notices_from_array", "notices_to_array"]


@dataclass(frozen=True, slots=True)
class Notice:
    """name: what it is about, a sentence; size of it and the limit that it passes (0: it should be none; NaN:
    no size); cure: what to do."""

    name: str
    size: float
    limit: float
    cure: str

    @classmethod
    def plain(cls, name: str, cure: str) -> Self:
        """Without a size."""
        return cls(name, math.nan, math.nan, cure)

    def __str__(self) -> str:
        """One line."""
        size = "" if self.size != self.size or self.limit != self.limit else f"{self.size:.2g}"
        limit = f", at most {self.limit:.2g} is normal" if size and self.limit > 0 else ""
        beyond = f" ({size}{limit})" if size else ""
        return f"{self.name}{beyond}: {self.cure}" if self.cure else f"{self.name}{beyond}"


@dataclass(frozen=True, slots=True)
class Judged:
    """A test of a result: its figure, the limit beyond which it fails (infinite: it never does; NaN of
    either: it fails), words that hold then, and what to do."""

    test: str
    figure: float
    limit: float
    words: str
    cure: str = ""

    @property
    def fails(self) -> bool:
        """Whether the figure is beyond its limit."""
        return not self.figure <= self.limit

    @property
    def notice(self) -> Notice:
        """Its words with figure and limit."""
        return Notice(self.words, self.figure, self.limit, self.cure)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; None for a number that is none."""
        figure, limit = (number if math.isfinite(number) else None for number in (self.figure, self.limit))
        return {"test": self.test, "figure": figure, "limit": limit, "fails": self.fails}


def notices_to_array(notices: Iterable[Notice]) -> NDArray[np.str_]:
    """Lines of JSON, for an .npz."""
    return np.array([json.dumps(asdict(notice)) for notice in notices], dtype=np.str_)


def notices_from_array(lines: NDArray[Any]) -> tuple[Notice, ...]:
    """Inverse of notices_to_array. InputError if a line is no notice."""
    return tuple(from_json(Notice, line, "notices") for line in np.atleast_1d(lines).tolist())
