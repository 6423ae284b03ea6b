"""Compiled: two periods of four quarter shifts, in two loops: fitted and flagged, then unwrapped.

Most of what fit_kernels, unwrap_kernels and flag_kernels hand to each other through the cache stays in
registers. The formulas are theirs. One loop for all would be slower: it is longer than what a processor has
under way at once. Nor are storing and merging one, as a loop that asks within is stored by masks.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fit_kernels import OF_QUARTERS, TINY, highest, quarter_sums
from .flag_kernels import MOVED, beyond_pattern, either, seen_limits, why_doubted, why_order, why_seen
from .jit import apart_kernel, leaf_kernel, pasted_kernel
from .phase_kernels import phase_of
from .records import AxisRecord, Camera, FringeRecord
from .stream_kernels import ahead
from .unwrap_kernels import CERTAIN, doubt_of

__all__ = ["highest_of", "merge_pair", "order_pair", "pair_of", "store_pair"]

Array = NDArray[Any]
#: Pixels between two looks ahead at frames, and bytes that come at once.
_APART, _LINE = 128, 64
_ZERO, _ONE, _TWO, _FOUR = np.float32(0), np.float32(1), np.float32(2), np.float32(4)
_QUARTER, _HALF, _THREE, _NONE = np.float32(0.25), np.float32(0.5), np.float32(3), np.int32(0)


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
    """What store_pair and merge_pair are told, and order_pair. Offsets are four times what they are until
    they are stored, squared amplitudes and misfits, too."""
    coarse, fine, extent = fringes.periods[0], fringes.periods[1], np.float32(axis.extent)
    low, black2, dark, worst = seen_limits(camera, _FOUR * fringes.misfit[1])
    seen = _FOUR * low, black2, dark, worst
    middle, close = _HALF * (extent - _ONE), (-_TWO / fine, CERTAIN / (fine * fine))
    return (
        (camera.read2, _QUARTER * camera.gain, coarse * coarse, fine * fine, _FOUR * fringes.misfit[0], seen),
        (coarse, fine, middle, _ONE / coarse, _ONE / fine, close, fringes.disagreement, extent),
    )


@pasted_kernel
def _phase(f0: Any, f1: Any, f2: Any, f3: Any, read2: Any, gain: Any, square: Any) -> Any:
    """Of four levels: 4 A, (2 B)^2, the squared contrast that is left (see quarter_sums), a sample's
    variance, turns, and the variance of the place in the period."""
    total, c, s, rest = quarter_sums(f0, f1, f2, f3)
    turn, power, inverse = phase_of(c, s)
    noise = read2 + gain * total
    # the products of fit_kernels and unwrap_kernels, as answers are to be the same to the last bit
    variance = noise * (_FOUR * OF_QUARTERS * inverse) + TINY
    return total, power, rest * rest, noise, turn, variance * square


@pasted_kernel
def _phases(i0: Any, i1: Any, i2: Any, i3: Any, k0: Any, k1: Any, k2: Any, k3: Any, limits: Any) -> Any:
    """Of raw levels of the coarse and of the fine period: turns and variance of either, flags, and A and B of
    the fine one."""
    read2, gain, coarse2, fine2, worst, seen = limits
    _, _, left, rough, about, before = _phase(
        *(np.float32(i0), np.float32(i1), np.float32(i2), np.float32(i3), read2, gain, coarse2)
    )
    total, power, misfit, noise, turn, own = _phase(
        *(np.float32(k0), np.float32(k1), np.float32(k2), np.float32(k3), read2, gain, fine2)
    )
    level, height = _QUARTER * total, _HALF * np.sqrt(power)
    why = why_seen(seen, power, noise, level, _ZERO, misfit)
    return about, before, turn, own, why | (MOVED if left > worst * rough else _NONE), level, height


@pasted_kernel
def _look_ahead(start: int, n: int, lines: Any) -> None:
    """What the next tile has where this one, of n pixels, has its next ones: on its way while these are
    worked on, and not waited for. The processor itself looks a few lines ahead, of a few frames."""
    for line in lines:
        for x in range(start, start + _APART, _LINE // line.itemsize):
            ahead(line, x + n)


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
    for start in range(0, n, _APART):
        _look_ahead(start, n, (i0, i1, i2, i3, k0, k1, k2, k3))
        base = np.uint64(start)
        for z in range(min(_APART, n - start)):
            x = base + np.uint64(z)
            about[x], before[x], turns[x], spread[x], flags[x], offset[x], amplitude[x] = _phases(
                i0[x], i1[x], i2[x], i3[x], k0[x], k1[x], k2[x], k3[x], limits
            )
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
    for start in range(0, n, _APART):
        _look_ahead(start, n, (i0, i1, i2, i3, k0, k1, k2, k3))
        base = np.uint64(start)
        for z in range(min(_APART, n - start)):
            x = base + np.uint64(z)
            about[x], before[x], turns[x], spread[x], why, level, height = _phases(
                i0[x], i1[x], i2[x], i3[x], k0[x], k1[x], k2[x], k3[x], limits
            )
            flags[x] |= why
            amplitude[x] = height if height < amplitude[x] else amplitude[x]
            offset[x] = _HALF * (offset[x] + level)


@pasted_kernel
def _place(limits: Any, about: Any, before: Any, turns: Any, spread: Any) -> Any:
    """Of a pixel's phases: its place, how far it lies from the coarse period's, the variance of that, and
    whether another order is nearly as good."""
    coarse, fine, middle, over_coarse, over_fine, (step_over, most), _, _ = limits
    rough = coarse * (about + np.rint(middle * over_coarse - about))
    place = fine * (turns + np.rint(rough * over_fine - turns))
    step, both = abs(place - rough), before + spread
    return place, step, both, _ONE + step_over * step < most * both


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
    most, extent, close = limits[6], limits[7], _ZERO
    for x in range(n):
        place, step, both, near = _place(limits, about[x], before[x], turns[x], spread[x])
        error = np.sqrt(spread[x])
        error = error if error > floor else floor
        close += _ONE if near else _ZERO
        surely = _THREE * error if _THREE * error > _HALF else _HALF
        flags[x] |= why_order(step * step > most * both, beyond_pattern(extent, place) > surely)
        coord[x], sigma[x] = place, error
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
        _doubt(n, limits, about, before, turns, spread, flags, order_error)


@apart_kernel
def _doubt(
    n: int,
    limits: Any,
    about: Array,
    before: Array,
    turns: Array,
    spread: Array,
    flags: Array,
    order_error: Array,
) -> None:
    """Into maps that are flagged already: probabilities of wrong orders (n,), of those that are close."""
    square, twice = limits[1] * limits[1], _TWO * limits[1]
    for x in range(n):
        _, step, both, near = _place(limits, about[x], before[x], turns[x], spread[x])
        share = _ONE / both
        wrong = doubt_of((square - twice * step) * share, (square + twice * step) * share) if near else _ZERO
        flags[x] |= why_doubted(wrong)
        order_error[x] = either(order_error[x], wrong)
