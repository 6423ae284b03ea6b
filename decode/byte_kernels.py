"""Compiled: bits and their inverses in 8-bit frames, in numbers as narrow as they take.

A vector holds two or four times as many of them as in float32. For codes all of whose bits have inverses, and
whose levels these tell; what is found is what code_kernels finds.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .doubt_kernels import FROM_PAIRS, SIX, surely, uneven
from .jit import apart_kernel, leaf_kernel, pasted_kernel
from .records import Camera, CellLines, CodeRecord

__all__ = ["whole_bytes"]

Array = NDArray[Any]
_ZERO, _HALF, _ONE, _NOUGHT = np.float32(0), np.float32(0.5), np.float32(1), np.int16(0)


@leaf_kernel
def whole_bytes(
    n: int, first: int, camera: Camera, code: CodeRecord, of_bytes: bool | None, found: CellLines
) -> tuple[bool, bool]:
    """code_tile up to weak pixels where frames are bytes, all bits have inverses and nothing else tells the
    levels; whether that is so, and whether any pixel is weak."""
    if of_bytes is not None:
        bits = len(code.plain)
        for bit in range(bits):
            if code.source != FROM_PAIRS or code.plain[bit] < 0 or code.inverse[bit] < 0:
                return False, False
        shorts, sizes = found.shorts, found.sizes
        _start_bytes(n, shorts, sizes)
        for bit in range(0, bits, 4):
            # the last bit of a Gray code leads to the next cell, and no further
            many, summed = min(4, bits - bit), bit > 0 or not code.gray
            _byte_pairs(
                *(n, bit, many, summed),
                *(camera.frames, code.plain, code.inverse, first),
                *(shorts[0], shorts[1], shorts[2], shorts[3], sizes[0], sizes[1]),
            )
        scale = _HALF / np.float32(bits)
        limits = camera.of_code[0], camera.of_code[1], code.loose, code.edges.inside
        doubtful = _settle_bytes(
            *(n, scale, limits),
            *(shorts[0], shorts[1], shorts[2], shorts[3], sizes[0], sizes[1]),
            *(found.middle, found.half, found.cell, found.weak, found.clipped),
            *(found.far, found.up, found.down, found.place),
        )
        return True, doubtful
    return False, False


@leaf_kernel
def _start_bytes(n: int, shorts: Array, sizes: Array) -> None:
    """What _byte_pairs adds to."""
    shorts[0, :n] = _NOUGHT
    shorts[1, :n] = np.int16(-0x8000)
    shorts[2, :n] = np.int16(0x7FFF)
    shorts[3, :n] = _NOUGHT
    sizes[0, :n] = np.uint8(255)
    sizes[1, :n] = np.uint8(0)


@pasted_kernel
def _byte_both(one: Any, two: Any, pair: Any, half: Any) -> Any:
    """Sum, least and largest size of margins, these doubled, of a bit's byte and its inverse's."""
    high, low = (one if one > two else two), (one if one < two else two)
    size = np.uint8(high - low)
    return np.int16(high + low), (size if size < pair else pair), (size if size > half else half)


@apart_kernel
def _byte_pairs(
    n: int,
    bit: int,
    many: int,
    summed: bool,
    frames: Array,
    plain: Array,
    inverse: Array,
    first: int,
    total: Array,
    high: Array,
    low: Array,
    word: Array,
    pair: Array,
    half: Array,
) -> None:
    """_pairs of bytes: in 16 and 8 bits, of which a vector holds two and four times as many."""
    end = first + n
    k1, k2, k3 = bit + min(1, many - 1), bit + min(2, many - 1), bit + min(3, many - 1)
    i0, j0 = frames[plain[bit], 0, first:end], frames[inverse[bit], 0, first:end]
    i1, j1 = frames[plain[k1], 0, first:end], frames[inverse[k1], 0, first:end]
    i2, j2 = frames[plain[k2], 0, first:end], frames[inverse[k2], 0, first:end]
    i3, j3 = frames[plain[k3], 0, first:end], frames[inverse[k3], 0, first:end]
    b0, b1, b2, b3 = np.int16(1 << bit), np.int16(1 << k1), np.int16(1 << k2), np.int16(1 << k3)
    w1 = np.int16(-1 if many > 1 else 0)
    w2 = np.int16(-1 if many > 2 else 0)
    w3 = np.int16(-1 if many > 3 else 0)
    for x in range(n):
        s0, least, most = _byte_both(i0[x], j0[x], pair[x], half[x])
        s1, least, most = _byte_both(i1[x], j1[x], least, most)
        s2, least, most = _byte_both(i2[x], j2[x], least, most)
        s3, least, most = _byte_both(i3[x], j3[x], least, most)
        s = s0 if summed else s3
        top, bottom = (s if s > s1 else s1), (s if s < s1 else s1)
        top, bottom = (top if top > s2 else s2), (bottom if bottom < s2 else s2)
        top, bottom = (top if top > s3 else s3), (bottom if bottom < s3 else s3)
        if summed or many > 1:
            high[x] = top if top > high[x] else high[x]
            low[x] = bottom if bottom < low[x] else low[x]
        pair[x], half[x] = least, most
        total[x] = np.int16(total[x] + s0 + np.int16(w1 & s1) + np.int16(w2 & s2) + np.int16(w3 & s3))
        # bytes are compared, as numba would widen a difference
        bits = np.int16((b0 if i0[x] > j0[x] else _NOUGHT) | (b1 if i1[x] > j1[x] else _NOUGHT))
        more = np.int16((b2 if i2[x] > j2[x] else _NOUGHT) | (b3 if i3[x] > j3[x] else _NOUGHT))
        word[x] = np.int16(word[x] | bits | more)


@apart_kernel
def _settle_bytes(
    n: int,
    scale: Any,
    limits: Any,
    total: Array,
    high: Array,
    low: Array,
    word: Array,
    pair: Array,
    most: Array,
    middle: Array,
    half: Array,
    cell: Array,
    weak: Array,
    clipped: Array,
    far: Array,
    up: Array,
    down: Array,
    place: Array,
) -> bool:
    """What _byte_pairs found, as the other kernels find it: levels, words, weak and odd pixels."""
    read2, gain, loose, inside = limits
    for x in range(n):
        level = scale * np.float32(total[x])
        contrast, margin = _HALF * np.float32(most[x]), _HALF * np.float32(pair[x])
        noise, apart = read2 + gain * level, np.float32(high[x]) - np.float32(low[x])
        weak[x] = np.uint8(0) if surely(margin, _HALF * noise, loose * contrast) else np.uint8(1)
        far[x] = _ONE if uneven(apart, contrast, SIX * np.sqrt(noise)) else _ZERO
        middle[x], half[x], cell[x] = level, contrast, np.int32(word[x])
        up[x], down[x], place[x], clipped[x] = _ZERO, _ZERO, inside, np.uint8(0)
    some = np.uint8(0)
    for x in range(n):
        some |= weak[x]
    return bool(some > 0)
