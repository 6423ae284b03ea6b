"""Compiled: what a pixel's neighbours tell of it, from maps that hold more than the pixel's own row.

A camera pixel sees a mean over its footprint. Where the map bends or is steep, or where part of the footprint
sees no pattern (beside a hole, at the border), that mean belongs to no place, and no sample of the pixel
itself tells.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, inline_kernel, leaf_kernel, outer_kernel
from .records import Near, Scratch, Shared

__all__ = ["NOTHING", "REACH", "READ", "near_rows", "shadow_rows"]

Array = NDArray[Any]

#: Rows above and below that are looked at.
REACH = 3
#: A pixel's mean over a box lies off its centre's value by the sum of second derivatives times this.
_BOX = np.float32(1 / 24)
#: A second difference counts above so many sigma: four times its own noise.
_BENT = np.float32(14.0)
#: OUTLIER is what these kernels write, so that they do not read it: rows are done in any order.
_OUTLIER = np.uint16(32)
READ = np.uint16(0xFFFF ^ 32)
#: DARK, LOW_CONTRAST and INVALID: nothing is seen there.
NOTHING = np.uint16(1 | 4 | 128)
#: Amplitude over the neighbours' largest, below which a pixel beside one that sees nothing, or near the
#: border, has lost part of its light.
_BESIDE, _BORDER = np.float32(0.85), np.float32(0.96)
#: Cells by which a pixel is surely nearer to it than another.
_NEARER = 1.0
_ZERO, _ONE, _TWO, _THREE = np.float32(0), np.float32(1), np.float32(2), np.float32(3)
_HALF, _GOOD = np.float32(0.5), np.uint16(0)


@outer_kernel
def near_rows(start: int, stop: int, near: Near, fresh: bool, shared: Shared, scratch: Scratch) -> None:
    """Compare rows start..stop with those around: bends go into sigma, steep and mixed pixels are flagged.

    near.steep: of a code alone along u and v, largest footprint and cell, pattern pixels, and the flags of
    neighbours that do not count as such; None: the axis is continuous; near.least: distance of an outlier.
    fresh: these rows and those around are not among scratch.kept yet.
    """
    kept, wide = scratch.kept, scratch.wide
    if near.shown[0]:
        _axis_rows(
            start,
            stop,
            near.steep[0],
            near.least[0],
            fresh,
            near.u,
            near.sigma_u,
            shared.flags,
            kept[0],
            wide,
        )
    if near.shown[1]:
        _axis_rows(
            start,
            stop,
            near.steep[1],
            near.least[1],
            fresh,
            near.v,
            near.sigma_v,
            shared.flags,
            kept[1],
            wide,
        )
    _mixed_rows(start, stop, near, shared, scratch.across)


@leaf_kernel
def _axis_rows(
    start: int,
    stop: int,
    most: Any,
    least: Any,
    fresh: bool,
    coord: Array,
    sigma: Array,
    flags: Array,
    kept: Array,
    wide: Array,
) -> None:
    if most is None:
        _bend_rows(start, stop, least, fresh, coord, sigma, flags, kept)
    else:
        _steep_rows(start, stop, most, fresh, coord, flags, kept, wide)


@leaf_kernel
def _bend_rows(
    start: int, stop: int, least: Any, fresh: bool, coord: Array, sigma: Array, flags: Array, kept: Array
) -> None:
    """Add to sigma (H, W), rows start..stop, what the bend of coord (H, W) shifts the mean over a pixel, and
    flag those that leave both rows beside them by more than `least`."""
    rows, ring = coord.shape[0], len(kept)
    _keep_first(start, fresh, coord, kept)
    for row in range(start, stop):
        up, down = max(row - 1, 0), min(row + 1, rows - 1)
        if fresh:
            _keep(coord[down], kept[down % ring])
        near = kept[up % ring], kept[row % ring], kept[down % ring]
        inner = 0 < row < rows - 1
        astray = _bend(inner, np.float32(2 * least), near, flags[up], flags[row], flags[down], sigma[row])
        if astray:
            _strays(least, near, flags[up], flags[row], flags[down])


@leaf_kernel
def _keep_first(start: int, fresh: bool, coord: Array, kept: Array) -> None:
    """The first row and the one above it, if they are not kept yet."""
    if fresh:
        for row in range(max(start - 1, 0), start + 1):
            _keep(coord[row], kept[row % len(kept)])


@apart_kernel
def _keep(row: Array, line: Array) -> None:
    for x in range(len(row)):
        line[x] = row[x]


@inline_kernel
def _widened(spread: Any, bend: Any) -> Any:
    shift = bend * _BOX
    return np.sqrt(spread * spread + shift * shift) if bend > _BENT * spread else spread


@apart_kernel
def _bend(
    inner: bool,
    far: Any,
    near: tuple[Array, Array, Array],
    bad_above: Array,
    bad: Array,
    bad_below: Array,
    spread: Array,
) -> bool:
    """One row, in float32 as fringes are decoded; at its two ends only what bends across it. Whether any
    pixel is `far` from those above and below, taken together."""
    above, here, below = near
    last = len(here) - 1
    weight = _ONE if inner else _ZERO
    left, right, bad_left, bad_right = here[:-2], here[2:], bad[:-2], bad[2:]
    astray = _ZERO
    for x in range(last - 1):
        y = x + 1
        middle = here[y]
        along = abs((left[x] - middle) + (right[x] - middle))
        across = weight * abs((above[y] - middle) + (below[y] - middle))
        astray += _ONE if across > far else _ZERO
        beside, over = (bad_left[x] | bad_right[x]) & READ, (bad_above[y] | bad_below[y]) & READ
        bend = (along if beside == _GOOD else _ZERO) + (across if over == _GOOD else _ZERO)
        spread[y] = _widened(spread[y], bend)
    for x in range(0, last + 1, max(last, 1)):
        middle = here[x]
        across = weight * abs((above[x] - middle) + (below[x] - middle))
        astray += _ONE if across > far else _ZERO
        spread[x] = _widened(spread[x], across if ((bad_above[x] | bad_below[x]) & READ) == _GOOD else _ZERO)
    return bool(astray > _ZERO)


@leaf_kernel
def _strays(
    least: Any, near: tuple[Array, Array, Array], bad_above: Array, bad: Array, bad_below: Array
) -> None:
    """Flag pixels of a row that leave both neighbours, above and below, which agree with each other: a light
    that flashed while the row was read. Along the row, see flag_kernels.outlier_rows."""
    above, here, below = near
    for x in range(len(here)):
        up, down = above[x] - here[x], below[x] - here[x]
        alike = up * down > 0 and min(abs(up), abs(down)) > max(least, _THREE * abs(up - down))
        if alike and ((bad_above[x] | bad_below[x]) & READ) == _GOOD:
            bad[x] |= _OUTLIER


@leaf_kernel
def _steep_rows(
    start: int, stop: int, most: Any, fresh: bool, coord: Array, flags: Array, kept: Array, wide: Array
) -> None:
    """Flag pixels of a code alone whose footprint is larger than `most`: its bits hold for no one place."""
    (rows, cols), ring = coord.shape, len(kept)
    limit, cell, bad_if = np.float32(2 * most[0]), most[1], most[2]
    _keep_first(start, fresh, coord, kept)
    for row in range(start, stop):
        up, down = max(row - 1, 0), min(row + 1, rows - 1)
        if fresh:
            _keep(coord[down], kept[down % ring])
        near = kept[up % ring], kept[row % ring], kept[down % ring]
        why = flags[up], flags[row], flags[down]
        # as a rule, all is good and flat
        calm = 0 < row < rows - 1 and cols > 2 and _all_good(why) and not _any_steep(limit, *near)
        if calm:
            wide[:cols] = _GOOD
        found = _steep(calm, up, row, down, limit, cell, bad_if, near, why, wide)
        if found:
            for x in range(cols):
                flags[row, x] |= wide[x]


@apart_kernel
def _all_good(why: tuple[Array, Array, Array]) -> bool:
    above, here, below = why
    every = np.uint16(0)
    for x in range(len(here)):
        every |= above[x] | here[x] | below[x]
    return bool((every & READ) == _GOOD)


@apart_kernel
def _any_steep(most: Any, above: Array, here: Array, below: Array) -> bool:
    """Whether any pixel but the row's ends, all of whose neighbours are good, is steep."""
    inner = len(here) - 2
    left, right, top, bottom = here[:inner], here[2:], above[1:], below[1:]
    found = _ZERO
    for x in range(inner):
        found += _ONE if abs(right[x] - left[x]) + abs(bottom[x] - top[x]) > most else _ZERO
    return bool(found > _ZERO)


@inline_kernel
def _slope(
    before: Any, here: Any, after: Any, bad_before: Any, bad_after: Any, cell: Any, bad_if: Any
) -> Any:
    """What coordinates change over two pixels; with one good neighbour, twice the change to that side, less
    a cell, as places of cells are that rough. With none, doubtful ones will do: most of them are right.
    """
    none = ((bad_before & bad_if) != _GOOD) & ((bad_after & bad_if) != _GOOD)
    mask = NOTHING if none else bad_if
    good_before, good_after = (bad_before & mask) == _GOOD, (bad_after & mask) == _GOOD
    one = abs(here - before) if good_before else abs(after - here)
    twice = _TWO * one - cell
    twice = one if one > twice else twice
    single = twice if good_before | good_after else _ZERO
    return abs(after - before) if good_before & good_after else single


@apart_kernel
def _steep(
    ends: bool,
    up: int,
    row: int,
    down: int,
    most: Any,
    cell: Any,
    bad_if: Any,
    near: tuple[Array, Array, Array],
    why: tuple[Array, Array, Array],
    wide: Array,
) -> bool:
    """wide (cols,) = OUTLIER where differences to either side add up to more than `most`, or nothing beside
    can be trusted, so that nobody knows; True if any do. ends: only the two ends of the row.
    """
    above, here, below = near
    bad_above, bad, bad_below = why
    at_top = NOTHING if up == row else _GOOD
    at_bottom = NOTHING if down == row else _GOOD
    last = len(here) - 1
    found = _ZERO
    for x in range(1, 1 if ends else last):
        along = _slope(here[x - 1], here[x], here[x + 1], bad[x - 1], bad[x + 1], cell, bad_if)
        no_top, no_bottom = bad_above[x] | at_top, bad_below[x] | at_bottom
        across = _slope(above[x], here[x], below[x], no_top, no_bottom, cell, bad_if)
        sides = ((bad[x - 1] & READ) != _GOOD) & ((bad[x + 1] & READ) != _GOOD)
        alone = sides & ((no_top & READ) != _GOOD) & ((no_bottom & READ) != _GOOD)
        steep = (along + across > most) | alone
        wide[x] = _OUTLIER if steep else _GOOD
        found += _ONE if steep else _ZERO
    for x in range(0, last + 1, max(last, 1)):
        other = min(max(x, 1), last) - (1 if x else 0)
        beside = bad[other] if last > 0 else NOTHING
        along = _slope(here[x], here[x], here[other], NOTHING, beside, cell, bad_if)
        no_top, no_bottom = bad_above[x] | at_top, bad_below[x] | at_bottom
        across = _slope(above[x], here[x], below[x], no_top, no_bottom, cell, bad_if)
        steep = along + across > most
        wide[x] = _OUTLIER if steep else _GOOD
        found += _ONE if steep else _ZERO
    return bool(found > _ZERO)


@leaf_kernel
def _sees_nothing_beside(row: int, x: int, flags: Array) -> bool:
    rows, cols = flags.shape
    for y in range(max(row - 1, 0), min(row + 2, rows)):
        for z in range(max(x - 1, 0), min(x + 2, cols)):
            if flags[y, z] & NOTHING:
                return True
    return False


@leaf_kernel
def _any_nothing(start: int, stop: int, flags: Array) -> bool:
    none = np.uint16(0)
    for row in range(start, stop):
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
def _mixed_rows(start: int, stop: int, near: Near, shared: Shared, top: Array) -> None:
    """Flag pixels that part of their light lacks: dimmer than neighbours and beside nothing.

    What little light lacks goes into sigma. Rows with dim pixels near the border are noted in near.dim: what
    lies between these and the border may not be decoded yet. top: room for (W,).
    """
    flags, amplitude, offset = shared.flags, shared.amplitude, shared.offset
    u, v, sigma_u, sigma_v = near.u, near.v, near.sigma_u, near.sigma_v
    rows, cols = amplitude.shape
    bordered = near.extents[0] < np.inf or near.extents[1] < np.inf
    for row in range(start, stop):
        here = amplitude[row]
        holes = _any_nothing(max(row - 1, 0), min(row + 2, rows), flags)
        if not (holes or bordered):
            continue
        dim = _brightest(row, near.read2, near.gain, amplitude, offset, top)
        if not (dim or holes):
            continue
        for x in range(cols):
            if not here[x] < top[x]:
                continue
            if bordered and here[x] < _BORDER * top[x] and _at_border(row, x, near, flags):
                near.dim[row] = 1
            if holes and _sees_nothing_beside(row, x, flags):
                if here[x] < _BESIDE * top[x]:
                    flags[row, x] |= _OUTLIER
                # the part of the footprint that is left has its middle elsewhere
                off = 0.5 * (1 - here[x] / top[x])
                sigma_u[row, x] = np.hypot(sigma_u[row, x], off * _steepness(row, x, u, flags))
                sigma_v[row, x] = np.hypot(sigma_v[row, x], off * _steepness(row, x, v, flags))


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
                    flags[row, x] |= _OUTLIER
