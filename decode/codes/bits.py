"""Bits of an axis -> interval of the cells that stay possible.

A bit is open where its level is within a quarter of the pixel's half contrast of the middle, or within five
deviations of noise. The words that stay possible give an interval of cells: its middle is the place, its
length over sqrt 12 sigma; a single open bit is an edge between two cells and counts as one cell. In Gray and
binary codes the finest open bits are one interval by themselves; of the other open bits (in other codes, of
all of them) every combination of two is tried, more are an order in doubt.

The middle is that of white and black; without them, of the fringe of the axis; else (max + min) / 2 of the
code's frames. A pair of bit and inverse is compared with itself.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from optolever.kernels import F32, HALF, I32, I64, ZERO, inner, kernel

from ..correspondence import Flag
from ..frames import RawFrames, level_of
from ..plan import AxisPlan, Plan

__all__ = ["BitTable", "bit_tables", "ends_row", "read_row"]

_ORDER = np.int32(Flag.ORDER_DOUBTFUL)
_ONE = np.int32(1)
#: Squares: share of the half contrast, deviations, within which a bit is open.
_SHARE2, _SURE2 = np.float32(0.25**2), np.float32(25)
#: Cells, and share of the surface, up to which an interval is no doubt by itself.
_WIDEST, _EXTENT = 16, 1 / 8


class BitTable(NamedTuple):
    """Code of an axis, B bits.

    plain, inverse (B,): frames, -1: none; ends: frames of black and white, or else all of the code, of which
    the extremes count; fringe: whether the fringe has the middle level; cells (2^B,): word -> cell; adjacent
    (B or 1, 2^B): bits of a word without so many of the finest ones whose other value leads to the next cell;
    gray: cells are those of a Gray code; run: the finest open bits are one interval; most: half of an
    interval, cells, that is not doubtful; cell, origin:
    pattern px
    """

    plain: I64
    inverse: I64
    ends: I64
    fringe: bool
    cells: I32
    adjacent: I32
    gray: bool
    run: bool
    most: float
    cell: np.float32
    origin: np.float32


_NO, _CELLS = np.zeros(0, np.int64), np.zeros((1, 0), np.int32)
_NONE = BitTable(_NO, _NO, _NO, False, _CELLS[0], _CELLS, False, False, 0.0, np.float32(1), np.float32(0))


def bit_tables(plan: Plan, axes: list[AxisPlan]) -> tuple[BitTable, ...]:
    """Tables of the axes' codes, without bits where there is no code."""
    codes = [axis.code for axis in axes if axis.code is not None]
    every = sorted(int(i) for code in codes for i in (*code.plain, *code.inverse) if i >= 0)
    found: list[BitTable] = []
    for axis in axes:
        code = axis.code
        if code is None:
            found.append(_NONE)
            continue
        known = min(plan.white, plan.black) >= 0
        paired = bool((np.minimum(code.plain, code.inverse) >= 0).all())
        run, cells = code.kind in ("gray", "binary"), code.cells.astype(np.int32)
        found.append(
            BitTable(
                code.plain,
                code.inverse,
                np.array([plan.black, plan.white] if known else every, np.int64),
                not known and bool(axis.fringes) and not paired,
                cells,
                _adjacent(cells.tobytes(), len(code.plain), run),
                code.kind == "gray",
                run,
                1e9 if axis.fringes else max(_WIDEST, _EXTENT * axis.extent / code.cell) / 2,
                np.float32(code.cell),
                np.float32(code.origin),
            )
        )
    return tuple(found)


@lru_cache(maxsize=8)
def _adjacent(cells: bytes, bits: int, run: bool) -> I32:
    cell, word = np.frombuffer(cells, np.int32), np.arange(len(cells) // 4)
    out = np.zeros((bits + 1 if run else 1, len(cell)), np.int32)
    for k, row in enumerate(out):
        low = (1 << k) - 1
        for b in range(k, bits):
            there = cell[(word ^ (1 << b)) & ~low] & ~low
            row |= np.where(np.abs((cell[word & ~low] & ~low) - there) == low + 1, 1 << b, 0).astype(np.int32)
    return out


@kernel
def ends_row(raw: RawFrames, table: F32 | None, ends: I64, y: int, low: F32, high: F32) -> None:
    """Levels (W,) of black and white in row y of the frames."""
    first, last = ends[0], ends[ends.size - 1]
    for x in range(low.size):
        low[x], high[x] = level_of(raw[first, y, x], table), level_of(raw[last, y, x], table)
    if ends.size > 2:
        for i in ends:
            for x in range(low.size):
                level = level_of(raw[i, y, x], table)
                low[x], high[x] = min(low[x], level), max(high[x], level)


@kernel
def read_row(
    raw: RawFrames,
    table: F32 | None,
    noise: tuple[np.float32, np.float32],
    code: BitTable,
    y: int,
    low: F32,
    high: F32,
    work: F32,
    words: I32,
    place: F32,
    reach: F32,
    error: F32,
    flags: I32,
) -> None:
    """Places (W,) by a code in row y of the frames, and half of their intervals, pattern px; low, high:
    levels of black and white; work (3, W), words (2, W)."""
    (read2, gain), none, two, width = noise, np.int32(0), np.float32(2), place.size
    plain, inverse, cells = code.plain, code.inverse, code.cells
    for x in range(width):
        words[0, x], words[1, x] = none, none
    # twice the middle; squares of twice the half width of what is open, of a bit with its inverse and alone
    for x in range(width):
        middle, contrast = low[x] + high[x], high[x] - low[x]
        own = two * _SURE2 * (read2 + gain * max(HALF * middle, ZERO))
        work[0, x] = middle
        work[1, x] = max(_SHARE2 * contrast * contrast, own)
        work[2, x] = max(_SHARE2 * contrast * contrast, np.float32(3) * own)
    for b in range(plain.size):
        i, j, bit = plain[b], inverse[b], np.int32(_ONE << np.int32(b))
        if i >= 0 and j >= 0:
            for x in range(width):
                d = level_of(raw[i, y, x], table) - level_of(raw[j, y, x], table)
                words[0, x] |= bit if d > ZERO else none
                words[1, x] |= bit if d * d < work[1, x] else none
        else:
            sign, i = np.float32(1 if i >= 0 else -1), max(i, j)
            for x in range(width):
                d = sign * (two * level_of(raw[i, y, x], table) - work[0, x])
                words[0, x] |= bit if d > ZERO else none
                words[1, x] |= bit if d * d < work[2, x] else none
    # first and last cell of the interval; of one that needs more thought the last lies before the first
    if code.gray:
        for x in range(width):
            o = words[1, x]
            fine = np.int32(np.int32(o ^ np.int32(o + _ONE)) >> _ONE)  # the finest open bits
            more, w = np.int32(o & ~fine), np.int32(words[0, x] & ~fine)
            w = np.int32(w ^ np.int32(w >> _ONE))
            w = np.int32(w ^ np.int32(w >> np.int32(2)))
            w = np.int32(w ^ np.int32(w >> np.int32(4)))
            w = np.int32(np.int32(w ^ np.int32(w >> np.int32(8))) & ~fine)
            # the other value of one open bit inverts all finer ones
            z = np.int32(w ^ np.int32(np.int32(more << _ONE) - (_ONE if more != none else none)))
            z = np.int32(z & ~fine)
            first, last = min(w, z), np.int32(max(w, z) + fine)
            wide = _ONE if np.int32(last - first) > np.int32(_ONE + fine + fine) else none
            wide = np.int32(wide | np.int32(more & np.int32(more - _ONE)))
            words[0, x], words[1, x] = first, np.int32(first - _ONE) if wide != none else last
    else:
        for x in range(width):
            cell = cells[words[0, x]]
            words[0, x], words[1, x] = cell, np.int32(cell - _ONE) if words[1, x] != none else cell
    some = none
    for x in range(width):
        some |= np.int32(words[1, x] - words[0, x])
    if some < none:
        for x in range(width):
            if words[1, x] < words[0, x]:
                own = two * _SURE2 * (read2 + gain * max(HALF * work[0, x], ZERO))
                if _unsure(raw, table, code, (y, x), (own, work[0, x], work[1, x], work[2, x]), words):
                    flags[x], error[x] = flags[x] | _ORDER, np.float32(1)
    size, most, one = code.cell, np.float32(code.most), np.float32(1)
    begin = HALF * (size - one) + code.origin
    for x in range(width):
        half = HALF * np.float32(np.int32(words[1, x] - words[0, x] + _ONE))
        half = half if half > one else HALF
        place[x] = HALF * np.float32(np.int32(words[0, x] + words[1, x])) * size + begin
        reach[x] = half * size
    for x in range(width):
        wide = _ORDER if reach[x] > most * size else none
        flags[x] |= wide
        error[x] = max(error[x], one if wide != none else ZERO)


@inner
def _unsure(
    raw: RawFrames,
    table: F32 | None,
    code: BitTable,
    at: tuple[int, int],
    limits: tuple[np.float32, np.float32, np.float32, np.float32],
    words: I32,
) -> bool:
    """First and last cell of any code by its table, and of a Gray code where the open bits are no edge
    between two cells; whether three bits are open. limits: square of twice the noise; twice the middle;
    squares of what is open.

    A bit beyond noise is open only at an edge, where its other value leads to the next cell; elsewhere
    interreflections dim it, and its sign counts. Two bits beside the finest ones may be open."""
    (y, x), (own, middle, pair, single) = at, limits
    word, opened, noisy = np.int64(0), np.int64(0), np.int64(0)
    for b in range(code.plain.size):
        i, j, bit = code.plain[b], code.inverse[b], np.int64(1) << b
        d, most, chance = level_of(raw[max(i, j), y, x], table), single, np.float32(3) * own
        if i >= 0 and j >= 0:
            d, most, chance = level_of(raw[i, y, x], table) - level_of(raw[j, y, x], table), pair, own
        else:
            d = np.float32(2) * d - middle if i >= 0 else middle - np.float32(2) * d
        word |= bit if d > ZERO else np.int64(0)
        opened |= bit if d * d < most else np.int64(0)
        noisy |= bit if d * d < chance else np.int64(0)
    low, count = ((opened ^ (opened + 1)) >> 1) if code.run else np.int64(0), 0
    while (low >> count) & 1:
        count += 1
    kept = opened & ~low & (np.int64(code.adjacent[count, word & ~low]) | noisy)
    one = kept & -kept
    two = kept & ~one
    doubtful = bool((two & (two - 1)) != 0)
    two &= -two
    first, last = np.int64(1 << 30), np.int64(-1)
    for k in range(4):
        flip = word ^ (one if k & 1 else 0) ^ (two if k & 2 else 0)
        start = min(np.int64(code.cells[flip & ~low]), np.int64(code.cells[flip | low])) & ~low
        first, last = min(first, start), max(last, start | low)
    words[0, x], words[1, x] = first, last
    return doubtful
