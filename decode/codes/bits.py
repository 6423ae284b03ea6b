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
from numpy.typing import NDArray

from optolever.kernels import F32, I32, I64, kernel
from optolever.kernels import HALF as _HALF
from optolever.kernels import ZERO as _ZERO

from ..frames import RawFrames, level_of
from ..plan import AxisPlan, Plan
from ..records import Flag

__all__ = ["BitTable", "bit_tables", "ends_of", "read_rows"]

_ORDER = np.int32(Flag.ORDER_DOUBTFUL)
_ONE = np.int32(1)
#: Squares: share of the half contrast, deviations, within which a bit is open.
_SHARE2, _SURE2 = np.float32(0.25**2), np.float32(25)
#: Cells, and share of the surface, up to which an interval is no doubt by itself.
_CELLS, _EXTENT = 16, 1 / 8


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


def bit_tables(plan: Plan, axes: list[AxisPlan]) -> tuple[BitTable | None, ...]:
    """Tables of the axes' codes; None: without a code."""
    codes = [axis.code for axis in axes if axis.code is not None]
    every = sorted(int(i) for code in codes for i in (*code.plain, *code.inverse) if i >= 0)
    found: list[BitTable | None] = []
    for axis in axes:
        code = axis.code
        if code is None:
            found.append(None)
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
                1e9 if axis.fringes else max(_CELLS, _EXTENT * axis.extent / code.cell) / 2,
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


def ends_of(raw: RawFrames, table: F32 | None, code: BitTable, start: int, stop: int) -> tuple[F32, F32]:
    """Levels of black and white (n, W) in rows of the frames."""
    first = code.ends[0]
    low = high = raw[first, start:stop]
    if len(code.ends) == 2:
        high = raw[code.ends[1], start:stop]
    else:
        for i in code.ends[1:]:
            low, high = np.minimum(low, raw[i, start:stop]), np.maximum(high, raw[i, start:stop])
    if table is None:
        return low.astype(np.float32), high.astype(np.float32)
    return table[low], table[high]


def read_rows(
    raw: RawFrames,
    table: F32 | None,
    noise: tuple[np.float32, np.float32],
    code: BitTable,
    start: int,
    ends: tuple[F32, F32],
    place: F32,
    error: F32,
    flags: I32,
) -> F32:
    """Places (n, W) by a code in rows of the frames from `start` on; ends: levels of black and white. Half of
    the interval, pattern px."""
    shape = place.shape
    word, open_, noisy = np.empty((3, *shape), np.int32)
    half, unsure = np.empty(shape, np.float32), np.empty(shape, np.bool_)
    work = np.empty((3, shape[1]), np.float32)
    out = word, open_, noisy, place, half, unsure
    _read(raw, table, noise, code.plain, code.inverse, code.gray, start, ends, work, *out)
    if not code.gray:
        place[:], half[:] = code.cells[word], _HALF
    at = np.nonzero(unsure)
    if at[0].size:
        place[at], half[at], doubtful = _unsure(code, word[at], open_[at], noisy[at])
        flags[at] |= np.where(doubtful, _ORDER, 0)
    np.multiply(place, code.cell, out=place)
    place += _HALF * (code.cell - 1) + code.origin
    np.copyto(half, _HALF, where=half <= 1)
    doubtful = half > code.most
    if at[0].size or doubtful.any():
        flags |= np.where(doubtful, _ORDER, np.int32(0))
        np.maximum(error, (flags & _ORDER) != 0, out=error)
    half *= code.cell
    return half


@kernel
def _read(
    raw: RawFrames,
    table: F32 | None,
    noise: tuple[np.float32, np.float32],
    plain: I64,
    inverse: I64,
    gray: bool,
    start: int,
    ends: tuple[F32, F32],
    work: F32,
    word: I32,
    open_: I32,
    noisy: I32,
    place: F32,
    half: F32,
    unsure: NDArray[np.bool_],
) -> None:
    """Words, their open bits and those within noise; of a Gray code with one open bit beside the finest ones
    the middle and half length, in cells, of the interval; unsure: others with open bits."""
    (n, width), (read2, gain), (low, high), none, two = word.shape, noise, ends, np.int32(0), np.float32(2)
    for r in range(n):
        y = start + r
        for x in range(width):
            word[r, x] = none
        for x in range(width):
            open_[r, x] = none
        for x in range(width):
            noisy[r, x] = none
        # twice the middle; squares of twice a share of the half contrast, of twice noise
        for x in range(width):
            work[0, x] = low[r, x] + high[r, x]
            contrast = high[r, x] - low[r, x]
            work[1, x] = _SHARE2 * contrast * contrast
            work[2, x] = two * _SURE2 * (read2 + gain * max(_HALF * work[0, x], _ZERO))
        for b in range(plain.size):
            i, j, bit = plain[b], inverse[b], np.int32(_ONE << np.int32(b))
            if i >= 0 and j >= 0:
                for x in range(width):
                    d = level_of(raw[i, y, x], table) - level_of(raw[j, y, x], table)
                    word[r, x] |= bit if d > _ZERO else none
                    open_[r, x] |= bit if d * d < max(work[1, x], work[2, x]) else none
                    noisy[r, x] |= bit if d * d < work[2, x] else none
            else:
                sign, k, more = np.float32(1 if i >= 0 else -1), max(i, j), np.float32(3)
                for x in range(width):
                    d = sign * (two * level_of(raw[k, y, x], table) - work[0, x])
                    word[r, x] |= bit if d > _ZERO else none
                    open_[r, x] |= bit if d * d < max(work[1, x], more * work[2, x]) else none
                    noisy[r, x] |= bit if d * d < more * work[2, x] else none
        if gray:
            for x in range(width):
                o = open_[r, x]
                fine = np.int32(o ^ np.int32(o + _ONE)) >> _ONE  # the finest open bits
                w = np.int32(word[r, x] & ~fine)
                z = np.int32(w ^ np.int32(o & ~fine))
                for shift in (1, 2, 4, 8):
                    w ^= w >> np.int32(shift)
                    z ^= z >> np.int32(shift)
                first = min(np.int32(w & ~fine), np.int32(z & ~fine))
                last = np.int32(max(np.int32(w & ~fine), np.int32(z & ~fine)) + fine)
                place[r, x] = _HALF * np.float32(first + last)
                half[r, x] = _HALF * np.float32(last - first + _ONE)
                unsure[r, x] = last - first > np.int32(_ONE + fine + fine)
        else:
            for x in range(width):
                unsure[r, x] = open_[r, x] != none


def _unsure(code: BitTable, word: I32, open_: I32, noisy: I32) -> tuple[F32, F32, NDArray[np.bool_]]:
    """Middle and half length, cells, of any code by its table, and of a Gray code where the open bits are no
    edge between two cells; whether three bits are open.

    A bit beyond noise is open only at an edge, where its other value leads to the next cell; elsewhere
    interreflections dim it, and its sign counts. Two bits beside the finest ones may be open."""
    low = (open_ ^ (open_ + 1)) >> 1 if code.run else np.zeros_like(open_)
    kept = open_ & ~low & (code.adjacent[np.bitwise_count(low), word & ~low] | noisy)
    one = kept & -kept
    two = kept & ~one
    doubtful = (two & (two - 1)) != 0
    two &= -two
    first, last = np.full_like(word, 1 << 30), np.full_like(word, -1)
    for flip in (word, word ^ one, word ^ two, word ^ one ^ two):
        start = np.minimum(code.cells[flip & ~low], code.cells[flip | low]) & ~low
        first, last = np.minimum(first, start), np.maximum(last, start | low)
    return (0.5 * (first + last)).astype(np.float32), (0.5 * (last - first + 1)).astype(np.float32), doubtful
