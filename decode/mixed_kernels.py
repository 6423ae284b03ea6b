"""Compiled: pixels part of whose footprint sees no pattern, beside a hole or at the border, told by their
neighbours: the mean over the rest belongs to no place, and no sample of the pixel itself tells.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel, outer_kernel
from .records import Near, Scratch, Shared

__all__ = ["NOTHING", "OUTLIER", "REACH", "READ", "mixed_rows", "shadow_rows"]

Array = NDArray[Any]

#: Rows above and below that are looked at.
REACH = 3
#: OUTLIER is what these kernels write, so that they do not read it: rows are done in any order.
OUTLIER = np.uint16(32)
READ = np.uint16(0xFFFF ^ 32)
#: DARK, LOW_CONTRAST and INVALID: nothing is seen there.
NOTHING = np.uint16(1 | 4 | 128)
#: Amplitude over the neighbours' largest, below which a pixel beside one that sees nothing, or near the
#: border, has lost part of its light.
_BESIDE, _BORDER = np.float32(0.85), np.float32(0.96)
#: The same, of a neighbour that sees hardly anything.
_FAINT = np.float32(0.25)
#: Cells by which a pixel is surely nearer to it than another.
_NEARER = 1.0
_ZERO, _ONE, _THREE, _HALF = np.float32(0), np.float32(1), np.float32(3), 0.5
_GOOD = np.uint16(0)


@leaf_kernel
def _sees_nothing_beside(row: int, x: int, flags: Array, amplitude: Array, faint: float) -> bool:
    """Whether a neighbour does, or hardly anything: a contrast below `faint`."""
    rows, cols = flags.shape
    for y in range(max(row - 1, 0), min(row + 2, rows)):
        for z in range(max(x - 1, 0), min(x + 2, cols)):
            if flags[y, z] & NOTHING or amplitude[y, z] < faint:
                return True
    return False


@leaf_kernel
def _any_nothing(row: int, flags: Array) -> bool:
    none = np.uint16(0)
    for x in range(flags.shape[1]):
        none |= flags[row, x]
    return bool((none & NOTHING) != 0)


@leaf_kernel
def _steepness(row: int, x: int, coord: Array, flags: Array) -> float:
    """Largest step to a neighbour that sees something; 0 for an axis that was not shown."""
    rows, cols = coord.shape
    most = 0.0
    for y, z in ((row - 1, x), (row + 1, x), (row, x - 1), (row, x + 1)):
        if 0 <= y < rows and 0 <= z < cols and (flags[y, z] & READ) == 0:
            step = abs(coord[y, z] - coord[row, x])
            most = max(most, step) if step < np.inf else most
    return most


@leaf_kernel
def _inside(row: int, x: int, coord: Array, flags: Array, extent: float) -> float:
    """Distance from the nearer border, cells; inf where there is no pixel or it is not to be trusted."""
    rows, cols = coord.shape
    if not (0 <= row < rows and 0 <= x < cols) or (flags[row, x] & READ) != _GOOD:
        return np.inf
    return float(0.5 * extent - abs(coord[row, x] - 0.5 * (extent - 1)))


@leaf_kernel
def _shadowed(
    row: int,
    x: int,
    coord: Array,
    flags: Array,
    extent: float,
    band: tuple[float, float],
    amplitude: Array,
    bright: float,
) -> bool:
    """Whether a dim pixel in the `band` beside the border may lie in its shadow: that only grows darker
    towards it, and nothing on the way there, nearer by more than noise, is `bright`.
    """
    here = start = _inside(row, x, coord, flags, extent)
    if not band[0] <= here < band[1]:
        return False
    down, right, closest = 0, 0, here
    for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        there = _inside(row + i, x + j, coord, flags, extent)
        if there < closest:
            down, right, closest = i, j, there
    while closest < here:
        row, x, here = row + down, x + right, closest
        if amplitude[row, x] > bright and here < start - _NEARER:
            return False
        closest = _inside(row + down, x + right, coord, flags, extent)
    return True


@apart_kernel
def _brightest(row: int, read2: Any, gain: Any, amplitude: Array, offset: Array, top: Array) -> bool:
    """top (cols,) = largest amplitude within REACH along and across, less 3 sigma; True if any is dimmer."""
    rows, cols = amplitude.shape
    here, mean = amplitude[row], offset[row]
    up1, up2, up3 = amplitude[max(row - 1, 0)], amplitude[max(row - 2, 0)], amplitude[max(row - 3, 0)]
    last = rows - 1
    down1, down2 = amplitude[min(row + 1, last)], amplitude[min(row + 2, last)]
    down3 = amplitude[min(row + 3, last)]
    for x in range(cols):
        most = up1[x] if up1[x] > here[x] else here[x]
        most = up2[x] if up2[x] > most else most
        most = up3[x] if up3[x] > most else most
        most = down1[x] if down1[x] > most else most
        most = down2[x] if down2[x] > most else most
        top[x] = down3[x] if down3[x] > most else most
    for x in range(min(REACH, cols)):
        for z in range(min(x + REACH + 1, cols)):
            top[x] = here[z] if here[z] > top[x] else top[x]
    # views, as indices like x - 3 are checked for being negative
    inner = max(cols - 2 * REACH, 0)
    middle = top[REACH : REACH + inner]
    left1, left2, left3 = here[2 : 2 + inner], here[1 : 1 + inner], here[0:inner]
    right1, right2, right3 = here[4 : 4 + inner], here[5 : 5 + inner], here[6 : 6 + inner]
    for x in range(inner):
        most = left1[x] if left1[x] > middle[x] else middle[x]
        most = left2[x] if left2[x] > most else most
        most = left3[x] if left3[x] > most else most
        most = right1[x] if right1[x] > most else most
        most = right2[x] if right2[x] > most else most
        middle[x] = right3[x] if right3[x] > most else most
    for x in range(max(cols - REACH, REACH), cols):
        for z in range(x - REACH, cols):
            top[x] = here[z] if here[z] > top[x] else top[x]
    dim = _ZERO
    for x in range(cols):
        variance = read2 + gain * (mean[x] if mean[x] > _ZERO else _ZERO)
        top[x] -= _THREE * np.sqrt(variance)
        dim += _ONE if here[x] < _BORDER * top[x] else _ZERO
    return bool(dim > _ZERO)


@leaf_kernel
def mixed_rows(start: int, stop: int, near: Near, shared: Shared, kept: Array, top: Array) -> None:
    """Flag pixels that part of their light lacks: dimmer than neighbours and beside nothing.

    What little light lacks goes into sigma. Rows with dim pixels near the border are noted in near.dim: what
    lies between these and the border may not be decoded yet. top: room for (W,).
    """
    flags, amplitude, offset = shared.flags, shared.amplitude, shared.offset
    u, v, sigma_u, sigma_v = near.u, near.v, near.sigma_u, near.sigma_v
    rows, cols = amplitude.shape
    holes_above, holes_here = start > 0 and _any_nothing(start - 1, flags), _any_nothing(start, flags)
    for row in range(start, stop):
        here = amplitude[row]
        holes_below = row + 1 < rows and _any_nothing(row + 1, flags)
        holes = holes_above or holes_here or holes_below
        holes_above, holes_here = holes_here, holes_below
        beside = _any_beside(row, near, kept)
        if not (holes or beside):
            continue
        dim = _brightest(row, near.read2, near.gain, amplitude, offset, top)
        if not (dim or holes):
            continue
        for x in range(cols):
            if not here[x] < top[x]:
                continue
            if beside and here[x] < _BORDER * top[x] and _at_border(row, x, near, flags):
                near.dim[row] = 1
            if holes and _sees_nothing_beside(row, x, flags, amplitude, _FAINT * top[x]):
                if here[x] < _BESIDE * top[x]:
                    flags[row, x] |= OUTLIER
                # the part of the footprint that is left has its middle elsewhere
                off = 0.5 * (1 - here[x] / top[x])
                sigma_u[row, x] = np.hypot(sigma_u[row, x], off * _steepness(row, x, u, flags))
                sigma_v[row, x] = np.hypot(sigma_v[row, x], off * _steepness(row, x, v, flags))


@leaf_kernel
def _any_beside(row: int, near: Near, kept: Array) -> bool:
    """Whether any pixel of a row may be in the band beside the border, or beyond it, along u or v."""
    for axis in range(2):
        half, high = 0.5 * near.extents[axis], near.bands[axis][1]
        line, middle = kept[axis, row % kept.shape[1], : near.u.shape[1]], np.float32(half - _HALF)
        if half < np.inf and _any_beyond(line, middle, np.float32(half - high)):
            return True
    return False


@apart_kernel
def _any_beyond(line: Array, middle: Any, near: Any) -> bool:
    """Whether any coordinate of a row lies further than `near` from the middle."""
    found = _ZERO
    for x in range(len(line)):
        found += _ONE if abs(line[x] - middle) > near else _ZERO
    return bool(found > _ZERO)


@leaf_kernel
def _at_border(row: int, x: int, near: Near, flags: Array) -> bool:
    """Whether a pixel is in the band in which shadows are looked for, along u or v."""
    u = _inside(row, x, near.u, flags, near.extents[0])
    v = _inside(row, x, near.v, flags, near.extents[1])
    bands = near.bands
    return bool(bands[0][0] <= u < bands[0][1] or bands[1][0] <= v < bands[1][1])


@outer_kernel
def shadow_rows(start: int, stop: int, near: Near, shared: Shared, scratch: Scratch) -> None:
    """Flag pixels of the rows noted in near.dim that lie in the border's shadow, once all rows are decoded.

    near.extents: of the pattern along u and v (inf: not shown); near.bands: distances from the border between
    which it may throw one that matters.
    """
    flags, amplitude, top = shared.flags, shared.amplitude, scratch.across
    extents, bands = near.extents, near.bands
    for row in range(start, stop):
        if near.dim[row] == 0:
            continue
        _brightest(row, near.read2, near.gain, amplitude, shared.offset, top)
        here = amplitude[row]
        for x in range(len(here)):
            if here[x] < _BORDER * top[x]:
                border = _shadowed(row, x, near.u, flags, extents[0], bands[0], amplitude, top[x])
                border |= _shadowed(row, x, near.v, flags, extents[1], bands[1], amplitude, top[x])
                if border:
                    flags[row, x] |= OUTLIER
