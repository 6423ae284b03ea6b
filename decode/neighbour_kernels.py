"""Compiled: what a pixel's neighbours tell of it, from maps that hold more than the pixel's own row.

A camera pixel sees a mean over its footprint. Where the map bends or is steep, that mean belongs to no place,
and no sample of the pixel itself tells. (Footprints part of which sees no pattern: mixed_kernels.)
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, calling, inline_kernel, leaf_kernel, linked_kernel, outer_kernel
from .mixed_kernels import NOTHING, OUTLIER, REACH, READ, mixed_rows
from .records import Near, Scratch, Shared

__all__ = ["call_near", "near_block", "near_rows"]

Array = NDArray[Any]

#: A pixel's mean over a box lies off its centre's value by the sum of second derivatives times this.
_BOX = np.float32(1 / 24)
#: Second differences along and across, added, count above so many sigma: three times their own noise.
_BENT = np.float32(14.0)
#: Pixels among which bends are looked for: where one is, all of them are worked out.
_TOGETHER = 128
#: Change of a coordinate over two pixels from which on it may be too steep, in distances of an outlier (0.4
#: periods), and how many times that is; share of the contrast around that is left of a fringe of which most
#: of a period lies on a pixel.
_STEEP, _STEEPER, _LOST = np.float32(2.5), np.float32(1.6), 0.4
_ZERO, _ONE, _TWO, _THREE = np.float32(0), np.float32(1), np.float32(2), np.float32(3)
_HALF, _GOOD = np.float32(0.5), np.uint16(0)


@linked_kernel
def near_block(start: int, stop: int, near: Near, fresh: bool, shared: Shared, scratch: Scratch) -> None:
    """Compare rows start..stop with those around: bends go into sigma, steep and mixed pixels are flagged.

    near.steep: of a code alone along u and v, largest footprint and cell, pattern pixels, and the flags of
    neighbours that do not count as such; None: the axis is continuous; near.least: distance of an outlier.
    fresh: these rows and those around are not among scratch.kept yet.
    """
    few = scratch.kept.shape[1] - 2
    for row in range(start, stop, few):
        _few_rows(row, min(row + few, stop), near, fresh, shared, scratch)


call_near = near_block.call


@calling(lambda types: [(near_block, types)])
@outer_kernel
def near_rows(start: int, stop: int, near: Near, fresh: bool, shared: Shared, scratch: Scratch) -> None:
    """near_block, to be called from Python."""
    call_near((start, stop, near, fresh, shared, scratch))


@leaf_kernel
def _few_rows(start: int, stop: int, near: Near, fresh: bool, shared: Shared, scratch: Scratch) -> None:
    """near_block, of as many as scratch.kept holds together with those around."""
    kept, wide = scratch.kept, scratch.wide
    if near.shown[0]:
        steep, least = near.steep[0], near.least[0]
        _axis_rows(start, stop, steep, least, fresh, near.u, near.sigma_u, shared, kept[0], wide)
    if near.shown[1]:
        steep, least = near.steep[1], near.least[1]
        _axis_rows(start, stop, steep, least, fresh, near.v, near.sigma_v, shared, kept[1], wide)
    mixed_rows(start, stop, near, shared, kept, scratch.across)


@leaf_kernel
def _axis_rows(
    start: int,
    stop: int,
    most: Any,
    least: Any,
    fresh: bool,
    coord: Array,
    sigma: Array,
    shared: Shared,
    kept: Array,
    wide: Array,
) -> None:
    if most is None:
        _bend_rows(start, stop, least, fresh, coord, sigma, shared, kept)
    else:
        _steep_rows(start, stop, most, fresh, coord, shared.flags, kept, wide)


@leaf_kernel
def _bend_rows(
    start: int, stop: int, least: Any, fresh: bool, coord: Array, sigma: Array, shared: Shared, kept: Array
) -> None:
    """Add to sigma (H, W), rows start..stop, what the bend of coord (H, W) shifts the mean over a pixel, and
    flag those that leave both rows beside them by more than `least`, and those too steep for the fringe."""
    flags, (rows, cols), ring = shared.flags, coord.shape, len(kept)
    _keep_first(start, fresh, coord, kept)
    for row in range(start, stop):
        up, down = max(row - 1, 0), min(row + 1, rows - 1)
        if fresh:
            _keep(coord[down], kept[down % ring])
        near = kept[up % ring, :cols], kept[row % ring, :cols], kept[down % ring, :cols]
        inner, bad, spread = 0 < row < rows - 1, (flags[up], flags[row], flags[down]), sigma[row]
        astray, steep = False, False
        for first in range(0, cols - 2, _TOGETHER):
            part = slice(first, min(first + _TOGETHER + 2, cols))
            beside = near[0][part], near[1][part], near[2][part]
            if _any_bend(least, beside, spread[part]):  # as a rule not
                why = bad[0][part], bad[1][part], bad[2][part]
                strays, climbs = _bend(inner, least, beside, why, spread[part])
                astray, steep = astray or strays, steep or climbs
        if _bend_ends(inner, least, near, bad, spread):
            astray = True
        if astray:
            _strays(least, near, flags[up], flags[row], flags[down])
        if steep:
            _too_steep(row, least, near, shared)


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
def _without(flags: Any, which: Any) -> Any:
    """Whether none of these is set; in 16 bits, which the compiler does not find by itself."""
    return np.uint16(flags & which) == _GOOD


@inline_kernel
def _widened(spread: Any, bend: Any) -> Any:
    shift = bend * _BOX
    return np.sqrt(spread * spread + shift * shift) if bend > _BENT * spread else spread


@apart_kernel
def _any_bend(least: Any, near: tuple[Array, Array, Array], spread: Array) -> bool:
    """Whether _bend has anything to tell, were all pixels good; so it has of no numbers."""
    above, here, below = near
    far, wide = _TWO * least, _STEEP * least
    left, middle, right, up, down, own = here[:-2], here[1:], here[2:], above[1:], below[1:], spread[1:]
    found = _ZERO
    for x in range(len(here) - 2):
        bend = abs((left[x] - middle[x]) + (right[x] - middle[x]))
        bend += abs((up[x] - middle[x]) + (down[x] - middle[x]))
        step, other = abs(right[x] - left[x]), abs(down[x] - up[x])
        limit = _BENT * own[x]
        calm = bend <= (limit if limit < far else far)
        found += _ZERO if calm & ((step if step > other else other) <= wide) else _ONE
    return bool(found > _ZERO)


@apart_kernel
def _bend(
    inner: bool,
    least: Any,
    near: tuple[Array, Array, Array],
    bad: tuple[Array, Array, Array],
    spread: Array,
) -> tuple[bool, bool]:
    """Some pixels of a row between two more, in float32 as fringes are decoded. Whether any is far from those
    above and below, taken together; whether any may be too steep."""
    above, here, below = near
    bad_above, bad_here, bad_below = bad
    weight = _ONE if inner else _ZERO
    far, wide = _TWO * least, _STEEP * least
    left, right, bad_left, bad_right = here[:-2], here[2:], bad_here[:-2], bad_here[2:]
    astray, steep = _ZERO, _ZERO
    for x in range(len(here) - 2):
        y = x + 1
        middle = here[y]
        along = abs((left[x] - middle) + (right[x] - middle))
        across = weight * abs((above[y] - middle) + (below[y] - middle))
        astray += _ONE if across > far else _ZERO
        beside, over = np.uint16(bad_left[x] | bad_right[x]), np.uint16(bad_above[y] | bad_below[y])
        step = abs(right[x] - left[x]) if _without(beside, NOTHING) else _ZERO
        other = weight * abs(below[y] - above[y]) if _without(over, NOTHING) else _ZERO
        steep += _ONE if (step > wide) | (other > wide) else _ZERO
        bend = (along if _without(beside, READ) else _ZERO) + (across if _without(over, READ) else _ZERO)
        spread[y] = _widened(spread[y], bend)
    return bool(astray > _ZERO), bool(steep > _ZERO)


@leaf_kernel
def _bend_ends(
    inner: bool,
    least: Any,
    near: tuple[Array, Array, Array],
    bad: tuple[Array, Array, Array],
    spread: Array,
) -> bool:
    """_bend at the two ends of a row, where only what bends across it is known; whether any is far."""
    above, here, below = near
    last, astray = len(here) - 1, False
    for x in range(0, last + 1 if inner else 0, max(last, 1)):
        across = abs((above[x] - here[x]) + (below[x] - here[x]))
        astray = astray or across > _TWO * least
        if ((bad[0][x] | bad[2][x]) & READ) == _GOOD:
            spread[x] = _widened(spread[x], across)
    return astray


@leaf_kernel
def _too_steep(row: int, least: float, near: tuple[Array, Array, Array], shared: Shared) -> None:
    """Flag pixels of a row on which most of a fringe's period lies, or more of it: near one period nothing is
    left but what the bend makes of it, beyond that the contrast is the other way round, half a period off.

    Misread neighbours are as far off, so that contrast tells, too; a jump of the map alone tells nothing.
    """
    above, here, below = near
    flags, wide = shared.flags, _STEEP * least
    rows, cols = flags.shape
    for x in range(1, cols - 1):
        step, steps = _climb(here[x - 1], here[x], here[x + 1], flags[row, x - 1] | flags[row, x + 1], least)
        if 0 < row < rows - 1:
            beside = flags[row - 1, x] | flags[row + 1, x]
            across, in_steps = _climb(above[x], here[x], below[x], beside, least)
            step, steps = max(step, across), max(steps, in_steps)
        over = steps > _STEEPER * wide
        if not over and step > wide:
            over = _faded(row, x, shared)
        if over:
            flags[row, x] |= OUTLIER


@leaf_kernel
def _climb(before: float, here: float, after: float, beside: Any, least: float) -> tuple[Any, Any]:
    """Change over two pixels, 0 if nothing is seen beside; and the same, 0 also for a jump on one side."""
    if beside & NOTHING:
        return _ZERO, _ZERO
    step = abs(after - before)
    return step, step if min(abs(here - before), abs(after - here)) > _HALF * least else _ZERO


@leaf_kernel
def _faded(row: int, x: int, shared: Shared) -> bool:
    """Whether little is left of the contrast that a pixel within reach has."""
    rows, cols = shared.flags.shape
    own = most = 0.0
    for y in range(max(row - REACH, 0), min(row + REACH + 1, rows)):
        for z in range(max(x - REACH, 0), min(x + REACH + 1, cols)):
            if shared.flags[y, z] & NOTHING == 0:
                contrast = shared.amplitude[y, z] / max(shared.offset[y, z], _ONE)
                most = max(most, contrast)
                own = contrast if y == row and z == x else own
    return own < _LOST * most


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
            bad[x] |= OUTLIER


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
        near = kept[up % ring, :cols], kept[row % ring, :cols], kept[down % ring, :cols]
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
        wide[x] = OUTLIER if steep else _GOOD
        found += _ONE if steep else _ZERO
    for x in range(0, last + 1, max(last, 1)):
        other = min(max(x, 1), last) - (1 if x else 0)
        beside = bad[other] if last > 0 else NOTHING
        along = _slope(here[x], here[x], here[other], NOTHING, beside, cell, bad_if)
        no_top, no_bottom = bad_above[x] | at_top, bad_below[x] | at_bottom
        across = _slope(above[x], here[x], below[x], no_top, no_bottom, cell, bad_if)
        steep = along + across > most
        wide[x] = OUTLIER if steep else _GOOD
        found += _ONE if steep else _ZERO
    return bool(found > _ZERO)
