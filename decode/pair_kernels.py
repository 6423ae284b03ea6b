"""Compiled: two periods of four quarter shifts, in two loops: fitted and flagged, then unwrapped.

Most of what fit_kernels, unwrap_kernels and flag_kernels hand to each other through the cache stays in
registers. The formulas are theirs. One loop for all would be slower: it is longer than what a processor has
under way at once. Nor are storing and merging one, as a loop that asks within is stored by masks.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import TINY, TURN2, highest, phase_of, quarter_sums
from .flag_kernels import MOVED, add_doubt, why_placed, why_seen
from .jit import apart_kernel, leaf_kernel, pasted_kernel
from .records import AxisRecord, Camera, FringeRecord
from .unwrap_kernels import CERTAIN, beside

__all__ = ["highest_of", "merge_pair", "order_pair", "pair_of", "store_pair"]

Array = NDArray[Any]
_ZERO, _ONE, _TWO, _FOUR = np.float32(0), np.float32(1), np.float32(2), np.float32(4)
_QUARTER, _HALF, _NONE = np.float32(0.25), np.float32(0.5), np.int32(0)


@apart_kernel
def highest_of(n: int, frames: Array, index: Array, first: int) -> Any:
    """Highest raw level of n pixels of frames index (2, 4)."""
    end = first + n
    i0, i1 = frames[index[0, 0], 0, first:end], frames[index[0, 1], 0, first:end]
    i2, i3 = frames[index[0, 2], 0, first:end], frames[index[0, 3], 0, first:end]
    k0, k1 = frames[index[1, 0], 0, first:end], frames[index[1, 1], 0, first:end]
    k2, k3 = frames[index[1, 2], 0, first:end], frames[index[1, 3], 0, first:end]
    top = i0[0]
    for x in range(n):
        one, other = highest(i0[x], i1[x], i2[x], i3[x]), highest(k0[x], k1[x], k2[x], k3[x])
        most = one if one > other else other
        top = most if most > top else top
    return top


@pasted_kernel
def pair_of(camera: Camera, fringes: FringeRecord, axis: AxisRecord) -> Any:
    """What store_pair and merge_pair are told, and order_pair. Amplitudes and offsets are not divided by 2
    and 4 before they are stored."""
    coarse, fine, extent = fringes.periods[0], fringes.periods[1], np.float32(axis.extent)
    read2, gain, quad = camera.read2, camera.gain, fringes.quad
    of_coarse = _FOUR * (read2 * quad[0, 0, 0] * TURN2), gain * quad[0, 1, 0] * TURN2, coarse * coarse
    of_fine = _FOUR * (read2 * quad[1, 0, 0] * TURN2), gain * quad[1, 1, 0] * TURN2, fine * fine
    seen = camera.dark, _QUARTER * camera.scale, _FOUR * fringes.misfit[1]
    middle, lies = _HALF * (extent - _ONE) / coarse, (_ZERO, fringes.reach, extent)
    return (
        (read2, _QUARTER * gain, of_coarse, of_fine, _FOUR * fringes.misfit[0], seen),
        (coarse, fine, middle, fringes.disagreement, lies),
    )


@pasted_kernel
def _phase(f0: Any, f1: Any, f2: Any, f3: Any, read2: Any, gain: Any, of_turns: Any) -> Any:
    """Of four levels: 4 A, four times the squared amplitude and contrast (see quarter_sums), a sample's
    variance, turns, and the variance of the place in the period."""
    total, c, s, both = quarter_sums(f0, f1, f2, f3)
    turn, inverse = phase_of(c, s)
    level = total if total > _ZERO else _ZERO
    # the products of fit_kernels and unwrap_kernels, as answers are to be the same to the last bit
    variance = (of_turns[0] + of_turns[1] * level) * inverse + TINY
    return total, c * c + s * s, both * both, read2 + gain * level, turn, variance * of_turns[2]


@pasted_kernel
def _phases(i0: Any, i1: Any, i2: Any, i3: Any, k0: Any, k1: Any, k2: Any, k3: Any, limits: Any) -> Any:
    """Of raw levels of the coarse and of the fine period: turns and variance of either, flags, and 4 A and
    the squared 2 B of the fine one."""
    read2, gain, of_coarse, of_fine, worst, seen = limits
    _, _, left, rough, about, before = _phase(
        *(np.float32(i0), np.float32(i1), np.float32(i2), np.float32(i3), read2, gain, of_coarse)
    )
    total, power, misfit, noise, turn, own = _phase(
        *(np.float32(k0), np.float32(k1), np.float32(k2), np.float32(k3), read2, gain, of_fine)
    )
    why = why_seen(seen, power, noise, _QUARTER * total, _ZERO, misfit)
    return about, before, turn, own, why | (MOVED if left > worst * rough else _NONE), total, power


@apart_kernel
def store_pair(
    n: int,
    frames: Array,
    index: Array,
    first: int,
    limits: Any,
    about: Array,
    before: Array,
    turns: Array,
    spread: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """n pixels of two periods, frames index (2, 4), from pixel `first` on, none of which is clipped: turns of
    the coarse one (about) and variance of its place (before), those of the fine one, and what finest_tile
    writes, all (n,), of orders that are certain. limits: see pair_of.
    """
    end = first + n
    i0, i1 = frames[index[0, 0], 0, first:end], frames[index[0, 1], 0, first:end]
    i2, i3 = frames[index[0, 2], 0, first:end], frames[index[0, 3], 0, first:end]
    k0, k1 = frames[index[1, 0], 0, first:end], frames[index[1, 1], 0, first:end]
    k2, k3 = frames[index[1, 2], 0, first:end], frames[index[1, 3], 0, first:end]
    for x in range(n):
        about[x], before[x], turns[x], spread[x], flags[x], total, power = _phases(
            i0[x], i1[x], i2[x], i3[x], k0[x], k1[x], k2[x], k3[x], limits
        )
        amplitude[x], offset[x] = _HALF * np.sqrt(power), _QUARTER * total
        order_error[x] = _ZERO


@apart_kernel
def merge_pair(
    n: int,
    frames: Array,
    index: Array,
    first: int,
    limits: Any,
    about: Array,
    before: Array,
    turns: Array,
    spread: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
) -> None:
    """store_pair, what both axes share being that of the other axis so far."""
    end = first + n
    i0, i1 = frames[index[0, 0], 0, first:end], frames[index[0, 1], 0, first:end]
    i2, i3 = frames[index[0, 2], 0, first:end], frames[index[0, 3], 0, first:end]
    k0, k1 = frames[index[1, 0], 0, first:end], frames[index[1, 1], 0, first:end]
    k2, k3 = frames[index[1, 2], 0, first:end], frames[index[1, 3], 0, first:end]
    for x in range(n):
        about[x], before[x], turns[x], spread[x], why, total, power = _phases(
            i0[x], i1[x], i2[x], i3[x], k0[x], k1[x], k2[x], k3[x], limits
        )
        height = _HALF * np.sqrt(power)
        flags[x] |= why
        amplitude[x] = height if height < amplitude[x] else amplitude[x]
        offset[x] = _HALF * (offset[x] + _QUARTER * total)


@pasted_kernel
def _place(limits: Any, about: Any, before: Any, turns: Any, spread: Any) -> Any:
    """Of a pixel's phases: its place, how far it lies from the coarse period's, the variance of that, and
    whether another order is nearly as good."""
    coarse, fine, middle, _, _ = limits
    rough = coarse * (about + np.rint(middle - about))
    place = fine * (turns + np.rint(rough * (_ONE / fine) - turns))
    step, both = abs(place - rough), before + spread
    return place, step, both, fine * (fine - _TWO * step) < CERTAIN * both


@apart_kernel
def _order(
    n: int,
    limits: Any,
    floor: Any,
    about: Array,
    before: Array,
    turns: Array,
    spread: Array,
    coord: Array,
    sigma: Array,
    flags: Array,
) -> bool:
    """Whether any orders are close."""
    (_, _, _, most, lies), close = limits, _ZERO
    for x in range(n):
        place, step, both, near = _place(limits, about[x], before[x], turns[x], spread[x])
        error = np.sqrt(spread[x])
        close += _ONE if near else _ZERO
        flags[x] |= why_placed(lies, step * step - most * both, _ZERO, _ZERO, place, spread[x])
        coord[x], sigma[x] = place, error if error > floor else floor
    return bool(close > _ZERO)


@leaf_kernel
def order_pair(
    n: int,
    limits: Any,
    floor: Any,
    about: Array,
    before: Array,
    turns: Array,
    spread: Array,
    coord: Array,
    sigma: Array,
    flags: Array,
    order_error: Array,
) -> None:
    """coord and sigma (n,), at least `floor`, from what store_pair found, its flags and order error. limits:
    see pair_of.

    As in unwrap_kernels: the coarse period's place is nearest to the middle of the surface, the fine one's
    nearest to that.
    """
    if _order(n, limits, floor, about, before, turns, spread, coord, sigma, flags):
        fine = float(limits[1])
        for x in range(n):
            _, step, both, near = _place(limits, about[x], before[x], turns[x], spread[x])
            if near:
                add_doubt(x, np.float32(beside(fine, float(step), float(both))), flags, order_error)
