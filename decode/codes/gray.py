"""Binary codes: bits -> word -> cell, with the probability of a wrong bit.

A bit is the sign of a difference: from its inverse, or from the mean of white and black, or, without these,
of a fringe's samples. The probability of a bit error is Q(z), z the difference over its deviation. Bits that
the camera resolves nowhere are removed from the code, which widens its cells. At the edge of a cell one bit
of a Gray code is weak: either value gives one of two adjacent cells. With two or more weak bits all words
that they allow are compared (bit_levels): the result is the run of cells around the most probable one, with
wider cells if necessary; the remaining probability is the error. A binary code, which changes several bits at
once, shows a mixture of two adjacent cells, b = A ((1 - f) s(c) + f s(c + 1)), f in 0..1, s the cells' levels
behind the blur, and the posterior is over the cells c first.
Where white saturates, only a lower bound of its level is known. A bit and its inverse compare as before, but
their mean is not tested; a single bit that is brighter than the mean of black and clipped white, and does not
saturate, may have either value.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from ..estimate import Estimate, Line, vanishing
from ..flags import DOUBT, Into, marked, marks_for, merge_line
from ..frames import KernelLight, Light, RawFrames, level_of
from ..plan import Code, Fringe, Plan
from ..profile.noise import Noise, Numbers, Sample, product
from .bit_levels import (
    GROUP,
    WEAK,
    CodePlan,
    bit_contrast,
    bit_values,
    bits_in_groups,
    blurred,
    coarser,
    dull_level,
    fitted_levels,
    hidden_variance,
    mixture,
    nested,
    posterior,
    turned,
    unresolved_bits,
)

__all__ = [
    "CodePlan",
    "Resolved",
    "code_plan",
    "decode_code",
    "read_code",
    "read_line",
    "room_for",
    "unresolved_count",
]

#: Largest sample for the blur: medians to 4 %; and for resolved bits: with a twentieth of the pixels at
#: edges, 1 % of wrong ones are four.
_PIXELS, _AT_EDGES = 1024, 8192
#: State of a line over the groups of bits: value of the weakest bit, its weakness and that of the next,
#: largest difference that counts. Groups pass it on, as conditional stores in place are slow.
_WEAKEST, _LEAST, _SECOND, _LARGEST, _KEPT = 0, 1, 2, 3, 4


F32 = NDArray[np.float32]
#: Of a bit: row of CodePlan.share, value, scale and counts.
_Bit = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.int32, np.float32, np.float32]
#: A line of each frame of a group of bits; the word and the other state of a pixel's bits.
_Group = tuple[RawFrames, RawFrames, RawFrames, RawFrames]
_Kept = tuple[np.int32, np.float32, np.float32, np.float32, np.float32]


class _Room(NamedTuple):
    """Workspace for a line: words (W,), of a linear code cells; state of the bits (2, _KEPT, W); deviations
    of pair means from the mean level, summed, and squared (2, W); squared distance of the weakest bit from
    its threshold in deviations (W,); differences of one pixel (bits,); marks of pixels with several weak
    bits, and their indices (W,)."""

    word: NDArray[np.int32]
    kept: F32
    off: F32
    sure: F32
    margin: F32
    several: NDArray[np.uint8]
    places: NDArray[np.int64]


class Resolved(NamedTuple):
    """A code in the form for kernels, without unresolved bits, and the number of these."""

    plan: CodePlan
    unresolved: int


def code_plan(
    code: Code, plan: Plan, noise: Noise, lit: Sample, whole: bool, fringe: Fringe | None
) -> Resolved:
    """The parameters of a code: resolved bits and their blur, from illuminated pixels.

    whole: keep all bits, for a look-up; fringe: its mean is the threshold of bits without an inverse, if
    there is no white and black; None: there is none.
    """
    bits, level, variance = _seen(code, plan, noise, lit, None if whole else fringe)
    unresolved, spread2 = (0, 0.0) if whole else unresolved_bits(code, level, variance, bits.factor)
    code, bits, level = coarser(code, unresolved), bits.only(unresolved), level[unresolved:]
    few = slice(None, None, max(1, level.shape[1] // _PIXELS))
    blur, misfit2 = fitted_levels(code, level[:, few], variance[few], bits.factor)
    # a blur's misfit of pairs is at edges, if one bit changes, or covered by a nested code's coarser cells
    hidden = code.together and not nested(code)
    misfit2 = max(spread2, misfit2 if hidden or not bits.pairs.all() else 0.0)
    value, linear = bit_values(code.cells)
    counts = bits.pairs != bits.referenced if bits.pairs.any() or bits.referenced else ~bits.pairs
    frames, share, value, scale, counting = bits_in_groups(bits.frames, bits.factor, counts, value)
    plan_of_code = CodePlan(
        frames=frames,
        share=share,
        value=value,
        scale=scale,
        counts=counting,
        factor=bits.factor,
        ends=bits.ends,
        cells=code.cells,
        linear=linear,
        levels=blurred(code, blur),
        misfit2=np.float32(misfit2),
        together=code.together,
        hidden=np.float32(hidden_variance(code, blur)),
        nested=nested(code),
        by_fringe=bits.mean is not None,
        above=np.float32(bits.above),
        contrast=bit_contrast(level),
        dull=np.float32(dull_level(code, level)),
        cell=np.float32(code.cell),
        first=np.float32(0.5 * (code.cell - 1) + code.origin),
        freedom=bits.freedom,
    )
    return Resolved(plan_of_code, unresolved)


def unresolved_count(code: Code, plan: Plan, noise: Noise, lit: Sample, fringe: Fringe | None) -> int:
    """Number of the finest bits that the camera does not resolve, see `code_plan`."""
    bits, level, variance = _seen(code, plan, noise, lit, fringe)
    return unresolved_bits(code, level, variance, bits.factor)[0]


class _Seen(NamedTuple):
    """Bits of illuminated pixels: level (bits, K) over the amplitude, variance (K,) of a sample in that
    unit."""

    bits: "_Bits"
    level: NDArray[np.float32]
    variance: NDArray[np.float32]


def _seen(code: Code, plan: Plan, noise: Noise, lit: Sample, fringe: Fringe | None) -> _Seen:
    many = lit.only(slice(None, None, max(1, len(lit.places) // _AT_EDGES)))
    bits = _Bits.of(code, plan, fringe).levelled(many.levels)
    margin, amplitude = bits.margins(many.levels)
    return _Seen(bits, margin / amplitude, many.variance(noise) / np.square(amplitude))


class _Bits(NamedTuple):
    """Frames (bits, 2) of a code's bits and their inverses, -1: none; pairs (bits,): whether both exist;
    variance (bits,) of a difference over that of a sample; white and black, -1: none; the fringe whose mean
    is the threshold, and the threshold's offset over the amplitude."""

    frames: NDArray[np.int64]
    pairs: NDArray[np.bool_]
    factor: NDArray[np.float32]
    ends: NDArray[np.int64]
    mean: Fringe | None
    above: float = 0.0

    @classmethod
    def of(cls, code: Code, plan: Plan, fringe: Fringe | None) -> "_Bits":
        frames = np.stack([code.plain, code.inverse], axis=1)
        pairs = np.asarray((frames >= 0).all(axis=1))
        referenced = plan.white >= 0 and plan.black >= 0
        # (p - q) / 2 has half the variance of a sample, p - (white + black) / 2 has one and a half
        factor = np.where(pairs, 0.5, 1.5).astype(np.float32)
        ends = np.array([plan.white, plan.black] if referenced else [-1, -1])
        return cls(frames, pairs, factor, ends, None if referenced or pairs.all() else fringe)

    @property
    def referenced(self) -> bool:
        return bool(self.ends[0] >= 0)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the test of pair means and single bits."""
        return max(int(self.pairs.sum()) - (0 if self.referenced else 1), 0) + int((~self.pairs).any())

    def only(self, first: int) -> "_Bits":
        """Bits from a first one on."""
        return self._replace(frames=self.frames[first:], pairs=self.pairs[first:], factor=self.factor[first:])

    def levelled(self, levels: F32) -> "_Bits":
        """With the threshold's offset: median over pixels of the middle of the bits' levels."""
        if self.mean is None:
            return self
        margin, _ = self.margins(levels)
        both = (margin.min(axis=0) < 0) & (margin.max(axis=0) > 0)
        middle = 0.5 * (margin.min(axis=0) + margin.max(axis=0)) / self._wave(levels)[1]
        return self._replace(above=float(np.median(middle[both])) if both.any() else 0.0)

    def _wave(self, levels: F32) -> tuple[F32, F32]:
        """Mean level and amplitude (K,) of the fringe."""
        assert self.mean is not None
        mean, c, s = product(self.mean.inverse.astype(np.float32), levels[list(self.mean.index)])
        return mean, np.maximum(np.hypot(c, s), np.float32(1e-3))

    def margins(self, levels: F32) -> tuple[F32, F32]:
        """Differences (bits, K), and the amplitude (K,), of sampled levels (N, K)."""
        white, black = levels[self.ends[0]], levels[self.ends[1]]
        mean = 0.5 * (white + black)
        if self.mean is not None:
            level, wave = self._wave(levels)
            mean = level + np.float32(self.above) * wave
        plain, inverse = levels[self.frames[:, 0]], levels[self.frames[:, 1]]
        single = np.where(self.frames[:, :1] >= 0, plain - mean, mean - inverse)
        margin = np.where(self.pairs[:, None], 0.5 * (plain - inverse), single)
        amplitude = 0.5 * (white - black) if self.referenced else np.abs(margin).max(axis=0)
        return margin, np.maximum(amplitude, np.float32(1e-3))


def read_code(light: Light, noise: Noise, code: CodePlan, rows: tuple[int, int], estimate: Estimate) -> None:
    """Read the code in rows start..stop, in place: coordinates are cells' centres."""
    _read_rows(light.numbers(), rows, code, noise.numbers(), estimate)


@exact
def _read_rows(
    light: KernelLight, rows: tuple[int, int], code: CodePlan, noise: Numbers, out: Estimate
) -> None:
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
def _decode_rows(
    light: KernelLight, rows: tuple[int, int], code: CodePlan, noise: Numbers, into: Into
) -> None:
    """Row by row, so that the data of a row stay in the cache."""
    width = into.place.shape[1]
    room, own = room_for(code, width), np.empty((5, width), np.float32)
    for row in range(rows[0], rows[1]):
        line = into.place[row], into.variance[row], own[0], own[1], own[2], own[3], own[4]
        read_line(light, row, code, True, noise, room, line)
        merge_line(line, noise, row, into)


@exact
def room_for(code: CodePlan, width: int) -> _Room:
    """Workspace for a line."""
    kept, off = np.empty((2, _KEPT, width), np.float32), np.empty((2, width), np.float32)
    margin = np.empty(code.factor.size, np.float32)
    sure, places = np.empty(width, np.float32), np.empty(width, np.int64)
    return _Room(np.empty(width, np.int32), kept, off, sure, margin, marks_for(width), places)


@exact
def read_line(
    light: KernelLight, row: int, code: CodePlan, alone: bool, noise: Numbers, room: _Room, out: Line
) -> None:
    """Decode a row into out, an Estimate's arrays, each (W,); light: see `Light.numbers`.

    alone: variances include the place within the cell and an equally likely neighbour; else the cell's edges
    only, if a fringe gives the place. room: see room_for. If a fringe's mean is the threshold, out holds it
    as the mean level.
    """
    (raw, table, _, (clip, _)), (_, _, _, a, o, _, clipped) = light, out
    pairs, referenced = np.float32(np.sum(code.factor < 1)), code.ends[0] >= 0
    misfit2 = code.misfit2
    if code.by_fringe:
        clipped[:] = np.float32(0)
    else:
        high, low = code.ends if referenced else code.frames[0]
        _references(raw[high, row], raw[low, row], table, clip, a, o, clipped)
    room.word[:], room.off[:] = 0, np.float32(0)
    kept = _compared(raw, row, table, code, pairs, o, room)
    if not referenced:
        _moved(kept[_LARGEST], a)
    _cells_line(room, kept, code, (pairs, misfit2, alone, noise), out)
    _several_weak(kept[_SECOND], misfit2, noise, a, o, room.several[: a.size])
    if alone & (pairs < code.factor.size):  # a fringe's place is never at a cell's edge
        for x in range(a.size):
            room.several[x] |= np.uint8(clipped[x] > 0)
    for x in room.places[: marked(room.several, room.places)]:
        _reread(raw, table, row, x, code, alone, noise, room.margin, out)


@exact
def _reread(
    raw: RawFrames,
    table: F32 | None,
    row: int,
    x: int,
    code: CodePlan,
    alone: bool,
    noise: Numbers,
    margin: F32,
    out: Line,
) -> None:
    """A pixel with several weak bits, or with saturated white; margin (bits,): workspace."""
    place, var, error, a, o, _, clipped = out
    for b in range(margin.size):
        plain, inverse = code.frames[b]
        one, other = level_of(raw[plain, row, x], table), level_of(raw[inverse, row, x], table)
        margin[b] = _single(one, o[x], _bit(code, b)) + code.share[b, 1] * other
    own = noise.read2 + noise.gain * max(o[x], np.float32(0))
    known, saturated = (place[x], var[x]), alone & (clipped[x] > 0)
    by_mixture = code.together and code.nested and not saturated
    if by_mixture:
        place[x], var[x], error[x] = mixture(margin, code, a[x], own, alone, known)
    if not by_mixture or error[x] > np.float32(DOUBT):
        place[x], var[x], error[x] = posterior(margin, code, a[x], own, saturated, alone)


@exact
def _compared(
    raw: RawFrames, row: int, table: F32 | None, code: CodePlan, pairs: np.float32, offset: F32, room: _Room
) -> F32:
    """Words of a line, and the state of their bits (_KEPT, W)."""
    before: F32 = room.kept[0]
    after: F32 = room.kept[1]
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
    white: RawFrames,
    black: RawFrames,
    table: F32 | None,
    clip: np.float32,
    amplitude: F32,
    offset: F32,
    clipped: F32,
) -> None:
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    for x in range(offset.size):
        high, low = level_of(white[x], table), level_of(black[x], table)
        amplitude[x], offset[x] = half * (high - low), half * (high + low)
        clipped[x] = one if np.float32(max(white[x], black[x])) >= clip else zero


@kernel
def _moved(largest: F32, amplitude: F32) -> None:
    """Take the largest difference as amplitude, and set its excess to none."""
    for x in range(amplitude.size):
        amplitude[x], largest[x] = largest[x], np.float32(0)


@inlined
def _bit(code: CodePlan, b: int) -> _Bit:
    """Parameters of a bit."""
    share = code.share[b]
    return share[0], share[1], share[2], share[3], share[4], code.value[b], code.scale[b], code.counts[b]


@inlined
def _single(one: np.float32, offset: np.float32, bit: _Bit) -> np.float32:
    """Contribution of a bit to its difference from its inverse, or from the mean level."""
    return bit[0] * one + bit[2] * offset + bit[3]


@kernel
def _join(
    ones: _Group,
    others: _Group | None,
    table: F32 | None,
    bits: tuple[_Bit, _Bit, _Bit, _Bit],
    offset: F32,
    word: NDArray[np.int32],
    off: F32,
    before: F32,
    after: F32,
) -> None:
    """Add a group of bits to the words, their state, and the deviations of pair means; others: inverses or
    None."""
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
def _paired(
    one: np.float32, margin: np.float32, other: np.float32, offset: np.float32, bit: _Bit
) -> tuple[np.float32, np.float32]:
    """Difference of a bit and its inverse, and the deviation of their mean from the mean level."""
    return margin + bit[1] * other, bit[4] * (np.float32(0.5) * (one + other) - offset)


@inlined
def _with_bit(margin: np.float32, bit: _Bit, kept: _Kept) -> _Kept:
    """State with one more bit: word, value of the weakest bit, its weakness and that of the next (deviations
    of a sample), largest difference that counts."""
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
def _cells_line(
    room: _Room, kept: F32, code: CodePlan, numbers: tuple[np.float32, np.float32, bool, Numbers], out: Line
) -> None:
    """Cells of the words; expected shift by an error of the weakest bit."""
    place, var, error, amplitude, offset, chi2, clipped = out
    zero, half, eighth, one = np.float32(0), np.float32(0.5), np.float32(0.125), np.float32(1)
    weakest, least, second, largest = kept[_WEAKEST], kept[_LEAST], kept[_SECOND], kept[_LARGEST]
    word, off, square = room.word, room.off[0], room.off[1]
    (pairs, misfit2, alone, noise), (cells, cell, first) = numbers, (code.cells, code.cell, code.first)
    within, mixed = (cell * cell / np.float32(12), one) if alone else (zero, zero)
    count = one / max(pairs, one)
    # a pair's mean has two samples; white and black are one more pair
    known = one - (count / (one + count) if code.ends[0] >= 0 else zero)
    size = np.sqrt(np.float32(0.5) if pairs > 0 else np.float32(1.5))  # of a difference that is weak by 1
    for x in range(word.size):  # word with the weakest bit turned
        weakest[x] = np.float32(word[x] ^ np.int32(weakest[x]))
    if not code.linear:
        for x in range(word.size):
            weakest[x], word[x] = np.float32(cells[np.int32(weakest[x])]), cells[word[x]]
    for x in range(word.size):
        own = noise.read2 + noise.gain * max(offset[x], zero)
        power = amplitude[x] * amplitude[x]
        deviation = one / np.sqrt(own + misfit2 * power)
        weak, next_ = least[x] * deviation, second[x] * deviation
        wrong, room.sure[x] = turned(weak), weak * weak
        # upper bound for the next bit: Q(z) <= exp(-z^2 / 2) / 2
        also = half * vanishing(half * next_ * next_)
        step = weakest[x] - np.float32(word[x])
        beside = abs(step) == one
        place[x] = first + cell * (np.float32(word[x]) + (mixed * wrong * step if beside else zero))
        # an edge is one cell wide at most, and noise moves it by its ratio to the contrast
        spread = code.hidden + eighth * (own + misfit2 * power) / max(power, own)
        spread += mixed * wrong * (one - wrong) if beside else zero
        var[x] = within + cell * cell * spread
        # neither black nor white, and not at an edge
        dull = least[x] * size < code.dull * amplitude[x]
        wrong = zero if beside else (one if dull else wrong)
        error[x] = wrong + also - wrong * also
        unlike = noise.rounding2 + noise.misfit2 * power
        rss = (square[x] - off[x] * off[x] * count * known) * (one - clipped[x])
        over = max(largest[x] - amplitude[x], zero)
        singles, both = np.float32(1.5) * own + unlike + code.misfit2 * power, half * own + unlike
        # one division for both quotients
        chi2[x] = (rss * singles + over * over * both) / (both * singles)


@kernel
def _several_weak(
    second: F32, misfit2: np.float32, noise: Numbers, amplitude: F32, offset: F32, several: NDArray[np.uint8]
) -> None:
    """Mark pixels (W,) with more than one weak bit, except pixels without contrast."""
    sure = np.float32(WEAK * WEAK)
    for x in range(several.size):
        own = noise.read2 + noise.gain * max(offset[x], np.float32(0))
        power = amplitude[x] * amplitude[x]
        weak = second[x] * second[x] < sure * (own + misfit2 * power)
        several[x] = np.uint8(weak & (power > np.float32(8) * own))
