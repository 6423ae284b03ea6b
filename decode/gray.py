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

from optolever.kernels import exact, inlined, kernel

from .bit_levels import GROUP, WEAK, CodePlan, bits_in_groups, fitted_levels, turned, weak_bits
from .estimate import Estimate
from .frames import Light, level_of
from .noise import Noise, Sample
from .plan import Code, Plan

__all__ = ["CodePlan", "code_plan", "read_code"]

#: Pixels that tell the blur at most: medians to 4 %.
_PIXELS = 1024
#: What a line keeps of the bits compared so far: the value of the weakest, how weak it and the next are, the
#: largest difference that counts. It is passed on from group to group: compilers make slow conditional stores
#: of a maximum in place.
_WEAKEST, _LEAST, _SECOND, _LARGEST, _KEPT = 0, 1, 2, 3, 4


class _Lines(NamedTuple):
    """Room for a line: margins (bits, W), words (W,), what is kept of bits (2, _KEPT, W), and what the means
    of pairs are off the usual level, summed, and squared (2, W)."""

    margin: Any
    word: Any
    kept: Any
    off: Any


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
    of_bits = bits_in_groups(factor, pairs != referenced)
    return CodePlan(frames, factor, *of_bits, ends, code.cells, levels, unlike2, cell, start, freedom)


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
    width, bits, pairs = raw.shape[2], code.factor.size, np.float32(np.sum(code.factor < 1))
    lines = _Lines(
        np.full((code.value.size, width), np.float32(1e9)),
        np.empty(width, np.int32),
        np.empty((2, _KEPT, width), np.float32),
        np.empty((2, width), np.float32),
    )
    # a bit and its inverse are off by the same: their difference keeps its sign
    misfit2 = np.float32(0) if pairs == bits else code.misfit2
    for row in range(start, stop):
        r = row - start
        a, o, numbers = amplitude[r], offset[r], (pairs, misfit2, alone, noise)
        clipped[r], lines.off[:] = np.float32(0), np.float32(0)
        if code.ends[0] >= 0:
            _references(raw[code.ends[0], row], raw[code.ends[1], row], table, a, o)
            _saturated(raw[code.ends[0], row], clip, clipped[r])
        _margins_line(raw, row, table, code, o, lines)
        kept = _compared(code, lines)
        if code.ends[0] < 0:
            a[:], kept[_LARGEST] = kept[_LARGEST], np.float32(0)
        _cells_line(lines, kept, code, numbers, a, o, place[r], var[r], error[r], chi2[r])
        _several_weak(kept[_SECOND], misfit2, noise, a, o, lines.word)
        for x in range(width):
            if lines.word[x] != 0:
                own = noise.read2 + noise.gain * max(o[x], np.float32(0))
                place[r, x], var[r, x], error[r, x] = weak_bits(
                    lines.margin[:bits, x], code, a[x], own, alone, (place[r, x], var[r, x])
                )


@exact
def _margins_line(raw: Any, row: Any, table: Any, code: Any, offset: Any, lines: Any) -> None:
    """Of every bit half the difference from its inverse, or that from the mean level, which the first pair
    tells where no references do."""
    free = code.ends[0] < 0
    for b in range(code.factor.size):
        plain, inverse = code.frames[b]
        if plain >= 0 and inverse >= 0:
            _pair(raw[plain, row], raw[inverse, row], table, free, offset, lines.margin[b], lines.off)
            free = False
        else:
            sign = np.float32(1) if plain >= 0 else np.float32(-1)
            _single(raw[max(plain, inverse), row], table, sign, offset, lines.margin[b])


@exact
def _compared(code: Any, lines: Any) -> Any:
    """Words of a line, and what is kept of their bits (_KEPT, W)."""
    before, after = lines.kept[0], lines.kept[1]
    lines.word[:], before[_WEAKEST], before[_LARGEST] = 0, np.float32(0), np.float32(0)
    before[_LEAST], before[_SECOND] = np.float32(1e9), np.float32(1e9)
    for b in range(0, code.value.size, GROUP):
        group = slice(b, b + GROUP)
        bits = code.value[group], code.scale[group], code.counts[group]
        _join(lines.margin[group], bits, lines.word, before, after)
        before, after = after, before
    return before


@kernel
def _saturated(line: Any, clip: Any, clipped: Any) -> None:
    for x in range(line.size):
        clipped[x] = np.float32(1) if np.float32(line[x]) >= clip else np.float32(0)


@kernel
def _references(white: Any, black: Any, table: Any, amplitude: Any, offset: Any) -> None:
    half = np.float32(0.5)
    for x in range(offset.size):
        high, low = level_of(white[x], table), level_of(black[x], table)
        amplitude[x], offset[x] = half * (high - low), half * (high + low)


@kernel
def _pair(one: Any, other: Any, table: Any, free: Any, offset: Any, margin: Any, sums: Any) -> None:
    """A bit and its inverse: half their difference, and how far their mean is off the usual level, which a
    `free` one tells itself."""
    half, (off, square) = np.float32(0.5), (sums[0], sums[1])
    if free:
        for x in range(offset.size):
            offset[x] = half * (level_of(one[x], table) + level_of(other[x], table))
    for x in range(offset.size):
        p, q = level_of(one[x], table), level_of(other[x], table)
        away = half * (p + q) - offset[x]
        margin[x] = half * (p - q)
        off[x] += away
        square[x] += away * away


@kernel
def _single(line: Any, table: Any, sign: Any, offset: Any, margin: Any) -> None:
    for x in range(offset.size):
        margin[x] = sign * (level_of(line[x], table) - offset[x])


@kernel
def _join(margin: Any, bits: Any, word: Any, before: Any, after: Any) -> None:
    """A group of bits, whose margins are (GROUP, W), joins the words and what is kept of them."""
    value, scale, counts = bits
    for x in range(word.size):
        kept = word[x], before[_WEAKEST, x], before[_LEAST, x], before[_SECOND, x], before[_LARGEST, x]
        for k in range(GROUP):
            kept = _with_bit(margin[k, x], value[k], scale[k], counts[k], kept)
        word[x], after[_WEAKEST, x], after[_LEAST, x], after[_SECOND, x], after[_LARGEST, x] = kept


@inlined
def _with_bit(margin: Any, value: Any, scale: Any, counts: Any, kept: Any) -> Any:
    """Word, value of the weakest bit, how weak it and the next are (deviations of a sample), largest margin
    that counts."""
    word, weakest, least, second, largest = kept
    size = abs(margin)
    weak = size * scale
    return (
        word + value * np.int32(margin > np.float32(0)),
        np.float32(value) if weak < least else weakest,
        min(least, weak),
        min(second, max(weak, least)),
        max(largest, size * counts),
    )


@kernel
def _cells_line(
    lines: Any,
    kept: Any,
    code: Any,
    numbers: Any,
    amplitude: Any,
    offset: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    """Cells of the words; what the weakest bit leads to if noise turned it."""
    zero, half, eighth, one = np.float32(0), np.float32(0.5), np.float32(0.125), np.float32(1)
    weakest, least, second, largest = kept[_WEAKEST], kept[_LEAST], kept[_SECOND], kept[_LARGEST]
    word, off, square = lines.word, lines.off[0], lines.off[1]
    (pairs, misfit2, alone, noise), (cells, cell, first) = numbers, (code.cells, code.cell, code.first)
    within, mixed = (cell * cell / np.float32(12), one) if alone else (zero, zero)
    count = one / max(pairs, one)
    # a mean of two samples; white and black are one more
    known = one - (count / (one + count) if code.ends[0] >= 0 else zero)
    for x in range(word.size):  # the cell that a turned bit leads to
        weakest[x] = np.float32(cells[word[x] ^ np.int32(weakest[x])])
    for x in range(word.size):
        word[x] = cells[word[x]]
    for x in range(word.size):
        own = noise.read2 + noise.gain * max(offset[x], zero)
        power = amplitude[x] * amplitude[x]
        deviation = one / np.sqrt(own + misfit2 * power)
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
        rss = square[x] - off[x] * off[x] * count * known
        over = max(largest[x] - amplitude[x], zero)
        singles = np.float32(1.5) * own + unlike + code.misfit2 * power
        chi2[x] = rss / (half * own + unlike) + over * over / singles


@kernel
def _several_weak(second: Any, misfit2: Any, noise: Any, amplitude: Any, offset: Any, several: Any) -> None:
    """Whether (W,) more than one bit is weak in a pixel that is not as weak itself."""
    sure = np.float32(WEAK * WEAK)
    for x in range(several.size):
        own = noise.read2 + noise.gain * max(offset[x], np.float32(0))
        power = amplitude[x] * amplitude[x]
        weak = second[x] * second[x] < sure * (own + misfit2 * power)
        several[x] = np.int32(weak & (power > np.float32(8) * own))
