"""Binary codes: bits -> word -> cell, with the probability of a wrong bit.

A bit is the sign of the difference from its inverse, or from the mean of white and black; the chance that
noise turned it is Q(z), z that difference over its deviation. At the edge of a cell one bit of a Gray code is
weak: read either way it leads to one of two cells side by side. Whatever else the weakest bit leads to, and
any other weak bit, makes the cell doubtful. Where two bits or more are weak (codes that change several bits
at once, or faint light) every word that they allow is compared: a pixel sees a mixture of one cell and the
next, b = A ((1 - f) s(c) + f s(c + 1)), f in 0..1, s the cells' levels behind the blur (bit_levels), and the
posterior is over the cells c.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, kernel

from .bit_levels import WEAK, fitted_levels, turned, weak_bits
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


@dataclass(frozen=True, slots=True)
class CodePlan:
    """A code as the kernel needs it.

    frames (bits, 2): of each bit, least significant first, and its inverse, -1: not shown
    factor (bits,)  variance of a bit's difference over that of a sample
    ends            white, black; -1: not shown
    cells           word -> cell
    levels          (cells, bits) what a cell shows of a bit, -1..1; misfit2: variance that this leaves
    cell, first     width of a cell and coordinate of the centre of cell 0, pattern pixels
    freedom         degrees of freedom of chi2
    """

    frames: NDArray[np.int64]
    factor: NDArray[np.float32]
    ends: NDArray[np.int64]
    cells: NDArray[np.int32]
    levels: NDArray[np.float32]
    misfit2: float
    cell: float
    first: float
    freedom: int


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
    return CodePlan(frames, factor, ends, code.cells, levels, misfit2, code.cell, first, freedom)


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
    _read_rows(
        *(light.raw, light.lut, np.float32(min(light.clip, 1e9)), *rows),
        *(code.frames, code.factor, code.ends, code.cells, code.levels, np.float32(code.misfit2)),
        *(np.float32(code.cell), np.float32(code.first), alone, *noise.numbers()),
        *(estimate.coordinate, estimate.variance, estimate.error, estimate.amplitude),
        *(estimate.offset, estimate.chi2, estimate.clipped),
    )


@exact
def _read_rows(
    raw: Any,
    table: Any,
    clip: Any,
    start: Any,
    stop: Any,
    frames: Any,
    factor: Any,
    ends: Any,
    cells: Any,
    levels: Any,
    unlike2: Any,
    cell: Any,
    first: Any,
    alone: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
    place: Any,
    var: Any,
    error: Any,
    amplitude: Any,
    offset: Any,
    chi2: Any,
    clipped: Any,
) -> None:
    width, bits = raw.shape[2], factor.size
    light = np.empty((0 if table is None else 2, width), np.float32)
    word, of_bits = np.empty(width, np.int32), np.empty((2, _KEPT, width), np.float32)
    total, square = np.empty(max(width, bits), np.float32), np.empty(width, np.float32)
    referenced = ends[0] >= 0
    for row in range(start, stop):
        r = row - start
        a, o, c2 = amplitude[r], offset[r], chi2[r]
        _begin(word, of_bits[0], total, square, clipped[r])
        pairs = 0
        if referenced:
            if table is None:
                _references(raw[ends[0], row], raw[ends[1], row], a, o)
            else:
                fetch_line(raw[ends[0], row], table, light[0])
                fetch_line(raw[ends[1], row], table, light[1])
                _references(light[0], light[1], a, o)
            _saturated(raw[ends[0], row], clip, clipped[r])
        for b in range(bits):
            scale, bit = np.float32(1) / np.sqrt(factor[b]), np.int32(1 << b)
            plain, inverse = frames[b, 0], frames[b, 1]
            before, after = of_bits[b % 2], of_bits[1 - b % 2]
            if plain >= 0 and inverse >= 0:
                free = not referenced and pairs == 0
                pairs += 1
                if table is None:
                    one, other = raw[plain, row], raw[inverse, row]
                    if free:
                        _half_sum(one, other, o)
                    _pair(one, other, scale, bit, o, total, square, word, before, after)
                else:
                    fetch_line(raw[plain, row], table, light[0])
                    fetch_line(raw[inverse, row], table, light[1])
                    if free:
                        _half_sum(light[0], light[1], o)
                    _pair(light[0], light[1], scale, bit, o, total, square, word, before, after)
            else:
                sign = np.float32(1) if plain >= 0 else np.float32(-1)
                line = raw[max(plain, inverse), row]
                if table is None:
                    _single(line, sign, scale, bit, o, a, word, before, after)
                else:
                    fetch_line(line, table, light[0])
                    _single(light[0], sign, scale, bit, o, a, word, before, after)
        kept = of_bits[bits % 2]
        weakest, least, second = kept[_WEAKEST], kept[_LEAST], kept[_SECOND]
        if not referenced:
            a[:] = kept[_LARGEST]
        c2[:] = kept[_OVER]
        _cells_line(
            *(
                word,
                weakest,
                least,
                second,
                cells,
                cell,
                first,
                alone,
                np.float32(pairs),
                np.float32(bits),
                referenced,
            ),
            *(a, o, total, square, read2, gain, rounding2, misfit2, unlike2, place[r], var[r], error[r], c2),
        )
        for x in range(width):
            noise = read2 + gain * max(o[x], np.float32(0))
            if (
                second[x] * second[x]
                < np.float32(WEAK * WEAK)
                * (noise + (unlike2 * a[x] * a[x] if pairs < bits else np.float32(0)))
                and a[x] * a[x] > np.float32(8) * noise
            ):
                for b in range(bits):
                    total[b] = _margin(raw, frames[b], row, x, table, o[x])
                weak_bits(
                    *(total[:bits], factor, cells, levels, a[x], noise, unlike2, cell, first, alone),
                    *(x, place[r], var[r], error[r]),
                )


@kernel
def _begin(word: Any, of_bits: Any, total: Any, square: Any, clipped: Any) -> None:
    zero, far = np.float32(0), np.float32(1e9)
    of_bits[_WEAKEST], of_bits[_LARGEST], of_bits[_OVER] = zero, zero, zero
    of_bits[_LEAST], of_bits[_SECOND] = far, far
    for x in range(word.size):
        word[x], total[x], square[x], clipped[x] = np.int32(0), zero, zero, zero


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
def _half_sum(one: Any, other: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = np.float32(0.5) * (np.float32(one[x]) + np.float32(other[x]))


@kernel
def _pair(
    one: Any,
    other: Any,
    scale: Any,
    bit: Any,
    offset: Any,
    total: Any,
    square: Any,
    word: Any,
    before: Any,
    after: Any,
) -> None:
    """A bit and its inverse: the word, how weak its weakest bits are (deviations of a sample), and how far
    the mean of both is off the usual level."""
    half, none = np.float32(0.5), np.int32(0)
    least, weakest = before[_LEAST], np.float32(bit)
    after[_OVER] = before[_OVER]
    for x in range(word.size):
        p, q = np.float32(one[x]), np.float32(other[x])
        off, apart = half * (p + q) - offset[x], half * abs(p - q)
        size = apart * scale
        total[x] += off
        square[x] += off * off
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
    weakest: Any,
    least: Any,
    second: Any,
    cells: Any,
    cell: Any,
    first: Any,
    alone: Any,
    pairs: Any,
    bits: Any,
    referenced: Any,
    amplitude: Any,
    offset: Any,
    total: Any,
    square: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
    unlike2: Any,
    place: Any,
    var: Any,
    error: Any,
    chi2: Any,
) -> None:
    """Cells of the words; what the weakest bit leads to if noise turned it."""
    within = cell * cell / np.float32(12) if alone else np.float32(0)
    mixed = np.float32(1) if alone else np.float32(0)
    one = np.float32(1)
    count = one / max(pairs, one)
    # a mean of two samples; white and black are one more
    known = one / (one + count) if referenced else np.float32(0)
    known = one - known * count
    # a bit and its inverse are off by the same: their difference keeps its sign
    threshold2 = unlike2 if pairs < bits else np.float32(0)
    zero, half, eighth = np.float32(0), np.float32(0.5), np.float32(0.125)
    for x in range(word.size):  # the cell that a turned bit leads to
        weakest[x] = np.float32(cells[word[x] ^ np.int32(weakest[x])])
    for x in range(word.size):
        word[x] = cells[word[x]]
    for x in range(word.size):
        noise = read2 + gain * max(offset[x], zero)
        power = amplitude[x] * amplitude[x]
        deviation = one / np.sqrt(noise + threshold2 * power)
        wrong, also = turned(least[x] * deviation), turned(second[x] * deviation)
        step = weakest[x] - np.float32(word[x])
        beside = abs(step) == one
        unlike = rounding2 + misfit2 * power
        place[x] = first + cell * (np.float32(word[x]) + (mixed * wrong * step if beside else zero))
        # an edge is as wide as a cell at most, and noise moves it by its share of the contrast
        spread = (mixed * wrong * (one - wrong) if beside else zero) + eighth * noise / max(power, noise)
        var[x] = within + cell * cell * spread
        wrong = zero if beside else wrong
        error[x] = wrong + also - wrong * also
        of_pairs = (square[x] - total[x] * total[x] * count * known) / (half * noise + unlike)
        chi2[x] = of_pairs + chi2[x] / (np.float32(1.5) * noise + unlike + unlike2 * power)
