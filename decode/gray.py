"""Binary codes: bits -> word -> cell, with the probability of a wrong bit.

A bit is the sign of the difference from its inverse, or from the mean of white and black; the chance that
noise turned it is Q(z), z that difference over its deviation. At the edge of a cell one bit of a Gray code is
weak: read either way it leads to one of two cells side by side. Whatever else the weakest bit leads to, and
any other weak bit, makes the cell doubtful. Where two bits or more are weak (codes that change several bits
at once, or faint light) every word that they allow is compared: a pixel sees a mixture of one cell and the
next, b = A ((1 - f) s(c) + f s(c + 1)), f in 0..1, s the cells' levels behind the blur (bit_levels), and the
posterior is over the cells c.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, kernel

from .bit_levels import WEAK, CodePlan, fitted_levels, turned, weak_bits
from .estimate import Estimate
from .frames import Light, fetch_line, level_of
from .noise import Noise, Sample
from .plan import Code, Plan

__all__ = ["CodePlan", "code_plan", "read_code"]

#: Pixels that tell the blur at most: medians to 4 %.
_PIXELS = 1024
#: What a line keeps of the bits read so far: the value of the weakest, how weak it and the next are, the
#: largest half difference, what most passes white and black. It is passed on from line to line: compilers
#: make slow conditional stores of a maximum in place.
_WEAKEST, _LEAST, _SECOND, _LARGEST, _OVER, _KEPT = 0, 1, 2, 3, 4, 5


class _Sums(NamedTuple):
    """Of a line (W,): what the means of pairs are off the usual level, summed; their squares."""

    off: Any
    square: Any


def code_plan(code: Code, plan: Plan, noise: Noise, lit: Sample) -> CodePlan:
    """The numbers of a code, the blur of its bits by pixels that see the pattern."""
    frames = np.stack([code.plain, code.inverse], axis=1)
    pairs = (frames >= 0).all(axis=1)
    referenced = plan.white >= 0 and plan.black >= 0
    words = np.empty(len(code.cells), np.int32)
    words[code.cells] = np.arange(len(code.cells), dtype=np.int32)
    # (p - q) / 2 has half the variance of a sample, p - (white + black) / 2 has one and a half
    factor = np.where(pairs, 0.5, 1.5).astype(np.float32)
    freedom = max(int(pairs.sum()) - (0 if referenced else 1), 0) + int((~pairs).any())
    first = 0.5 * (code.cell - 1) + code.origin
    ends = np.array([plan.white, plan.black] if referenced else [-1, -1])
    few = lit.only(slice(None, None, max(1, len(lit.places) // _PIXELS)))
    margin, amplitude = _margins(frames, ends, few.levels)
    variance = few.variance(noise) / np.square(amplitude)
    levels, misfit2 = fitted_levels(words, margin / amplitude, variance, factor)
    unlike2, cell, start = (np.float32(one) for one in (misfit2, code.cell, first))
    return CodePlan(frames, factor, ends, code.cells, levels, unlike2, cell, start, freedom)


def _margins(frames: NDArray[np.int64], ends: NDArray[np.int64], levels: Any) -> tuple[Any, Any]:
    """Differences (bits, K) of bits, and the amplitude (K,), of sampled levels (N, K); as _margin below."""
    pairs, single = np.all(frames >= 0, axis=1, keepdims=True), np.where(frames[:, :1] >= 0, 1, -1)
    mean = 0.5 * (levels[ends[0]] + levels[ends[1]])
    margin = np.where(
        pairs,
        0.5 * (levels[frames[:, 0]] - levels[frames[:, 1]]),
        single * (levels[frames.max(axis=1)] - mean),
    )
    amplitude = np.abs(margin).max(axis=0) if ends[0] < 0 else 0.5 * (levels[ends[0]] - levels[ends[1]])
    return margin, np.maximum(amplitude, np.float32(1e-3))


def read_code(
    light: Light, noise: Noise, code: CodePlan, rows: tuple[int, int], alone: bool, estimate: Estimate
) -> None:
    """Read the code in rows start..stop, in place: coordinates are cells' centres.

    alone: variances are those of a place within the cell and of its neighbour where that is as likely; else
    of the cell's edges only, for a fringe that tells the place.
    """
    clip = np.float32(min(light.clip, 1e9))
    _read_rows(light.raw, light.lut, clip, *rows, code, alone, noise.numbers(), estimate.arrays())


@exact
def _read_rows(
    raw: Any, table: Any, clip: Any, start: Any, stop: Any, code: Any, alone: Any, noise: Any, out: Any
) -> None:
    """Rows start..stop; noise: Noise.numbers(), out: Estimate.arrays()."""
    place, var, error, amplitude, offset, chi2, clipped = out
    width, bits = raw.shape[2], code.factor.size
    light = np.empty((2, width), np.float32)
    word, of_bits = np.empty(width, np.int32), np.empty((2, _KEPT, width), np.float32)
    sums = _Sums(np.empty(width, np.float32), np.empty(width, np.float32))
    margin = np.empty(bits, np.float32)
    referenced = code.ends[0] >= 0
    for row in range(start, stop):
        r = row - start
        a, o = amplitude[r], offset[r]
        _begin(word, of_bits[0], sums, clipped[r])
        pairs = 0
        if referenced:
            if table is None:
                _references(raw[code.ends[0], row], raw[code.ends[1], row], a, o)
            else:
                _fetch(raw, code.ends, row, table, light)
                _references(light[0], light[1], a, o)
            _saturated(raw[code.ends[0], row], clip, clipped[r])
        for b in range(bits):
            scale, bit = np.float32(1) / np.sqrt(code.factor[b]), np.int32(1 << b)
            before, after = of_bits[b % 2], of_bits[1 - b % 2]
            plain, inverse = code.frames[b]
            if plain >= 0 and inverse >= 0:
                free = not referenced and pairs == 0
                pairs += 1
                if table is None:
                    one, other = raw[plain, row], raw[inverse, row]
                    _pair(one, other, free, scale, bit, o, sums, word, before, after)
                else:
                    _fetch(raw, code.frames[b], row, table, light)
                    _pair(light[0], light[1], free, scale, bit, o, sums, word, before, after)
            else:
                sign = np.float32(1) if plain >= 0 else np.float32(-1)
                if table is None:
                    _single(raw[max(plain, inverse), row], sign, scale, bit, o, a, word, before, after)
                else:
                    fetch_line(raw[max(plain, inverse), row], table, light[0])
                    _single(light[0], sign, scale, bit, o, a, word, before, after)
        kept = of_bits[bits % 2]
        if not referenced:
            a[:] = kept[_LARGEST]
        _cells_line(
            word, kept, code, alone, np.float32(pairs), noise, sums, a, o, place[r], var[r], error[r], chi2[r]
        )
        for x in range(width):
            own = noise.read2 + noise.gain * max(o[x], np.float32(0))
            threshold = code.misfit2 * a[x] * a[x] if pairs < bits else np.float32(0)
            weak = kept[_SECOND, x] * kept[_SECOND, x] < np.float32(WEAK * WEAK) * (own + threshold)
            if weak and a[x] * a[x] > np.float32(8) * own:
                for b in range(bits):
                    margin[b] = _margin(raw, code.frames[b], row, x, table, o[x])
                place[r, x], var[r, x], error[r, x] = weak_bits(
                    margin, code, a[x], own, alone, (place[r, x], var[r, x])
                )


@kernel
def _fetch(raw: Any, frames: Any, row: Any, table: Any, light: Any) -> None:
    """Linear levels of a row of two frames."""
    fetch_line(raw[frames[0], row], table, light[0])
    fetch_line(raw[frames[1], row], table, light[1])


@kernel
def _begin(word: Any, of_bits: Any, sums: Any, clipped: Any) -> None:
    zero, far = np.float32(0), np.float32(1e9)
    of_bits[_WEAKEST], of_bits[_LARGEST], of_bits[_OVER] = zero, zero, zero
    of_bits[_LEAST], of_bits[_SECOND] = far, far
    for x in range(word.size):
        word[x], sums.off[x], sums.square[x], clipped[x] = np.int32(0), zero, zero, zero


@kernel
def _saturated(line: Any, clip: Any, clipped: Any) -> None:
    for x in range(line.size):
        clipped[x] = np.float32(1) if np.float32(line[x]) >= clip else np.float32(0)


@kernel
def _references(white: Any, black: Any, amplitude: Any, offset: Any) -> None:
    half = np.float32(0.5)
    for x in range(offset.size):
        amplitude[x] = half * (np.float32(white[x]) - np.float32(black[x]))
        offset[x] = half * (np.float32(white[x]) + np.float32(black[x]))


@kernel
def _pair(
    one: Any,
    other: Any,
    free: Any,
    scale: Any,
    bit: Any,
    offset: Any,
    sums: Any,
    word: Any,
    before: Any,
    after: Any,
) -> None:
    """A bit and its inverse: the word, how weak its weakest bits are (deviations of a sample), and how far
    the mean of both is off the usual level, which a `free` one tells itself."""
    half, none = np.float32(0.5), np.int32(0)
    if free:
        for x in range(word.size):
            offset[x] = half * (np.float32(one[x]) + np.float32(other[x]))
    least, weakest = before[_LEAST], np.float32(bit)
    after[_OVER] = before[_OVER]
    for x in range(word.size):
        p, q = np.float32(one[x]), np.float32(other[x])
        off, apart = half * (p + q) - offset[x], half * abs(p - q)
        size = apart * scale
        sums.off[x] += off
        sums.square[x] += off * off
        word[x] |= bit if p > q else none
        after[_LARGEST, x] = max(before[_LARGEST, x], apart)
        after[_SECOND, x] = min(before[_SECOND, x], max(size, least[x]))
        after[_WEAKEST, x] = weakest if size < least[x] else before[_WEAKEST, x]
        after[_LEAST, x] = min(least[x], size)


@kernel
def _single(
    line: Any,
    sign: Any,
    scale: Any,
    bit: Any,
    offset: Any,
    amplitude: Any,
    word: Any,
    before: Any,
    after: Any,
) -> None:
    """A bit against the mean level; over: what most passes white and black, levels^2."""
    zero, none = np.float32(0), np.int32(0)
    least, weakest = before[_LEAST], np.float32(bit)
    after[_LARGEST] = before[_LARGEST]
    for x in range(word.size):
        margin = sign * (np.float32(line[x]) - offset[x])
        size = abs(margin) * scale
        over = max(abs(margin) - amplitude[x], zero)
        word[x] |= bit if margin > zero else none
        after[_OVER, x] = max(before[_OVER, x], over * over)
        after[_SECOND, x] = min(before[_SECOND, x], max(size, least[x]))
        after[_WEAKEST, x] = weakest if size < least[x] else before[_WEAKEST, x]
        after[_LEAST, x] = min(least[x], size)


@exact
def _margin(raw: Any, frames: Any, row: Any, x: Any, table: Any, offset: Any) -> Any:
    """Of one pixel: half the difference of a bit and its inverse, or that from the mean level."""
    if frames[0] >= 0 and frames[1] >= 0:
        one, other = level_of(raw[frames[0], row, x], table), level_of(raw[frames[1], row, x], table)
        return np.float32(0.5) * (one - other)
    if frames[0] >= 0:
        return level_of(raw[frames[0], row, x], table) - offset
    return offset - level_of(raw[frames[1], row, x], table)


@kernel
def _cells_line(
    word: Any,
    kept: Any,
    code: Any,
    alone: Any,
    pairs: Any,
    noise: Any,
    sums: Any,
    amplitude: Any,
    offset: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    """Cells of the words; what the weakest bit leads to if noise turned it."""
    zero, half, eighth, one = np.float32(0), np.float32(0.5), np.float32(0.125), np.float32(1)
    weakest, least, second, over = kept[_WEAKEST], kept[_LEAST], kept[_SECOND], kept[_OVER]
    cells, cell, first = code.cells, code.cell, code.first
    within, mixed = (cell * cell / np.float32(12), one) if alone else (zero, zero)
    count = one / max(pairs, one)
    # a mean of two samples; white and black are one more
    known = one - (count / (one + count) if code.ends[0] >= 0 else zero)
    # a bit and its inverse are off by the same: their difference keeps its sign
    threshold2 = code.misfit2 if pairs < np.float32(code.factor.size) else zero
    for x in range(word.size):  # the cell that a turned bit leads to
        weakest[x] = np.float32(cells[word[x] ^ np.int32(weakest[x])])
    for x in range(word.size):
        word[x] = cells[word[x]]
    for x in range(word.size):
        own = noise.read2 + noise.gain * max(offset[x], zero)
        power = amplitude[x] * amplitude[x]
        deviation = one / np.sqrt(own + threshold2 * power)
        wrong, also = turned(least[x] * deviation), turned(second[x] * deviation)
        step = weakest[x] - np.float32(word[x])
        beside = abs(step) == one
        place[x] = first + cell * (np.float32(word[x]) + (mixed * wrong * step if beside else zero))
        # an edge is as wide as a cell at most, and noise moves it by its share of the contrast
        spread = (mixed * wrong * (one - wrong) if beside else zero) + eighth * own / max(power, own)
        var[x] = within + cell * cell * spread
        wrong = zero if beside else wrong
        error[x] = wrong + also - wrong * also
        unlike = noise.rounding2 + noise.misfit2 * power
        rss = sums.square[x] - sums.off[x] * sums.off[x] * count * known
        singles = np.float32(1.5) * own + unlike + code.misfit2 * power
        chi2[x] = rss / (half * own + unlike) + over[x] / singles
