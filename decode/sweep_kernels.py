"""Compiled: where a swept stripe was when it lit a pixel most."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import inline_kernel, kernel
from .table_kernels import residual

__all__ = ["stripe_rows"]

Array = NDArray[Any]


@inline_kernel
def _lit(profile: Any, distance: Any) -> Any:
    """Light at a distance in samples of the profile, interpolated; none beyond its end."""
    k = int(distance)
    if k + 1 >= len(profile):
        return 0.0
    return profile[k] + (distance - k) * (profile[k + 1] - profile[k])


@kernel
def stripe_rows(
    frames: Array,
    clip: float,
    start: int,
    stop: int,
    index: Array,
    at: Array,
    profile: Array,
    per_px: float,
    window: int,
    coord: Array,
    curvature: Array,
    misfit: Array,
    offset: Array,
    scale: Array,
    count: Array,
    rival: Array,
    level: Array,
    mean: Array,
) -> None:
    """A swept stripe: the brightest frame, then the best place of the known profile within +- window frames.

    index (M,) frames in the order of their stripes' places at (M,); profile: light at distances 0, 1, 2, ...
    / per_px. Out as table_kernels.refine_rows; rival = brightest sample outside the window minus offset;
    level, mean: see _levels.
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
                raw = np.float32(line[x])
                peak[x] = k if raw > top[x] else peak[x]
                top[x] = raw if raw > top[x] else top[x]
        for k in range(frames_count):
            line = frames[index[k], row]
            for x in range(cols):
                raw = np.float32(line[x])
                other[x] = raw if (abs(k - peak[x]) > window) & (raw > other[x]) else other[x]
        for x in range(cols):
            low, high = max(peak[x] - window, 0), min(peak[x] + window, frames_count - 1)
            n = high - low + 1
            samples = 0
            for k in range(n):
                light[k] = frames[index[low + k], row, x]
                used[k] = light[k] < clip
                samples += used[k]
            span = 0.5 * (at[high] - at[low]) / window
            values = np.empty(steps + 1)
            best = 0
            for f in range(steps + 1):
                place = at[peak[x]] + (2.0 * f / steps - 1) * span
                for k in range(n):
                    shown[k] = _lit(profile, per_px * abs(place - at[low + k]))
                values[f] = residual(light[:n], used[:n], shown[:n])[0]
                if values[f] < values[best]:
                    best = f
            shift, bend = 0.0, 0.0
            if 0 < best < steps:
                bend = values[best - 1] - 2 * values[best] + values[best + 1]
                shift = 0.5 * (values[best - 1] - values[best + 1]) / bend if bend > 0 else 0.0
            pitch = 2 * span / steps
            coord[block, x] = at[peak[x]] - span + (best + shift) * pitch
            for k in range(n):
                shown[k] = _lit(profile, per_px * abs(coord[block, x] - at[low + k]))
            rss, a, b = residual(light[:n], used[:n], shown[:n])
            curvature[block, x] = max(0.5 * bend / (pitch * pitch), 0.0) if pitch > 0 else 0.0
            misfit[block, x], offset[block, x], scale[block, x], count[block, x] = (
                max(rss, 0.0),
                a,
                b,
                samples,
            )
            rival[block, x] = other[x] - a
            slope = light  # not needed any more
            for k in range(n):
                away = per_px * abs(coord[block, x] - at[low + k])
                slope[k] = _lit(profile, away + 0.5) - _lit(profile, max(away - 0.5, 0.0))
                slope[k] = -slope[k] if coord[block, x] < at[low + k] else slope[k]
            level[block, x], mean[block, x] = _levels(slope[:n], used[:n], shown[:n], a, b)


@kernel
def _levels(slope: Array, used: Array, shown: Array, a: float, b: float) -> tuple[float, float]:
    """Means of the levels a + b shown, weighted by what each sample says of the place, and by what of it the
    fit of level, contrast and place leaves.
    """
    n, st, sg, stt, stg = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(slope)):
        if used[k]:
            n += 1
            st += shown[k]
            sg += slope[k]
            stt += shown[k] * shown[k]
            stg += shown[k] * slope[k]
    if n < 4:
        return a, a
    spread = max(stt - st * st / n, 1e-12)
    tilt = (stg - st * sg / n) / spread
    told, weighted, left = 0.0, 0.0, 0.0
    for k in range(len(slope)):
        if used[k]:
            own = (slope[k] - sg / n - tilt * (shown[k] - st / n)) ** 2
            told += own
            weighted += own * shown[k]
            left += (1 - 1 / n - (shown[k] - st / n) ** 2 / spread) * shown[k]
    weighted /= max(told, 1e-12)
    return a + b * weighted, a + b * (left - weighted) / (n - 3)
