"""Compiled: rows of frames as the look-up reads them: brightest frames, vectors of samples, linear levels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import inlined, kernel

from ..frames import RawFrames, RawLevel
from .lookup_search import Book

__all__ = ["BATCH", "SATURATED", "Camera", "beside", "brightest", "gather"]

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]
I64 = NDArray[np.int64]
#: Pixels per conversion into vectors: they fit the first-level cache.
BATCH = 64
#: Level of a saturated sample; a mean with one is saturated, too.
SATURATED = np.float32(-np.inf)


class Camera(NamedTuple):
    """raw (N, H, W), level of each raw value (empty: linear), white level, variance = read2 + gain level +
    misfit2 amplitude^2."""

    raw: RawFrames
    table: F32
    clip: float
    read2: float
    gain: float
    misfit2: float


@kernel
def brightest(raw: RawFrames, index: I64, row: int, clip: float, top: RawFrames, at: I16) -> None:
    """Largest level of each pixel of a row, and its first frame; the middle one of consecutive saturated
    frames."""
    top[:], at[:] = 0, 0
    for k in range(index.size):
        _raise(raw[index[k], row], np.int16(k), top, at)
    for x in range(top.size):
        ahead = np.int64(at[x])
        if top[x] >= clip:
            while ahead + 1 < index.size and raw[index[ahead + 1], row, x] >= clip:
                ahead += 1
            at[x] = (at[x] + ahead) // 2


@kernel
def _raise(line: RawFrames, place: np.int16, top: RawFrames, at: I16) -> None:
    for x in range(line.size):
        at[x] = place if line[x] > top[x] else at[x]
        top[x] = max(line[x], top[x])


@kernel
def beside(raw: RawFrames, index: I64, row: int, at: I16, away: int, across: int, other: RawFrames) -> None:
    """Largest level of the frames that are more than `away` from `at` along either axis of a raster that is
    `across` frames wide."""
    other[:] = 0
    down, right = np.empty(at.size, np.int16), np.empty(at.size, np.int16)
    for x in range(at.size):
        down[x], right[x] = at[x] // across, at[x] % across
    for k in range(index.size):
        _compare(raw[index[k], row], k // across, k % across, away, down, right, other)


@kernel
def _compare(line: RawFrames, i: int, j: int, away: int, down: I16, right: I16, other: RawFrames) -> None:
    above, below = np.int16(i - away), np.int16(i + away)
    left, beyond = np.int16(j - away), np.int16(j + away)
    for x in range(line.size):
        near = (down[x] >= above) & (down[x] <= below) & (right[x] >= left) & (right[x] <= beyond)
        v = line[x]
        v = other.dtype.type(0) if near else v
        other[x] = max(v, other[x])


@kernel
def gather(
    camera: Camera, book: Book, row: int, first: int, at: I16, lines: F32, batch: F32, pixels: F32
) -> None:
    """Samples of the pixels first.. of a row -> lines (n, BATCH), linear levels or SATURATED; less their mean
    -> batch (BATCH, n), saturated ones 0; pixels (3 BATCH..): means, squared sums, numbers of unsaturated
    samples. Of a sweep, samples around the brightest frame, `at`."""
    raw, frames, cols = camera.raw, book.frames, min(BATCH, camera.raw.shape[2] - first)
    middle, power, count = pixels[:BATCH], pixels[BATCH : 2 * BATCH], pixels[2 * BATCH : 3 * BATCH]
    clip = np.float32(camera.clip)
    for i in range(lines.shape[0]):
        if frames.shape[0] == 1:
            _convert(raw[frames[0, i, 0], row, first : first + cols], camera.table, clip, lines[i])
        else:
            _means(raw[:, row, first : first + cols], camera.table, clip, frames[:, i], at[first:], lines[i])
    middle[:], power[:], count[:] = np.float32(0), np.float32(0), np.float32(1e-6)
    for i in range(lines.shape[0]):
        _add(lines[i], middle, count)
    for k in range(BATCH):
        middle[k] /= count[k]
    for i in range(lines.shape[0]):
        _deviate(lines[i], middle, power, batch[:, i])


@inlined
def _level(value: RawLevel, table: F32, clip: np.float32) -> np.float32:
    linear = table[np.int64(value)] if table.size > 0 else np.float32(value)
    return SATURATED if value >= clip else linear


@kernel
def _means(raw: RawFrames, table: F32, clip: np.float32, frames: I64, at: I16, out: F32) -> None:
    """Mean level of the frames (K', S)[at[k]] for each pixel k (raw (N, K)); SATURATED if one is."""
    for k in range(raw.shape[1]):
        total = np.float32(0)
        for j in range(frames.shape[1]):
            total += _level(raw[frames[at[k], j], k], table, clip)
        out[k] = total / np.float32(frames.shape[1])


@kernel
def _convert(line: RawFrames, table: F32, clip: np.float32, out: F32) -> None:
    if table.size > 0:
        for k in range(line.size):
            out[k] = _level(line[k], table, clip)
    else:
        for k in range(line.size):
            out[k] = SATURATED if line[k] >= clip else np.float32(line[k])


@kernel
def _add(line: F32, total: F32, count: F32) -> None:
    for k in range(BATCH):
        whole = line[k] > SATURATED
        total[k] += line[k] if whole else np.float32(0)
        count[k] += np.float32(1) if whole else np.float32(0)


@kernel
def _deviate(line: F32, mean: F32, power: F32, out: F32) -> None:
    """Subtract the mean, with saturated samples 0; add squares."""
    for k in range(BATCH):
        own = line[k] - mean[k] if line[k] > SATURATED else np.float32(0)
        power[k] += own * own
        out[k] = own
