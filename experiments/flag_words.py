"""Flags in words and colours: what a reader of the report is told about every reason."""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.reconstruct import HeightFlag

__all__ = ["FlagRow", "flag_index", "flag_rows"]

GOOD_COLOUR = "#dfe5ea"
MEANING = {
    "DARK": "too little light came back, for instance where total reflection is lost",
    "SATURATED": "the camera was at its upper limit",
    "LOW_CONTRAST": "the pattern is too weak in this pixel to be decoded",
    "ORDER_DOUBTFUL": "which fringe it is cannot be told with certainty",
    "OFF_PATTERN": "the pixel looks beside the pattern surface",
    "OUTLIER": "the coordinate does not fit its neighbours",
    "MOVED": "the mirror moved while the frames were taken",
    "INVALID": "no data came in for this pixel",
    "WRONG_FRAME": "frames were lost, shown twice, torn or in each other's place",
    "NO_ANCHOR": "an island whose absolute height nothing fixes",
    "CURL": "the slopes contradict each other around this pixel",
    "STEEP": "steeper than the optical lever can measure",
    "NOT_CONVERGED": "the solver found no answer here",
    "SINGULAR": "the pattern lies within its noise of the mirror: no slope can be told",
}
COLOURS = [to_hex(colour) for colour in colormaps["tab20"].colors]  # type: ignore[attr-defined]


@dataclass(frozen=True, slots=True)
class FlagRow:
    """One reason: how many pixels carry it (a pixel may carry several) and what it means."""

    name: str
    bit: int
    count: int
    share: float
    meaning: str
    colour: str


def flag_rows(flags: NDArray[np.integer]) -> list[FlagRow]:
    """The reasons that occur in a flag field, after a row for the pixels without any."""
    rows = [_row("good", 0, int((flags == 0).sum()), flags.size, "the number and its sigma stand", 0)]
    members: list[IntFlag] = [*Flag, *HeightFlag]
    for place, member in enumerate(members):
        bit = int(member)
        count = int(((flags & bit) != 0).sum())
        if count and bit:
            name = member.name or str(bit)
            rows.append(_row(name, bit, count, flags.size, MEANING.get(name, ""), place + 1))
    return rows


def flag_index(flags: NDArray[np.integer], rows: list[FlagRow]) -> NDArray[np.int8]:
    """Which of `rows` colours each pixel: the first of its reasons, row 0 where it has none."""
    index = np.zeros(flags.shape, dtype=np.int8)
    for place in range(len(rows) - 1, 0, -1):
        index[(flags & rows[place].bit) != 0] = place
    return index


def _row(name: str, bit: int, count: int, size: int, meaning: str, place: int) -> FlagRow:
    colour = GOOD_COLOUR if place == 0 else COLOURS[(place - 1) % len(COLOURS)]
    words = name.lower().replace("_", " ")
    return FlagRow(words, bit, count, count / max(size, 1), meaning, colour)
