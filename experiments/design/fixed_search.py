"""The fixed sequence of fewest frames that meets a goal on several dents at once.

Number of frames by number of frames, all that could be shown: fringes of two or three periods with steps of
their own for every period and axis, and the codes of `candidates`. Each axis is decoded once by itself;
of two axes together the share within the goal is at most

    min(share that u passes, share that v passes, mean erf(goal / (sqrt 2 sigma))),

by which nearly all fall out. The rest is predicted whole, the most promising first.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence

from .candidates import LEAST_STEPS, PERIODS, SPAN, Candidate, candidates, pairs
from .outlook import Outlook

__all__ = ["Offer", "fringe_codes", "offers"]

#: Candidates of one number of frames that are predicted whole.
WHOLE = 60
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
    pattern = outlooks[0].lever.scene.pattern
    rows, cols = pattern.rows, pattern.cols
    order = list(outlooks)  # the hardest first
    for count in range(2 * LEAST_STEPS, most + 1):
        named = [c for c in candidates(rows, cols, count) if len(c.sequence) == count]
        promising, paired = _paired(order, rows, cols, count, need)
        predicted = [(_worst(order, c.sequence, need), c) for c in [*named, *promising]]
        best = sorted((one for one in predicted if one[0] >= need), key=lambda one: -one[0])
        yield Offer(count, best, len(named) + paired)


def _worst(outlooks: list[Outlook], sequence: Sequence, need: float) -> float:
    """Least predicted share; where it is under `need`, of those up to there."""
    least = 1.0
    for outlook in outlooks:
        least = min(least, outlook.share(sequence))
        if least < need:
            break
    return least


def _paired(
    outlooks: list[Outlook], rows: int, cols: int, count: int, need: float
) -> tuple[list[Candidate], int]:
    """Of all pairs of fringe codes of `count` frames the WHOLE most promising ones, by the bound on their
    share; the number of pairs."""
    found: list[tuple[float, AxisCode, AxisCode]] = []
    paired = 0
    least = max(2 * LEAST_STEPS, math.ceil(LEAST_SHARE * count))
    for along_u in range(least, count - least + 1):
        codes = fringe_codes("u", cols, along_u), fringe_codes("v", rows, count - along_u)
        paired += len(codes[0]) * len(codes[1])
        bound = _bound(outlooks, codes, rows, cols, need)
        found += [(float(bound[i, j]), codes[0][i], codes[1][j]) for i, j in np.argwhere(bound >= need)]
    found.sort(key=lambda one: -one[0])
    return [_joined(u, v, rows, cols) for _, u, v in found[:WHOLE]], paired


def _bound(
    outlooks: list[Outlook], codes: tuple[list[AxisCode], list[AxisCode]], rows: int, cols: int, need: float
) -> NDArray[np.float64]:
    """Greatest share that each code of u can have together with each of v everywhere, (U, V); where it is
    under `need`, up to there."""
    bound = np.ones((len(codes[0]), len(codes[1])))
    for outlook in tuple(outlooks):
        alive = [np.flatnonzero((bound >= need).any(axis=other)) for other in (1, 0)]
        sizes, passed = [], []
        for axis, mine, some in zip("uv", codes, alive, strict=True):
            predicted = [outlook.axis(axis, Sequence(mine[k].frames, rows, cols)) for k in some]
            sizes.append(np.array([one.size for one in predicted]))
            passed.append(np.array([one.share for one in predicted]))
        within = outlook.within_at(np.hypot(sizes[0][:, None], sizes[1]))
        both = np.minimum(np.minimum(passed[0][:, None], passed[1]), within)
        bound[np.ix_(*alive)] = np.minimum(bound[np.ix_(*alive)], both)
        if bound.max(initial=0.0) < need:  # what is hardest here will be so for the next
            outlooks.remove(outlook)
            outlooks.insert(0, outlook)
            break
    return bound


def _joined(u: AxisCode, v: AxisCode, rows: int, cols: int) -> Candidate:
    text = f"u {u.text}; v {v.text}"
    return Candidate(text, Sequence((*u.frames, *v.frames), rows, cols, text))


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
