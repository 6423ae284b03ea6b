"""Compiled: what a pixel's neighbours tell of it, from maps that hold more than the pixel's own row.

A camera pixel sees a mean over its footprint. Where the map bends or is steep, or where part of the footprint
sees no pattern (beside a hole, at the border), that mean belongs to no place, and no sample of the pixel
itself tells.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import leaf_kernel, roomy_kernel

__all__ = ["REACH", "bend_rows", "mixed_rows", "steep_rows"]

Array = NDArray[Any]

#: Rows above and below that are looked at.
REACH = 3
#: A pixel's mean over a box lies off its centre's value by the sum of second derivatives over this.
_BOX = np.float64(24.0)
#: A second difference counts above so many sigma: four times its own noise.
_BENT = np.float64(14.0)
#: OUTLIER is what these kernels write, so that they do not read it: rows are done in any order.
_OUTLIER = np.uint16(32)
_READ = np.uint16(0xFFFF ^ 32)
#: DARK, LOW_CONTRAST and INVALID: nothing is seen there.
_NOTHING = np.uint16(1 | 4 | 128)
#: Amplitude over the neighbours' largest, below which a pixel beside one that sees nothing, or near the
#: border, has lost part of its light.
_BESIDE, _BORDER = np.float32(0.85), np.float32(0.96)
#: Cells from the border in which that is looked at: the border's shadow in a strong blur.
_NEAR = 16.0
_ZERO, _THREE = np.float32(0), np.float32(3)


@roomy_kernel
def bend_rows(start: int, stop: int, coord: Array, sigma: Array, flags: Array) -> None:
    """Add to sigma (H, W), rows start..stop, what the bend of coord (H, W) shifts the mean over a pixel."""
    rows, cols = coord.shape
    bend = np.zeros(cols, np.float64)
    for row in range(start, stop):
        here, spread = coord[row], sigma[row]
        above, below = coord[max(row - 1, 0)], coord[min(row + 1, rows - 1)]
        bad, bad_above, bad_below = flags[row], flags[max(row - 1, 0)], flags[min(row + 1, rows - 1)]
        inner = 0 < row < rows - 1
        for x in range(1, cols - 1):
            along = abs(here[x - 1] - 2 * here[x] + here[x + 1])
            bend[x] = along if ((bad[x - 1] | bad[x + 1]) & _READ) == 0 else 0.0
        for x in range(cols):
            across = abs(above[x] - 2 * here[x] + below[x])
            bend[x] += across if inner & (((bad_above[x] | bad_below[x]) & _READ) == 0) else 0.0
        for x in range(cols):
            shift = bend[x] / _BOX
            more = bend[x] > _BENT * spread[x]
            spread[x] = np.sqrt(spread[x] * spread[x] + shift * shift) if more else spread[x]


@roomy_kernel
def steep_rows(start: int, stop: int, most: float, coord: Array, flags: Array) -> None:
    """Flag pixels of a code alone whose footprint is larger than `most`: its bits hold for no one place."""
    rows, cols = coord.shape
    for row in range(start, stop):
        here = coord[row]
        up, down = max(row - 1, 0), min(row + 1, rows - 1)
        for x in range(cols):
            left, right = max(x - 1, 0), min(x + 1, cols - 1)
            low = here[left] if (flags[row, left] & _READ) == 0 else here[x]
            high = here[right] if (flags[row, right] & _READ) == 0 else here[x]
            top = coord[up, x] if (flags[up, x] & _READ) == 0 else here[x]
            bottom = coord[down, x] if (flags[down, x] & _READ) == 0 else here[x]
            if 0.5 * (abs(high - low) + abs(bottom - top)) > most:
                flags[row, x] |= _OUTLIER


@leaf_kernel
def _sees_nothing_beside(row: int, x: int, flags: Array) -> bool:
    rows, cols = flags.shape
    for y in range(max(row - 1, 0), min(row + 2, rows)):
        for z in range(max(x - 1, 0), min(x + 2, cols)):
            if flags[y, z] & _NOTHING:
                return True
    return False


@leaf_kernel
def _any_nothing(start: int, stop: int, flags: Array) -> bool:
    none = np.uint16(0)
    for row in range(start, stop):
        for x in range(flags.shape[1]):
            none |= flags[row, x]
    return bool((none & _NOTHING) != 0)


@leaf_kernel
def _steepness(row: int, x: int, coord: Array, flags: Array) -> float:
    """Largest step to a neighbour that sees something; 0 for an axis that was not shown."""
    rows, cols = coord.shape
    most = 0.0
    for y, z in ((row - 1, x), (row + 1, x), (row, x - 1), (row, x + 1)):
        if 0 <= y < rows and 0 <= z < cols and (flags[y, z] & _READ) == 0:
            step = abs(coord[y, z] - coord[row, x])
            most = max(most, step) if step < np.inf else most
    return most


@leaf_kernel
def _near_border(place: float, extent: float, nearest: float) -> bool:
    """True within _NEAR of the border, but not within `nearest`."""
    inside = 0.5 * extent - abs(place - 0.5 * (extent - 1))
    return nearest <= inside < _NEAR


@roomy_kernel
def mixed_rows(
    start: int,
    stop: int,
    read2: float,
    gain: float,
    extents: tuple[float, float],
    nearest: tuple[float, float],
    u: Array,
    v: Array,
    sigma_u: Array,
    sigma_v: Array,
    amplitude: Array,
    offset: Array,
    flags: Array,
) -> None:
    """Flag pixels that part of their light lacks: dimmer than neighbours, beside nothing or near the border.

    Beside nothing, what little light lacks goes into sigma.

    extents: of the pattern along u and v (inf: not shown); nearest: distance from the border within which an
    answer is right in spite of that.
    """
    rows, cols = amplitude.shape
    top = np.empty(cols, np.float32)
    for row in range(start, stop):
        here, mean = amplitude[row], offset[row]
        top[:] = here
        for step in range(1, REACH + 1):
            above, below = amplitude[max(row - step, 0)], amplitude[min(row + step, rows - 1)]
            for x in range(cols):
                top[x] = above[x] if above[x] > top[x] else top[x]
            for x in range(cols):
                top[x] = below[x] if below[x] > top[x] else top[x]
            for x in range(cols - step):
                top[x] = here[x + step] if here[x + step] > top[x] else top[x]
            for x in range(step, cols):
                top[x] = here[x - step] if here[x - step] > top[x] else top[x]
        dim = 0
        for x in range(cols):
            variance = np.float32(read2) + np.float32(gain) * (mean[x] if mean[x] > _ZERO else _ZERO)
            top[x] -= _THREE * np.sqrt(variance)
            dim += here[x] < _BORDER * top[x]
        holes = _any_nothing(max(row - 1, 0), min(row + 2, rows), flags)
        if dim == 0 and not holes:
            continue
        for x in range(cols):
            if not here[x] < top[x]:
                continue
            if here[x] < _BORDER * top[x]:
                border = _near_border(u[row, x], extents[0], nearest[0])
                border |= _near_border(v[row, x], extents[1], nearest[1])
                if border:
                    flags[row, x] |= _OUTLIER
            if holes and _sees_nothing_beside(row, x, flags):
                if here[x] < _BESIDE * top[x]:
                    flags[row, x] |= _OUTLIER
                # the part of the footprint that is left has its middle elsewhere
                off = 0.5 * (1 - here[x] / top[x])
                sigma_u[row, x] = np.hypot(sigma_u[row, x], off * _steepness(row, x, u, flags))
                sigma_v[row, x] = np.hypot(sigma_v[row, x], off * _steepness(row, x, v, flags))
