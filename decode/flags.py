"""Flags, from the estimates of both axes, and the maps that the axes share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_dilation, maximum_filter, uniform_filter
from scipy.special import chdtri

from optolever.kernels import exact, kernel

from .correspondence import Flag
from .estimate import Estimate, Line
from .profile.noise import Noise, Numbers

__all__ = [
    "Into",
    "Limits",
    "Shared",
    "flag_amid_contradictions",
    "limits_of",
    "marked",
    "marks_for",
    "merge",
    "merge_line",
]

#: Probability of a wrong order above which a pixel is flagged.
DOUBT = 1e-4
#: False-alarm probability of a flag by misfit.
_CHANCE = 1e-6
#: Side of the neighbourhood in which a majority of contradictions makes all doubtful, pixels; share of the
#: image that contradicts itself below which none is sought; gaps between contradictions that are closed,
#: pixels.
_AMID, _MOST, _RARE, _GAP = 9, 0.5, 1e-3, 5
#: Modulation over its noise below which a pixel is flagged: noise alone reaches it once in 3.7e-6.
_CONTRAST = 5.0
#: Share of the camera's range that the brightest sample of a dark pixel reaches: 4 of 8 bits.
_DIM = 1 / 16

_DARK, _SATURATED, _LOW, _ORDER = (
    np.int32(Flag.DARK),
    np.int32(Flag.SATURATED),
    np.int32(Flag.LOW_CONTRAST),
    np.int32(Flag.ORDER_DOUBTFUL),
)
_OFF, _MOVED, _INVALID = np.int32(Flag.OFF_PATTERN), np.int32(Flag.MOVED), np.int32(Flag.INVALID)


class Limits(NamedTuple):
    """Of one axis: extent of the surface (px), modulation^2 over a sample's variance, chi2, darkest white
    level."""

    extent: np.float32
    contrast2: np.float32
    misfit: np.float32
    dim: np.float32


class Shared(NamedTuple):
    """Maps (H, W) that both axes share: flags uint16; smaller amplitude, mean level, error float32."""

    flags: NDArray[np.uint16]
    amplitude: NDArray[np.float32]
    offset: NDArray[np.float32]
    error: NDArray[np.float32]


def limits_of(extent: int, factor: float, freedom: int, white: float) -> Limits:
    """factor: variance of the amplitude over that of a sample; freedom: of chi2; white: where samples
    saturate."""
    most = float(chdtri(freedom, _CHANCE)) if freedom > 0 else np.inf
    dim = _DIM * white if np.isfinite(white) else 0.0
    return Limits(*(np.float32(x) for x in (extent, _CONTRAST**2 * factor, most, dim)))


class Into(NamedTuple):
    """Output maps of an axis: coordinate and variance (H, W); limits; first: the shared maps are still
    empty."""

    place: NDArray[np.float32]
    variance: NDArray[np.float32]
    limits: Limits
    first: bool
    shared: Shared


def merge(estimate: Estimate, noise: Noise, rows: tuple[int, int], into: Into) -> None:
    """Merge one axis' estimate of rows start..stop into the shared maps."""
    _merge(estimate, noise.numbers(), *rows, into)


@exact
def _merge(estimate: Estimate, noise: Numbers, start: int, stop: int, into: Into) -> None:
    place, var, error, amplitude, offset, misfit, clipped = estimate
    for row in range(start, stop):
        r = row - start
        lines = place[r], var[r], error[r], amplitude[r], offset[r], misfit[r], clipped[r]
        merge_line(lines, noise, row, into)


@kernel
def merge_line(estimate: Line, noise: Numbers, row: int, into: Into) -> None:
    """Merge one axis' estimate of a row (W,), in the order of Estimate's fields, into the shared maps."""
    coordinate, variance, error, amplitude, offset, misfit, clipped = estimate
    read2, gain, _, _ = noise
    _, _, limits, first, shared = into
    extent, contrast2, most, dim = limits
    flags, least, mean, either = shared[0][row], shared[1][row], shared[2][row], shared[3][row]
    half, zero, none = np.float32(0.5), np.float32(0), np.int32(0)
    for x in range(coordinate.size):
        c, a, o = coordinate[x], amplitude[x], offset[x]
        faint = a * a < contrast2 * (read2 + gain * max(o, zero))
        blind = variance[x] > extent * extent
        flag = none if first else np.int32(flags[x])
        flag |= _LOW if faint else none
        flag |= _DARK if faint & (o + a < dim) else none
        flag |= none if abs(c) < np.float32(1e9) else _INVALID
        flag |= _SATURATED if (blind | faint) & (clipped[x] > zero) else none
        flag |= _ORDER if (error[x] > np.float32(DOUBT)) | blind else none
        flag |= _OFF if (c < -half) | (c > extent - half) else none
        flag |= _MOVED if misfit[x] > most else none
        flags[x] = np.uint16(flag)
        wrong = min(error[x], np.float32(1))
        least[x] = a if first else min(least[x], a)
        mean[x] = o if first else half * (mean[x] + o)
        either[x] = wrong if first else either[x] + wrong - either[x] * wrong


def flag_amid_contradictions(flags: NDArray[np.uint16]) -> None:
    """Flag pixels amid a majority of contradictions, in place.

    An object in front of the pattern in some frames gives random words; some agree with fringes by chance.
    """
    moved = (flags & np.uint16(Flag.MOVED)) > 0
    if moved.mean() < _RARE:
        return
    seen = (flags & np.uint16(Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID)) == 0
    share, whole = (
        uniform_filter(one.astype(np.float32), _AMID, mode="nearest") for one in (moved & seen, seen)
    )
    core = share > np.float32(_MOST) * np.maximum(whole, np.float32(_MOST))
    # up to the rim, with fewer contradictions around, and one pixel beyond
    near = np.pad(moved & maximum_filter(core, _AMID), _GAP)
    closed = binary_dilation(binary_closing(near, np.ones((_GAP, _GAP))))
    core |= closed[_GAP:-_GAP, _GAP:-_GAP]
    np.bitwise_or(flags, np.uint16(Flag.MOVED), out=flags, where=core & seen)


@exact
def marks_for(width: int) -> NDArray[np.uint8]:
    """Room for the marks of a line, uint8, all 0."""
    return np.zeros(-(-width // 8) * 8, np.uint8)


@exact
def marked(marks: NDArray[np.uint8], places: NDArray[np.int64]) -> int:
    """Number of marked pixels of a line; places (W,): their indices. Marks are rare: eight are tested at
    once."""
    count = 0
    for first in range(0, marks.size, 8):
        some = marks[first]
        for x in range(first + 1, first + 8):
            some |= marks[x]
        for x in range(first, first + 8 if some else first):
            if marks[x] != 0:
                places[count] = x
                count += 1
    return count
