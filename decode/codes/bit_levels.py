"""Levels of a code's bits behind a blur: which bits are resolved, and the posterior of a pixel's words.

A Gaussian blur (deviation s cells) attenuates fine bits more than coarse ones. Levels are interpolated
between the centres of two cells. The blur is the one that fits the bits of illuminated pixels best; the
residual (light by way of the scene, other blurs) is a misfit of the levels.

A pixel of more than a period of a bit's stripes may read them reversed, even without noise. Where a coarser
bit changes, a finer one is known: its sign is checked there (see `unresolved_bits`). Bits that fail are
removed from the code. Each remaining bit of a word has an independent error probability, from its distance to
the threshold over noise and misfit; these give the posterior over words (see `posterior`).
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from optolever.kernels import Real, exact, inlined

from ..estimate import less_likely, vanishing
from ..flags import DOUBT
from ..plan import Code

__all__ = [
    "GROUP",
    "WEAK",
    "CodePlan",
    "bit_contrast",
    "bit_values",
    "bits_in_groups",
    "blurred",
    "coarser",
    "dull_level",
    "fitted_levels",
    "hidden_variance",
    "mixture",
    "nested",
    "posterior",
    "turned",
    "unresolved_bits",
]

F32 = NDArray[np.float32]
#: Of a pixel: place, variance, probability of another place.
_Answer = tuple[np.float32, np.float32, np.float32]
#: Bits per pass over a line.
GROUP = 4
#: Trial blurs, cells: the last one reduces the contrast of a Gray code's finest bit to 3 %.
_BLURS = np.arange(0.0, 1.8, 0.2)
#: Largest displacement, cells, by wrong bits next to an edge; larger ones come from weak bits.
_BESIDE = 2
#: Places per cell.
_PARTS = 8
#: Contrast from which on a bit is resolved; contrast below which it is not, if too few edges test it.
_SURE, _NONE = 0.5, 0.1
#: Share of the contrast below which a level is neither black nor white: in a pixel of four cells a bit has
#: half of it in the cell next to its edge.
_DULL = 0.35
#: Contrast, relative to the bit's maximum, below which a bit is at an edge; share of wrong signs by noise.
_EDGE, _WRONG = 0.2, 0.01
#: Fewest pixels for a blur; pixels for a contrast to 1 %.
_FEWEST, _ENOUGH = 64, 1024
#: Deviations within which a bit is weak: noise turns a stronger one once in 3.5e6.
WEAK = 5.0
#: Weak bits in all combinations; a pixel with more is not decoded.
_MOST_WEAK = 5
#: Level from which on a bit is as bright as a white that saturates.
_FULL = 0.999
#: Cells on both sides of a pixel's word for its posterior; negligible probability; largest number of
#: doublings of a pixel's cell; largest deviation of a result, cells.
_WINDOW, _TINY, _DOUBLED, _WIDEST = 32, 1e-6, 3, 4.0


class CodePlan(NamedTuple):
    """A code in the form for kernels.

    frames (B, 2)   of each bit, least significant first, and its inverse, the same frame twice without an
                    inverse; filled up to complete groups by bits that never count as weak
    share (B, 5)    weights in a difference: of a bit, its inverse, the mean level, and 1; 1 for a pair
    value, scale (B,)  of bits, and one over the deviation of their difference for noise of 1
    counts (B,)     1 if a difference enters the largest one: of pairs where these give the amplitude, else
                    of the others, which must not exceed it
    factor (bits,)  variance of a bit's difference over that of a sample
    ends            white, black; -1: none
    cells           word -> cell; linear: whether a cell is the exclusive or of the cells of its word's bits,
                    as in all codes but long-run-gray: then these are the value of a bit, which is 1 << b else
    levels          (cells, bits) of a bit in a cell, -1..1; misfit2: variance of a bit's level beyond noise,
                    of bits that are compared with white and black, or next to unresolved bits
    together        whether several bits change between adjacent cells
    hidden          variance of the cell behind the blur, beyond that of a place within it
    nested          whether the upper bits of a word give a cell of twice, four times, ... the width
    by_fringe       whether bits are compared with the mean of a fringe; above: offset of this threshold over
                    the fringe's amplitude, to the middle of the bits' levels
    contrast (bits,)  largest level of a bit over the amplitude
    dull            level over the amplitude below which a bit is neither black nor white, unless at its edge;
                    0 of codes that change several bits together
    cell, first     width of a cell and coordinate of the centre of cell 0, pattern pixels
    freedom         degrees of freedom of chi2; the numbers before it are float32, as in the kernels
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
    misfit2: np.float32
    together: bool
    hidden: np.float32
    nested: bool
    by_fringe: bool
    above: np.float32
    contrast: F32
    dull: np.float32
    cell: np.float32
    first: np.float32
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


def bit_contrast(level: F32) -> F32:
    """90 % quantile of the levels (bits,); level (bits, K): see fitted_levels."""
    if not level.size:
        return np.ones(len(level), np.float32)
    some = level[:, :: max(1, level.shape[1] // _ENOUGH)]
    return np.asarray(np.quantile(np.abs(some), 0.9, axis=1), np.float32)


def coarser(code: Code, bits: int) -> Code:
    """A code without its finest bits; of nested codes only."""
    words = np.arange(len(code.cells) >> bits) << bits
    cells = (code.cells[words] >> bits).astype(np.int32)
    return replace(
        code, plain=code.plain[bits:], inverse=code.inverse[bits:], cell=code.cell * 2**bits, cells=cells
    )


def nested(code: Code) -> bool:
    """Whether the upper bits of a word give a cell of twice, four times, ... the width."""
    return code.kind in ("gray", "binary")


def unresolved_bits(code: Code, level: F32, variance: F32, factor: F32) -> tuple[int, float]:
    """Number of finest bits that the camera does not resolve, and if there are any, the variance of the next
    bit's level beyond noise.

    level (bits, K), variance (K,), factor (bits,): see fitted_levels.
    """
    bits = len(level)
    contrast = bit_contrast(level)
    count = 0
    for b in range(bits - 2 if nested(code) else 0):
        if contrast[b] >= _SURE:  # coarser bits are resolved, too, unless frames are wrong
            break
        if not _right_at_edges(code, level, contrast, b):
            count = b + 1
    if count == 0 or count == bits:
        return 0, 0.0
    seen = _at_edges(code, level, contrast, count)
    if len(seen[0]) < _FEWEST:
        return count, 0.0
    known = float(np.median(variance)) * float(factor[count])
    return count, max(float(np.var(seen[0])) - known, 0.0)


def dull_level(code: Code, level: F32) -> float:
    """Level over the amplitude below which bits of a code that changes one at a time are neither black nor
    white, unless at an edge: a share of the least contrast.

    Every cell is at an edge of the finest bit, which is excluded. level (bits, K): see fitted_levels.
    """
    if code.together or len(level) < 2 or not level.size:
        return 0.0
    return _DULL * float(bit_contrast(level[1:]).min())


def _right_at_edges(code: Code, level: F32, contrast: F32, b: int) -> bool:
    """Whether bit b has the code's sign where a coarser one changes."""
    (seen,) = _at_edges(code, level, contrast, b)
    return contrast[b] > _NONE if len(seen) < _FEWEST else bool((seen <= 0).mean() < _WRONG)


def _at_edges(code: Code, level: F32, contrast: F32, b: int) -> tuple[F32]:
    """Level of bit b, positive if the code's sign is right, where one coarser bit changes.

    There a Gray code's bit is in the middle of a stripe of 0, except for the bit that follows the changing
    one. A binary code's bit falls where the highest changing bit rises, and vice versa: their signs are
    opposite on either side.
    """
    first = b + 2 if code.kind == "gray" else b + 1
    coarse = np.abs(level[first:]) / np.maximum(contrast[first:, None], 1e-6)
    if code.kind == "gray":
        return (-level[b, (coarse < _EDGE).sum(axis=0) == 1],)
    weak = coarse < _EDGE
    top = len(weak) - 1 - np.argmax(weak[::-1], axis=0)
    at = np.flatnonzero(weak.any(axis=0))
    side = level[first + top[at], at]
    clear = np.abs(side) > _EDGE / 4
    return (-np.sign(side[clear]) * level[b, at[clear]],)


def fitted_levels(code: Code, margin: F32, variance: F32, factor: F32) -> tuple[int, float]:
    """Index of the blur that fits a code's bits best, and the residual variance, from illuminated pixels.

    margin (bits, K) differences of bits over the amplitude, variance (K,) of a sample in the same unit,
    factor (bits,) of a difference over that of a sample.
    """
    bits, count = margin.shape
    if count < _FEWEST or len(code.cells) < 2:
        return 0, 0.0
    cell = code.cells[((margin > 0) << np.arange(bits)[:, None]).sum(axis=0)].astype(np.float32)
    expected = float(np.median(variance)) * max(bits - 1, 1)
    seen, weight = np.ascontiguousarray(margin.T), 1 / factor
    misfit, place = np.empty((2, len(_BLURS), count), np.float32)
    # a blur turns bits, and the word gives another cell: search around it with a medium blur
    _least_misfits(blurred(code, len(_BLURS) // 2), cell, seen, weight, _BESIDE, misfit[0], place[0])
    cell = place[0].copy()
    for blur, own in enumerate(misfit):
        _least_misfits(blurred(code, blur), cell, seen, weight, 1, own, place[blur])
    left = np.median(misfit, axis=1)
    best = int(np.argmin(left))
    return best, max(float(left[best]) - expected, 0.0) / bits


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


@lru_cache(maxsize=8 * len(_BLURS))
def hidden_variance(code: Code, blur: int) -> float:
    """Variance (cells^2) of a place in the cell that is read behind a blur, beyond the variance within a
    cell: where several bits change together, a narrow stripe between wide ones reads as one of these."""
    levels, parts = blurred(code, blur), len(code.cells) * _PARTS
    place = np.clip((np.arange(parts) + 0.5) / _PARTS - 0.5, 0, len(levels) - 1)
    low = np.minimum(place.astype(int), len(levels) - 2)
    share = (place - low)[:, None]
    word = ((((1 - share) * levels[low] + share * levels[low + 1]) > 0) << np.arange(levels.shape[1])).sum(1)
    away = place - code.cells[word]
    return max(float(np.square(away[np.abs(away) <= _BESIDE + 0.5]).mean()) - 1 / 12, 0.0)


@exact
def _least_misfits(
    levels: F32, cell: F32, margin: F32, weight: F32, reach: int, least: F32, place: F32
) -> None:
    """Least squared misfit (K,), weighted (bits,), of margins (K, bits) from mixtures of two adjacent cells
    within `reach` of a place (K,), and the place of the minimum; levels (cells, bits)."""
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
def turned(z: Real) -> Real:
    """Q(z) for z >= 0 within 2 % (W. Boerjesson, C. Sundberg, doi:10.1109/TCOM.1979.1094433)."""
    root: Real = np.sqrt(np.float32(0.76) * z * z + np.float32(4))
    return vanishing(np.float32(0.5) * z * z) / (np.float32(1.64) * z + root)


@exact
def posterior(
    margin: F32, code: CodePlan, amplitude: np.float32, noise: np.float32, saturated: bool, alone: bool
) -> _Answer:
    """Posterior over the words that a pixel's weak bits allow: place, variance, probability of another place.

    Bits are wrong independently. The result is the run of cells around the most probable one; of a nested
    code cells are doubled until no other is likely. margin (bits,): differences; saturated: whether white
    saturates, so that the threshold may be higher; alone: see read_line.
    """
    weak, wrong = np.empty(margin.size, np.int64), np.empty(margin.size, np.float32)
    sure, weakest, least = np.empty(margin.size, np.float32), 0, np.float32(1e9)
    count, word, power = 0, np.int32(0), amplitude * amplitude
    for b in range(code.factor.size):
        word |= np.int32(1 << b) if margin[b] > 0 else np.int32(0)
        either = saturated and code.factor[b] > 1 and 0 < margin[b] < np.float32(_FULL) * amplitude
        z2 = margin[b] * margin[b] / ((noise + code.misfit2 * power) * code.factor[b])
        if either or z2 < WEAK * WEAK:
            z, full2 = np.sqrt(z2), np.square(code.contrast[b] * amplitude) * z2 / max(margin[b] ** 2, 1e-9)
            weak[count] = b
            wrong[count] = np.float32(0.5) if either else turned(z)
            # of black and white, at half of the contrast at least, the nearer one: by their likelihood ratio
            sure[count] = less_likely(z * np.sqrt(full2)) if 16 * z2 > full2 and not either else wrong[count]
            weakest = count if z2 < least or either else weakest
            least = min(z2, least)
            count += 1
    # one bit may be at its own edge, where all levels are equally likely
    for i in range(count):
        beside = abs(code.cells[word ^ np.int32(1 << weak[i])] - code.cells[word]) == 1
        wrong[i] = wrong[i] if beside and i == weakest else sure[i]
    doubled, most = 0, _DOUBLED if code.nested else 0
    chance, some_of = np.empty(2 * _WINDOW + 1, np.float32), np.empty(_MOST_WEAK, np.int64)
    while True:
        number, others = _weakest(weak[:count], wrong[:count], doubled, some_of)
        home = code.cells[word] >> doubled
        chance[:] = np.float32(0)
        for some in range(1 << number):
            this, likely = word, np.float32(1)
            for k in range(number):
                i, turn = some_of[k], (some >> k) & 1
                this ^= np.int32(turn << weak[i])
                likely *= wrong[i] if turn else np.float32(1) - wrong[i]
            at = (code.cells[this] >> doubled) - home + _WINDOW
            if 0 <= at < chance.size:
                chance[at] += likely
        place, variance, error = _connected(chance, alone)
        error = min(error + others, np.float32(1))
        if error < np.float32(DOUBT) or doubled == most:
            break
        doubled += 1
    scale = np.float32(1 << doubled)
    if variance * scale * scale > np.float32(_WIDEST**2):
        error = np.float32(1)
    if not alone:  # half widths beyond that of the code's cell, and of an edge
        variance += np.square((scale - 1) / (2 * scale))
        variance += np.float32(0.125) * (noise + code.misfit2 * power) / max(power, noise)
    wide = code.cell * scale
    middle = code.first + code.cell * (scale - 1) / 2
    return middle + wide * (np.float32(home - _WINDOW) + place), wide * wide * variance, error


@exact
def _weakest(weak: NDArray[np.int64], wrong: F32, first: int, out: NDArray[np.int64]) -> tuple[int, Real]:
    """Number of weak bits to combine, from bit `first` on, with the largest error probabilities, and their
    indices into `out`; probability that one of the others is wrong."""
    number, others = 0, np.float32(0)
    for i in range(weak.size):
        if weak[i] < first:
            continue
        if number < out.size:
            out[number] = i
            number += 1
            continue
        least = 0
        for k in range(1, number):
            least = k if wrong[out[k]] < wrong[out[least]] else least
        if wrong[i] > wrong[out[least]]:
            others += wrong[out[least]]
            out[least] = i
        else:
            others += wrong[i]
    return number, others


@exact
def _connected(chance: F32, alone: bool) -> _Answer:
    """From probabilities of cells: place (cells), variance, and probability outside the run of cells around
    the most probable one. Each cell of the run above DOUBT is within five deviations. Not alone: the most
    probable cell itself, and the variance beyond its neighbours."""
    best = np.argmax(chance)
    low, high = best, best
    while low > 0 and chance[low - 1] > np.float32(_TINY):
        low -= 1
    while high < chance.size - 1 and chance[high + 1] > np.float32(_TINY):
        high += 1
    total, mean, square, beyond = 0.0, 0.0, 0.0, 0.0
    for at in range(low, high + 1):
        total += chance[at]
        mean += chance[at] * (at - best)
        square += chance[at] * (at - best) ** 2
        if abs(at - best) > 1:
            beyond += chance[at] * (abs(at - best) - 1) ** 2
    error = np.float32(max(1 - total, 0.0))
    if not alone:
        return np.float32(best), np.float32(beyond / total), error
    mean /= total
    variance = square / total - mean * mean + 1 / 12
    for at in range(low, high + 1):
        if chance[at] > np.float32(DOUBT):
            variance = max(variance, np.square((abs(at - best - mean) + 0.5) / 5))
    return np.float32(best + mean), np.float32(variance), error


@exact
def mixture(
    margin: F32,
    code: CodePlan,
    amplitude: np.float32,
    noise: np.float32,
    alone: bool,
    read: tuple[np.float32, np.float32],
) -> _Answer:
    """Posterior over the mixtures of two adjacent cells that the weak bits of a pixel allow, for binary
    codes: place, variance, probability of another cell. read: place and variance if
    there is no result."""
    factor, cells, levels = code.factor, code.cells, code.levels
    unlike2 = float(code.misfit2)
    weak = np.empty(_MOST_WEAK, np.int64)
    count, word = 0, np.int32(0)
    for b in range(factor.size):
        word |= np.int32(1 << b) if margin[b] > 0 else np.int32(0)
        threshold = unlike2 * amplitude * amplitude
        if margin[b] * margin[b] < WEAK * WEAK * (noise + threshold) * factor[b]:
            if count == _MOST_WEAK:
                return read[0], read[1], np.float32(1)
            weak[count] = b
            count += 1
    judged = float(noise / (amplitude * amplitude)) + unlike2
    best, at, curve = np.inf, 0, 1.0
    weight, near, beside = 0.0, 0.0, 0.0
    for turn in range(2):  # the best mixture, then the weights of all, of its cell and adjacent ones
        for some in range(1 << count):
            this = word
            for i in range(count):
                this ^= np.int32(((some >> i) & 1) << weak[i])
            for before in range(2):
                c = cells[this] - before
                if 0 <= c < levels.shape[0] - 1:
                    rss, share, sharp = _mixture(margin, factor, amplitude, levels[c], levels[c + 1])
                    rss /= judged
                    here = c + (1 if share > 0.5 else 0)
                    if turn == 0 and rss < best:
                        best, at, curve = rss, here, sharp
                    if turn == 1:
                        likely = np.exp(-0.5 * (rss - best))
                        weight += likely
                        near += likely * _near(c, share, np.sqrt(judged / sharp), at)
                        beside += likely if abs(here - at) == 1 else 0.0
    if weight == 0.0:
        return read[0], read[1], np.float32(1)
    # the mixture's edge has the variance of its share, a cell that of its width
    variance = min(float(noise / (amplitude * amplitude * curve)), 0.25)
    variance += 1 / 12 + beside / weight if alone else 0.0
    place = code.first + code.cell * np.float32(at)
    return place, code.cell * code.cell * np.float32(variance), np.float32(1 - near / weight)


@inlined
def _near(c: int, share: float, deviation: float, at: int) -> Real:
    """Probability that a place between cells c and c + 1, known to a deviation, is in cell `at` or next to
    it."""
    if c == at or c == at - 1:
        return 1.0
    if c != at + 1 and c != at - 2:
        return 0.0
    z = np.float32((1.5 - abs(c + share - at)) / deviation)
    return 1.0 - turned(z) if z > 0 else turned(-z)


@exact
def _mixture(
    margin: F32, factor: F32, amplitude: np.float32, one: F32, other: F32
) -> tuple[float, float, float]:
    """Best mixture of two cells' levels: squared misfit over the factor and the squared amplitude, share of
    the second cell, curvature; margins, factors, levels: (bits,)."""
    top, bottom = 0.0, 1e-6
    for b in range(factor.size):
        step = other[b] - one[b]
        top += step * (margin[b] / amplitude - one[b]) / factor[b]
        bottom += step * step / factor[b]
    share = min(max(top / bottom, 0.0), 1.0)
    rss, common, singles = 0.0, 0.0, 0
    for b in range(factor.size):
        off = margin[b] / amplitude - one[b] - share * (other[b] - one[b])
        if factor[b] > 1:  # a sample against the mean of white and black, whose noise is common to these bits
            rss += off * off
            common += off
            singles += 1
        else:
            rss += off * off / factor[b]
    return rss - common * common / (singles + 2), share, bottom
