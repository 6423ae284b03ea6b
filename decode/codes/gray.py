"""Binary codes: bits -> word -> cell, with the probability of a wrong bit.

A bit is the sign of the difference from its inverse, or from the mean of white and black; the chance that
noise turned it is Q(z), z that difference over its deviation. At the edge of a cell one bit of a Gray code is
weak: read either way it leads to one of two cells side by side. Whatever else the weakest bit leads to, and
any other weak bit, makes the cell doubtful. Where two bits or more are weak (codes that change several bits
at once, or faint light) every word that they allow is compared: a pixel sees a mixture of one cell and the
next, b = A ((1 - f) s(c) + f s(c + 1)), f in 0..1, s the cells' levels behind the blur (bit_levels), and the
posterior is over the cells c.

Where white saturates, its level is known from below only. A bit and its inverse compare as ever, but their
mean tells nothing; a single bit that is brighter than the mean of black and of what is read for white, and
does not saturate, may be either, and every white up to twice as bright is compared, too.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from ..estimate import Estimate, vanishing
from ..flags import Into, marked, marks_for, merge_line
from ..frames import Light, level_of
from ..plan import Code, Plan
from ..profile.noise import Noise, Sample
from .bit_levels import (
    GROUP,
    WEAK,
    CodePlan,
    bit_values,
    bits_in_groups,
    blurred,
    fitted_levels,
    read_beside,
    turned,
    weak_bits,
)

__all__ = ["CodePlan", "code_plan", "decode_code", "read_code", "read_line", "room_for"]

#: Pixels that tell the blur at most: medians to 4 %; at least, that tell white where it saturates.
_PIXELS, _FEWEST = 1024, 64
#: Levels between which a bit changes; whites that are compared where white saturates.
_BETWEEN, _WHITES = 0.9, 5
#: What a line keeps of the bits compared so far: the value of the weakest, how weak it and the next are, the
#: largest difference that counts. It is passed on from group to group: compilers make slow conditional stores
#: of a maximum in place.
_WEAKEST, _LEAST, _SECOND, _LARGEST, _KEPT = 0, 1, 2, 3, 4


class _Room(NamedTuple):
    """For a line: words (W,), of a linear code cells; what is kept of bits (2, _KEPT, W); what the means of
    pairs are off the usual level, summed, and squared (2, W); differences of one pixel (bits,); marks of
    pixels of several weak bits, and where they are (W,)."""

    word: Any
    kept: Any
    off: Any
    margin: Any
    several: Any
    places: Any


def code_plan(code: Code, plan: Plan, noise: Noise, lit: Sample) -> CodePlan:
    """The numbers of a code, the blur of its bits by pixels that see the pattern."""
    frames = np.stack([code.plain, code.inverse], axis=1)
    pairs = (frames >= 0).all(axis=1)
    referenced = plan.white >= 0 and plan.black >= 0
    # (p - q) / 2 has half the variance of a sample, p - (white + black) / 2 has one and a half
    factor = np.where(pairs, 0.5, 1.5).astype(np.float32)
    freedom = max(int(pairs.sum()) - (0 if referenced else 1), 0) + int((~pairs).any())
    first = 0.5 * (code.cell - 1) + code.origin
    ends = np.array([plan.white, plan.black] if referenced else [-1, -1])
    value, linear = bit_values(code.cells)
    of_bits = bits_in_groups(frames, factor, pairs != referenced, value)
    few = lit.only(slice(None, None, max(1, len(lit.places) // _PIXELS)))
    shown, share = of_bits[0][: len(frames)], of_bits[1][: len(frames)].astype(np.float64)
    margin, amplitude = _margins(shown, share, ends, few.levels)
    variance = few.variance(noise) / np.square(amplitude)
    seen = fitted_levels(code, margin / amplitude, variance, factor)
    unlike2, cell, start = (np.float32(one) for one in (seen.misfit2, code.cell, first))
    whites = np.linspace(1, 2, _WHITES)
    if code.together and referenced:
        whites = _whites(few.levels[ends[0]] >= few.white, margin[factor > 1] / amplitude)
    told = blurred(code, seen.blur), unlike2, *read_beside(code, seen), whites
    return CodePlan(*of_bits, factor, ends, code.cells, linear, *told, cell, start, freedom)


def _whites(saturated: Any, level: Any) -> NDArray[np.float64]:
    """Whites that may be where white saturates, in units of what is read for it: what bits say that turn
    opposite ways at one place, as their sum is that of white and black; else up to twice as bright.

    saturated (K,), level (bits, K) of bits without inverses, black -1, what is read for white 1.
    """
    mixed = (level > -_BETWEEN) & (level < _BETWEEN)
    several = saturated & (mixed.sum(axis=0) > 1)
    if np.count_nonzero(several) < _FEWEST:
        return np.linspace(1, 2, _WHITES)
    some, kept = level[:, several], mixed[:, several]
    ends = np.where(kept, some, -1).max(axis=0) + np.where(kept, some, 1).min(axis=0)
    least, most = np.clip(1 + np.quantile(ends, (0.05, 0.95)) / 2, 1, 2)
    return np.linspace(least, most, _WHITES)


def _margins(frames: NDArray[np.int64], share: Any, ends: NDArray[np.int64], levels: Any) -> tuple[Any, Any]:
    """Differences (bits, K) of bits, and the amplitude (K,), of sampled levels (N, K); frames (bits, 2) and
    share (bits, 5) as of a CodePlan."""
    white, black = levels[ends[0]], levels[ends[1]]
    one, other, mean = share[:, 0:1], share[:, 1:2], share[:, 2:3] * (0.5 * (white + black))
    margin = one * levels[frames[:, 0]] + other * levels[frames[:, 1]] + mean
    amplitude = np.abs(margin).max(axis=0) if ends[0] < 0 else 0.5 * (white - black)
    return margin, np.maximum(amplitude, np.float32(1e-3))


def read_code(light: Light, noise: Noise, code: CodePlan, rows: tuple[int, int], estimate: Estimate) -> None:
    """Read the code in rows start..stop, in place: coordinates are cells' centres."""
    _read_rows(light.numbers(), rows, code, noise.numbers(), estimate)


@exact
def _read_rows(light: Any, rows: Any, code: Any, noise: Any, out: Any) -> None:
    place, var, error, amplitude, offset, chi2, clipped = out
    room = room_for(code, place.shape[1])
    for row in range(rows[0], rows[1]):
        r = row - rows[0]
        line = place[r], var[r], error[r], amplitude[r], offset[r], chi2[r], clipped[r]
        read_line(light, row, code, True, noise, room, line)


def decode_code(light: Light, noise: Noise, code: CodePlan, rows: tuple[int, int], into: Into) -> None:
    """Coordinates of rows start..stop from the code alone."""
    _decode_rows(light.numbers(), rows, code, noise.numbers(), into)


@exact
def _decode_rows(light: Any, rows: Any, code: Any, noise: Any, into: Any) -> None:
    """A row at a time, so that what it tells is still in the cache."""
    width = into.place.shape[1]
    room, own = room_for(code, width), np.empty((5, width), np.float32)
    for row in range(rows[0], rows[1]):
        line = into.place[row], into.variance[row], own[0], own[1], own[2], own[3], own[4]
        read_line(light, row, code, True, noise, room, line)
        merge_line(line, noise, row, into)


@exact
def room_for(code: Any, width: Any) -> Any:
    """Room for a line."""
    kept, off = np.empty((2, _KEPT, width), np.float32), np.empty((2, width), np.float32)
    margin = np.empty(code.factor.size, np.float32)
    return _Room(np.empty(width, np.int32), kept, off, margin, marks_for(width), np.empty(width, np.int64))


@exact
def read_line(light: Any, row: Any, code: Any, alone: Any, noise: Any, room: Any, out: Any) -> None:
    """A row into out, as an Estimate's arrays, each (W,); light: see `Light.numbers`.

    alone: variances are those of a place within the cell and of its neighbour where that is as likely; else
    of the cell's edges only, for a fringe that tells the place. room: see room_for.
    """
    (raw, table, _, (clip, _)), (_, _, _, a, o, _, clipped) = light, out
    pairs, referenced = np.float32(np.sum(code.factor < 1)), code.ends[0] >= 0
    # a bit and its inverse are off by the same: their difference keeps its sign
    misfit2 = np.float32(0) if pairs == code.factor.size else code.misfit2
    high, low = code.ends if referenced else code.frames[0]
    _references(raw[high, row], raw[low, row], table, clip, a, o, clipped)
    room.word[:], room.off[:] = 0, np.float32(0)
    kept = _compared(raw, row, table, code, pairs, o, room)
    if not referenced:
        _moved(kept[_LARGEST], a)
    _cells_line(room, kept, code, (pairs, misfit2, alone, noise), out)
    if code.beside.size > 0:
        _moved_beside(room.word, kept[_WEAKEST], code, out[0], out[1])
    _several_weak(kept[_SECOND], misfit2, noise, a, o, room.several[: a.size])
    if alone & (pairs < code.factor.size):  # a fringe's place is none of an edge's
        for x in range(a.size):
            room.several[x] |= np.uint8(clipped[x] > 0)
    for x in room.places[: marked(room.several, room.places)]:
        _reread(raw, row, table, x, code, alone, noise, room.margin, out)


@exact
def _reread(
    raw: Any, row: Any, table: Any, x: Any, code: Any, alone: Any, noise: Any, margin: Any, out: Any
) -> None:
    """A pixel of several weak bits, or of a white that saturates; margin (bits,): room."""
    place, var, error, a, o, _, clipped = out
    for b in range(margin.size):
        plain, inverse = code.frames[b]
        one, other = level_of(raw[plain, row, x], table), level_of(raw[inverse, row, x], table)
        margin[b] = _single(one, o[x], _bit(code, b)) + code.share[b, 1] * other
    own = noise.read2 + noise.gain * max(o[x], np.float32(0))
    known = place[x], var[x]
    place[x], var[x], error[x] = weak_bits(margin, code, a[x], own, alone & (clipped[x] > 0), alone, known)


@exact
def _compared(raw: Any, row: Any, table: Any, code: Any, pairs: Any, offset: Any, room: Any) -> Any:
    """Words of a line, and what is kept of their bits (_KEPT, W)."""
    before, after = room.kept[0], room.kept[1]
    before[_WEAKEST], before[_LARGEST] = np.float32(0), np.float32(0)
    before[_LEAST], before[_SECOND] = np.float32(1e9), np.float32(1e9)
    for b in range(0, code.value.size, GROUP):
        i, j = code.frames[b : b + GROUP, 0], code.frames[b : b + GROUP, 1]
        ones = raw[i[0], row], raw[i[1], row], raw[i[2], row], raw[i[3], row]
        others = raw[j[0], row], raw[j[1], row], raw[j[2], row], raw[j[3], row]
        bits = _bit(code, b), _bit(code, b + 1), _bit(code, b + 2), _bit(code, b + 3)
        if pairs == 0:
            _join(ones, None, table, bits, offset, room.word, room.off, before, after)
        else:
            _join(ones, others, table, bits, offset, room.word, room.off, before, after)
        before, after = after, before
    return before


@kernel
def _references(
    white: Any, black: Any, table: Any, clip: Any, amplitude: Any, offset: Any, clipped: Any
) -> None:
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    for x in range(offset.size):
        high, low = level_of(white[x], table), level_of(black[x], table)
        amplitude[x], offset[x] = half * (high - low), half * (high + low)
        clipped[x] = one if np.float32(max(white[x], black[x])) >= clip else zero


@kernel
def _moved(largest: Any, amplitude: Any) -> None:
    """The largest difference is the amplitude, so that none is larger."""
    for x in range(amplitude.size):
        amplitude[x], largest[x] = largest[x], np.float32(0)


@inlined
def _bit(code: Any, b: Any) -> Any:
    """Numbers of a bit."""
    share = code.share[b]
    return share[0], share[1], share[2], share[3], share[4], code.value[b], code.scale[b], code.counts[b]


@inlined
def _single(one: Any, offset: Any, bit: Any) -> Any:
    """A bit's share in its difference from its inverse, or from the mean level."""
    return bit[0] * one + bit[2] * offset + bit[3]


@kernel
def _join(
    ones: Any,
    others: Any,
    table: Any,
    bits: Any,
    offset: Any,
    word: Any,
    off: Any,
    before: Any,
    after: Any,
) -> None:
    """A group of bits joins the words, what is kept of them, and what means of pairs are off; others: their
    inverses, None if there are none."""
    (a, b, c, d), total, square = ones, off[0], off[1]
    for x in range(word.size):
        o, weakest, least = offset[x], before[_WEAKEST, x], before[_LEAST, x]
        second, largest, w = before[_SECOND, x], before[_LARGEST, x], word[x]
        first, next_ = level_of(a[x], table), level_of(b[x], table)
        third, last = level_of(c[x], table), level_of(d[x], table)
        p, q = _single(first, o, bits[0]), _single(next_, o, bits[1])
        r, s = _single(third, o, bits[2]), _single(last, o, bits[3])
        if others is not None:
            p, e = _paired(first, p, level_of(others[0][x], table), o, bits[0])
            q, f = _paired(next_, q, level_of(others[1][x], table), o, bits[1])
            r, g = _paired(third, r, level_of(others[2][x], table), o, bits[2])
            s, h = _paired(last, s, level_of(others[3][x], table), o, bits[3])
            total[x] += (e + f) + (g + h)
            square[x] += (e * e + f * f) + (g * g + h * h)
        kept = _with_bit(p, bits[0], (w, weakest, least, second, largest))
        kept = _with_bit(q, bits[1], kept)
        kept = _with_bit(r, bits[2], kept)
        word[x], after[_WEAKEST, x], after[_LEAST, x], after[_SECOND, x], after[_LARGEST, x] = _with_bit(
            s, bits[3], kept
        )


@inlined
def _paired(one: Any, margin: Any, other: Any, offset: Any, bit: Any) -> Any:
    """Difference of a bit and its inverse, and what their mean is off the usual level."""
    return margin + bit[1] * other, bit[4] * (np.float32(0.5) * (one + other) - offset)


@inlined
def _with_bit(margin: Any, bit: Any, kept: Any) -> Any:
    """Word, value of the weakest bit, how weak it and the next are (deviations of a sample), largest
    difference that counts."""
    (word, weakest, least, second, largest), value, size = kept, bit[5], abs(margin)
    weak = size * bit[6]
    return (
        word ^ (value if margin > np.float32(0) else np.int32(0)),
        np.float32(value) if weak < least else weakest,
        min(least, weak),
        min(second, max(weak, least)),
        max(largest, size * bit[7]),
    )


@kernel
def _cells_line(room: Any, kept: Any, code: Any, numbers: Any, out: Any) -> None:
    """Cells of the words; what the weakest bit leads to if noise turned it."""
    place, var, error, amplitude, offset, chi2, clipped = out
    zero, half, eighth, one = np.float32(0), np.float32(0.5), np.float32(0.125), np.float32(1)
    weakest, least, second, largest = kept[_WEAKEST], kept[_LEAST], kept[_SECOND], kept[_LARGEST]
    word, off, square = room.word, room.off[0], room.off[1]
    (pairs, misfit2, alone, noise), (cells, cell, first) = numbers, (code.cells, code.cell, code.first)
    within, mixed = (cell * cell / np.float32(12), one) if alone else (zero, zero)
    count = one / max(pairs, one)
    # a mean of two samples; white and black are one more
    known = one - (count / (one + count) if code.ends[0] >= 0 else zero)
    for x in range(word.size):  # what a turned bit leads to
        weakest[x] = np.float32(word[x] ^ np.int32(weakest[x]))
    if not code.linear:
        for x in range(word.size):
            weakest[x], word[x] = np.float32(cells[np.int32(weakest[x])]), cells[word[x]]
    for x in range(word.size):
        own = noise.read2 + noise.gain * max(offset[x], zero)
        power = amplitude[x] * amplitude[x]
        deviation = one / np.sqrt(own + misfit2 * power)
        wrong, next_ = turned(least[x] * deviation), second[x] * deviation
        # of the next one from above: Q(z) <= exp(-z^2 / 2) / 2
        also = half * vanishing(half * next_ * next_)
        step = weakest[x] - np.float32(word[x])
        beside = abs(step) == one
        place[x] = first + cell * (np.float32(word[x]) + (mixed * wrong * step if beside else zero))
        # an edge is as wide as a cell at most, and noise moves it by its share of the contrast
        spread = (mixed * wrong * (one - wrong) if beside else zero) + eighth * own / max(power, own)
        var[x] = within + cell * cell * spread
        wrong = zero if beside else wrong
        error[x] = wrong + also - wrong * also
        unlike = noise.rounding2 + noise.misfit2 * power
        rss = (square[x] - off[x] * off[x] * count * known) * (one - clipped[x])
        over = max(largest[x] - amplitude[x], zero)
        singles, both = np.float32(1.5) * own + unlike + code.misfit2 * power, half * own + unlike
        # one division for both quotients
        chi2[x] = (rss * singles + over * over * both) / (both * singles)


@kernel
def _moved_beside(word: Any, weakest: Any, code: Any, place: Any, var: Any) -> None:
    """Places (W,) by what the blur hides (see read_beside) of their cell and, where they lie between two, of
    that one to which the weakest bit leads (W,)."""
    one, cell2 = np.float32(1), code.cell * code.cell
    for x in range(word.size):
        here, there = word[x], np.int32(weakest[x])
        step = np.float32(there - here)
        share = step * ((place[x] - code.first) / code.cell - np.float32(here))  # see _cells_line
        share = share if abs(step) == one else np.float32(0)
        apart = step + code.beside[there] - code.beside[here]
        place[x] += code.cell * ((one - share) * code.beside[here] + share * code.beside[there])
        unsure = (one - share) * code.unsure[here] + share * code.unsure[there]
        var[x] += cell2 * (unsure + share * (one - share) * (apart * apart - one))


@kernel
def _several_weak(second: Any, misfit2: Any, noise: Any, amplitude: Any, offset: Any, several: Any) -> None:
    """Whether (W,) more than one bit is weak in a pixel that is not as weak itself."""
    sure = np.float32(WEAK * WEAK)
    for x in range(several.size):
        own = noise.read2 + noise.gain * max(offset[x], np.float32(0))
        power = amplitude[x] * amplitude[x]
        weak = second[x] * second[x] < sure * (own + misfit2 * power)
        several[x] = np.uint8(weak & (power > np.float32(8) * own))
