"""What a pixel sees of every bit of a code: the levels of its cells behind the blur of display and optics.

A Gaussian blur (deviation s cells) leaves of the fine bits less than of the coarse ones. Between two centres
of cells levels are interpolated. The blur is the one that explains the bits of pixels that see the pattern
best; what it does not explain (light that comes by way of the scene, other blurs) is a misfit of the levels.
A pixel's footprint is no Gaussian: each bit has a gain beside the blur, which tells whether stripes as wide
as a pixel are turned.
"""

import itertools
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from optolever.kernels import exact, inlined

from ..estimate import vanishing
from ..plan import Code

__all__ = [
    "GROUP",
    "WEAK",
    "CodePlan",
    "Levels",
    "bit_values",
    "bits_in_groups",
    "blurred",
    "fitted_levels",
    "read_beside",
    "turned",
    "weak_bits",
]

F32 = NDArray[np.float32]
#: Bits that are compared in one pass over a line.
GROUP = 4
#: Blurs that are tried, cells: a Gray code's finest bit keeps 3 % of its contrast behind the last one.
_BLURS = np.arange(0.0, 1.8, 0.2)
#: Cells by which turned bits lead beside a place; those that lead further are weak ones.
_BESIDE = 2
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


class Levels(NamedTuple):
    """What is left of a code: the blur that fits best, misfit2, the variance that it leaves unexplained, and
    the gain (bits,) of each bit over what it predicts: under 0 where a pixel sees over one whole stripe."""

    blur: int
    misfit2: float
    gain: NDArray[np.float64]


def fitted_levels(code: Code, margin: F32, variance: F32, factor: F32) -> Levels:
    """What is left of a code, by pixels that see the pattern.

    margin (bits, K) differences of bits over the amplitude, variance (K,) of a sample in the same unit,
    factor (bits,) of a difference over that of a sample.
    """
    bits, count = margin.shape
    if count < _FEWEST or len(code.cells) < 2:
        return Levels(0, 0.0, np.ones(bits))
    cell = code.cells[((margin > 0) << np.arange(bits)[:, None]).sum(axis=0)].astype(np.float32)
    expected = float(np.median(variance)) * max(bits - 1, 1)
    seen, weight = np.ascontiguousarray(margin.T), 1 / factor
    misfit, place = np.empty((2, len(_BLURS), count), np.float32)
    # a blur turns bits, so that a word leads beside its cell: found by one that is neither slight nor large
    _least_misfits(blurred(code, len(_BLURS) // 2), cell, seen, weight, _BESIDE, misfit[0], place[0])
    cell = place[0].copy()
    for blur, own in enumerate(misfit):
        _least_misfits(blurred(code, blur), cell, seen, weight, 1, own, place[blur])
    left = np.median(misfit, axis=1)
    best = int(np.argmin(left))
    usual = misfit[best] <= 2 * left[best]
    one, other, share = _between(blurred(code, best), place[best, usual])
    told = (1 - share) * one + share * other
    gain = (told * seen[usual]).sum(axis=0) / np.maximum((told * told).sum(axis=0), 1e-9)
    return Levels(best, max(float(left[best]) - expected, 0.0) / bits, gain)


@lru_cache(maxsize=8 * len(_BLURS))
def blurred(code: Code, blur: int) -> F32:
    """Levels (cells, bits) of a code behind one of the blurs."""
    spread, bits = float(_BLURS[blur]), np.arange(len(code.plain))
    sharp = np.where((np.argsort(code.cells)[:, None] >> bits) & 1, 1.0, -1.0)
    reach = int(np.ceil(4 * spread))
    edges = (np.arange(-reach, reach + 2) - 0.5) / max(spread, 1e-9)
    weights = np.diff(ndtr(edges))
    seen = correlate1d(sharp, weights / weights.sum(), axis=0, mode="nearest")
    return np.asarray(seen, np.float32)


def _between(levels: F32, place: NDArray[Any]) -> tuple[F32, F32, NDArray[Any]]:
    """Levels (K, bits) of the cells on both sides of places (K,), and the share (K, 1) of the second ones."""
    low = np.clip(np.floor(place).astype(int), 0, len(levels) - 2)
    return levels[low], levels[low + 1], np.clip(place - low, 0, 1)[:, None]


def read_beside(code: Code, levels: Levels) -> tuple[F32, F32]:
    """What a blur hides: by how many cells places that read as a cell are beside its centre (cells,), mean
    and variance beyond the cell's own; empty where it hides nothing.

    A narrow stripe between wide ones reads as one beside it, and a bit of which hardly any contrast is left
    may be turned as a whole, as stripes of one cell are that a pixel of over two sees.
    """
    if len(code.cells) < 2:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    # rounded, so that the next capture finds it again
    misfit2 = 2.0 ** round(math.log2(max(levels.misfit2, 1e-9)))
    return _hidden(code, levels.blur, misfit2, tuple(np.rint(8 * np.clip(levels.gain, -1, 1)) / 8))


@lru_cache(maxsize=16)
def _hidden(code: Code, blur: int, misfit2: float, gain: tuple[float, ...]) -> tuple[F32, F32]:
    count = len(code.cells)
    place = (np.arange(count * _PARTS) + 0.5) / _PARTS - 0.5
    one, other, share = _between(blurred(code, blur), place)
    word = (((1 - share) * one + share * other > 0) << np.arange(len(gain))).sum(axis=1)
    # at an edge a bit is sure of either side: its contrast is what is off
    contrast = np.maximum(np.abs(one), np.abs(other)) * gain
    faint = np.argsort(contrast, axis=1)[:, :2]
    chance = ndtr(-np.take_along_axis(contrast, faint, axis=1) / math.sqrt(misfit2))
    total, moved, square = np.zeros((3, count))
    for turn in itertools.product((0, 1), repeat=faint.shape[1]):
        read = code.cells[word ^ (turn << faint).sum(axis=1)]
        away = place - read
        weight = np.abs(np.subtract(turn, 1) + chance).prod(axis=1)
        weight[np.abs(away) > _BESIDE + 0.5] = 0.0  # others have weak bits
        total += np.bincount(read, weight, count)
        moved += np.bincount(read, weight * away, count)
        square += np.bincount(read, weight * away * away, count)
    mean = moved / np.maximum(total, 1e-9)
    unsure = np.maximum(square / np.maximum(total, 1e-9) - mean**2 - 1 / 12, 0.0)
    if max(np.abs(mean).max(), math.sqrt(unsure.max())) < 1 / _PARTS:
        mean = unsure = np.zeros(0)
    return mean.astype(np.float32), unsure.astype(np.float32)


@exact
def _least_misfits(
    levels: Any, cell: Any, margin: Any, weight: Any, reach: Any, least: Any, place: Any
) -> None:
    """Squared misfit (K,), weighted (bits,), of margins (K, bits) from the best mixture of two cells, up to
    `reach` from a place (K,), and where that is; levels (cells, bits)."""
    for k in range(cell.size):
        least[k] = np.inf
        near = round(cell[k])
        for at in range(max(near - reach, 0), min(near + reach, levels.shape[0] - 1)):
            top, bottom, square = 0.0, 1e-12, 0.0
            for b in range(weight.size):
                step, off = levels[at + 1, b] - levels[at, b], margin[k, b] - levels[at, b]
                top += weight[b] * step * off
                bottom += weight[b] * step * step
                square += weight[b] * off * off
            share = min(max(top / bottom, 0.0), 1.0)
            left = square - share * (2 * top - share * bottom)
            if left < least[k]:
                least[k], place[k] = left, at + share


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
