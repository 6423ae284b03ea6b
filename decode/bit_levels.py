"""What a pixel sees of every bit of a code: the levels of its cells behind the blur of display and optics.

A Gaussian blur (deviation s cells) leaves of the fine bits less than of the coarse ones. Between two centres
of cells levels are interpolated. The blur is the one that explains the bits of pixels that see the pattern
best; what it does not explain (light that comes by way of the scene, other blurs) is a misfit of the levels.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from optolever.kernels import exact, inlined

from .estimate import vanishing
from .plan import Code

__all__ = [
    "GROUP",
    "WEAK",
    "CodePlan",
    "bit_values",
    "bits_in_groups",
    "fitted_levels",
    "turned",
    "weak_bits",
]

F32 = NDArray[np.float32]
#: Bits that are compared in one pass over a line.
GROUP = 4
#: Blurs that are tried, cells: a Gray code's finest bit keeps 3 % of its contrast behind the last one.
_BLURS = np.arange(0.0, 1.8, 0.2)
#: Places of a cell at which its levels are read.
_PARTS = 16
#: Pixels that tell a blur; fewer tell none.
_FEWEST = 64
#: Deviations within which a bit is weak: noise turns others once in 3.5e6.
WEAK = 5.0
#: Weak bits of which all combinations are tried; with more a pixel tells nothing.
_MOST_WEAK = 5
#: Level from which on a bit is as bright as a white that saturates.
_FULL = 0.999


class CodePlan(NamedTuple):
    """A code as the kernels need it.

    frames (B, 2)   of each bit, least significant first, and its inverse, twice the same one where there is
                    none; filled up to whole groups by bits that are sure
    share (B, 5)    in a difference: of a bit, its inverse, the mean level, and 1; 1 for a pair
    value, scale (B,)  of bits, and one over the deviation that noise of 1 makes of their difference
    counts (B,)     1 where a difference counts as large: that of pairs where these tell the amplitude, else
                    of the others, which must not pass it
    factor (bits,)  variance of a bit's difference over that of a sample
    ends            white, black; -1: not shown
    cells           word -> cell; linear: whether a cell is the exclusive or of those of its word's bits, as
                    in all codes but long-run-gray: then these are the value of a bit, which is 1 << b else
    levels          (cells, bits) what a cell shows of a bit, -1..1; misfit2: variance that this leaves
    beside, unsure  (cells,) by how many cells places that read as a cell are beside it: mean, variance; empty
                    where none is
    whites          that are compared where white saturates, over what is read for it
    cell, first     width of a cell and coordinate of the centre of cell 0, pattern pixels
    freedom         degrees of freedom of chi2; the numbers before it are float32, as the loops are
    """

    frames: NDArray[np.int64]
    share: F32
    value: NDArray[np.int32]
    scale: F32
    counts: F32
    factor: F32
    ends: NDArray[np.int64]
    cells: NDArray[np.int32]
    linear: bool
    levels: F32
    misfit2: Any
    beside: F32
    unsure: F32
    whites: NDArray[np.float64]
    cell: Any
    first: Any
    freedom: int


class Blurred(NamedTuple):
    """Levels of a code behind a blur, and what that hides: a narrow stripe between wide ones, whose cell then
    reads as one beside it. As in a CodePlan."""

    levels: F32
    beside: F32
    unsure: F32


def bits_in_groups(
    frames: NDArray[np.int64], factor: F32, counts: NDArray[np.bool_], value: NDArray[np.int32]
) -> tuple[NDArray[np.int64], F32, NDArray[np.int32], F32, F32]:
    """frames to counts of a CodePlan; frames (bits, 2) of each bit and its inverse, -1: not shown."""
    more, pair = (0, -len(factor) % GROUP), (frames >= 0).all(axis=1)
    sign = np.where(pair, 0.5, np.where(frames[:, 0] >= 0, 1.0, -1.0))
    share = np.stack([sign, -0.5 * pair, -sign * ~pair, 0.0 * sign, pair], axis=1)
    share = np.concatenate([share, np.tile([0, 0, 0, 1e9, 0], (more[1], 1))]).astype(np.float32)
    scale = np.pad(factor, more, constant_values=1) ** -0.5
    shown = np.pad(np.where(frames < 0, frames[:, ::-1], frames), (more, (0, 0)))
    return shown, share, np.pad(value, more), scale, np.pad(counts, more).astype(np.float32)


def bit_values(cells: NDArray[np.int32]) -> tuple[NDArray[np.int32], bool]:
    """value (bits,) and linear of a CodePlan."""
    bit = 1 << np.arange(len(cells).bit_length() - 1)
    linear = all(np.array_equal(cells[k : 2 * k], cells[:k] ^ cells[k]) for k in bit.tolist())
    return (cells[bit] if linear else bit.astype(np.int32)), linear


def fitted_levels(code: Code, margin: F32, variance: F32, factor: F32) -> tuple[Blurred, float]:
    """Levels behind the blur that fits best, and the variance that they leave unexplained.

    margin (bits, K) differences of bits over the amplitude, variance (K,) of a sample in the same unit,
    factor (bits,) of a difference over that of a sample.
    """
    bits, count = margin.shape
    tried = _tried(code)
    if count < _FEWEST or len(code.cells) < 2:
        return tried[0], 0.0
    cell = code.cells[((margin > 0) << np.arange(bits)[:, None]).sum(axis=0)]
    expected = float(np.median(variance)) * max(bits - 1, 1)
    misfit = np.empty((len(tried), count), np.float32)
    for one, least in zip(tried, misfit, strict=True):
        _least_misfits(one.levels, cell, np.ascontiguousarray(margin.T), 1 / factor, least)
    left = np.median(misfit, axis=1)
    best = int(np.argmin(left))
    return tried[best], max(float(left[best]) - expected, 0.0) / bits


@lru_cache(maxsize=8)
def _tried(code: Code) -> list[Blurred]:
    """A code behind each of the blurs."""
    bits = np.arange(len(code.plain))
    sharp = np.where((np.argsort(code.cells)[:, None] >> bits) & 1, 1.0, -1.0)
    return [_blurred(code.cells, sharp, float(blur)) for blur in _BLURS]


def _blurred(cells: NDArray[np.int32], sharp: NDArray[np.float64], blur: float) -> Blurred:
    """sharp (cells, bits): levels in front of the blur."""
    reach = int(np.ceil(4 * blur))
    edges = (np.arange(-reach, reach + 2) - 0.5) / max(blur, 1e-9)
    weights = np.diff(ndtr(edges))
    levels = correlate1d(sharp, weights / weights.sum(), axis=0, mode="nearest").astype(np.float32)
    count, bits = levels.shape
    place = (np.arange(count * _PARTS) + 0.5) / _PARTS - 0.5
    low = np.clip(np.floor(place).astype(int), 0, max(count - 2, 0))
    share = np.clip(place - low, 0, 1)[:, None]
    seen = (1 - share) * levels[low] + share * levels[np.minimum(low + 1, count - 1)]
    read = cells[((seen > 0) << np.arange(bits)).sum(axis=1)]
    off = np.repeat(np.arange(count), _PARTS) - read
    near = np.abs(off) <= 2  # others have weak bits
    read, off = read[near], off[near]
    if not off.any():
        return Blurred(levels, np.zeros(0, np.float32), np.zeros(0, np.float32))
    total, moved, square = (np.bincount(read, weight, count) for weight in (None, off, off * off))
    mean = moved / np.maximum(total, 1)
    return Blurred(
        levels, mean.astype(np.float32), (square / np.maximum(total, 1) - mean**2).astype(np.float32)
    )


@exact
def _least_misfits(levels: Any, cell: Any, margin: Any, weight: Any, least: Any) -> None:
    """Squared misfit (K,), weighted (bits,), of margins (K, bits) from the best mixture of a cell (K,) and
    one beside it; levels (cells, bits)."""
    for k in range(cell.size):
        least[k] = np.inf
        for before in range(2):
            at = min(max(cell[k] - before, 0), levels.shape[0] - 2)
            top, bottom, square = 0.0, 1e-12, 0.0
            for b in range(weight.size):
                step, off = levels[at + 1, b] - levels[at, b], margin[k, b] - levels[at, b]
                top += weight[b] * step * off
                bottom += weight[b] * step * step
                square += weight[b] * off * off
            share = min(max(top / bottom, 0.0), 1.0)
            least[k] = min(least[k], square - share * (2 * top - share * bottom))


@inlined
def turned(z: Any) -> Any:
    """Q(z) for z >= 0 within 2 % (W. Boerjesson, C. Sundberg, doi:10.1109/TCOM.1979.1094433)."""
    return vanishing(np.float32(0.5) * z * z) / (
        np.float32(1.64) * z + np.sqrt(np.float32(0.76) * z * z + np.float32(4))
    )


@exact
def weak_bits(
    margin: Any, code: Any, amplitude: Any, noise: Any, saturated: Any, alone: Any, read: Any
) -> Any:
    """Posterior over the mixtures of one cell and the next that the weak bits of a pixel allow: place,
    variance, probability of another cell; saturated: white is, so that all that it may be are compared; read:
    place and variance as they are where it tells nothing."""
    factor, cells, levels, whites = code.factor, code.cells, code.levels, code.whites
    unlike2 = float(code.misfit2)
    weak = np.empty(_MOST_WEAK, np.int64)
    count, word = 0, np.int32(0)
    for b in range(factor.size):
        word |= np.int32(1 << b) if margin[b] > 0 else np.int32(0)
        threshold = unlike2 * amplitude * amplitude if factor[b] > 1 else 0.0
        either = saturated and factor[b] > 1 and 0 < margin[b] < _FULL * amplitude
        if either or margin[b] * margin[b] < WEAK * WEAK * (noise + threshold) * factor[b]:
            if count == _MOST_WEAK:
                return read[0], read[1], np.float32(1)
            weak[count] = b
            count += 1
    judged = noise / (amplitude * amplitude) + unlike2
    if saturated:  # as far as whites are from the next
        judged += (whites[1] - whites[0]) ** 2 / 12
    tried = whites.size if saturated else 1
    best, at, curve = np.inf, 0, 1.0
    weight, near, beside, shift = 0.0, 0.0, 0.0, 0.0
    for turn in range(2):  # the best mixture, then the weight of all, of its cell and those beside it
        for some in range(1 << count):
            this = word
            for i in range(count):
                this ^= np.int32(((some >> i) & 1) << weak[i])
            for before in range(2):
                c = cells[this] - before
                inside = 0 <= c < levels.shape[0] - 1
                for k in range(tried if inside else 0):
                    seen = margin, factor, amplitude, whites[k] if saturated else 0.0
                    rss, share, sharp = _mixture(seen, float(before), levels[c], levels[c + 1])
                    rss /= judged
                    here = c + (1 if share > 0.5 else 0)
                    if turn == 0 and rss < best:
                        best, at, curve = rss, here, sharp
                    if turn == 1:
                        likely = np.exp(-0.5 * (rss - best))
                        weight += likely
                        near += likely * _near(c, share, np.sqrt(judged / sharp), at)
                        beside += likely if abs(here - at) == 1 else 0.0
                        shift += likely * (here - at) if abs(here - at) == 1 else 0.0
    if weight == 0.0:
        return read[0], read[1], np.float32(1)
    # the mixture's edge is known to the noise of its share, a cell to its width
    variance = min(noise / (amplitude * amplitude * curve), 0.25)
    shift = shift / weight if alone and saturated else 0.0  # by a threshold that is off to one side
    variance += 1 / 12 + beside / weight - shift * shift if alone else 0.0
    place = code.first + code.cell * np.float32(at + shift)
    return place, code.cell * code.cell * np.float32(variance), np.float32(1 - near / weight)


@inlined
def _near(c: Any, share: Any, deviation: Any, at: Any) -> Any:
    """Chance that a place between cells c and c + 1, known to a deviation, lies in cell `at` or beside."""
    if c == at or c == at - 1:
        return 1.0
    if c != at + 1 and c != at - 2:
        return 0.0
    z = np.float32((1.5 - abs(c + share - at)) / deviation)
    return 1.0 - turned(z) if z > 0 else turned(-z)


@exact
def _mixture(seen: Any, share: Any, one: Any, other: Any) -> tuple[Any, Any, Any]:
    """Of the best mixture of two cells' levels: squared misfit over the factor and the squared amplitude, the
    share of the other one, and its curvature; seen: margins, factors, amplitude, white (see _level); share:
    where it starts."""
    margin, factor, amplitude, white = seen
    bottom = 1e-6
    for _ in range(2 if white > 0 else 1):  # the share tells which saturated samples say something
        top, bottom = 0.0, 1e-6
        for b in range(factor.size):
            step = other[b] - one[b]
            level = _level(margin[b] / amplitude, factor[b], white, one[b] + share * step)
            top += step * (level - one[b]) / factor[b]
            bottom += step * step / factor[b]
        share = min(max(top / bottom, 0.0), 1.0)
    rss, common, singles = 0.0, 0.0, 0
    for b in range(factor.size):
        expected = one[b] + share * (other[b] - one[b])
        off = _level(margin[b] / amplitude, factor[b], white, expected) - expected
        if factor[b] > 1:  # a sample against the mean of white and black, whose noise all of these share
            rss += off * off
            common += off
            singles += 1
        else:
            rss += off * off / factor[b]
    return rss - common * common / (singles + 2), share, bottom


@inlined
def _level(level: Any, factor: Any, white: Any, expected: Any) -> Any:
    """Level of a bit, if white is so many times as far from black as what is read for it (0: as far); where a
    single bit saturates, what is expected, if that would."""
    if white == 0.0 or factor <= 1:
        return level
    return (level + 1) / white - 1 if level < _FULL else max(expected, 2 / white - 1)
