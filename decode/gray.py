"""Binary codes: bits -> word -> cell, with the probability of a wrong bit.

A bit is the sign of the difference from its inverse, or from the mean of white and black; the chance that noise
turned it is Q(z), z that difference over its deviation. At the edge of a cell one bit of a Gray code is weak: read
either way it leads to one of two cells side by side. Whatever else the weakest bit leads to, and any other weak
bit, makes the cell doubtful. Where two bits or more are weak (codes that change several bits at once, or faint
light) every word that they allow is compared: a pixel sees a mixture of one cell and the next,
b = A ((1 - f) s(c) + f s(c + 1)), f in 0..1, and the posterior is over the cells c.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .estimate import Estimate
from .frames import Light, fetch_rows
from .noise import Noise
from .plan import Code, Plan
from .unwrap import vanishing

__all__ = ["CodePlan", "code_plan", "read_code"]

#: Deviations within which a bit is weak: noise turns others once in 3.5e6.
_WEAK = 5.0
#: Weak bits of which all combinations are tried; with more a pixel tells nothing.
_MOST_WEAK = 5


@dataclass(frozen=True, slots=True)
class CodePlan:
    """A code as the kernel needs it.

    frames (bits, 2): of each bit, least significant first, and its inverse, -1: not shown
    factor (bits,)  variance of a bit's difference over that of a sample
    ends            white, black; -1: not shown
    cells           word -> cell; words (cells,) the other way round
    cell, first     width of a cell and coordinate of the centre of cell 0, pattern pixels
    freedom         degrees of freedom of chi2
    """

    frames: NDArray[np.int64]
    factor: NDArray[np.float32]
    ends: NDArray[np.int64]
    cells: NDArray[np.int32]
    words: NDArray[np.int32]
    cell: float
    first: float
    freedom: int


def code_plan(code: Code, plan: Plan) -> CodePlan:
    """The numbers of a code."""
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
    return CodePlan(frames, factor, ends, code.cells, words, code.cell, first, freedom)


def read_code(
    light: Light, noise: Noise, code: CodePlan, rows: tuple[int, int], alone: bool, estimate: Estimate
) -> None:
    """Read the code in rows start..stop, in place: coordinates are cells' centres.

    alone: variances are those of a place within the cell and of its neighbour where that is as likely; else of the
    cell's edges only, for a fringe that tells the place.
    """
    _read_rows(
        *(light.raw, light.table, np.float32(light.clip), *rows),
        *(code.frames, code.factor, code.ends, code.cells, code.words),
        *(np.float32(code.cell), np.float32(code.first), alone, *noise.numbers()),
        *(estimate.coordinate, estimate.variance, estimate.error, estimate.amplitude),
        *(estimate.offset, estimate.chi2, estimate.clipped),
    )


@inlined
def turned(z: Any) -> Any:
    """Q(z) for z >= 0 within 2 % (W. Boerjesson, C. Sundberg, doi:10.1109/TCOM.1979.1094433)."""
    return vanishing(np.float32(0.5) * z * z) / (
        np.float32(1.64) * z + np.sqrt(np.float32(0.76) * z * z + np.float32(4))
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
    words: Any,
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
    light = np.empty((2, width), np.float32)
    margin = np.empty((bits, width), np.float32)
    word, weakest = np.empty(width, np.int32), np.empty(width, np.int32)
    least, second = np.empty(width, np.float32), np.empty(width, np.float32)
    total, square = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(start, stop):
        r = row - start
        a, o, c2 = amplitude[r], offset[r], chi2[r]
        referenced = ends[0] >= 0
        pairs = 0
        word[:], weakest[:], total[:], square[:], c2[:] = 0, 0, 0, 0, 0
        least[:], second[:] = np.float32(1e9), np.float32(1e9)
        clipped[r, :] = np.float32(0)
        if referenced:
            if fetch_rows(raw, ends, row, table, clip, light):
                _count(raw[ends[0], row], clip, clipped[r])
            _half_difference(light[0], light[1], a)
            _half_sum(light[0], light[1], o)
        for b in range(bits):
            both = frames[b, 0] >= 0 and frames[b, 1] >= 0
            if both:
                fetch_rows(raw, frames[b], row, table, clip, light)
                if not referenced and pairs == 0:
                    a[:] = np.float32(0)
                    _half_sum(light[0], light[1], o)
                pairs += 1
                _half_difference(light[0], light[1], margin[b])
                _uneven(light[0], light[1], o, total, square)
            else:
                plain = frames[b, 0] >= 0
                fetch_rows(raw, frames[b, 0:1] if plain else frames[b, 1:2], row, table, clip, light)
                _single(light[0], plain, o, a, margin[b], c2)
            if not referenced:
                _largest(margin[b], a)
            _bit(margin[b], np.float32(1) / np.sqrt(factor[b]), b, word, weakest, least, second)
        _cells_line(
            *(word, weakest, least, second, cells, cell, first, alone, np.float32(pairs), referenced),
            *(a, o, total, square, read2, gain, rounding2, misfit2, place[r], var[r], error[r], c2),
        )
        for x in range(width):
            noise = read2 + gain * max(o[x], np.float32(0))
            if second[x] * second[x] < np.float32(_WEAK * _WEAK) * noise and a[x] * a[x] > np.float32(8) * noise:
                _weak_bits(
                    *(x, margin, factor, words[word[x]], cells, words, a[x], noise, cell, first, alone),
                    *(place[r], var[r], error[r]),
                )


@exact
def _count(line: Any, clip: Any, clipped: Any) -> None:
    for x in range(line.size):
        clipped[x] = np.float32(1) if line[x] >= clip else np.float32(0)


@kernel
def _half_difference(one: Any, other: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = np.float32(0.5) * (one[x] - other[x])


@kernel
def _half_sum(one: Any, other: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = np.float32(0.5) * (one[x] + other[x])


@kernel
def _uneven(one: Any, other: Any, offset: Any, total: Any, square: Any) -> None:
    """Sums of how far the mean of a bit and its inverse is off the usual level."""
    for x in range(offset.size):
        total[x] += np.float32(0.5) * (one[x] + other[x]) - offset[x]
    for x in range(offset.size):
        off = np.float32(0.5) * (one[x] + other[x]) - offset[x]
        square[x] += off * off


@kernel
def _single(line: Any, plain: Any, offset: Any, amplitude: Any, margin: Any, chi2: Any) -> None:
    """Difference from the mean level; what most passes white and black, levels^2."""
    sign = np.float32(1) if plain else np.float32(-1)
    for x in range(offset.size):
        margin[x] = sign * (line[x] - offset[x])
    for x in range(offset.size):
        over = max(abs(margin[x]) - amplitude[x], np.float32(0))
        chi2[x] = max(chi2[x], over * over)


@kernel
def _largest(margin: Any, amplitude: Any) -> None:
    for x in range(amplitude.size):
        amplitude[x] = max(amplitude[x], abs(margin[x]))


@kernel
def _bit(margin: Any, scale: Any, b: Any, word: Any, weakest: Any, least: Any, second: Any) -> None:
    """One more bit of the words; the weakest, its margin and the next one's, in deviations of a sample."""
    bit, number = np.int32(1 << b), np.int32(b)
    for x in range(word.size):
        word[x] |= bit if margin[x] > np.float32(0) else np.int32(0)
    for x in range(word.size):
        second[x] = min(second[x], max(abs(margin[x]) * scale, least[x]))
    for x in range(word.size):
        weakest[x] = number if abs(margin[x]) * scale < least[x] else weakest[x]
    for x in range(word.size):
        least[x] = min(least[x], abs(margin[x]) * scale)


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
    referenced: Any,
    amplitude: Any,
    offset: Any,
    total: Any,
    square: Any,
    read2: Any,
    gain: Any,
    rounding2: Any,
    misfit2: Any,
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
    for x in range(word.size):  # the cell that a turned bit leads to
        weakest[x] = cells[word[x] ^ (np.int32(1) << weakest[x])]
    for x in range(word.size):
        word[x] = cells[word[x]]
    for x in range(word.size):  # in deviations
        least[x] = least[x] / np.sqrt(read2 + gain * max(offset[x], np.float32(0)))
    for x in range(word.size):
        off = np.float32(weakest[x] - word[x])
        step = off if abs(off) == one else np.float32(0)
        place[x] = first + cell * (np.float32(word[x]) + mixed * turned(least[x]) * step)
    for x in range(word.size):
        beside = abs(weakest[x] - word[x]) == 1
        wrong = turned(least[x])
        spread = mixed * wrong * (one - wrong) if beside else np.float32(0)
        # an edge is as wide as a cell at most, and noise moves it by its share of the contrast
        noise = read2 + gain * max(offset[x], np.float32(0))
        power = max(amplitude[x] * amplitude[x], noise)
        var[x] = within + cell * cell * (spread + np.float32(0.125) * noise / power)
    for x in range(word.size):
        noise = read2 + gain * max(offset[x], np.float32(0))
        wrong = np.float32(0) if abs(weakest[x] - word[x]) == 1 else turned(least[x])
        also = turned(second[x] / np.sqrt(noise))
        error[x] = wrong + also - wrong * also
    for x in range(word.size):
        noise = read2 + gain * max(offset[x], np.float32(0))
        unlike = rounding2 + misfit2 * amplitude[x] * amplitude[x]
        of_pairs = (square[x] - total[x] * total[x] * count * known) / (np.float32(0.5) * noise + unlike)
        chi2[x] = of_pairs + chi2[x] / (np.float32(1.5) * noise + unlike)


@exact
def _weak_bits(
    x: Any,
    margin: Any,
    factor: Any,
    word: Any,
    cells: Any,
    words: Any,
    amplitude: Any,
    noise: Any,
    cell: Any,
    first: Any,
    alone: Any,
    place: Any,
    var: Any,
    error: Any,
) -> None:
    """Posterior over the mixtures of one cell and the next that the weak bits of a pixel allow."""
    weak = np.empty(_MOST_WEAK, np.int64)
    count = 0
    for b in range(factor.size):
        if margin[b, x] * margin[b, x] < _WEAK * _WEAK * noise * factor[b]:
            if count == _MOST_WEAK:
                error[x] = np.float32(1)
                return
            weak[count] = b
            count += 1
    best, best_cell, best_share = np.inf, 0, 0.0
    weight, near = 0.0, 0.0
    for turn in range(2):  # the best mixture, then the weight of all and of those beside it
        for some in range(1 << count):
            this = word
            for i in range(count):
                this ^= np.int32(((some >> i) & 1) << weak[i])
            for before in range(2):
                c = cells[this] - before
                if 0 <= c < words.size - 1:
                    rss, share = _mixture(x, margin, factor, words[c], words[c + 1], amplitude, noise)
                    if turn == 0 and rss < best:
                        best, best_cell, best_share = rss, c, share
                    if turn == 1:
                        here = np.exp(-0.5 * (rss - best))
                        weight += here
                        near += here if abs(c - best_cell) <= 1 else 0.0
    if weight == 0.0:
        error[x] = np.float32(1)
        return
    at = best_cell + (1 if best_share > 0.5 else 0)
    place[x] = first + cell * np.float32(at)
    # the mixture's edge is known to the noise of its share, a cell to its width
    within = 1 / 12 if alone else 0.0
    var[x] = cell * cell * np.float32(within + min(0.125 * noise / (amplitude * amplitude), 0.25))
    error[x] = np.float32(1 - near / weight)


@exact
def _mixture(
    x: Any, margin: Any, factor: Any, one: Any, other: Any, amplitude: Any, noise: Any
) -> tuple[Any, Any]:
    """Misfit of the best mixture of two words, and the share of the other one."""
    top, bottom = 0.0, 1e-30
    for b in range(factor.size):
        if ((one ^ other) >> b) & 1:
            sign = 1.0 if (other >> b) & 1 else -1.0
            top += (sign * margin[b, x] + amplitude) / factor[b]
            bottom += 2.0 * amplitude / factor[b]
    share = min(max(top / bottom, 0.0), 1.0)
    rss = 0.0
    for b in range(factor.size):
        first = 1.0 if (one >> b) & 1 else -1.0
        second = 1.0 if (other >> b) & 1 else -1.0
        off = margin[b, x] - amplitude * ((1 - share) * first + share * second)
        rss += off * off / (factor[b] * noise)
    return rss, share
