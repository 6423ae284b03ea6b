"""Compiled: rows of frames as the look-up reads them: brightest frames, vectors of samples, linear levels."""

from typing import Any

import numpy as np

from optolever.kernels import exact, kernel

__all__ = ["BATCH", "beside", "brightest", "gather"]

#: Pixels whose samples are turned into vectors together: they stay in the first cache.
BATCH = 64
#: Below all levels: what stands for a saturated one.
_SATURATED = -1e9


@kernel
def brightest(raw: Any, index: Any, row: Any, clip: Any, top: Any, at: Any) -> None:
    """Largest level of each pixel of a row, and which of the frames shows it first; the middle of those that
    are saturated one after the other."""
    line = raw[index[0], row]
    for x in range(top.size):
        top[x], at[x] = line[x], 0
    for k in range(1, index.size):
        line = raw[index[k], row]
        place = np.int16(k)
        for x in range(top.size):
            v = line[x]
            at[x] = place if v > top[x] else at[x]
            top[x] = max(v, top[x])
    for x in range(top.size):
        ahead = np.int64(at[x])
        if top[x] >= clip:
            while ahead + 1 < index.size and raw[index[ahead + 1], row, x] >= clip:
                ahead += 1
            at[x] = (at[x] + ahead) // 2


@kernel
def beside(raw: Any, index: Any, row: Any, at: Any, away: Any, other: Any) -> None:
    """Largest level of the frames that are more than `away` from `at`."""
    other[:] = 0
    for k in range(index.size):
        line = raw[index[k], row]
        low, high = np.int16(k - away), np.int16(k + away)
        for x in range(at.size):
            v = line[x]
            v = v if (at[x] < low) | (at[x] > high) else raw.dtype.type(0)
            other[x] = max(v, other[x])


@kernel
def gather(camera: Any, book: Any, row: Any, first: Any, at: Any, lines: Any, batch: Any, pixels: Any) -> Any:
    """Samples of the pixels first.. of a row without their mean -> batch (BATCH, n); pixels (3, BATCH):
    mean, squared sum, how many are not saturated (those that are become 0). Whether all are the frames 0..n,
    or those around the brightest one, `at`: where several are saturated, around the middle of them."""
    raw, n, cols = camera.raw, book.samples, min(BATCH, camera.raw.shape[2] - first)
    middle, power, count = pixels[0], pixels[1], pixels[2]
    window = at[first : first + cols]
    for i in range(n):
        own = lines[i]
        if book.begin.size > 1:
            for k in range(cols):
                own[k] = raw[book.index[book.begin[window[k]] + i], row, first + k]
        else:
            convert(raw[book.index[i], row, first : first + cols], own)
    saturated, clip = 0, np.float32(camera.clip)
    middle[:], power[:], count[:] = np.float32(0), np.float32(0), np.float32(n)
    for i in range(n):
        add(lines[i], middle)
        saturated += above(lines[i], clip)
    if saturated > 0 or camera.table.size > 0:
        linearised(camera, lines, cols, middle, count)
    for k in range(BATCH):
        middle[k] /= count[k]
    for i in range(n):
        deviate(lines[i], middle, power)
    transpose(lines, batch)


@kernel
def convert(line: Any, out: Any) -> None:
    for k in range(line.size):
        out[k] = line[k]


@kernel
def transpose(lines: Any, batch: Any) -> None:
    for i in range(lines.shape[0]):
        for k in range(lines.shape[1]):
            batch[k, i] = lines[i, k]


@kernel
def add(line: Any, total: Any) -> None:
    for k in range(BATCH):
        total[k] += line[k]


@kernel
def above(line: Any, clip: Any) -> Any:
    count = np.int32(0)
    for k in range(BATCH):
        count += np.int32(1) if line[k] >= clip else np.int32(0)
    return count


@kernel
def deviate(line: Any, mean: Any, power: Any) -> None:
    """Less the mean, saturated samples 0; squares added."""
    for k in range(BATCH):
        line[k] = line[k] - mean[k] if line[k] > np.float32(_SATURATED) else np.float32(0)
        power[k] += line[k] * line[k]


@exact
def linearised(camera: Any, lines: Any, cols: Any, total: Any, count: Any) -> None:
    """Linear levels of raw ones, saturated ones far below 0; sum and number of those that are not."""
    total[:], count[:] = np.float32(0), np.float32(1e-6)
    for i in range(lines.shape[0]):
        for k in range(cols):
            level = lines[i, k]
            if level >= camera.clip:
                lines[i, k] = np.float32(2 * _SATURATED)
            else:
                lines[i, k] = camera.table[np.int64(level)] if camera.table.size > 0 else level
                total[k] += lines[i, k]
                count[k] += np.float32(1)
