"""Compiled binary codes: bits -> code word -> cell, and the probability that a bit was misread."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import fast_kernel, inline_kernel, kernel

__all__ = ["FROM_EXTREMES", "FROM_PAIRS", "FROM_WHITE_BLACK", "code_rows"]

Array = NDArray[Any]

#: Where the threshold of bits without inverse, the contrast and the offset come from.
FROM_WHITE_BLACK, FROM_PAIRS, FROM_EXTREMES = 0, 1, 2
#: Squared margin over variance beyond which a bit is certain: 6 sigma, 1e-9.
_CERTAIN = 36.0
_TILE = 512


@kernel
def code_rows(
    frames: Array,
    lut: Array,
    clip: float,
    start: int,
    stop: int,
    source: int,
    white: int,
    black: int,
    plain: Array,
    inverse: Array,
    cells: Array,
    read2: float,
    gain: float,
    loose: float,
    cell: Array,
    far: Array,
    up: Array,
    down: Array,
    half: Array,
    middle: Array,
    clipped: Array,
) -> None:
    """Decode rows start..stop into block arrays (stop - start, W).

    plain, inverse (bits,): frame numbers, -1 = not shown, bit 0 least significant; cells: word -> cell;
    read2 + gain I = variance of a sample; loose = systematic error of a margin, in half contrasts.
    Out: cell; probabilities that the truth is one cell up, one cell down, or anywhere else (far);
    half contrast, mid level; clipped = number of clipped samples that decide bits or the threshold.
    """
    width = frames.shape[2]
    weakest = np.empty(_TILE, np.float32)
    word = np.empty(_TILE, np.int32)
    for row in range(start, stop):
        at = row - start
        for first in range(0, width, _TILE):
            n = min(_TILE, width - first)
            end = first + n
            mid_n, half_n = middle[at, first:end], half[at, first:end]
            _reference(frames, lut, row, first, n, source, white, black, plain, inverse, mid_n, half_n)
            _words(
                frames,
                lut,
                clip,
                row,
                first,
                n,
                source,
                plain,
                inverse,
                read2,
                gain,
                loose,
                mid_n,
                half_n,
                weakest,
                word,
                clipped[at, first:end],
            )
            for x in range(n):
                cell[at, first + x] = cells[word[x]]
                far[at, first + x] = 0
                up[at, first + x] = 0
                down[at, first + x] = 0
            for x in range(n):
                if not weakest[x] > _CERTAIN:
                    _misread(
                        frames,
                        lut,
                        row,
                        first + x,
                        source,
                        plain,
                        inverse,
                        cells,
                        read2,
                        gain,
                        loose,
                        word[x],
                        mid_n[x],
                        half_n[x],
                        far[at],
                        up[at],
                        down[at],
                    )


@inline_kernel
def _level(lut: Array, raw: Any) -> Any:
    return lut[int(raw)] if lut.size else np.float32(raw)


@fast_kernel
def _reference(
    frames: Array,
    lut: Array,
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
    """Mid level and half contrast of each pixel."""
    if source == 0:
        bright, dark = frames[white, row, first : first + n], frames[black, row, first : first + n]
        for x in range(n):
            high, low = _level(lut, bright[x]), _level(lut, dark[x])
            middle[x] = np.float32(0.5) * (high + low)
            half[x] = np.float32(0.5) * (high - low)
        return
    for x in range(n):
        middle[x] = 0
        half[x] = 0
    if source == 1:
        pairs = 0
        for bit in range(len(plain)):
            if plain[bit] >= 0 and inverse[bit] >= 0:
                pairs += 1
                line, other = (
                    frames[plain[bit], row, first : first + n],
                    frames[inverse[bit], row, first : first + n],
                )
                for x in range(n):
                    high, low = _level(lut, line[x]), _level(lut, other[x])
                    middle[x] += np.float32(0.5) * (high + low)
                    half[x] = max(half[x], np.float32(0.5) * abs(high - low))
        scale = np.float32(1.0) / np.float32(max(pairs, 1))
        for x in range(n):
            middle[x] *= scale
        return
    for x in range(n):
        high, low = np.float32(-np.inf), np.float32(np.inf)
        for bit in range(len(plain)):
            raw = frames[max(plain[bit], inverse[bit]), row, first + x]
            high, low = max(high, _level(lut, raw)), min(low, _level(lut, raw))
        middle[x] = np.float32(0.5) * (high + low)
        half[x] = np.float32(0.5) * (high - low)


@fast_kernel
def _words(
    frames: Array,
    lut: Array,
    clip: float,
    row: int,
    first: int,
    n: int,
    source: int,
    plain: Array,
    inverse: Array,
    read2: float,
    gain: float,
    loose: float,
    middle: Array,
    half: Array,
    weakest: Array,
    word: Array,
    clipped: Array,
) -> None:
    """Code words, and the smallest squared margin over its variance."""
    for x in range(n):
        weakest[x] = 1e30
        word[x] = 0
        clipped[x] = 0
    for bit in range(len(plain)):
        single = np.float32(1.0) if source == 2 else np.float32(1.5)
        if plain[bit] >= 0 and inverse[bit] >= 0:
            line, other = (
                frames[plain[bit], row, first : first + n],
                frames[inverse[bit], row, first : first + n],
            )
            for x in range(n):
                margin = np.float32(0.5) * (_level(lut, line[x]) - _level(lut, other[x]))
                spread = np.float32(0.5) * (read2 + gain * middle[x]) + (loose * half[x]) ** 2
                weakest[x] = min(weakest[x], margin * margin / spread)
                word[x] |= np.int32(margin > 0) << bit
                clipped[x] += np.uint8((line[x] >= clip) & (other[x] >= clip))
        else:
            sign = np.float32(1.0) if plain[bit] >= 0 else np.float32(-1.0)
            line = frames[max(plain[bit], inverse[bit]), row, first : first + n]
            for x in range(n):
                margin = sign * (_level(lut, line[x]) - middle[x])
                spread = single * (read2 + gain * middle[x]) + (loose * half[x]) ** 2
                weakest[x] = min(weakest[x], margin * margin / spread)
                word[x] |= np.int32(margin > 0) << bit
                clipped[x] += np.uint8((line[x] >= clip) & (middle[x] >= clip))


@kernel
def _misread(
    frames: Array,
    lut: Array,
    row: int,
    x: int,
    source: int,
    plain: Array,
    inverse: Array,
    cells: Array,
    read2: float,
    gain: float,
    loose: float,
    word: int,
    middle: float,
    half: float,
    far: Array,
    up: Array,
    down: Array,
) -> None:
    """Sum over bits of Q(margin / sigma), sorted by where the flipped bit would lead."""
    cell = cells[word]
    for bit in range(len(plain)):
        if plain[bit] >= 0 and inverse[bit] >= 0:
            margin = 0.5 * (
                _level(lut, frames[plain[bit], row, x]) - _level(lut, frames[inverse[bit], row, x])
            )
            spread = 0.5 * (read2 + gain * middle)
        else:
            margin = _level(lut, frames[max(plain[bit], inverse[bit]), row, x]) - middle
            spread = (1.0 if source == 2 else 1.5) * (read2 + gain * middle)
        spread += (loose * half) ** 2
        wrong = 0.5 * math.erfc(abs(margin) / math.sqrt(2 * spread)) if spread > 0 else 0.5
        step = cells[word ^ (1 << bit)] - cell
        if step == 1:
            up[x] += wrong
        elif step == -1:
            down[x] += wrong
        else:
            far[x] += wrong
