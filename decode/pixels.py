"""Levels of one pixel -> place, variance, amplitude, residual, flags; row by row, in lines that stay in the
core's first cache."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, HALF, I32, ZERO, kernel

from .codes.bits import BitTable, ends_row, read_row
from .codes.fringe import FringeTable, fit_row
from .codes.lookup import Lines
from .codes.orders import Orders, climb_row, compare_row, join_row, start_row
from .frames import RawFrames
from .records import Flag

__all__ = ["AxisTable", "Maps", "pixel_rows"]

#: Modulation over its noise below which a pixel is flagged: noise alone reaches it once in 3.7e-6.
_CONTRAST2 = np.float32(25)
#: Square of the deviations by which a place may lie beyond the surface.
_SLACK2 = np.float32(9)
#: Share of the camera's range that the brightest sample of a dark pixel reaches: 4 of 8 bits.
_DIM = np.float32(1 / 16)
_DARK, _LOW, _OFF = np.int32(Flag.DARK), np.int32(Flag.LOW_CONTRAST), np.int32(Flag.OFF_PATTERN)
_INVALID, _ORDER = np.int32(Flag.INVALID), np.int32(Flag.ORDER_DOUBTFUL)


class AxisTable(NamedTuple):
    """An axis for kernels. given: its place comes from a look-up; close: its periods are close; factor:
    variance of the amplitude over a sample's; more: variance of every place, px^2; extent: of the surface,
    px; beyond: share of the surface that the coarsest period does not cover; either: flags where two orders
    fit the interval of a code, see neighbours.settle."""

    fringes: FringeTable
    bits: BitTable
    orders: Orders
    given: bool
    close: bool
    factor: np.float32
    more: np.float32
    extent: np.float32
    beyond: np.float32
    either: np.int32


class Maps(NamedTuple):
    """Outputs. Of a block: place, variance, amplitude of the coarsest fringe (A, n, W), chi2 float32, flags
    uint16 (n, W); of the image: least amplitude, offset, error (H, W) float32."""

    place: F32
    variance: F32
    amplitude: F32
    chi2: F32
    flags: NDArray[np.uint16]
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
) -> None:
    """Decode rows start..stop of the frames into a block's rows from `at` on, and into the image's from
    `first` to `last`; rows: start, stop, first, last; looked_up: (A, n, W) of look-ups."""
    width, count = light[0].shape[2], max(len(table.fringes.period) for table in tables)
    lines, words = np.zeros((15 + 2 * count, width), np.float32), np.zeros((3, width), np.int32)
    top = np.zeros(width, light[0].dtype)
    for a, table in enumerate(tables):
        _axis_rows(*light, noise, table, looked_up, rows, (a, at), out, lines, words, top)


@kernel
def _axis_rows(
    raw: RawFrames,
    table: F32 | None,
    clip: np.float32,
    noise: tuple[np.float32, np.float32],
    axis: AxisTable,
    looked_up: Lines,
    rows: tuple[int, int, int, int],
    at: tuple[int, int],
    out: Maps,
    lines: F32,
    words: I32,
    top: RawFrames,
) -> None:
    """One axis, `at[0]`; flags, chi2, error of both. lines (15 + 2 K, W), words (3, W), top (W,)."""
    (start, stop, first, last), (a, begin) = rows, at
    fringes, code, width = axis.fringes, axis.bits, raw.shape[2]
    count, bits = (0, 0) if axis.given else (fringes.period.size, code.plain.size)
    phases, own, flags = lines[15 : 15 + count], lines[15 + count : 15 + 2 * count], words[2]
    offset, amplitude, low, high, reach = lines[0], lines[1], lines[2], lines[3], lines[4]
    for y in range(start, stop):
        to = begin + y - start
        place, variance, coarse = out.place[a, to], out.variance[a, to], out.amplitude[a, to]
        chi2, shown = out.chi2[to], first <= y < last  # others are another thread's, too
        error = out.error[y] if shown else lines[5]
        if a == 0 or not shown:
            for x in range(width):
                error[x] = ZERO
        for x in range(width):
            flags[x] = np.int32(out.flags[to, x]) if a else np.int32(0)
            chi2[x] = chi2[x] if a else ZERO
        if axis.given:
            r, of = y - start, looked_up
            for x in range(width):
                place[x], variance[x], coarse[x] = (
                    of.place[a, r, x],
                    of.variance[a, r, x],
                    of.amplitude[a, r, x],
                )
                offset[x], error[x] = of.offset[a, r, x], max(error[x], of.error[a, r, x])
                chi2[x], flags[x] = chi2[x] + of.chi2[a, r, x], flags[x] | of.flags[a, r, x]
        for k in range(max(count, min(bits, 1))):
            if k < count:
                j = k if axis.close else 0
                fit = lines[6:10], top, offset, amplitude, phases[j], own[j]
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
            if axis.close:
                continue
            if k > 0:
                climb_row(phases[0], own[0], fringes.period[k], place, variance, error, flags)
            elif count and bits:
                period = fringes.period[0]
                join_row(phases[0], own[0], period, reach, place, variance, error, flags, axis.either)
            elif bits:
                for x in range(width):
                    variance[x] = reach[x] * reach[x] * np.float32(1 / 3)
                    offset[x] = low[x] + coarse[x]
            else:
                start_row(phases[0], own[0], fringes.period[0], axis.extent, place, variance)
                if axis.beyond > ZERO:
                    for x in range(width):
                        error[x] = max(error[x], axis.beyond)
                        flags[x] |= _ORDER
        if axis.close:
            compare_row(
                phases, own, fringes.period, axis.orders, lines[6:12], words[0], place, variance, lines[12],
                chi2, flags,
            )  # fmt: skip
            for x in range(width):
                error[x] = max(error[x], lines[12, x])
        fine = amplitude if count else coarse
        _judged(noise, axis, _DIM * clip, fine, offset, place, variance, flags)
        for x in range(width):
            out.flags[to, x] = np.uint16(flags[x])
        if shown:
            least, mean = out.least[y], out.offset[y]
            for x in range(width):
                least[x] = min(least[x], fine[x]) if a else fine[x]
                mean[x] = HALF * (mean[x] + offset[x]) if a else offset[x]


@kernel
def _judged(
    noise: tuple[np.float32, np.float32],
    axis: AxisTable,
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
