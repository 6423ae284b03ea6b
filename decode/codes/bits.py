"""Bits of an axis -> interval of the cells that stay possible.

A bit is open where its level is within a quarter of the pixel's half contrast of the middle, or within five
deviations of noise. The words that stay possible give an interval of cells: its middle is the place, its
length over
sqrt 12 sigma; a single open bit is an edge between two cells and counts as one cell. In Gray and binary
codes the
finest open bits are one interval by themselves; of the other open bits (in other codes, of all of them) every
combination of two is tried, more are an order in doubt.

The middle is that of white and black; without them, of the fringe of the axis; else (max + min) / 2 of the
code's
frames. A pair of bit and inverse is compared with itself.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, I32, I64, exact, kernel
from optolever.kernels import HALF as _HALF
from optolever.kernels import ZERO as _ZERO

from ..frames import RawFrames, level_of
from ..plan import AxisPlan, Plan
from ..records import Flag

__all__ = ["BitTables", "Reading", "bit_tables", "extremes_row", "read_row"]

_ORDER = np.int32(Flag.ORDER_DOUBTFUL)
#: Squares: share of the half contrast, deviations, within which a bit is open.
_SHARE2, _SURE2 = np.float32(0.25**2), np.float32(25)
#: Cells, and share of the surface, up to which an interval is no doubt by itself.
_CELLS, _EXTENT = 16, 1 / 8
#: How words become cells.
_NO_BITS, _GRAY, _TABLE = 0, 1, 2
#: Sources of the middle level.
_ENDS, _FRINGE, _EXTREMES = 0, 1, 2
_ONE = np.int32(1)


class BitTables(NamedTuple):
    """Codes of the axes for kernels, padded: A axes, B bits.

    kind, middle, bits (A,): how words become cells, source of the middle level, number of bits; plain,
    inverse
    (A, B): frames, -1: none; cells (A, 2^B): word -> cell; words (A, 2^B): cell -> word; run (A,): whether
    the finest
    open bits are one interval; least, most (A,): half
    of an interval, cells: the least (two cells of xor-gray), of one that is not doubtful; cell,
    origin (A,): pattern px; white, black: frames; all (C,): frames of all codes
    """

    kind: I64
    middle: I64
    bits: I64
    plain: I64
    inverse: I64
    cells: I32
    run: NDArray[np.bool_]
    least: F32
    most: F32
    cell: F32
    origin: F32
    white: int
    black: int
    all: I64


class Reading(NamedTuple):
    """Lines (W,) of a code: word and open bits; half contrast, middle level; squared level below which a
    single
    bit and one of a pair is open; half of the interval, pattern px."""

    word: I32
    open: I32
    half: F32
    middle: F32
    single: F32
    pair: F32
    reach: F32


def bit_tables(plan: Plan, axes: list[AxisPlan]) -> BitTables:
    """Tables of the axes' codes; an axis without a code has kind 0."""
    codes = [axis.code for axis in axes]
    a, b = len(axes), max((len(code.plain) for code in codes if code), default=0)
    size = max((len(code.cells) for code in codes if code), default=1)
    out = BitTables(
        np.zeros(a, np.int64),
        np.zeros(a, np.int64),
        np.zeros(a, np.int64),
        np.full((a, b), -1),
        np.full((a, b), -1),
        np.zeros((a, size), np.int32),
        np.zeros(a, bool),
        np.full(a, 0.5, np.float32),
        np.full(a, 1e9, np.float32),
        np.ones(a, np.float32),
        np.zeros(a, np.float32),
        plan.white,
        plan.black,
        np.array(_code_frames(axes), np.int64),
    )
    for i, (axis, code) in enumerate(zip(axes, codes, strict=True)):
        if code is None:
            continue
        n = len(code.plain)
        out.bits[i], out.plain[i, :n], out.inverse[i, :n] = n, code.plain, code.inverse
        out.kind[i] = _GRAY if code.kind == "gray" else _TABLE
        out.run[i], out.least[i] = code.kind in ("gray", "binary"), 1.0 if code.kind == "xor-gray" else 0.5
        if not axis.fringes:
            out.most[i] = max(_CELLS, _EXTENT * axis.extent / code.cell) / 2
        out.cells[i, : len(code.cells)] = code.cells
        out.cell[i], out.origin[i] = code.cell, code.origin
        ends = plan.white >= 0 and plan.black >= 0
        paired = bool((np.minimum(code.plain, code.inverse) >= 0).all())
        out.middle[i] = _ENDS if ends else _FRINGE if axis.fringes and not paired else _EXTREMES
    return out


def _code_frames(axes: list[AxisPlan]) -> list[int]:
    codes = [axis.code for axis in axes if axis.code is not None]
    return sorted(int(i) for code in codes for i in (*code.plain, *code.inverse) if i >= 0)


@kernel
def extremes_row(raw: RawFrames, table: F32 | None, y: int, frames: I64, low: F32, high: F32) -> None:
    """Least and largest level of some frames in a row."""
    for x in range(low.size):
        low[x], high[x] = np.float32(1e30), np.float32(-1e30)
    for i in range(frames.size):
        f = raw[frames[i], y]
        for x in range(low.size):
            value = level_of(f[x], table)
            low[x] = min(low[x], value)
            high[x] = max(high[x], value)


@kernel
def _contrast(low: F32, high: F32, read2: np.float32, gain: np.float32, out: Reading) -> None:
    """Half contrast, middle and limits from the levels of black and white."""
    for x in range(low.size):
        half = _HALF * (high[x] - low[x])
        middle = low[x] + half
        share = _SHARE2 * half * half
        noise = read2 + gain * max(middle, _ZERO)
        out.half[x], out.middle[x] = half, middle
        out.single[x] = max(share, np.float32(1.5) * _SURE2 * noise)
        out.pair[x] = max(share, _HALF * _SURE2 * noise)


@kernel
def _add_bit(level: F32, limit: F32, bit: np.int32, word: I32, open_: I32) -> None:
    none = np.int32(0)
    for x in range(level.size):
        d = level[x]
        word[x] |= bit if d > _ZERO else none
        open_[x] |= bit if d * d < limit[x] else none


@kernel
def read_row(
    raw: RawFrames,
    table: F32 | None,
    noise: tuple[np.float32, np.float32],
    tables: BitTables,
    a: int,
    y: int,
    ends: tuple[F32, F32],
    work: F32,
    read: Reading,
    place: F32,
    variance: F32,
    error: F32,
    flags: I32,
) -> None:
    """Read the code of axis a in row y; ends: levels of black and white (W,)."""
    word, open_, middle = read.word, read.open, read.middle
    _contrast(ends[0], ends[1], noise[0], noise[1], read)
    for x in range(word.size):
        word[x], open_[x] = np.int32(0), np.int32(0)
    for b in range(tables.bits[a]):
        i, j = tables.plain[a, b], tables.inverse[a, b]
        bit = np.int32(_ONE << np.int32(b))
        if (i >= 0) & (j >= 0):
            f, g = raw[i, y], raw[j, y]
            for x in range(work.size):
                work[x] = _HALF * (level_of(f[x], table) - level_of(g[x], table))
            _add_bit(work, read.pair, bit, word, open_)
        else:
            f = raw[max(i, j), y]
            sign = np.float32(1) if i >= 0 else np.float32(-1)
            for x in range(work.size):
                work[x] = sign * (level_of(f[x], table) - middle[x])
            _add_bit(work, read.single, bit, word, open_)
    if tables.kind[a] == _GRAY:
        _gray_cells(word, open_, work, read.reach)
    _unsure_cells(raw, table, noise, tables, a, y, read, work, flags)
    cell, origin, none, least, most = (
        tables.cell[a],
        tables.origin[a],
        np.int32(0),
        tables.least[a],
        tables.most[a],
    )
    for x in range(place.size):
        half = read.reach[x]
        place[x] = work[x] * cell + (_HALF * (cell - np.float32(1)) + origin)
        half = max(_HALF if half <= np.float32(1) else half, least)
        read.reach[x] = half * cell
        variance[x] = half * half * cell * cell * np.float32(1 / 3)
        flags[x] |= _ORDER if half > most else none
        error[x] = max(error[x], np.float32(1) if flags[x] & _ORDER != none else _ZERO)


@kernel
def _gray_cells(word: I32, open_: I32, cell: F32, half: F32) -> None:
    """Middle and half length, in cells, of the interval of a Gray code with one open bit beside the finest
    ones."""
    one = np.int32(1)
    for x in range(word.size):
        o = open_[x]
        low = np.int32(o ^ np.int32(o + one)) >> one  # the finest open bits
        w = np.int32(word[x] & ~low)
        z = np.int32(w ^ np.int32(o & ~low))
        for shift in (1, 2, 4, 8):
            w ^= w >> np.int32(shift)
            z ^= z >> np.int32(shift)
        first = min(np.int32(w & ~low), np.int32(z & ~low))
        last = np.int32(max(np.int32(w & ~low), np.int32(z & ~low)) + low)
        cell[x] = _HALF * np.float32(first + last)
        half[x] = _HALF * np.float32(last - first + one)


@exact
def _unsure_cells(
    raw: RawFrames,
    table: F32 | None,
    noise: tuple[np.float32, np.float32],
    tables: BitTables,
    a: int,
    y: int,
    read: Reading,
    cell: F32,
    flags: I32,
) -> None:
    """The same of any code by its table, and of a Gray code where the open bits are no edge between two
    cells.

    A bit beyond noise is open only at an edge, where its other value leads to the next cell; elsewhere
    interreflections
    dim it, and its sign counts. Two bits beside the finest ones may be open."""
    cells, gray, run, half = tables.cells[a], tables.kind[a] == _GRAY, tables.run[a], read.reach
    for x in range(cell.size):
        o, w = int(read.open[x]), int(read.word[x])
        low = ((o ^ (o + 1)) >> 1) if run else 0
        more = o & ~low
        if gray & (half[x] <= low + 1.0):
            continue
        here, level = int(cells[w & ~low]) & ~low, max(read.middle[x], np.float32(0))
        limit, kept = _SURE2 * (noise[0] + noise[1] * level), 0
        for b in range(tables.bits[a]):
            bit = 1 << b
            if more & bit:
                i, j = tables.plain[a, b], tables.inverse[a, b]
                one = level_of(raw[max(i, j), y, x], table)
                pair = (i >= 0) & (j >= 0)
                d = 0.5 * (one - level_of(raw[min(i, j), y, x], table)) if pair else one - read.middle[x]
                there = int(cells[(w ^ bit) & ~low]) & ~low
                if (abs(here - there) == low + 1) | (d * d < (0.5 if pair else 1.5) * limit):
                    kept |= bit
        one_bit = kept & -kept
        two = kept & ~one_bit
        if two & (two - 1):
            flags[x] |= _ORDER
            two = two & -two
        first, last = 1 << 30, -1
        for flip in range(4):
            other = w ^ (one_bit if flip & 1 else 0) ^ (two if flip & 2 else 0)
            start = min(int(cells[other & ~low]), int(cells[other | low])) & ~low
            first, last = min(first, start), max(last, start | low)
        cell[x] = np.float32(0.5 * (first + last))
        half[x] = np.float32(0.5 * (last - first + 1))
