"""Compiled: where a swept stripe was when it lit a pixel most."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import inline_kernel, kernel, leaf_kernel
from .table_kernels import residual

__all__ = ["StripeFit", "Swept", "stripe_rows"]

Array = NDArray[Any]
#: Steps within the window that are tried.
_STEPS = 32


class Swept(NamedTuple):
    """frame (M,): numbers in the order of the stripes' places at (M,), pattern px; profile: light at
    distances 0, 1, 2, ... / per_px; window: frames on either side of the brightest that are fitted."""

    frame: Array
    at: Array
    profile: Array
    per_px: float
    window: int


class StripeFit(NamedTuple):
    """Of a block of rows (R, W). coord, whose variance is that of a sample over curvature = d^2 RSS / du^2
    / 2; misfit = RSS, offset A, scale B of I = A + B t, samples that are not clipped; rival = brightest
    sample outside the window minus offset; level, mean: see _levels."""

    coord: Array
    curvature: Array
    misfit: Array
    offset: Array
    scale: Array
    samples: Array
    rival: Array
    level: Array
    mean: Array


class _Samples(NamedTuple):
    """Of a pixel, within its window: light, which of it counts, and what a place would show."""

    light: Array
    used: Array
    shown: Array


@inline_kernel
def _lit(profile: Any, distance: Any) -> Any:
    """Light at a distance in samples of the profile, interpolated; none beyond its end."""
    k = int(distance)
    if k + 1 >= len(profile):
        return 0.0
    return profile[k] + (distance - k) * (profile[k + 1] - profile[k])


@kernel
def stripe_rows(frames: Array, clip: float, start: int, stop: int, swept: Swept, found: StripeFit) -> None:
    """A swept stripe: the brightest frame, then the best place of the known profile within the window."""
    cols, most = frames.shape[2], 2 * swept.window + 1
    top, peak, other = np.empty(cols, np.float32), np.empty(cols, np.int32), np.empty(cols, np.float32)
    seen = _Samples(np.empty(most), np.empty(most, np.bool_), np.empty(most))
    values = np.empty(_STEPS + 1)
    for row in range(start, stop):
        _brightest(frames, row, swept, top, peak, other)
        for x in range(cols):
            _fit(frames, clip, row, x, peak[x], swept, seen, values, row - start, found)
            found.rival[row - start, x] = other[x] - found.offset[row - start, x]


@leaf_kernel
def _brightest(frames: Array, row: int, swept: Swept, top: Array, peak: Array, other: Array) -> None:
    """Of a row's pixels: largest level, its frame's place in the order, largest level outside the window."""
    cols, frame = frames.shape[2], swept.frame
    top[:], peak[:], other[:] = -1.0, 0, -1.0
    for k in range(len(frame)):
        line = frames[frame[k], row]
        for x in range(cols):
            raw = np.float32(line[x])
            peak[x] = k if raw > top[x] else peak[x]
            top[x] = raw if raw > top[x] else top[x]
    for k in range(len(frame)):
        line = frames[frame[k], row]
        for x in range(cols):
            raw = np.float32(line[x])
            other[x] = raw if (abs(k - peak[x]) > swept.window) & (raw > other[x]) else other[x]


@leaf_kernel
def _fit(
    frames: Array,
    clip: float,
    row: int,
    x: int,
    peak: int,
    swept: Swept,
    seen: _Samples,
    values: Array,
    block: int,
    found: StripeFit,
) -> None:
    """One pixel, into row `block` of `found`."""
    at, window = swept.at, swept.window
    low, high = max(peak - window, 0), min(peak + window, len(at) - 1)
    n = high - low + 1
    light, used, shown = seen.light[:n], seen.used[:n], seen.shown[:n]
    samples = 0
    for k in range(n):
        light[k] = frames[swept.frame[low + k], row, x]
        used[k] = light[k] < clip
        samples += used[k]
    span = 0.5 * (at[high] - at[low]) / window
    best, pitch = 0, 2 * span / _STEPS
    for f in range(_STEPS + 1):
        _show(at[peak] - span + f * pitch, low, swept, shown)
        values[f] = residual(light, used, shown)[0]
        if values[f] < values[best]:
            best = f
    shift, bend = 0.0, 0.0
    if 0 < best < _STEPS:
        bend = values[best - 1] - 2 * values[best] + values[best + 1]
        shift = 0.5 * (values[best - 1] - values[best + 1]) / bend if bend > 0 else 0.0
    place = at[peak] - span + (best + shift) * pitch
    _show(place, low, swept, shown)
    rss, a, b = residual(light, used, shown)
    found.coord[block, x], found.misfit[block, x] = place, max(rss, 0.0)
    found.offset[block, x], found.scale[block, x], found.samples[block, x] = a, b, samples
    found.curvature[block, x] = max(0.5 * bend / (pitch * pitch), 0.0) if pitch > 0 else 0.0
    slope = light  # not needed any more
    for k in range(n):
        away = swept.per_px * abs(place - at[low + k])
        rise = _lit(swept.profile, away + 0.5) - _lit(swept.profile, max(away - 0.5, 0.0))
        slope[k] = -rise if place < at[low + k] else rise
    found.level[block, x], found.mean[block, x] = _levels(slope, used, shown, a, b)


@inline_kernel
def _show(place: float, low: int, swept: Swept, shown: Array) -> None:
    """What the frames from `low` on show at a place, 0..1."""
    for k in range(len(shown)):
        shown[k] = _lit(swept.profile, swept.per_px * abs(place - swept.at[low + k]))


@leaf_kernel
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
