"""Compiled binary codes: bits -> code word -> cell."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .doubt_kernels import (
    BRIGHTER,
    FROM_EXTREMES,
    FROM_PAIRS,
    FROM_WHITE_BLACK,
    SIX,
    lone,
    misread,
    surely,
    uneven,
)
from .jit import apart_kernel, fast_kernel, inline_kernel, leaf_kernel
from .records import Camera, CellLines, CodeRecord

__all__ = ["FROM_EXTREMES", "FROM_PAIRS", "FROM_WHITE_BLACK", "code_tile"]

Array = NDArray[Any]

_HUGE = np.float32(1e30)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@leaf_kernel
def code_tile(n: int, first: int, camera: Camera, code: CodeRecord, found: CellLines) -> None:
    """Decode n pixels from `first` on, from raw levels: a response does not move a threshold half way."""
    cell, weak = found.cell, found.weak
    if _any_levels(n, first, camera, code, found):
        for x in range(n):
            if weak[x]:
                misread(x, first, camera, code, found)
    (read2, gain), most = camera.of_code, found.most
    _odd(n, read2, gain, code.beyond, found.middle, found.half, most, found.high, found.low, found.far)
    if code.gray:
        _of_gray(n, cell)
    else:
        _looked_up(n, code.cells, cell)


@leaf_kernel
def _any_levels(n: int, first: int, camera: Camera, code: CodeRecord, found: CellLines) -> bool:
    """Words, levels and least margins of pixels; whether any is weak."""
    source, half, middle = code.source, found.half, found.middle
    read2, gain = camera.of_code
    _start(n, found.cell, found.pair, found.single, half, middle)
    found.most[:n] = _ZERO
    found.high[:n] = -_HUGE
    found.low[:n] = _HUGE
    if source != FROM_PAIRS:
        _reference(n, first, camera.frames, code, middle, half)
    pairs = _bits(n, first, camera.frames, code, found)
    if source == FROM_PAIRS:
        scale = _HALF / np.float32(max(pairs, 1))
        for x in range(n):
            middle[x] *= scale
    found.far[:n] = _ZERO
    found.up[:n] = _ZERO
    found.down[:n] = _ZERO
    found.clipped[:n] = np.uint8(0)
    found.place[:n] = code.edges.inside
    astray = max(code.loose, code.edges.astray)
    limits = read2, gain, np.float32(camera.clip), code.loose, astray, lone(source)
    return bool(_weak(n, *limits, middle, half, found.pair, found.single, found.weak))


@leaf_kernel
def _bits(n: int, first: int, frames: Array, code: CodeRecord, found: CellLines) -> int:
    """Words of all bits, and their margins; how many bits have an inverse."""
    plain, inverse = code.plain, code.inverse
    half, middle, cell = found.half, found.middle, found.cell
    pairs, bit = 0, 0
    while bit < len(plain):
        many = _paired(plain, inverse, bit)
        if many > 0:
            # the last bit of a Gray code leads to the next cell, and no further
            summed = bit > 0 or not code.gray
            _pairs(
                *(n, bit, many, code.source == FROM_PAIRS, summed, frames, plain, inverse, first),
                *(middle, half, found.pair, found.high, found.low, cell),
            )
        else:
            sign = _ONE if plain[bit] >= 0 else -_ONE
            shown = max(plain[bit], inverse[bit])
            _single(
                *(n, np.int32(1 << bit), sign, code.edges.shift, frames, shown, first),
                *(middle, half, found.single, found.most, cell),
            )
        pairs += many
        bit += max(many, 1)
    return pairs


@fast_kernel
def _of_gray(n: int, word: Array) -> None:
    """Cell of a Gray word: the parity of all bits from a bit on, by doubling; vectors, unlike a table."""
    for x in range(n):
        w = word[x]
        w = np.int32(w ^ np.int32(w >> 1))  # as numba makes int64 of them
        w = np.int32(w ^ np.int32(w >> 2))
        w = np.int32(w ^ np.int32(w >> 4))
        w = np.int32(w ^ np.int32(w >> 8))
        word[x] = np.int32(w ^ np.int32(w >> 16))


@fast_kernel
def _looked_up(n: int, cells: Array, word: Array) -> None:
    for x in range(n):
        word[x] = cells[word[x]]


@fast_kernel
def _start(n: int, word: Array, pair: Array, single: Array, half: Array, middle: Array) -> None:
    for x in range(n):
        word[x] = 0
    pair[:n] = _HUGE
    single[:n] = _HUGE
    half[:n] = _ZERO
    middle[:n] = _ZERO


@leaf_kernel
def _reference(n: int, first: int, frames: Array, code: CodeRecord, middle: Array, half: Array) -> None:
    """Mid level and half contrast of each pixel, from white and black or from the extremes of the bits."""
    if code.source == FROM_WHITE_BLACK:
        _levels(n, frames, code.white, first, middle)
        _levels(n, frames, code.black, first, half)
    else:
        middle[:n] = -_HUGE
        half[:n] = _HUGE
        for bit in range(len(code.plain)):
            _extremes(n, frames, max(code.plain[bit], code.inverse[bit]), first, middle, half)
    _between(n, middle, half)


@apart_kernel
def _levels(n: int, frames: Array, at: int, first: int, level: Array) -> None:
    line = frames[at, 0, first : first + n]
    for x in range(n):
        level[x] = np.float32(line[x])


@apart_kernel
def _extremes(n: int, frames: Array, at: int, first: int, high: Array, low: Array) -> None:
    """high, low: of what they were and a frame."""
    line = frames[at, 0, first : first + n]
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
    i0, j0 = frames[plain[bit], 0, first:end], frames[inverse[bit], 0, first:end]
    i1, j1 = frames[plain[k1], 0, first:end], frames[inverse[k1], 0, first:end]
    i2, j2 = frames[plain[k2], 0, first:end], frames[inverse[k2], 0, first:end]
    i3, j3 = frames[plain[k3], 0, first:end], frames[inverse[k3], 0, first:end]
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
    shift: Any,
    frames: Array,
    at: int,
    first: int,
    middle: Array,
    half: Array,
    single: Array,
    most: Array,
    word: Array,
) -> None:
    """A bit shown without its inverse: its least margin against the threshold, `shift` half contrasts from
    the mid level, and the largest distance from that."""
    line = frames[at, 0, first : first + n]
    for x in range(n):
        above = np.float32(line[x]) - middle[x]
        margin, far = sign * (above - shift * half[x]), abs(above)
        size = abs(margin)
        single[x] = size if size < single[x] else single[x]
        most[x] = far if far > most[x] else most[x]
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
        noise = SIX * np.sqrt(read2 + gain * middle[x])
        # 0 where no bit is without its inverse
        outside = (most[x] > _ZERO) & (most[x] > (_ONE + beyond) * half[x] + noise)
        odd = uneven(high[x] - low[x], half[x], noise) | outside
        far[x] = _ONE if odd else far[x]


@fast_kernel
def _weak(
    n: int,
    read2: Any,
    gain: Any,
    clip: Any,
    loose: Any,
    astray: Any,
    lone: Any,
    middle: Array,
    half: Array,
    pair: Array,
    single: Array,
    weak: Array,
) -> bool:
    """Pixels with a bit whose margin is below 6 sigma."""
    brighter = BRIGHTER if astray < BRIGHTER else astray
    for x in range(n):
        noise, unsure = read2 + gain * middle[x], brighter if middle[x] + half[x] >= clip else astray
        certain = surely(pair[x], _HALF * noise, loose * half[x])
        certain &= surely(single[x], lone * noise, unsure * half[x])
        weak[x] = np.uint8(0) if certain else np.uint8(1)
    count = 0
    for x in range(n):
        count += weak[x]
    return count > 0
