"""Levels of one pixel -> place, variance, amplitude, residual, flags; row by row, in lines that stay in the
core's first cache."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, HALF, I32, ZERO, inlined, inner, kernel

from .codes.bits import BitTable, ends_row, read_row
from .codes.fringe import CLIPPED, FringeTable, fit_row, refitted
from .codes.lookup import Lines
from .codes.orders import Orders, climb_row, compare_row, join_row, start_row
from .correspondence import Flag
from .frames import RawFrames

__all__ = ["AxisNumbers", "AxisTable", "Maps", "pixel_rows"]

U16 = NDArray[np.uint16]
#: Modulation over its noise below which a pixel is flagged: noise alone reaches it once in 3.7e-6.
_CONTRAST2 = np.float32(25)
#: Square of the deviations by which a place may lie beyond the surface.
_SLACK2 = np.float32(9)
#: Share of the camera's range that the brightest sample of a dark pixel reaches: 4 of 8 bits.
_DIM = np.float32(1 / 16)
_DARK, _LOW, _OFF = np.int32(Flag.DARK), np.int32(Flag.LOW_CONTRAST), np.int32(Flag.OFF_PATTERN)
_INVALID, _ORDER = np.int32(Flag.INVALID), np.int32(Flag.ORDER_DOUBTFUL)


class AxisNumbers(NamedTuple):
    """factor: variance of the amplitude over a sample's; more: variance of every place, px^2; extent: of the
    surface, px; beyond: share of the surface that the coarsest period does not cover; either: flags where two
    orders fit the interval of a code, see neighbours.settle."""

    factor: np.float32
    more: np.float32
    extent: np.float32
    beyond: np.float32
    either: np.int32


class AxisTable(NamedTuple):
    """An axis. designs: of fringe_table(); given: its place comes from a look-up; close: its periods are
    close."""

    fringes: FringeTable
    designs: F64
    bits: BitTable
    orders: Orders
    numbers: AxisNumbers
    given: bool
    close: bool


class Maps(NamedTuple):
    """Outputs. Of a block: place, variance, amplitude of the coarsest fringe (A, n, W), chi2 float32, flags
    uint16 (n, W); of the image: least amplitude, offset, error (H, W) float32."""

    place: F32
    variance: F32
    amplitude: F32
    chi2: F32
    flags: U16
    least: F32
    offset: F32
    error: F32


def pixel_rows(
    light: tuple[RawFrames, F32 | None, np.float32],
    noise: tuple[np.float32, np.float32],
    tables: tuple[AxisTable, ...],
    looked_up: Lines,
    rows: tuple[int, int, int, int],
    at: int,
    out: Maps,
    known: list[F32] | None = None,
) -> None:
    """Decode rows start..stop of the frames into a block's rows from `at` on, and into the image's from
    `first` to `last`; rows: start, stop, first, last; looked_up: (A, n, W) of look-ups; known: fits of
    clipped pixels by axis, see fit_row; without it these pixels are fitted, and decoded again as a row."""
    none, (start, stop, first, last) = np.zeros((1, 4, 0), np.float32), rows
    width, count = light[0].shape[2], max(len(table.fringes.period) for table in tables)
    lines, words = np.zeros((15 + 2 * count, width), np.float32), np.zeros((3, width), np.int32)
    top, fits = np.zeros(width, light[0].dtype), known or [none] * len(tables)
    for a, table in enumerate(tables):
        if table.given:
            _given_rows(noise, table.numbers, _DIM * light[2], looked_up, rows, (a, at), out, lines, words[2])
        else:  # apart: each is compiled where it is needed
            one = *light, noise, table.fringes, table.numbers, rows, (a, at), fits[a], out, lines, words, top
            _close_rows(*one, table.orders) if table.close else _axis_rows(*one, table.bits)
    flags = out.flags[at : at + stop - start]
    if flags.max() < CLIPPED:  # the highest of all, and a maximum costs less than a search
        return
    row, col = np.nonzero(flags & CLIPPED)
    few = np.ascontiguousarray(light[0][:, row + start, col])
    own = few, *light[1:], noise
    fits = [none if table.given else refitted(*own, table.fringes, table.designs) for table in tables]
    some: list[Any] = [one if one.size == 1 else one[:, None, row, col] for one in looked_up]
    whole: list[Any] = [*out]
    again: list[Any] = [np.zeros((*one.shape[:-2], 1, row.size), one.dtype) for one in out]
    one_row = (few[:, None], *light[1:]), noise, tables, Lines(*some), (0, 1, 0, 1), 0
    pixel_rows(*one_row, Maps(*again), fits)
    shown = (row >= first - start) & (row < last - start)
    for k, (into, found) in enumerate(zip(whole, again, strict=True)):
        if k < 5:  # of the block
            into[..., row + at, col] = found[..., 0, :]
        else:
            into[row[shown] + start, col[shown]] = found[0, shown]


@inlined
def _rows_of(
    out: Maps, lines: F32, a: int, to: int, y: int, shown: bool
) -> tuple[F32, F32, F32, F32, F32, F32, F32]:
    """Place, variance, amplitude, chi2 of a block's row; error, least amplitude and offset of the image's, or
    (another thread's, too) scratch."""
    error, least, mean = (
        (out.error[y], out.least[y], out.offset[y]) if shown else (lines[5], lines[13], lines[14])
    )
    return out.place[a, to], out.variance[a, to], out.amplitude[a, to], out.chi2[to], error, least, mean


@kernel
def _axis_rows(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    fringes: FringeTable,
    axis: AxisNumbers,
    rows: tuple[int, int, int, int],
    at: tuple[int, int],
    known: F32,
    out: Maps,
    lines: F32,
    words: I32,
    top: RawFrames,
    code: BitTable,
) -> None:
    """An axis of a code or a ladder of periods, `at[0]`; flags, chi2, error of both. lines (15 + 2 K, W),
    words (3, W), top (W,)."""
    (start, stop, first, last), (a, begin) = rows, at
    count, bits, flags, width = fringes.period.size, code.plain.size, words[2], raw.shape[2]
    offset, amplitude, low, high, reach = lines[0], lines[1], lines[2], lines[3], lines[4]
    phase, own = lines[10], lines[11]
    for y in range(start, stop):
        to, shown = begin + y - start, first <= y < last
        place, variance, coarse, chi2, error, least, mean = _rows_of(out, lines, a, to, y, shown)
        _begun(a > 0, shown, out.flags[to], flags, chi2, error)
        for k in range(max(count, min(bits, 1))):
            if k < count:
                fit = known, lines[6:10], top, offset, amplitude, phase, own
                fit_row(raw, table, clip, noise, fringes, (k, y), *fit, chi2, flags)
            if k == 0 and bits:
                if code.fringe:
                    for x in range(width):
                        low[x], high[x] = offset[x] - amplitude[x], offset[x] + amplitude[x]
                else:
                    ends_row(raw, table, code.ends, y, low, high)
                read_row(raw, table, noise, code, y, low, high, lines[6:9], words, place, reach, error, flags)
            if k == 0:
                for x in range(width):
                    coarse[x] = amplitude[x] if count else HALF * (high[x] - low[x])
            if k > 0:
                climb_row(phase, own, fringes.period[k], place, variance, error, flags)
            elif count and bits:
                join_row(phase, own, fringes.period[0], reach, place, variance, error, flags, axis.either)
            elif bits:
                for x in range(width):
                    variance[x] = reach[x] * reach[x] * np.float32(1 / 3)
                    offset[x] = low[x] + coarse[x]
            else:
                start_row(phase, own, fringes.period[0], axis.extent, place, variance)
                if axis.beyond > ZERO:
                    for x in range(width):
                        error[x] = max(error[x], axis.beyond)
                        flags[x] |= _ORDER
        fine = amplitude if count else coarse
        _judged(noise, axis, _DIM * clip, fine, offset, place, variance, flags)
        _ended(a > 0, fine, offset, flags, out.flags[to], least, mean)


@kernel
def _close_rows(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    fringes: FringeTable,
    axis: AxisNumbers,
    rows: tuple[int, int, int, int],
    at: tuple[int, int],
    known: F32,
    out: Maps,
    lines: F32,
    words: I32,
    top: RawFrames,
    orders: Orders,
) -> None:
    """An axis of close periods; see _axis_rows."""
    (start, stop, first, last), (a, begin), flags = rows, at, words[2]
    count, offset, amplitude, wrong = fringes.period.size, lines[0], lines[1], lines[12]
    phases, own = lines[15 : 15 + count], lines[15 + count : 15 + 2 * count]
    for y in range(start, stop):
        to, shown = begin + y - start, first <= y < last
        place, variance, coarse, chi2, error, least, mean = _rows_of(out, lines, a, to, y, shown)
        _begun(a > 0, shown, out.flags[to], flags, chi2, error)
        for k in range(count):
            fit = known, lines[6:10], top, offset, amplitude, phases[k], own[k]
            fit_row(raw, table, clip, noise, fringes, (k, y), *fit, chi2, flags)
            if k == 0:
                for x in range(coarse.size):
                    coarse[x] = amplitude[x]
        rest = words[0], place, variance, wrong, chi2, flags
        compare_row(phases, own, fringes.period, orders, lines[6:12], *rest)
        for x in range(coarse.size):
            error[x] = max(error[x], wrong[x])
        _judged(noise, axis, _DIM * clip, amplitude, offset, place, variance, flags)
        _ended(a > 0, amplitude, offset, flags, out.flags[to], least, mean)


@kernel
def _given_rows(
    noise: tuple[np.float32, np.float32],
    axis: AxisNumbers,
    dim: np.float32,
    of: Lines,
    rows: tuple[int, int, int, int],
    at: tuple[int, int],
    out: Maps,
    lines: F32,
    flags: I32,
) -> None:
    """An axis by a look-up; see _axis_rows."""
    (start, stop, first, last), (a, begin) = rows, at
    for y in range(start, stop):
        to, r, shown = begin + y - start, y - start, first <= y < last
        place, variance, coarse, chi2, error, least, mean = _rows_of(out, lines, a, to, y, shown)
        _begun(a > 0, shown, out.flags[to], flags, chi2, error)
        for x in range(coarse.size):
            place[x], variance[x] = of.place[a, r, x], of.variance[a, r, x]
            coarse[x], error[x] = of.amplitude[a, r, x], max(error[x], of.error[a, r, x])
            chi2[x], flags[x] = chi2[x] + of.chi2[a, r, x], flags[x] | of.flags[a, r, x]
        _judged(noise, axis, dim, coarse, of.offset[a, r], place, variance, flags)
        _ended(a > 0, coarse, of.offset[a, r], flags, out.flags[to], least, mean)


@inner
def _begun(second: bool, shown: bool, before: U16, flags: I32, chi2: F32, error: F32) -> None:
    """A row's flags, chi2 and error: of the axis before, if this is the second one."""
    kept = second and shown
    for x in range(flags.size):
        error[x] = error[x] if kept else ZERO
    for x in range(flags.size):
        flags[x] = np.int32(before[x]) if second else np.int32(0)
        chi2[x] = chi2[x] if second else ZERO


@inner
def _ended(second: bool, amplitude: F32, offset: F32, flags: I32, out: U16, least: F32, mean: F32) -> None:
    """Flags, least amplitude and mean offset of both axes."""
    for x in range(flags.size):
        out[x] = np.uint16(flags[x])
    for x in range(flags.size):
        least[x] = min(least[x], amplitude[x]) if second else amplitude[x]
        mean[x] = HALF * (mean[x] + offset[x]) if second else offset[x]


@inner
def _judged(
    noise: tuple[np.float32, np.float32],
    axis: AxisNumbers,
    dim: np.float32,
    amplitude: F32,
    offset: F32,
    place: F32,
    variance: F32,
    flags: I32,
) -> None:
    """Flags by light and place; numbers that are finite."""
    (read2, gain), none, contrast2 = noise, np.int32(0), axis.factor * _CONTRAST2
    more, extent = axis.more, axis.extent
    for x in range(place.size):
        b, o = amplitude[x], offset[x]
        faint = (b * b < contrast2 * (read2 + gain * max(o, ZERO))) | (b <= ZERO)
        flags[x] |= _LOW if faint else none
        flags[x] |= _DARK if faint & (o + b < dim) else none
    for x in range(place.size):
        c, v = place[x], variance[x] + more
        known, beyond = abs(c) < np.float32(1e9), max(max(-HALF - c, c + HALF - extent), ZERO)
        flags[x] |= none if known else _INVALID
        flags[x] |= _OFF if beyond * beyond > _SLACK2 * v else none
        place[x] = c if known else ZERO
        variance[x] = v if known else np.float32(1e9)
