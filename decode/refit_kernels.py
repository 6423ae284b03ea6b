"""Compiled fringe fit of single pixels that equal weights do not suit: clipped samples, weights by noise."""

import math
from typing import Any

from numpy.typing import NDArray

from .fit_kernels import linear_level
from .jit import leaf_kernel
from .unwrap_kernels import UNKNOWN

__all__ = ["refit"]

Array = NDArray[Any]

#: Of the normal equations: that of three equal shifts is 27/4, with weights below 1 less.
_LEAST_DETERMINANT = 1e-6


@leaf_kernel
def refit(
    n: int,
    frames: Array,
    lut: Array | None,
    slope: Array,
    index: Array,
    first: int,
    clip: float,
    count: int,
    model: Array,
    read2: float,
    gain: float,
    equations: Array,
    sums: Array,
    turns: Array,
    variance: Array,
    misfit: Array,
) -> None:
    """Fit again what equal weights do not suit: pixels with clipped samples (left out), and with `slope` all.

    slope = d raw / d linear at linear levels 0..255, empty: 1; a sample's variance is (read2 + gain raw) /
    slope^2, taken at the level of the first fit, as weights from the samples would be biased. Where fewer
    than three samples are left, the variance is UNKNOWN. misfit is in raw levels, as the noise is.
    equations: room for (3, 4).
    """
    normal, right = equations[:, :3], equations[:, 3]
    for x in range(n):
        whole = True
        for i in range(count):
            whole &= frames[index[i], 0, first + x] < clip
        if whole and slope.size == 0:
            continue
        equations[:] = 0
        total = 0.0
        for i in range(count):
            raw = frames[index[i], 0, first + x]
            if raw >= clip:
                continue
            level = linear_level(raw, lut)
            weight = _weight(slope, model, i, sums[0, x], sums[1, x], sums[2, x]) / (
                1 + gain / read2 * max(raw, 0)
            )
            total += weight * level * level
            for j in range(3):
                right[j] += weight * model[i, j + 1] * level
                for k in range(3):
                    normal[j, k] += weight * model[i, j + 1] * model[i, k + 1]
        misfit[x] = 0
        if _invert(normal) < _LEAST_DETERMINANT:
            variance[x] = UNKNOWN
            continue
        a = normal[0, 0] * right[0] + normal[0, 1] * right[1] + normal[0, 2] * right[2]
        c = normal[1, 0] * right[0] + normal[1, 1] * right[1] + normal[1, 2] * right[2]
        s = normal[2, 0] * right[0] + normal[2, 1] * right[1] + normal[2, 2] * right[2]
        power = max(c * c + s * s, 1e-12)
        spread = (c * c * normal[2, 2] + s * s * normal[1, 1] - 2 * c * s * normal[1, 2]) / (power * power)
        if whole:
            misfit[x] = max(total - a * right[0] - c * right[1] - s * right[2], 0.0)
        sums[0, x], sums[1, x], sums[2, x] = a, c, s
        variance[x] = spread * read2 / (4 * math.pi * math.pi)
        turns[x] = math.atan2(s, c) / (2 * math.pi)


@leaf_kernel
def _weight(slope: Array, model: Array, i: int, a: float, c: float, s: float) -> float:
    """Squared slope at the fitted level of sample i; 1 without a response."""
    if slope.size == 0:
        return 1.0
    level = model[i, 1] * a + model[i, 2] * c + model[i, 3] * s
    here = slope[min(max(int(level + 0.5), 0), len(slope) - 1)]
    return float(here * here)


@leaf_kernel
def _invert(m: Array) -> float:
    """Invert a symmetric 3 x 3 matrix in place; its determinant (too small: left as it was)."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if determinant < _LEAST_DETERMINANT:
        return float(determinant)
    c11 = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    c12 = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    c22 = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    m[0, 0], m[1, 1], m[2, 2] = c00 / determinant, c11 / determinant, c22 / determinant
    m[0, 1] = m[1, 0] = c01 / determinant
    m[0, 2] = m[2, 0] = c02 / determinant
    m[1, 2] = m[2, 1] = c12 / determinant
    return float(determinant)
