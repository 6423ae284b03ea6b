"""Compiled: codes whose bits were all shown with their inverses, in 8-bit frames: in numbers as narrow as
they take, of which a vector holds two or four times as many as of float32, and into the maps in one go.

What is found is what code_kernels and flag_kernels find. Nearly all bits are certain: of a pixel with one in
doubt, what that changes is written over.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .doubt_kernels import FROM_PAIRS, SIX, misread, surely, uneven
from .flag_kernels import either, why_cell, why_misread
from .jit import apart_kernel, fast_kernel, leaf_kernel, pasted_kernel
from .records import AxisRecord, Camera, CellLines, CodeRecord, Scratch, Shared
from .stream_kernels import stream_widened

__all__ = ["byte_tile"]

Array = NDArray[Any]
_ZERO, _HALF, _ONE, _NOUGHT = np.float32(0), np.float32(0.5), np.float32(1), np.int16(0)
# lines of Scratch.shorts: all sums, extremes of a pair's, words, cells, contrasts (doubled)
_TOTAL, _HIGH, _LOW, _WORD, _CELL, _MOST = range(6)
# lines of Scratch.sizes: least and largest margins (doubled)
_PAIR, _LARGEST = range(2)


@leaf_kernel
def byte_tile(
    first: int,
    n: int,
    camera: Camera,
    code: CodeRecord,
    found: CellLines,
    axis: AxisRecord,
    shared: Shared,
    scratch: Scratch,
) -> None:
    """All of n pixels from `first` on into the maps, and the rows into scratch.kept."""
    shorts, sizes, weak = scratch.shorts, scratch.sizes, found.weak
    _words(n, first, camera.frames, code, shorts, sizes)
    width, kept, joined = shared.flags.shape[1], scratch.kept[axis.number], axis.joined
    limits, done = _limits(camera, code), 0
    while done < n:
        row, col = (first + done) // width, (first + done) % width
        end = min(col + n - done, width)
        part = slice(done, done + end - col)
        sums = shorts[_TOTAL, part], shorts[_HIGH, part], shorts[_LOW, part]
        told = sums, shorts[_CELL, part], sizes[_PAIR, part], shorts[_MOST, part]
        here = slice(first + done, first + done + end - col)
        flags, amplitude = shared.flat_flags[0, here], shared.flat_amplitude[0, here]
        offset, error = shared.flat_offset[0, here], shared.flat_error[0, here]
        line, sigma = kept[row % len(kept), col:end], axis.sigma[row, col:end]
        # two loops: one that asks within is stored by masks, which takes twice as long
        if joined:
            _merge(end - col, limits, told, weak[part], line, sigma, flags, amplitude, offset, error)
        else:
            _store(end - col, limits, told, weak[part], line, sigma, flags, amplitude, offset, error)
        stream_widened(line, axis.coord[row, col:end])
        done += end - col
    if _any(n, weak):
        for x in range(n):
            if weak[x]:
                _doubt(x, first, camera, code, limits[0], found, axis, shared, shorts)


@leaf_kernel
def _words(n: int, first: int, frames: Array, code: CodeRecord, shorts: Array, sizes: Array) -> None:
    """Lines of shorts and sizes."""
    bits, of_pairs = len(code.plain), code.source == FROM_PAIRS
    _start(n, shorts, sizes)
    for bit in range(0, bits, 4):
        # the last bit of a Gray code leads to the next cell, and no further
        many, summed = min(4, bits - bit), bit > 0 or not code.gray
        _pairs(
            *(n, bit, many, summed, frames, code.plain, code.inverse, first),
            *(shorts[_TOTAL], shorts[_HIGH], shorts[_LOW], shorts[_WORD], sizes[_PAIR], sizes[_LARGEST]),
        )
    if of_pairs:
        _widen(n, sizes[_LARGEST], shorts[_MOST])
    else:
        _references(n, first, frames, code.white, code.black, shorts[_TOTAL], shorts[_MOST])
    if code.gray:
        _of_gray(n, shorts[_WORD], shorts[_CELL])
    else:
        _looked_up(n, code.cells, shorts[_WORD], shorts[_CELL])


@leaf_kernel
def _start(n: int, shorts: Array, sizes: Array) -> None:
    """What _pairs adds to."""
    shorts[_TOTAL, :n] = _NOUGHT
    shorts[_HIGH, :n] = np.int16(-0x8000)
    shorts[_LOW, :n] = np.int16(0x7FFF)
    shorts[_WORD, :n] = _NOUGHT
    sizes[_PAIR, :n] = np.uint8(255)
    sizes[_LARGEST, :n] = np.uint8(0)


@pasted_kernel
def _both(one: Any, two: Any, pair: Any, half: Any) -> Any:
    """Sum, least and largest size of margins, these doubled, of a bit's byte and its inverse's."""
    high, low = (one if one > two else two), (one if one < two else two)
    size = np.uint8(high - low)
    return np.int16(high + low), (size if size < pair else pair), (size if size > half else half)


@apart_kernel
def _pairs(
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
    """code_kernels._pairs of bytes: in 16 and 8 bits, of which a vector holds two and four times as many."""
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
        s0, least, most = _both(i0[x], j0[x], pair[x], half[x])
        s1, least, most = _both(i1[x], j1[x], least, most)
        s2, least, most = _both(i2[x], j2[x], least, most)
        s3, least, most = _both(i3[x], j3[x], least, most)
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
def _widen(n: int, size: Array, most: Array) -> None:
    """Contrasts, doubled, are the largest margins."""
    for x in range(n):
        most[x] = np.int16(size[x])


@apart_kernel
def _references(n: int, first: int, frames: Array, white: int, black: int, total: Array, most: Array) -> None:
    """Mid level and contrast, doubled, are those of white and black."""
    bright, dim = frames[white, 0, first : first + n], frames[black, 0, first : first + n]
    for x in range(n):
        total[x] = np.int16(np.int16(bright[x]) + np.int16(dim[x]))
        most[x] = np.int16(np.int16(bright[x]) - np.int16(dim[x]))


@apart_kernel
def _of_gray(n: int, word: Array, cell: Array) -> None:
    """Cells of Gray words: the parity of all bits from a bit on, by doubling; vectors, unlike a table."""
    for x in range(n):
        w = word[x]
        w = np.int16(w ^ np.int16(w >> 1))  # as numba makes int64 of them
        w = np.int16(w ^ np.int16(w >> 2))
        w = np.int16(w ^ np.int16(w >> 4))
        cell[x] = np.int16(w ^ np.int16(w >> 8))


@fast_kernel
def _looked_up(n: int, cells: Array, word: Array, cell: Array) -> None:
    for x in range(n):
        cell[x] = cells[word[x]]


@leaf_kernel
def _limits(camera: Camera, code: CodeRecord) -> Any:
    """What _settled is told: scale of sums and noise; what why_cell is; where cells lie, and the sigma of a
    place in a cell whose bits are certain."""
    read2, gain = camera.of_code
    scale = _HALF / np.float32(len(code.plain)) if code.source == FROM_PAIRS else _HALF
    return (
        (scale, read2, gain, code.loose),
        (read2, gain, camera.dark, code.most),
        (code.pitch, code.origin, _sigma(camera, code, code.edges.inside)),
    )


@leaf_kernel
def _sigma(camera: Camera, code: CodeRecord, place: Any) -> Any:
    """Of a place's mean square error in cells."""
    error = np.sqrt(code.pitch * code.pitch * place)
    return error if error > camera.floor else camera.floor


@pasted_kernel
def _levels(scale: Any, total: Any, most: Any) -> Any:
    """Mid level and half contrast."""
    return scale * np.float32(total), _HALF * np.float32(most)


@pasted_kernel
def _settled(limits: Any, total: Any, high: Any, low: Any, cell: Any, pair: Any, most: Any) -> Any:
    """Whether a bit is in doubt; flags, half contrast, mid level, probability of a wrong bit, place; bits are
    certain, but where their sums differ."""
    (scale, read2, gain, loose), why, (pitch, origin, _) = limits
    level, contrast = _levels(scale, total, most)
    margin, noise, apart = _HALF * np.float32(pair), read2 + gain * level, np.float32(high) - np.float32(low)
    weak = np.uint8(0) if surely(margin, _HALF * noise, loose * contrast) else np.uint8(1)
    wrong = _ONE if uneven(apart, contrast, SIX * np.sqrt(noise)) else _ZERO
    flags = why_cell(why, contrast, level, np.uint8(0), np.int32(cell), wrong)
    return weak, flags, contrast, level, wrong, pitch * np.float32(cell) + origin


@apart_kernel
def _store(
    n: int,
    limits: Any,
    told: Any,
    weak: Array,
    line: Array,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    (total, high, low), cell, pair, most = told
    certain = limits[2][2]
    for x in range(n):
        weak[x], flags[x], amplitude[x], offset[x], order_error[x], line[x] = _settled(
            limits, total[x], high[x], low[x], cell[x], pair[x], most[x]
        )
        sigma[x] = certain


@apart_kernel
def _merge(
    n: int,
    limits: Any,
    told: Any,
    weak: Array,
    line: Array,
    sigma: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    (total, high, low), cell, pair, most = told
    certain = limits[2][2]
    for x in range(n):
        weak[x], why, half, middle, wrong, line[x] = _settled(
            limits, total[x], high[x], low[x], cell[x], pair[x], most[x]
        )
        flags[x] |= why
        amplitude[x] = half if half < amplitude[x] else amplitude[x]
        offset[x] = _HALF * (offset[x] + middle)
        order_error[x] = either(order_error[x], wrong)
        sigma[x] = certain


@fast_kernel
def _any(n: int, weak: Array) -> bool:
    some = np.uint8(0)
    for x in range(n):
        some |= weak[x]
    return bool(some > 0)


@leaf_kernel
def _doubt(
    x: int,
    first: int,
    camera: Camera,
    code: CodeRecord,
    limits: Any,
    found: CellLines,
    axis: AxisRecord,
    shared: Shared,
    shorts: Array,
) -> None:
    """Pixel x of a tile, some of whose bits are in doubt: what that changes in the maps."""
    at, width = first + x, shared.flags.shape[1]
    found.cell[x] = shorts[_WORD, x]
    found.middle[x], found.half[x] = _levels(limits[0], shorts[_TOTAL, x], shorts[_MOST, x])
    found.far[x] = found.up[x] = found.down[x] = _ZERO
    found.clipped[x] = np.uint8(0)
    misread(x, first, camera, code, found)
    far, wrong = found.far[x], found.far[x] + found.up[x] + found.down[x]
    error = shared.flat_error
    if error[0, at] < _ONE:
        error[0, at] = either(error[0, at], wrong if wrong < _ONE else _ONE)
    shared.flat_flags[0, at] |= why_misread(found.clipped[x], far)
    axis.sigma[at // width, at % width] = _sigma(camera, code, found.place[x])
