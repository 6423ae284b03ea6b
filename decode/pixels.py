"""Levels of one pixel -> place, variance, amplitude, residual, flags; by blocks of rows."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, I32, kernel
from optolever.kernels import HALF as _HALF
from optolever.kernels import ZERO as _ZERO

from .codes.bits import BitTable, ends_of, read_rows
from .codes.fringe import Fit, FringeTable, fringe_rows
from .codes.lookup import Lines
from .codes.orders import Orders, climb_row, compare_row, join_row, start_row
from .frames import RawFrames
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
    of the amplitude over a sample's; more (A,): variance of every place, px^2; extent (A,): of the surface,
    px; beyond (A,): share of the surface that the coarsest period does not cover; either (A,): flags where
    two orders fit the interval of a code, see neighbours.settle."""

    fringes: tuple[tuple[FringeTable, ...], ...]
    bits: tuple[BitTable | None, ...]
    orders: tuple[Orders, Orders]
    given: NDArray[np.bool_]
    close: NDArray[np.bool_]
    factor: F32
    more: F32
    extent: F32
    beyond: F32
    either: I32


class Maps(NamedTuple):
    """Outputs for rows: place, variance, amplitude of the coarsest fringe (A, n, W), chi2, least amplitude,
    offset, error (n, W) float32, flags (n, W) uint16."""

    place: F32
    variance: F32
    amplitude: F32
    chi2: F32
    least: F32
    offset: F32
    error: F32
    flags: NDArray[np.uint16]


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
    """Decode rows start..stop of the frames into rows 0..stop - start of out, of maps (A, n, W) from row `at`
    on; looked_up: (A, n, W) of look-ups."""
    raw, table, clip = light
    shape = stop - start, raw.shape[2]
    chi2, error, flags = out.chi2[: shape[0]], out.error[: shape[0]], np.zeros(shape, np.int32)
    chi2[:], error[:] = 0, 0
    for a, (fringes, code) in enumerate(zip(tables.fringes, tables.bits, strict=True)):
        place, variance, amplitude = (
            one[a, at : at + shape[0]] for one in (out.place, out.variance, out.amplitude)
        )
        if tables.given[a]:
            place[:], variance[:] = looked_up.place[a], looked_up.variance[a]
            amplitude[:], offset = looked_up.amplitude[a], looked_up.offset[a]
            np.maximum(error, looked_up.error[a], out=error)
            chi2 += looked_up.chi2[a]
            flags |= looked_up.flags[a]
        elif fringes:
            offset = np.empty(shape, np.float32)
            phases, own = np.empty((2, len(fringes) if tables.close[a] else 1, *shape), np.float32)
            for k, fringe in enumerate(fringes):
                j = k if tables.close[a] else 0
                amplitude = amplitude if k == 0 else np.empty(shape, np.float32)
                fringe_rows(
                    light, noise, fringe, start, Fit(offset, amplitude, phases[j], own[j]), chi2, flags
                )
                lines = [one.reshape(-1) for one in (place, variance, error, flags)]
                if tables.close[a]:
                    continue
                measured = phases[0].reshape(-1), own[0].reshape(-1), fringe.period
                if k > 0:
                    climb_row(*measured, *lines)
                elif code is not None:
                    known = offset - amplitude, offset + amplitude
                    ends = known if code.fringe else ends_of(raw, table, code, start, stop)
                    reach = read_rows(raw, table, noise, code, start, ends, place, error, flags)
                    join_row(*measured, reach.reshape(-1), *lines, tables.either[a])
                else:
                    start_row(*measured, tables.extent[a], *lines[:2])
                    if tables.beyond[a] > 0:
                        np.maximum(error, tables.beyond[a], out=error)
                        flags |= _ORDER
            if tables.close[a]:
                pixels = shape[0] * shape[1]
                work, wrong = np.empty((6, pixels), np.float32), np.empty(pixels, np.float32)
                periods = np.array([fringe.period for fringe in fringes])
                several = phases.reshape(-1, pixels), own.reshape(-1, pixels), periods, tables.orders[a]
                compare_row(*several, work, *lines[:2], wrong, chi2.reshape(-1), lines[3])
                np.maximum(error, wrong.reshape(shape), out=error)
        elif code is not None:
            low, high = ends_of(raw, table, code, start, stop)
            reach = read_rows(raw, table, noise, code, start, (low, high), place, error, flags)
            np.multiply(reach, reach, out=variance)
            variance /= 3
            np.subtract(high, low, out=amplitude)
            amplitude *= _HALF
            offset = low + amplitude
        limits = tables.factor[a] * _CONTRAST2, tables.extent[a], tables.more[a], _DIM * clip
        maps = [one.reshape(-1) for one in (place, variance, amplitude, offset, flags, out.least, out.offset)]
        _merge(a == 0, noise, limits, *maps)
    out.flags[: shape[0]] = flags


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
