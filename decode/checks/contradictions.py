"""Contradictions between reliable codes of a pixel, and places that jump to and fro between neighbours.

If the description of a capture is wrong, its codes agree in some pixels by chance, and no test finds these
pixels. So other descriptions are tried; one that removes nearly all contradictions is named.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Code, Fringe, Plan
from .sample_fit import AxisTable, ambiguous, axis_tables, bit_levels, places, turns

__all__ = ["Contradictions", "Described", "contradictions", "mistuned", "other_descriptions"]

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]
#: Fewest pixels for a share.
_FEWEST = 32
#: Contrast of a reliable bit, share of the pixel's.
_SURE = 0.5
#: Second difference that a smooth map excludes: slope over the sum of both differences, and intercept (cells;
#: with fringes: periods); share of crosses that exceed it for random cells, or for sawteeth of half a period.
_FOLDS, _TEETH = (0.5, 3.0, 0.84), (0.25, 0.15, 0.75)
#: Least mean phasor of an agreeing fringe over a code's cells; relative phasor of agreement; drift beyond lag
#: or stray light, turns; likelihood ratio of a significant drift.
_TELLS, _AGREES, _DRIFT, _SURELY = 0.3, 0.9, 0.12, 30.0
#: Largest phase error of a coarser fringe by lag, gamma or stray light, turns.
_BIAS = 0.25
#: Least number of periods on the surface for the drift of a fringe: over fewer, cells do not determine it.
_PERIODS = 8
#: Range of trial periods, share of the described one; largest drift, turns; share of contradictions.
_STRETCH, _MOST_TURNS, _HALF = 0.1, 20.0, 0.5


@dataclass(frozen=True, slots=True)
class Contradictions:
    """Shares of the pixels, 0 to 1, of the axis with most; 1: as for random places.

    in_pixel: codes of the pixel contradict each other; folded: places around it jump to and fro, as by wrong
    bits, or by steep waves of a scene.
    """

    in_pixel: float
    folded: float

    @property
    def worst(self) -> float:
        """The larger share."""
        return max(self.in_pixel, self.folded)


def contradictions(plan: Plan, levels: F32, contrast: F32, order: Ints) -> Contradictions:
    """Contradictions in pixels and between neighbours.

    levels (N, 5, T): of pixels and their four neighbours; contrast (T,): half of the span of a pixel's
    levels; order (N,): image of each frame, -1: unknown; axes that need an unknown one are skipped.
    """
    in_pixel, folded = [0.0], [0.0]
    for table in axis_tables(plan):
        source = order[table.frames]
        unknown = np.flatnonzero(source < 0)
        free = int(table.frames[unknown[0]]) if len(unknown) else -1
        if len(unknown) > 1 or ambiguous(table, free):
            continue
        own = levels[np.maximum(source, 0)] / table.exposure[:, None, None]
        if table.axis.code is not None:
            folded.append(_folded(table, own, free))
        in_pixel += [drift.contradicting for drift in _drifts(table, own[:, 0], contrast, free)]
    return Contradictions(min(max(in_pixel), 1.0), min(max(folded), 1.0))


def mistuned(plan: Plan, levels: F32, contrast: F32) -> str:
    """A sentence on fringes with another period or shift than described; empty: none."""
    for table in axis_tables(plan):
        for drift in _drifts(table, levels[table.frames, 0] / table.exposure[:, None], contrast):
            if drift.contradicting > _HALF or drift.sure:
                return drift.sentence(table.axis.axis)
    return ""


def _folded(table: AxisTable, levels: F32, free: int) -> float:
    """Share of pixels around which places of bits, or of bits and fringes, jump to and fro."""
    code = table.axis.code
    assert code is not None
    flat = levels.reshape(len(levels), -1)
    word = (1 << np.arange(len(code.plain))) @ (bit_levels(table, flat, free)[0] > 0)
    place = code.cells[word].astype(np.float64)
    rough, slack, chance = _FOLDS
    if table.axis.fringes:
        place = places(table, flat, free)[0] / table.axis.fringes[-1].period
        rough, slack, chance = _TEETH
    place = place.reshape(5, -1)
    first, second = place[0] - place[[1, 3]], place[[2, 4]] - place[0]
    folded = np.abs(second - first) > rough * (np.abs(first) + np.abs(second)) + slack
    return float(folded.any(axis=0).mean()) / chance


@dataclass(frozen=True, slots=True)
class _Drift:
    """Phase of a fringe relative to places by coarser fringes or bits: `turn` turns in the middle of the
    surface, `slope` turns from end to end.

    as_described, at_best: mean phasor of the difference, before and after subtraction of both, relative to a
    fringe that agrees; count: pixels; bias: largest turns by lag, gamma or stray light.
    """

    period: float
    extent: float
    turn: float
    slope: float
    as_described: float
    at_best: float
    count: int
    bias: float

    @property
    def contradicting(self) -> float:
        """Share of contradicting pixels."""
        return 1 - min(max(self.as_described, 0.0), 1.0)

    @property
    def sure(self) -> bool:
        """Whether another period agrees significantly better, and the drift exceeds lag or stray light."""
        better = self.count * (self.at_best**2 - max(self.as_described, 0.0) ** 2)
        drifts = self.at_best > _AGREES and abs(self.slope) > self.bias and better > _SURELY
        return drifts and self.extent > _PERIODS * self.period

    def sentence(self, axis: str) -> str:
        """Actual period or shift, if the fringe agrees with it; else empty."""
        if self.at_best < _AGREES:
            return ""
        if abs(self.slope) > self.bias:
            shown = 1 / (1 / self.period + self.slope / self.extent)
            return f"fringes of a period of {self.period:.5g} on {axis} are shown with about {shown:.4g}"
        return f"fringes of a period of {self.period:.5g} on {axis} are shown {self.turn:+.2f} periods off"


def _drifts(table: AxisTable, levels: F32, contrast: F32, free: int = -1) -> Iterator[_Drift]:
    """Drift of each fringe relative to coarser ones, or to reliable bits."""
    axis, code = table.axis, table.axis.code
    fringes, slack, coarser = list(axis.fringes), 0.0, 0.0
    if not fringes:
        return
    if code is not None:
        found, whole = bit_levels(table, levels, free)
        sure = (np.abs(found) > _SURE * whole[:, None] * contrast).all(axis=0)
        word = (1 << np.arange(len(code.plain))) @ (found > 0)
        place, slack = code.centre(code.cells[word]), code.cell / 2
    else:
        first = fringes.pop(0)
        if first.period < axis.extent:
            return
        place = np.mod(turns(table, first, levels, free) + 0.5 / first.period, 1.0) * first.period - 0.5
        sure, coarser = np.ones(place.shape, np.bool_), first.period
    if np.count_nonzero(sure) < _FEWEST:
        return
    for fringe in fringes:
        off = turns(table, fringe, levels, free) - place / fringe.period
        agreeing = float(np.sinc(2 * slack / fringe.period))
        if np.isfinite(off).all() and agreeing > _TELLS:
            bias = max(_DRIFT, _BIAS * coarser / fringe.period)
            yield _drift(fringe.period, place[sure], off[sure], agreeing, bias)
        coarser, place, slack = fringe.period, place + (off - np.rint(off)) * fringe.period, 0.0


def _drift(
    period: float, place: NDArray[np.float64], off: NDArray[np.float64], agreeing: float, bias: float
) -> _Drift:
    low, extent = float(place.min()), float(np.ptp(place)) + 1.0
    at = (place - low) / extent - 0.5
    most = min(_STRETCH * extent / period, _MOST_TURNS)
    slopes = np.linspace(-most, most, 2 * int(np.ceil(8 * most)) + 1)
    mean = np.exp(2j * np.pi * (off - slopes[:, None] * at)).mean(axis=1) / agreeing
    best = int(np.abs(mean).argmax())
    own = float(mean.real[len(slopes) // 2])
    turn = float(np.angle(mean[best])) / (2 * np.pi)
    return _Drift(period, extent, turn, float(slopes[best]), own, float(np.abs(mean[best])), len(place), bias)


@dataclass(frozen=True, slots=True)
class Described:
    """Another description of the frames, and the order of their images."""

    sentence: str
    plan: Plan
    order: Ints


def other_descriptions(plan: Plan, count: int) -> Iterator[Described]:
    """Descriptions that are often mistaken for the right one, and still encode places."""
    same = np.arange(count)
    yield Described("the frames are there in reverse order", plan, same[::-1].copy())
    other = tuple(replace(axis, fringes=tuple(map(_turned_back, axis.fringes))) for axis in plan.axes)
    yield Described("fringes are shown with shifts of the other sign", replace(plan, axes=other), same)
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


def _turned_back(fringe: Fringe) -> Fringe:
    return replace(fringe, shifts=-fringe.shifts)


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
    """Exchange the fringes of each period that both axes share."""
    one, two = plan.axes
    for k, fringe in enumerate(one.fringes):
        if k < len(two.fringes) and two.fringes[k].period == fringe.period:
            first, second = list(one.fringes), list(two.fringes)
            first[k], second[k] = second[k], first[k]
            axes = replace(one, fringes=tuple(first)), replace(two, fringes=tuple(second))
            yield replace(plan, axes=axes)
