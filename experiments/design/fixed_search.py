"""The fixed sequence of fewest frames that meets a goal on several dents at once.

Number of frames by number of frames, all that could be shown: fringes of two or three periods with steps of
their own for every period and axis, and the codes of `candidates`. Each axis is decoded once by itself; the
fringes that do best on the dent where most falls out are paired, and predicted on all.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from optolever.patterns import Frame, Sequence

from .candidates import LEAST_STEPS, PERIODS, SPAN, Candidate, candidates, pairs
from .outlook import Outlook

__all__ = ["Offer", "fringe_codes", "offers"]

#: Codes of an axis and a number of frames that are paired with those of the other axis.
BEST = 6
#: Steps of all periods but the last, besides an even share; the last has the rest.
FEW = (3, 4, 6)
#: Least share of the frames that an axis has.
LEAST_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class AxisCode:
    """Frames of one axis, and how they are called."""

    text: str
    frames: tuple[Frame, ...]


@dataclass(frozen=True)
class Offer:
    """What a number of frames has to offer: candidates with their least predicted share, best first, none
    under what was asked for; looked_at: sequences among which they were found."""

    frames: int
    best: list[tuple[float, Candidate]]
    looked_at: int


def offers(outlooks: list[Outlook], need: float, most: int) -> Iterator[Offer]:
    """From the fewest frames to `most`: what is predicted to bring a share of at least `need` everywhere."""
    pattern = outlooks[0].view.scene.pattern
    order = list(outlooks)  # the hardest first
    for count in range(2 * LEAST_STEPS, most + 1):
        named = [c for c in candidates(pattern.rows, pattern.cols, count) if len(c.sequence) == count]
        offered = [*named, *_paired(order[0], count, need)]
        predicted = [(_worst(order, candidate.sequence, need), candidate) for candidate in offered]
        best = sorted((one for one in predicted if one[0] >= need), key=lambda one: -one[0])
        yield Offer(count, best, len(offered))


def _worst(outlooks: list[Outlook], sequence: Sequence, need: float) -> float:
    """Least predicted share; where it is under `need`, of those up to there, which then comes first."""
    least = 1.0
    for outlook in tuple(outlooks):
        least = min(least, outlook.share(sequence))
        if least < need:
            outlooks.remove(outlook)
            outlooks.insert(0, outlook)
            break
    return least


def _paired(outlook: Outlook, count: int, need: float) -> Iterator[Candidate]:
    """Fringe codes of `count` frames: every split between the axes, the best of each axis with each other."""
    pattern = outlook.view.scene.pattern
    least = max(2 * LEAST_STEPS, math.ceil(LEAST_SHARE * count))
    for along_u in range(least, count - least + 1):
        best = _best(outlook, "u", along_u, need), _best(outlook, "v", count - along_u, need)
        for u, v in product(*best):
            text = f"u {u.text}; v {v.text}"
            yield Candidate(text, Sequence((*u.frames, *v.frames), pattern.rows, pattern.cols, text))


def _best(outlook: Outlook, axis: str, count: int, need: float) -> list[AxisCode]:
    """Fringe codes of an axis that enough pixels pass, those of the least errors."""
    pattern = outlook.view.scene.pattern
    found = []
    for code in fringe_codes(axis, outlook.view.extent(axis), count):
        one = outlook.axis(axis, Sequence(code.frames, pattern.rows, pattern.cols))
        if one.share >= need:
            found.append((one.error, code))
    return [code for _, code in sorted(found, key=lambda one: one[0])[:BEST]]


def fringe_codes(axis: str, extent: int, count: int) -> list[AxisCode]:
    """Fringes on an axis in `count` frames: one that spans the surface with one or two finer ones, or two or
    three that are unambiguous together (see `candidates`); every split of the frames."""
    return [
        AxisCode(
            ", ".join(f"{steps} of {period:.4g} px" for period, steps in zip(periods, split, strict=True)),
            tuple(
                Frame("phase", axis, period_px=period, shift=2 * math.pi * k / steps)
                for period, steps in zip(periods, split, strict=True)
                for k in range(steps)
            ),
        )
        for periods in _periods(extent)
        for split in _splits(count, len(periods))
    ]


def _periods(extent: int) -> Iterator[tuple[float, ...]]:
    coarse = SPAN * extent
    for fine in PERIODS:
        if 2 * fine < extent:
            yield coarse, fine
            yield coarse, math.sqrt(coarse * fine), fine
        most = 1.02 * extent / fine
        if most >= 12:
            numbers = most - math.sqrt(most), most - 1, most
            yield tuple(1.02 * extent / number for number in numbers)
    yield from pairs(extent)


def _splits(count: int, parts: int) -> Iterator[tuple[int, ...]]:
    even = count // parts
    for first in product(sorted({*FEW, even} - {0, 1, 2}), repeat=parts - 1):
        last = count - sum(first)
        if last >= LEAST_STEPS:
            yield (*first, last)
