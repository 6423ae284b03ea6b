"""Compiled binary codes: bits -> code word -> cell, and the probability that a bit was misread."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, fast_kernel, inline_kernel, leaf_kernel

__all__ = ["FROM_EXTREMES", "FROM_PAIRS", "FROM_WHITE_BLACK", "code_tile"]

Array = NDArray[Any]

#: Where the threshold of bits without inverse, the contrast and the offset come from.
FROM_WHITE_BLACK, FROM_PAIRS, FROM_EXTREMES = 0, 1, 2
#: Squared margin over variance beyond which a bit is certain: 6 sigma, 1e-9.
_CERTAIN, _SIX = np.float32(36.0), np.float32(6.0)
_HUGE = np.float32(1e30)
#: Sums of a bit and its inverse that differ by more half contrasts: a sample was lit by something else. Two
#: half contrasts flip a bit, fewer do where it is near its edge; real displays are uneven by a tenth.
_ODD = np.float32(0.4)
#: Squared contrast of a bit that is nothing but edges; share of the pixels that are edges, at least.
_ALL_EDGES, _FEWEST_EDGES = 1 / 3, 0.02
#: Variance and contrast over noise that are reckoned with at least; 1 / sqrt(2), 1 / sqrt(2 pi).
_LEAST_SPREAD, _LOWEST, _HALF_ROOT, _PEAK = 1e-12, 1e-3, math.sqrt(0.5), 1 / math.sqrt(2 * math.pi)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@leaf_kernel
def code_tile(
    frames: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    source: int,
    white: int,
    black: int,
    plain: Array,
    inverse: Array,
    gray: bool,
    cells: Array,
    together: bool,
    fringed: bool,
    contrast: Array,
    read2: Any,
    gain: Any,
    loose: Any,
    beyond: Any,
    room: Any,
    cell: Array,
    weak: Array,
    far: Array,
    up: Array,
    down: Array,
    half: Array,
    middle: Array,
    clipped: Array,
) -> None:
    """Decode n pixels of a row, from raw levels: a response does not move a threshold half way.

    plain, inverse (bits,): frame numbers, -1 = not shown, bit 0 least significant; cells: word -> cell,
    which for a Gray code (gray) is computed; together: bits change together from cell to cell;
    fringed: a fringe tells where in a cell a pixel is;
    contrast (bits,): squared, what is left of each bit's (see references);
    read2 + gain I = variance of a sample; loose = systematic error of a margin, in half contrasts; beyond =
    half contrasts by which a bit's level may pass white or black.
    Out (n,): cell; probabilities that the truth is one cell up, one cell down, or anywhere else (far; 1 where
    levels are no bit's); half contrast, mid level; clipped = 1 where clipped samples make a bit unreadable.
    room: 5 x (n,).
    """
    pair, single, most, high, low = room
    _start(n, cell, pair, single, half, middle)
    most[:n] = _ZERO
    high[:n] = -_HUGE
    low[:n] = _HUGE
    if source != FROM_PAIRS:
        _reference(frames, row, first, n, source, white, black, plain, inverse, middle, half)
    pairs, bit = 0, 0
    while bit < len(plain):
        many = _paired(plain, inverse, bit)
        if many > 0:
            # the last bit of a Gray code leads to the next cell, and no further
            summed = bit > 0 or not gray
            _pairs(
                *(n, bit, many, source == FROM_PAIRS, summed, frames, plain, inverse, row, first),
                *(middle, half, pair, high, low, cell),
            )
        else:
            sign = _ONE if plain[bit] >= 0 else -_ONE
            shown = max(plain[bit], inverse[bit])
            _single(n, np.int32(1 << bit), sign, frames, shown, row, first, middle, single, most, cell)
        pairs += many
        bit += max(many, 1)
    if source == FROM_PAIRS:
        scale = _HALF / np.float32(max(pairs, 1))
        for x in range(n):
            middle[x] *= scale
    far[:n] = _ZERO
    up[:n] = _ZERO
    down[:n] = _ZERO
    clipped[:n] = np.uint8(0)
    if _weak(n, read2, gain, loose, _lone(source), middle, half, pair, single, weak):
        for x in range(n):
            if weak[x]:
                _misread(
                    frames,
                    clip,
                    row,
                    first,
                    x,
                    source,
                    plain,
                    inverse,
                    cells,
                    together,
                    fringed,
                    contrast,
                    read2,
                    gain,
                    loose,
                    cell[x],
                    middle[x],
                    half[x],
                    far,
                    up,
                    down,
                    clipped,
                )
    _odd(n, read2, gain, beyond, middle, half, most, high, low, far)
    if gray:
        _of_gray(n, cell)
    else:
        _looked_up(n, cells, cell)


@fast_kernel
def _of_gray(n: int, word: Array) -> None:
    """Cell of a Gray word: the parity of all bits from a bit on, by doubling; vectors, unlike a table."""
    for x in range(n):
        w = word[x]
        w ^= w >> np.int32(1)
        w ^= w >> np.int32(2)
        w ^= w >> np.int32(4)
        w ^= w >> np.int32(8)
        word[x] = w ^ (w >> np.int32(16))


@fast_kernel
def _looked_up(n: int, cells: Array, word: Array) -> None:
    for x in range(n):
        word[x] = cells[word[x]]


@inline_kernel
def _lone(source: Any) -> Any:
    """Variance of a margin without inverse over that of a sample: the threshold has noise, too."""
    return np.float32(1.0) if source == 2 else np.float32(1.5)


@fast_kernel
def _start(n: int, word: Array, pair: Array, single: Array, half: Array, middle: Array) -> None:
    for x in range(n):
        word[x] = 0
    pair[:n] = _HUGE
    single[:n] = _HUGE
    half[:n] = _ZERO
    middle[:n] = _ZERO


@leaf_kernel
def _reference(
    frames: Array,
    row: int,
    first: int,
    n: int,
    source: int,
    white: int,
    black: int,
    plain: Array,
    inverse: Array,
    middle: Array,
    half: Array,
) -> None:
    """Mid level and half contrast of each pixel, from white and black or from the extremes of the bits."""
    if source == FROM_WHITE_BLACK:
        _levels(n, frames, white, row, first, middle)
        _levels(n, frames, black, row, first, half)
    else:
        middle[:n] = -_HUGE
        half[:n] = _HUGE
        for bit in range(len(plain)):
            _extremes(n, frames, max(plain[bit], inverse[bit]), row, first, middle, half)
    _between(n, middle, half)


@apart_kernel
def _levels(n: int, frames: Array, at: int, row: int, first: int, level: Array) -> None:
    line = frames[at, row, first : first + n]
    for x in range(n):
        level[x] = np.float32(line[x])


@apart_kernel
def _extremes(n: int, frames: Array, at: int, row: int, first: int, high: Array, low: Array) -> None:
    """high, low: of what they were and a frame."""
    line = frames[at, row, first : first + n]
    for x in range(n):
        level = np.float32(line[x])
        high[x] = level if level > high[x] else high[x]
        low[x] = level if level < low[x] else low[x]


@apart_kernel
def _between(n: int, middle: Array, half: Array) -> None:
    """From the highest and the lowest level to mid level and half contrast, in place."""
    for x in range(n):
        high, low = middle[x], half[x]
        middle[x] = _HALF * (high + low)
        half[x] = _HALF * (high - low)


@leaf_kernel
def _paired(plain: Array, inverse: Array, bit: int) -> int:
    """How many bits from this one on, at most four, were shown with their inverses."""
    many = 0
    while many < 4 and bit + many < len(plain) and plain[bit + many] >= 0 and inverse[bit + many] >= 0:
        many += 1
    return many


@inline_kernel
def _both(one: Any, two: Any, pair: Any, half: Any) -> Any:
    """Sum, margin, least and largest size of margins, of a bit's sample and its inverse's."""
    a, b = np.float32(one), np.float32(two)
    margin = _HALF * (a - b)
    size = abs(margin)
    return a + b, margin, (size if size < pair else pair), (size if size > half else half)


@apart_kernel
def _pairs(
    n: int,
    bit: int,
    many: int,
    reference: bool,
    summed: bool,
    frames: Array,
    plain: Array,
    inverse: Array,
    row: int,
    first: int,
    middle: Array,
    half: Array,
    pair: Array,
    high: Array,
    low: Array,
    word: Array,
) -> None:
    """Up to four bits shown with their inverses: their least margin `pair`, and what both are together.

    reference: they give mid level (sum) and half contrast; summed: largest and least sum, that of the first
    bit included, as all of them are the same light. Of fewer than four the last one counts again where that
    changes nothing.
    """
    end = first + n
    k1, k2, k3 = bit + min(1, many - 1), bit + min(2, many - 1), bit + min(3, many - 1)
    i0, j0 = frames[plain[bit], row, first:end], frames[inverse[bit], row, first:end]
    i1, j1 = frames[plain[k1], row, first:end], frames[inverse[k1], row, first:end]
    i2, j2 = frames[plain[k2], row, first:end], frames[inverse[k2], row, first:end]
    i3, j3 = frames[plain[k3], row, first:end], frames[inverse[k3], row, first:end]
    b0, b1, b2, b3 = np.int32(1 << bit), np.int32(1 << k1), np.int32(1 << k2), np.int32(1 << k3)
    w1 = _ONE if many > 1 else _ZERO
    w2 = _ONE if many > 2 else _ZERO
    w3 = _ONE if many > 3 else _ZERO
    none = np.int32(0)
    for x in range(n):
        s0, m0, least, most = _both(i0[x], j0[x], pair[x], half[x])
        s1, m1, least, most = _both(i1[x], j1[x], least, most)
        s2, m2, least, most = _both(i2[x], j2[x], least, most)
        s3, m3, least, most = _both(i3[x], j3[x], least, most)
        s = s0 if summed else s3
        top, bottom = (s if s > s1 else s1), (s if s < s1 else s1)
        top, bottom = (top if top > s2 else s2), (bottom if bottom < s2 else s2)
        top, bottom = (top if top > s3 else s3), (bottom if bottom < s3 else s3)
        if summed or many > 1:
            high[x] = top if top > high[x] else high[x]
            low[x] = bottom if bottom < low[x] else low[x]
        pair[x] = least
        if reference:
            middle[x] += s0 + w1 * s1 + w2 * s2 + w3 * s3
            half[x] = most
        bits = (b0 if m0 > _ZERO else none) | (b1 if m1 > _ZERO else none)
        word[x] |= bits | (b2 if m2 > _ZERO else none) | (b3 if m3 > _ZERO else none)


@apart_kernel
def _single(
    n: int,
    bit: Any,
    sign: Any,
    frames: Array,
    at: int,
    row: int,
    first: int,
    middle: Array,
    single: Array,
    most: Array,
    word: Array,
) -> None:
    """A bit shown without its inverse: its margin against the mid level, the least and the largest."""
    line = frames[at, row, first : first + n]
    for x in range(n):
        margin = sign * (np.float32(line[x]) - middle[x])
        size = abs(margin)
        single[x] = size if size < single[x] else single[x]
        most[x] = size if size > most[x] else most[x]
        word[x] |= bit if margin > _ZERO else np.int32(0)


@fast_kernel
def _odd(
    n: int,
    read2: Any,
    gain: Any,
    beyond: Any,
    middle: Array,
    half: Array,
    most: Array,
    high: Array,
    low: Array,
    far: Array,
) -> None:
    """far = 1 where sums of bit and inverse differ, or a level lies outside black and white."""
    for x in range(n):
        noise = _SIX * np.sqrt(read2 + gain * middle[x])
        odd = (high[x] - low[x] > _ODD * half[x] + noise) | (most[x] > (_ONE + beyond) * half[x] + noise)
        far[x] = _ONE if odd else far[x]


@fast_kernel
def _weak(
    n: int,
    read2: Any,
    gain: Any,
    loose: Any,
    lone: Any,
    middle: Array,
    half: Array,
    pair: Array,
    single: Array,
    weak: Array,
) -> bool:
    """Pixels with a bit whose margin is below 6 sigma."""
    for x in range(n):
        noise, systematic = read2 + gain * middle[x], (loose * half[x]) * (loose * half[x])
        certain = (pair[x] * pair[x] > _CERTAIN * (_HALF * noise + systematic)) & (
            single[x] * single[x] > _CERTAIN * (lone * noise + systematic)
        )
        weak[x] = np.uint8(0) if certain else np.uint8(1)
    count = 0
    for x in range(n):
        count += weak[x]
    return count > 0


@leaf_kernel
def _tail(x: float) -> float:
    """Q(x), what a normal distribution has beyond x."""
    return 0.5 * math.erfc(x * _HALF_ROOT)


@leaf_kernel
def _wrong_far(x: float, height: float) -> float:
    """Probability that a bit with margin x is wrong, its true level being no edge's; all in sigma.

    Where the noise reaches the contrast: from the odds of +height / 2 against -height / 2, the least margin
    that a bit of contrast `height` has away from its edges. Where the noise is small, a margin below that
    tells of something else, and nothing is known but the noise.
    """
    least = 0.5 * height
    return 1 / (1 + math.exp(min(2 * x * least, 100.0))) if x > least - 3 else _tail(x)


@leaf_kernel
def _wrong_beside(x: float, height: float, edges: float) -> float:
    """_wrong_far for a level that may be an edge's, as likely as not anywhere between -height and height; on
    a share `edges` of the pixels it is one.
    """
    flat, ramp = (1 - edges) * _PEAK, edges / height
    below, here = _tail(x), _tail(x - height)
    wrong = flat * math.exp(-0.5 * (x + height) ** 2) + ramp * (below - _tail(x + height))
    right = flat * math.exp(-0.5 * (x - height) ** 2) + ramp * (here - below)
    return wrong / (wrong + right) if wrong + right > 0 else below


@leaf_kernel
def _of_edge(x: float, height: float, contrast: float) -> float:
    """_wrong_beside of a bit of squared contrast `contrast`, height being that of others.

    Levels that are flat but for edges on a share e of the pixels have the mean square 1 - 2 e / 3; below 1/3
    all is edges, and lower.
    """
    if contrast < _ALL_EDGES:
        return _wrong_beside(x, height * math.sqrt(contrast / _ALL_EDGES), 1.0)
    return _wrong_beside(x, height, max((1 - contrast) / (1 - _ALL_EDGES), _FEWEST_EDGES))


@leaf_kernel
def _misread(
    frames: Array,
    clip: float,
    row: int,
    first: int,
    x: int,
    source: int,
    plain: Array,
    inverse: Array,
    cells: Array,
    together: bool,
    fringed: bool,
    contrast: Array,
    read2: float,
    gain: float,
    loose: float,
    word: int,
    middle: float,
    half: float,
    far: Array,
    up: Array,
    down: Array,
    clipped: Array,
) -> None:
    """Sum over bits of the probability that it is wrong, sorted by where the flipped bit would lead.

    A bit that would lead far has its edge elsewhere, unless its edge is that of others, too (together), or
    it leads to the cell after the next but one: past the next one, should the finest bit be wrong besides.
    With fringes only that counts which leads away from the side on which the fringe lies: no edge is there.
    """
    cell, beside, edged = cells[word], 0.0, together or not fringed
    noise, systematic = float(read2 + gain * middle), float(loose * half) ** 2
    for far_ones in range(2):
        for bit in range(len(plain)):
            step = cells[word ^ (1 << bit)] - cell
            if (abs(step) != 1) != (far_ones == 1):
                continue
            if plain[bit] >= 0 and inverse[bit] >= 0:
                raw, other = frames[plain[bit], row, first + x], frames[inverse[bit], row, first + x]
                margin = 0.5 * (np.float32(raw) - np.float32(other))
                spread, lost = 0.5 * noise + systematic, raw >= clip and other >= clip
            else:
                raw = frames[max(plain[bit], inverse[bit]), row, first + x]
                margin = np.float32(raw) - middle
                spread, lost = _lone(source) * noise + systematic, raw >= clip and middle >= clip
            if lost:
                clipped[x] = 1
            sigma = math.sqrt(max(spread, _LEAST_SPREAD))
            seen, height = abs(float(margin)) / sigma, max(float(half) / sigma, _LOWEST)
            at_edge = _of_edge(seen, height, contrast[bit]) if edged else 0.0
            elsewhere = _wrong_far(seen, height * math.sqrt(contrast[bit]))
            if step == 1:
                up[x] += at_edge if edged else elsewhere
            elif step == -1:
                down[x] += at_edge if edged else elsewhere
            else:
                far[x] += elsewhere + at_edge * (1.0 if together else beside if abs(step) == 3 else 0.0)
        beside = min(float(up[x] + down[x]), 1.0)
