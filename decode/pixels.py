"""Levels of one pixel -> place, variance, amplitude, residual, flags; row by row, so that the lines of a row
stay in
the cache."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, I32, exact, kernel
from optolever.kernels import HALF as _HALF
from optolever.kernels import ZERO as _ZERO

from .codes.bits import BitTables, Reading, extremes_row, read_row
from .codes.fringe import Fit, FringeTables, fringe_row
from .codes.lookup import Lines
from .codes.orders import Orders, climb_row, compare_row, join_row, start_row
from .frames import RawFrames, level_of
from .records import Flag

__all__ = ["Maps", "Tables", "pixel_rows"]

#: Modulation over its noise below which a pixel is flagged: noise alone reaches it once in 3.7e-6.
_CONTRAST2 = np.float32(25)
#: Deviations by which a place may lie beyond the surface.
_SLACK = np.float32(3)
#: Share of the camera's range that the brightest sample of a dark pixel reaches: 4 of 8 bits.
_DIM = np.float32(1 / 16)
_DARK, _LOW, _OFF = np.int32(Flag.DARK), np.int32(Flag.LOW_CONTRAST), np.int32(Flag.OFF_PATTERN)
_INVALID, _SATURATED = np.int32(Flag.INVALID), np.int32(Flag.SATURATED)
_ORDER = np.int32(Flag.ORDER_DOUBTFUL)


class Tables(NamedTuple):
    """A: axes. given (A,): place comes from a look-up; close (A,): periods are close; factor (A,): variance
    of the
    amplitude over a sample's; more (A,): variance of every place, px^2; extent (A,): of the surface, px;
    beyond (A,): share of the surface that the coarsest period does not cover."""

    fringes: FringeTables
    bits: BitTables
    orders: tuple[Orders, Orders]
    given: NDArray[np.bool_]
    close: NDArray[np.bool_]
    factor: F32
    more: F32
    extent: F32
    beyond: F32


class Maps(NamedTuple):
    """Outputs for rows, each row's lines written: place, variance (A, n, W), chi2, amplitude, offset, error
    (n, W)
    float32, flags (n, W) uint16."""

    place: F32
    variance: F32
    chi2: F32
    amplitude: F32
    offset: F32
    error: F32
    flags: NDArray[np.uint16]


@exact
def pixel_rows(
    light: tuple[RawFrames, F32 | None, np.float32],
    noise: tuple[np.float32, np.float32],
    tables: Tables,
    looked_up: Lines,
    start: int,
    stop: int,
    out: Maps,
    at: int,
) -> None:
    """Decode rows start..stop of the frames into rows 0..stop - start of out, of place and variance from row
    `at` on;
    looked_up: (A, n, W) of look-ups."""
    raw, table, clip = light
    width, many = raw.shape[2], tables.fringes.period.shape[1]
    f = np.zeros((20, width), np.float32)
    phases, variances = (
        np.zeros((max(many, 1), width), np.float32),
        np.zeros((max(many, 1), width), np.float32),
    )
    flags, words = np.zeros(width, np.int32), np.zeros((2, width), np.int32)
    top = np.zeros(width, raw.dtype)
    read = Reading(words[0], words[1], f[0], f[1], f[2], f[3], f[4])
    low, high, error, work, amplitude, offset = f[5], f[6], f[7], f[8], f[9], f[10]
    for y in range(start, stop):
        r = y - start
        chi2 = out.chi2[r]
        _clear(flags, chi2, error)
        for a in range(tables.given.size):
            place, variance = out.place[a, r + at], out.variance[a, r + at]
            if tables.given[a]:
                _take(looked_up, a, r, place, variance, amplitude, offset, error, chi2, flags)
            count = tables.fringes.number[a] if not tables.given[a] else 0
            for k in range(count):
                j = k if tables.close[a] else 0
                fit = Fit(f[11], f[12], f[13], f[14], phases[j], variances[j], f[15], top)
                fringe_row(light, noise, tables.fringes, a, k, y, fit, chi2, flags)
                period, v = tables.fringes.period[a, k], variances[j]
                if k == 0:
                    if tables.bits.kind[a] > 0:
                        ends = _ends(raw, table, y, tables.bits, a, fit, low, high)
                        read_row(
                            raw,
                            table,
                            noise,
                            tables.bits,
                            a,
                            y,
                            ends,
                            work,
                            read,
                            place,
                            variance,
                            error,
                            flags,
                        )
                        join_row(phases[0], v, period, read.reach, place, variance, error, flags)
                    elif not tables.close[a]:
                        start_row(phases[0], v, period, tables.extent[a], place, variance)
                        _doubt_beyond(tables.beyond[a], error, flags)
                elif not tables.close[a]:
                    climb_row(phases[0], v, period, place, variance, error, flags)
            if count > 0:
                amplitude, offset = f[15], f[11]
                if tables.close[a]:
                    compare_row(
                        phases[:count],
                        variances[:count],
                        tables.fringes.period[a, :count],
                        tables.orders[a],
                        f[:6],
                        place,
                        variance,
                        work,
                        chi2,
                        flags,
                    )
                    _most(work, error)
            elif not tables.given[a]:
                fit = Fit(f[11], f[12], f[13], f[14], phases[0], variances[0], f[15], top)
                ends = _ends(raw, table, y, tables.bits, a, fit, low, high)
                read_row(
                    raw, table, noise, tables.bits, a, y, ends, work, read, place, variance, error, flags
                )
                amplitude, offset = read.half, read.middle
            limits = tables.factor[a] * _CONTRAST2, tables.extent[a], tables.more[a], _DIM * clip
            _merge(
                a == 0,
                noise,
                limits,
                place,
                variance,
                amplitude,
                offset,
                flags,
                out.amplitude[r],
                out.offset[r],
            )
        _store(error, flags, out.error[r], out.flags[r])


@kernel
def _clear(flags: I32, chi2: F32, error: F32) -> None:
    for x in range(flags.size):
        flags[x] = np.int32(0)
        chi2[x], error[x] = _ZERO, _ZERO


@kernel
def _doubt_beyond(beyond: np.float32, error: F32, flags: I32) -> None:
    if beyond > _ZERO:
        for x in range(error.size):
            error[x] = max(error[x], beyond)
            flags[x] |= _ORDER


@kernel
def _most(one: F32, error: F32) -> None:
    for x in range(error.size):
        error[x] = max(error[x], one[x])


@kernel
def _take(
    found: Lines,
    a: int,
    r: int,
    place: F32,
    variance: F32,
    amplitude: F32,
    offset: F32,
    error: F32,
    chi2: F32,
    flags: I32,
) -> None:
    """Lines of a look-up."""
    p, v, m, o, e, c, g = (
        found.place[a, r],
        found.variance[a, r],
        found.amplitude[a, r],
        found.offset[a, r],
        found.error[a, r],
        found.chi2[a, r],
        found.flags[a, r],
    )
    for x in range(place.size):
        place[x], variance[x], amplitude[x], offset[x] = p[x], v[x], m[x], o[x]
        error[x] = max(error[x], e[x])
        chi2[x] += c[x]
        flags[x] |= g[x]


@kernel
def _ends(
    raw: RawFrames, table: F32 | None, y: int, bits: BitTables, a: int, fit: Fit, low: F32, high: F32
) -> tuple[F32, F32]:
    """Levels of black and white of a row."""
    if bits.middle[a] == 0:
        f, g = raw[bits.black, y], raw[bits.white, y]
        for x in range(low.size):
            low[x], high[x] = level_of(f[x], table), level_of(g[x], table)
    elif bits.middle[a] == 1:
        o, m = fit.offset, fit.amplitude
        for x in range(low.size):
            low[x], high[x] = o[x] - m[x], o[x] + m[x]
    else:
        extremes_row(raw, table, y, bits.all, low, high)
    return low, high


@kernel
def _merge(
    first: bool,
    noise: tuple[np.float32, np.float32],
    limits: tuple[np.float32, np.float32, np.float32, np.float32],
    place: F32,
    variance: F32,
    amplitude: F32,
    offset: F32,
    flags: I32,
    least: F32,
    mean: F32,
) -> None:
    """Flags of one axis; amplitude and offset of both."""
    (read2, gain), (contrast2, extent, more, dim), none = noise, limits, np.int32(0)
    for x in range(place.size):
        a, o = amplitude[x], offset[x]
        faint = (a * a < contrast2 * (read2 + gain * max(o, _ZERO))) | (a <= _ZERO)
        flags[x] |= _LOW if faint else none
        flags[x] |= _DARK if faint & (o + a < dim) else none
    for x in range(place.size):
        c, v = place[x], variance[x] + more
        slack = _HALF + _SLACK * np.sqrt(v)
        known = abs(c) < np.float32(1e9)
        flags[x] |= none if known else _INVALID
        flags[x] |= _OFF if (c < -slack) | (c > extent - np.float32(1) + slack) else none
        place[x] = c if known else _ZERO
        variance[x] = v if known else np.float32(1e9)
    if first:
        for x in range(place.size):
            least[x], mean[x] = amplitude[x], offset[x]
    else:
        for x in range(place.size):
            least[x] = min(least[x], amplitude[x])
            mean[x] = _HALF * (mean[x] + offset[x])


@kernel
def _store(error: F32, flags: I32, errors: F32, out: NDArray[np.uint16]) -> None:
    for x in range(flags.size):
        errors[x] = error[x]
        out[x] = np.uint16(flags[x])
