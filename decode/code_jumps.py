"""Bits of a Gray code: a wrong one shows where the decoded map jumps by what that bit is worth.

Neighbouring pixels look at neighbouring places. Where the picture of one bit is not that bit's (a frame lost,
shown twice, torn, in another's place), coordinates jump between pixels that are each at one with their other
neighbours, and the jump is gone if that one bit is flipped; the bit's own edges, where coordinates go on
while it changes, are missing. Both are counted along some rows and columns. Edges of objects jump, too, but
by what no bit is worth.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import code_words

from .code_jump_kernels import CALM, JUMP, mark_lines
from .correspondence import Flag
from .plan import AxisPlan, Code

__all__ = ["BitFault", "bit_faults"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
Event = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
#: Lines looked at along either side, pixels in all of them.
_LINES, _PIXELS = (16, 64), 32768
#: Jumps, less the bit's proper edges among them, that make a fault.
_FEWEST = 8
#: Share of the jumps and edges between the first and the last one that are proper edges, at most.
_PROPER = 0.35
#: Proper edges outside, per jump inside, that speak for rows; jumps, per proper edge, that do not against.
_OUTSIDE = 0.15
#: Pixels that tell of a whole picture; cells that a map spans, of two bits that are told from each other;
#: share of the pixels in which these differ at least; share of neighbours that are far apart in a wrong map.
_PIXELS_LEAST, _CELLS, _SAME, _ROUGH = 256, 8, 0.01, 0.1
_ENOUGH = 4096
#: Share of the pixels in which two pictures differ that are the same; changes along a line that they have, at
#: least, so that no edges of objects make them.
_TWIN, _OFTEN = 0.05, 4.0
#: Share of a fringe's period by which a jump of whole periods may be off; next to the border, what that
#: shifts is taken off where the wrong coordinate lies.
_ODD, _ODD_AT_BORDER = 0.05, 0.15
#: Usual bends that noise adds to that: three deviations.
_BENDS = 4.0
#: Of the steps between neighbours, one of so many tells what is usual.
_EVERY = 5
#: Median step between neighbours, cells, above which they are none.
_STEEP = 3.0
_BLIND = int(Flag.DARK | Flag.LOW_CONTRAST | Flag.SATURATED | Flag.INVALID)


@dataclass(frozen=True, slots=True)
class BitFault:
    """Frame of a bit whose picture, from row `start` to before row `stop`, is another one."""

    frame: int
    start: int
    stop: int


class _Lines:
    """Coordinates and flags along lines of pixels (L, N), rows (along) or columns; the usual step between
    neighbours, and its change (bend: mostly noise); how many pairs of these there are and how many are far
    apart (rough), and where between two of them coordinates jump (broken: anywhere) or go on.
    """

    def __init__(
        self, code: Code, axis: AxisPlan, lines: NDArray[np.int64], along: bool, coord: Map, flags: Map
    ) -> None:
        self.code, self.lines, self.along = code, lines, along
        shape = len(lines), coord.shape[1 if along else 0]
        self.coords, self.flags = np.empty(shape), np.empty(shape, flags.dtype)
        self.marks = np.empty((shape[0], shape[1] - 3), np.uint8)
        # a fringe moves the answer by up to half its period from the code's cell
        loose = 0.5 * code.cell + (0.5 * axis.fringes[0].period if axis.fringes else 0.5 * code.cell)
        # a code alone calls the edges of what is wrong outliers, too
        blind = _BLIND | int(Flag.OUTLIER) if axis.fringes else _BLIND
        limits = blind, float(_STEEP * code.cell), (loose, float(code.cell))
        usual, room = np.empty(2), np.empty((2, shape[0] * (shape[1] // _EVERY + 1)), np.float32)
        self.pairs, self.rough, jumps = mark_lines(
            *(coord, flags, lines, along, *limits, _EVERY),
            *(self.coords, self.flags, usual, room, self.marks),
        )
        self.broken = jumps > 0
        self.step, self.bend = usual.tolist()
        self.near = loose + 2 * self.step

    def _cells(
        self, words: NDArray[np.int64], line: NDArray[np.int64], place: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        cell = np.floor((self.coords[line, place] + 0.5 - self.code.origin) / self.code.cell)
        return np.clip(cell, 0, len(words) - 1).astype(np.int64)

    def jumps(self, axis: AxisPlan, tables: tuple[NDArray[np.int64], F64]) -> Event:
        """Jumps that a bit explains: bit, line, and the place before it on the line."""
        words, worth = tables
        line, place = np.nonzero(self.marks == JUMP)
        if axis.fringes:
            whole = self._whole_periods(axis, line, place)
            line, place = line[whole], place[whole]
        change = self.coords[line, place + 2] - self.coords[line, place + 1]
        mended = np.zeros((len(worth), len(line)), bool)
        ends = self._cells(words, line, place + 2), self._cells(words, line, place + 1)
        # where a bit is wrong, the fringe may lead to the cell beside the code's
        for beside in (-1, 0, 1) if axis.fringes else (0,):
            there, here = (np.clip(end + beside, 0, len(words) - 1) for end in ends)
            mended |= np.abs(change + worth[:, there]) <= self.near
            mended |= np.abs(change - worth[:, here]) <= self.near
        bit, which = np.nonzero(mended)
        return bit, line[which], place[which] + 1

    def _whole_periods(
        self, axis: AxisPlan, line: NDArray[np.int64], place: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Which jumps (K,) are of whole periods: others are the edges of objects, as phases go on where a bit
        is wrong."""
        period = axis.fringes[0].period
        before, here, there, after = (self.coords[line, place + k] for k in range(4))
        steps = here - before, after - there
        rest = there - here - 0.5 * (steps[0] + steps[1])
        inside = np.minimum(
            *(0.5 * axis.extent - np.abs(end - 0.5 * (axis.extent - 1)) for end in (here, there))
        )
        odd = np.where(inside < period, _ODD_AT_BORDER, _ODD)
        loose = odd * period + _BENDS * self.bend
        return np.asarray(np.abs(rest - period * np.rint(rest / period)) <= loose)

    def edges(self, tables: tuple[NDArray[np.int64], F64]) -> Event:
        """The bits' proper edges, likewise."""
        words, worth = tables
        line, place = np.nonzero(self.marks == CALM)
        here, there = self._cells(words, line, place + 1), self._cells(words, line, place + 2)
        other = here != there
        line, place = line[other], place[other]
        flips = words[here[other]] ^ words[there[other]]
        bit, which = np.nonzero((flips >> np.arange(len(worth))[:, None]) & 1)
        return bit, line[which], place[which] + 1


def bit_faults(axis: AxisPlan, stack: Map, coord: Map, flags: Map, offset: Map) -> tuple[BitFault, ...]:
    """Bits of a Gray code whose pictures do not fit decoded coordinates (H, W).

    stack (N, H, W): the frames; offset (H, W): mid levels.
    """
    code = axis.code
    if code is None or code.kind == "binary" or min(coord.shape) < 4:
        return ()
    height, width = coord.shape
    rows, cols = _lines(height, width), _lines(width, height)
    views = [
        _Lines(code, axis, rows, True, coord, flags),
        _Lines(code, axis, cols, False, coord, flags),
    ]
    whole = _alike(code, stack, offset, coord, flags, rows)
    if not whole:
        whole = tuple({bit for view in views for bit in _inverted(view)})
    if whole:
        frame = np.maximum(code.plain, code.inverse)
        return tuple(BitFault(int(frame[bit]), 0, height) for bit in whole)
    # neighbours of a long-run Gray code are none to each other with any bit flipped, which was seen above
    rough = views[0].step > _STEEP * code.cell
    return () if rough or code.kind == "long-run-gray" else _jumping(axis, code, stack, offset, views)


def _jumping(
    axis: AxisPlan, code: Code, stack: Map, offset: Map, views: list[_Lines]
) -> tuple[BitFault, ...]:
    """Bits by their jumps along some rows, and along some columns."""
    if not any(view.broken for view in views):
        return ()  # as a rule
    tables = _tables(code, axis)
    jumps, edges = (np.zeros((len(code.plain), len(offset))) for _ in range(2))
    told = [view.jumps(axis, tables) for view in views]
    if sum(len(jump[0]) for jump in told) < _FEWEST:
        return ()  # edges take time to count
    for view, jump in zip(views, told, strict=True):
        edge = _flips(stack, offset, code, view.lines, view.along, view.edges(tables))
        for counted, (which, line, place) in ((jumps, jump), (edges, edge)):
            np.add.at(counted, (which, view.lines[line] if view.along else place), 1)
    found = []
    for bit, frame in enumerate(np.maximum(code.plain, code.inverse).tolist()):
        span = _worst_span(jumps[bit], edges[bit])
        if span is not None:
            found.append(BitFault(frame, *span))
    return tuple(found)


def _alike(
    code: Code, stack: Map, offset: Map, coord: Map, flags: Map, rows: NDArray[np.int64]
) -> tuple[int, ...]:
    """Bits without inverse that show the picture of the next coarser one, or none: frames came too early; and
    two that show the same one.
    """
    frame = np.where(code.inverse < 0, code.plain, -1)
    if (frame < 0).any() or code.kind == "xor-gray":
        return ()
    every = 1 + len(rows) * coord.shape[1] // _ENOUGH
    levels, offset, coord, flags = (part[..., rows, ::every] for part in (stack, offset, coord, flags))
    seen = (flags & _BLIND) == 0
    if np.count_nonzero(seen) < _PIXELS_LEAST:
        return ()
    cell = np.maximum((coord[seen] + 0.5 - code.origin) // code.cell, 0).astype(np.int64)
    pictures = levels[frame] > offset
    shown = pictures[:, seen]
    found = []
    for bit in range(len(frame)):
        # what a bit of that fineness would show, had the map this range: half of it lit
        cells = len(np.unique(cell >> bit))
        other = shown[bit + 1] if bit + 1 < len(frame) else np.zeros_like(shown[bit])
        same = min(np.mean(shown[bit] != other), np.mean(shown[bit]), np.mean(~shown[bit]))
        if cells >= _CELLS and same < _SAME:
            found.append(bit)
    return tuple(sorted({*found, *_twins(pictures, seen)}))


def _twins(shown: NDArray[np.bool_], seen: NDArray[np.bool_]) -> tuple[int, ...]:
    """Bits (of pixels, (bits, L, N), where seen) whose picture is that of another one.

    A map that jumps passes over edges of several bits at once, but not time and again.
    """
    often = [i for i, picture in enumerate(shown) if _changes(picture, seen) >= _OFTEN]
    pairs = [(i, j) for i in often for j in often if i < j]
    same = [pair for pair in pairs if np.mean((shown[pair[0]] != shown[pair[1]])[seen]) < _TWIN]
    return tuple(sorted({bit for pair in same for bit in pair}))


def _changes(picture: NDArray[np.bool_], seen: NDArray[np.bool_]) -> float:
    """How often a picture (L, N) changes along a line, or from line to line, on the mean."""
    return max(
        float(np.count_nonzero((part[:, 1:] != part[:, :-1]) & known[:, 1:] & known[:, :-1])) / len(part)
        for part, known in ((picture, seen), (picture.T, seen.T))
    )


def _inverted(view: _Lines) -> tuple[int, ...]:
    """The bit without whose flip neighbours tell nothing of each other, and with which they do."""
    if view.pairs < _PIXELS_LEAST or view.rough < _ROUGH * view.pairs:
        return ()
    code, coord = view.code, view.coords
    smooth = _STEEP * code.cell
    seen = (view.flags & _BLIND) == 0
    pairs = seen[:, :-1] & seen[:, 1:]
    words = np.zeros(int(code.cells.max()) + 1, np.int64)  # of all cells: wrong ones lie beyond the surface
    words[code.cells] = np.arange(len(code.cells))
    word = words[np.clip((coord + 0.5 - code.origin) // code.cell, 0, len(words) - 1).astype(np.int64)]
    bits = range(len(code.plain))
    each = [_roughness(code.cells[word ^ (1 << bit)] * code.cell, pairs, smooth) for bit in bits]
    best = int(np.argmin(each))
    return (best,) if each[best] * view.pairs < 0.25 * view.rough else ()


def _roughness(coord: Map, pairs: Map, smooth: float) -> float:
    """Share of neighbours that are far from each other."""
    return float(np.mean(np.abs(np.diff(coord, axis=1))[pairs] > smooth))


def _flips(stack: Map, offset: Map, code: Code, lines: NDArray[np.int64], along: bool, edge: Event) -> Event:
    """Of the edges, those at which the bit's own picture changes; between fringes a map may go on without."""
    bit, line, place = edge
    frame = np.maximum(code.plain, code.inverse)
    ends = []
    for end in (place - 1, place + 2):
        row, col = (lines[line], end) if along else (end, lines[line])
        lit = stack[frame[bit], row, col] > offset[row, col]
        if code.kind == "xor-gray":  # every picture but the finest bit's changes with that one, too
            lit ^= (stack[frame[0], row, col] > offset[row, col]) & (bit > 0)
        ends.append(lit)
    keep = ends[0] != ends[1]
    return bit[keep], line[keep], place[keep]


@lru_cache(maxsize=16)
def _lines(count: int, length: int) -> NDArray[np.int64]:
    """Some of `count` lines of `length` pixels."""
    some = min(int(np.clip(_PIXELS // length, *_LINES)), count)
    return np.unique(np.linspace(0, count - 1, some).astype(np.int64))


def _tables(code: Code, axis: AxisPlan) -> tuple[NDArray[np.int64], F64]:
    """Gray word of each cell (C,), and what flipping a bit of it does to the coordinate (bits, C)."""
    count = min(len(code.cells), int(np.ceil((axis.extent - code.origin) / code.cell)) + 1)
    every = np.arange(1 << len(code.plain))
    cells = np.empty_like(every)
    cells[code_words("gray", every)] = every
    words = code_words("gray", np.arange(count))
    flipped = cells[words ^ (1 << np.arange(len(code.plain)))[:, None]]
    return words, (flipped - np.arange(count)) * code.cell


def _worst_span(jumps: F64, edges: F64) -> tuple[int, int] | None:
    """Rows [start, stop) in which jumps prevail, out to the next proper edge; None if they do nowhere."""
    gain = np.cumsum(np.concatenate([[0.0], jumps - edges]))
    before = np.minimum.accumulate(gain)
    last = int(np.argmax(gain - before))
    first = int(np.argmax(gain[: last + 1] == before[last]))
    bad, good = float(jumps[first:last].sum()), float(edges[first:last].sum())
    if bad - good < _FEWEST or good > _PROPER * (bad + good):
        return None
    start, stop = 0, len(jumps)
    if _trusted(jumps[:first], edges[:first], bad):
        start = int(np.flatnonzero(edges[:first])[-1])
    if _trusted(jumps[last:], edges[last:], bad):
        stop = last + int(np.flatnonzero(edges[last:])[0]) + 1
    return start, stop


def _trusted(jumps: F64, edges: F64, bad: float) -> bool:
    """Whether rows beside `bad` jumps have edges enough to say that the picture is right there."""
    proper = float(edges.sum())
    return proper >= max(_FEWEST, _OUTSIDE * bad) and float(jumps.sum()) <= _OUTSIDE * proper
