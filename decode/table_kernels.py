"""Compiled refinement of a coordinate against known grey values: least squares of I = A + B t(u), sub-cell.

For each place u on a fine grid around a first answer the best A and B are closed forms, and the residual sum
of squares is a parabola near its minimum; its curvature is the Fisher information.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import kernel

__all__ = ["refine_rows", "residual"]

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
            # a misread word may be a cell beyond the surface
            centre = min(max(int((first[at, col] + 0.5) * per_cell), 0), places - 1)
            low, high = max(centre - reach, 0), min(centre + reach, places - 1)
            best, best_rss = low, np.inf
            for f in range(low, high + 1):
                value[f - low] = residual(light, used, table[:, f])[0]
                if value[f - low] < best_rss:
                    best, best_rss = f, value[f - low]
            rss, a, b = residual(light, used, table[:, best])
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
def residual(light: Array, used: Array, shown: Array) -> tuple[float, float, float]:
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
