"""Codes of a pixel that are each sure and say different places: by chance they agree in some of the pixels of a
capture that is not what is described, and nothing tells in which. Other descriptions are tried, and named where
they leave hardly any contradiction."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Code, Fringe, Plan
from .sample_fit import AxisTable, axis_tables, bit_levels, turns

__all__ = ["Described", "contradicting", "other_descriptions"]

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]
#: Pixels that tell a share.
_FEWEST = 32
#: Contrast of a sure bit, share of the pixel's; slack of a phase, turns; of one beside another phase, turns.
_SURE, _SLACK, _APART = 0.5, 0.1, 0.3
#: Bend of places over their mean difference, and in cells besides, that a smooth map does not have; share of
#: the crosses of random places that have it (drawn).
_FOLDED, _CELLS, _BY_CHANCE = 0.5, 1.5, 0.6
_QUARTER = np.pi / 2


def contradicting(plan: Plan, levels: F32, contrast: F32, order: Ints) -> float:
    """Share of the pixels, 0 to 1, whose codes contradict each other, of the axis that has most: as many times
    as random places would.

    levels (N, 5, T): of pixels and their four neighbours; contrast (T,): half of what a pixel's levels span;
    order (N,): image that shows each frame, -1: none is known, and what needs it is not asked.
    """
    shares = [0.0]
    for table in axis_tables(plan):
        source = order[table.frames]
        if source.min() < 0:
            continue
        own = levels[source] / table.exposure[:, None, None]
        if table.axis.code is not None:
            shares.append(_folded(table, own))
        if table.axis.fringes:
            shares += _of_phases(table, own[:, 0], contrast)
    return min(max(shares), 1.0)


def _folded(table: AxisTable, levels: F32) -> float:
    """By bits whose places jump to and fro."""
    code = table.axis.code
    assert code is not None
    word = (1 << np.arange(len(code.plain))) @ (bit_levels(table, levels.reshape(len(levels), -1))[0] > 0)
    place = code.cells[word].reshape(5, -1).astype(np.float64)
    first, second = place[0] - place[[1, 3]], place[[2, 4]] - place[0]
    slack = _FOLDED * (np.abs(first) + np.abs(second)) + 2 * _CELLS
    folded = np.abs(second - first) > slack
    return float(folded.any(axis=0).mean()) / (1 - (1 - _BY_CHANCE) ** 2)


def _of_phases(table: AxisTable, levels: F32, contrast: F32) -> Iterator[float]:
    """By each fringe beside what coarser ones, or sure bits, tell."""
    axis, code = table.axis, table.axis.code
    fringes = list(axis.fringes)
    if code is not None:
        found, whole = bit_levels(table, levels)
        sure = (np.abs(found) > _SURE * whole[:, None] * contrast).all(axis=0)
        word = (1 << np.arange(len(code.plain))) @ (found > 0)
        place, slack = code.centre(code.cells[word]), code.cell / 2
    else:
        first = fringes.pop(0)
        if first.period < axis.extent:
            return
        place = np.mod(turns(table, first, levels) + 0.5 / first.period, 1.0) * first.period - 0.5
        sure, slack = np.ones(place.shape, np.bool_), 0.0
    if np.count_nonzero(sure) < _FEWEST:
        return
    for fringe in fringes:
        most = slack / fringe.period + _SLACK if slack else _APART
        off = turns(table, fringe, levels) - place / fringe.period
        off -= np.rint(off)
        if most < 0.45:
            yield float(np.mean(np.abs(off[sure]) > most)) / (1 - 2 * most)
        place, slack = place + off * fringe.period, 0.0


@dataclass(frozen=True, slots=True)
class Described:
    """Another description of the frames, and the order of their images."""

    sentence: str
    plan: Plan
    order: Ints


def other_descriptions(plan: Plan, count: int) -> Iterator[Described]:
    """What is mistaken for what is described, and still tells places."""
    same = np.arange(count)
    yield Described("the frames are there in reverse order", plan, same[::-1].copy())
    fringes: dict[str, Any] = {
        "fringes are shown a quarter of a period off: a sine for a cosine": lambda f: _turned(f, _QUARTER),
        "fringes are shown a quarter of a period off: a cosine for a sine": lambda f: _turned(f, -_QUARTER),
        "fringes are shown half a period off: inverted": lambda f: _turned(f, 2 * _QUARTER),
        "fringes are shown with shifts of the other sign": lambda f: replace(f, shifts=-f.shifts),
    }
    for sentence, change in fringes.items():
        axes = tuple(replace(axis, fringes=tuple(map(change, axis.fringes))) for axis in plan.axes)
        yield Described(sentence, replace(plan, axes=axes), same)
    codes: dict[str, Any] = {
        "bits are shown in reverse order": _reversed,
        "binary bits are shown for Gray ones, or Gray for binary": _other_kind,
        "bits are shown inverted": lambda code, axis: replace(code, cells=code.cells[::-1]),
        "the code is shown mirrored": _mirrored,
    }
    for sentence, change in codes.items():
        axes = tuple(
            axis if axis.code is None else replace(axis, code=change(axis.code, axis)) for axis in plan.axes
        )
        yield Described(sentence, replace(plan, axes=axes), same)
    if len(plan.axes) == 2:
        yield from (
            Described("fringes are shown on each other's axes", one, same) for one in _exchanged(plan)
        )


def _turned(fringe: Fringe, by: float) -> Fringe:
    return replace(fringe, shifts=fringe.shifts + by)


def _reversed(code: Code, axis: AxisPlan) -> Code:
    return replace(code, plain=code.plain[::-1], inverse=code.inverse[::-1])


def _other_kind(code: Code, axis: AxisPlan) -> Code:
    word = np.arange(len(code.cells))
    if code.kind == "gray":
        return replace(code, cells=word.astype(np.int32))
    cells = np.empty(len(word), np.int32)
    cells[word ^ (word >> 1)] = word
    return replace(code, cells=cells)


def _mirrored(code: Code, axis: AxisPlan) -> Code:
    last = int(np.ceil(axis.extent / code.cell)) - 1
    return replace(code, cells=(last - code.cells).astype(np.int32))


def _exchanged(plan: Plan) -> Iterator[Plan]:
    """Fringes of each period that both axes have."""
    one, two = plan.axes
    for k, fringe in enumerate(one.fringes):
        if k < len(two.fringes) and two.fringes[k].period == fringe.period:
            first, second = list(one.fringes), list(two.fringes)
            first[k], second[k] = second[k], first[k]
            axes = replace(one, fringes=tuple(first)), replace(two, fringes=tuple(second))
            yield replace(plan, axes=axes)
