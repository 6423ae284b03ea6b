"""Compiled refinement of a coordinate against known grey values: least squares of I = A + B t(u), sub-cell.

For each place u on a fine grid around a first answer the best A and B are closed forms, and the residual sum
of squares is a parabola near its minimum; its curvature is the Fisher information.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import inline_kernel, kernel

__all__ = ["refine_rows", "stripe_rows"]

Array = NDArray[Any]


@kernel
def refine_rows(
    frames: Array,
    clip: float,
    start: int,
    stop: int,
    index: Array,
    table: Array,
    per_cell: int,
    reach: int,
    first: Array,
    coord: Array,
    curvature: Array,
    misfit: Array,
    offset: Array,
    scale: Array,
    count: Array,
) -> None:
    """Rows start..stop: block arrays (stop - start, W).

    table (M, F): level 0..1 of each frame at places (f + 0.5) / per_cell - 0.5; first: answer to start from
    (pattern pixels), searched within +- reach fine steps. Out: coord, whose variance is that of a sample over
    curvature = d^2 RSS / du^2 / 2; misfit = RSS, offset A, scale B, count = samples that are not clipped.
    """
    places, width = table.shape[1], frames.shape[2]
    value = np.empty(2 * reach + 1, np.float64)
    light = np.empty(len(index), np.float64)
    used = np.empty(len(index), np.bool_)
    for row in range(start, stop):
        at = row - start
        for col in range(width):
            samples = 0
            for m in range(len(index)):
                raw = frames[index[m], row, col]
                light[m] = raw
                used[m] = raw < clip
                samples += used[m]
            centre = int((first[at, col] + 0.5) * per_cell)
            low, high = max(centre - reach, 0), min(centre + reach, places - 1)
            best, best_rss = low, np.inf
            for f in range(low, high + 1):
                value[f - low] = _rss(light, used, table[:, f])[0]
                if value[f - low] < best_rss:
                    best, best_rss = f, value[f - low]
            rss, a, b = _rss(light, used, table[:, best])
            shift, bend = 0.0, 0.0
            if low < best < high:
                left, right = value[best - low - 1], value[best - low + 1]
                bend = left - 2 * best_rss + right
                if bend > 0:
                    shift = 0.5 * (left - right) / bend
                    rss = best_rss - 0.25 * (left - right) * shift
            coord[at, col] = (best + 0.5 + shift) / per_cell - 0.5
            curvature[at, col] = max(0.5 * bend * per_cell * per_cell, 0.0)
            misfit[at, col], offset[at, col], scale[at, col], count[at, col] = max(rss, 0.0), a, b, samples


@kernel
def _rss(light: Array, used: Array, shown: Array) -> tuple[float, float, float]:
    """Residual sum of squares, A and B of light = A + B shown; B < 0 is no pattern."""
    n, si, st, sii, stt, sit = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(len(light)):
        if used[m]:
            i, t = light[m], float(shown[m])
            n += 1
            si += i
            st += t
            sii += i * i
            stt += t * t
            sit += i * t
    if n < 3:
        return 0.0, 0.0, 0.0
    cii, ctt, cit = sii - si * si / n, stt - st * st / n, sit - si * st / n
    if ctt < 1e-9 or cit <= 0:
        return cii, si / n, 0.0
    b = cit / ctt
    return cii - b * cit, (si - b * st) / n, b


@inline_kernel
def _profile(distance: Any) -> Any:
    """Raised cosine of full width 1 at half maximum."""
    return 0.5 + 0.5 * math.cos(math.pi * distance) if abs(distance) < 1 else 0.0


@kernel
def stripe_rows(
    frames: Array,
    clip: float,
    start: int,
    stop: int,
    index: Array,
    at: Array,
    width_px: float,
    window: int,
    coord: Array,
    curvature: Array,
    misfit: Array,
    offset: Array,
    scale: Array,
    count: Array,
    rival: Array,
) -> None:
    """A swept stripe: the brightest frame, then the best place of the known profile within +- window frames.

    index (M,) frames in the order of their stripes' places at (M,). Out as refine_rows; rival = brightest
    sample outside the window minus offset.
    """
    cols, frames_count = frames.shape[2], len(index)
    top, peak, other = np.empty(cols, np.float32), np.empty(cols, np.int32), np.empty(cols, np.float32)
    light, shown = np.empty(2 * window + 1, np.float64), np.empty(2 * window + 1, np.float64)
    used = np.empty(2 * window + 1, np.bool_)
    steps = 32
    for row in range(start, stop):
        block = row - start
        top[:], peak[:], other[:] = -1.0, 0, -1.0
        for k in range(frames_count):
            line = frames[index[k], row]
            for x in range(cols):
                level = np.float32(line[x])
                peak[x] = k if level > top[x] else peak[x]
                top[x] = level if level > top[x] else top[x]
        for k in range(frames_count):
            line = frames[index[k], row]
            for x in range(cols):
                level = np.float32(line[x])
                other[x] = level if (abs(k - peak[x]) > window) & (level > other[x]) else other[x]
        for x in range(cols):
            low, high = max(peak[x] - window, 0), min(peak[x] + window, frames_count - 1)
            n = high - low + 1
            samples = 0
            for k in range(n):
                raw = frames[index[low + k], row, x]
                light[k] = raw
                used[k] = raw < clip
                samples += used[k]
            span = 0.5 * (at[high] - at[low]) / window
            values = np.empty(steps + 1)
            best = 0
            for f in range(steps + 1):
                place = at[peak[x]] + (2.0 * f / steps - 1) * span
                for k in range(n):
                    shown[k] = _profile((place - at[low + k]) / width_px)
                values[f] = _rss(light[:n], used[:n], shown[:n])[0]
                if values[f] < values[best]:
                    best = f
            shift, bend = 0.0, 0.0
            if 0 < best < steps:
                bend = values[best - 1] - 2 * values[best] + values[best + 1]
                shift = 0.5 * (values[best - 1] - values[best + 1]) / bend if bend > 0 else 0.0
            pitch = 2 * span / steps
            coord[block, x] = at[peak[x]] - span + (best + shift) * pitch
            for k in range(n):
                shown[k] = _profile((coord[block, x] - at[low + k]) / width_px)
            rss, a, b = _rss(light[:n], used[:n], shown[:n])
            curvature[block, x] = max(0.5 * bend / (pitch * pitch), 0.0) if pitch > 0 else 0.0
            misfit[block, x], offset[block, x], scale[block, x], count[block, x] = (
                max(rss, 0.0),
                a,
                b,
                samples,
            )
            rival[block, x] = other[x] - a
