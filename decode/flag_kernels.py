"""Compiled flags: why a pixel is not to be trusted, and the maps that both axes share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel, outer_kernel, pasted_kernel
from .records import Camera, CellLines, CodeRecord, Shared
from .unwrap_kernels import UNKNOWN

__all__ = [
    "MOVED",
    "beyond_pattern",
    "code_tile_flags",
    "either",
    "finest_tile",
    "flag_fit",
    "merge_rows",
    "outlier_rows",
    "seen_limits",
    "why_cell",
    "why_doubted",
    "why_misread",
    "why_order",
    "why_seen",
]

Array = NDArray[Any]

# Flag's values, as the kernels need plain numbers of the width of their counters
_NONE, _DARK, _SATURATED, _LOW = np.int32(0), np.int32(1), np.int32(2), np.int32(4)
_ORDER, _OFF, MOVED, _INVALID = np.int32(8), np.int32(16), np.int32(64), np.int32(128)
_OUTLIER, _GOOD = np.uint16(32), np.uint16(0)
#: Amplitude over noise below which a pixel is flagged.
_LEAST_CONTRAST2 = np.float32(4.0**2)
#: Probability of a wrong order above which a pixel is flagged.
_DOUBT = np.float32(1e-4)
_UNKNOWN = np.float32(UNKNOWN / 10)
_INF = np.float32(np.inf)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
_THREE, _FOUR = np.float32(3), np.float32(4)


@leaf_kernel
def finest_tile(
    n: int,
    joined: bool,
    camera: Camera,
    worst: Any,
    disagreement: Any,
    reach: Any,
    extent: Any,
    fit: Array,
    variance: Array,
    misfit: Array,
    agreement: Array,
    doubt: Array,
    gap: Array,
    place: Array,
    spread: Array,
    why: Array,
    first: int,
    shared: Shared,
) -> None:
    """All flags of the finest period, with those of others (`why`), its amplitude, offset and order error:
    into the maps, from pixel `first` on.

    fit = A, c, s (3, n).
    LOW_CONTRAST: amplitude below 4 sigma; DARK: and offset below 8 sigma or `black`;
    SATURATED: too few samples left; MOVED: residuals that noise does not explain;
    ORDER_DOUBTFUL: periods disagree, an order is improbable, or code and fringe lie apart;
    OFF_PATTERN: beyond the border by more than half a pixel and 3 sigma; INVALID: no number.
    """
    limits = camera.read2, camera.gain, seen_limits(camera, worst), (disagreement, reach, extent)
    fitted, told = (fit[0], fit[1], fit[2], variance, misfit), (agreement, doubt, gap, place, spread)
    end = first + n
    flags, amplitude = shared.flat_flags[0, first:end], shared.flat_amplitude[0, first:end]
    offset, error = shared.flat_offset[0, first:end], shared.flat_error[0, first:end]
    # two loops: one that asks within is stored by masks, which takes twice as long
    if joined:
        _merge_finest(n, limits, fitted, told, why, flags, amplitude, offset, error)
    else:
        _store_finest(n, limits, fitted, told, why, flags, amplitude, offset, error)


@pasted_kernel
def either(one: Any, other: Any) -> Any:
    """Probability that one of two independent things is so."""
    return one + other - one * other


@pasted_kernel
def seen_limits(camera: Camera, worst: Any) -> Any:
    """What why_seen is told."""
    low = _LEAST_CONTRAST2 / camera.scale
    return low, camera.dark * camera.dark, _FOUR * _LEAST_CONTRAST2, worst


@pasted_kernel
def why_seen(limits: Any, power: Any, noise: Any, level: Any, variance: Any, misfit: Any) -> Any:
    """Flags of a fit: squared amplitude, a sample's variance, offset (not below 0), the phase's variance,
    misfit."""
    low, black2, dark, worst = limits
    lit = level * level >= (black2 if black2 > dark * noise else dark * noise)
    contrast = (_LOW if lit else _LOW | _DARK) if power < low * noise else _NONE
    lost = _SATURATED if variance > _UNKNOWN else _NONE
    return contrast | lost | (MOVED if misfit > worst * noise else _NONE)


@pasted_kernel
def why_order(wrong: Any, off: Any) -> Any:
    """Flags of a pixel's place."""
    return (_ORDER if wrong else _NONE) | (_OFF if off else _NONE)


@pasted_kernel
def why_doubted(wrong: Any) -> Any:
    """Flags of a probability that the order is wrong."""
    return _ORDER if wrong > _DOUBT else _NONE


@pasted_kernel
def beyond_pattern(extent: Any, place: Any) -> Any:
    """Distance from the border, negative within."""
    return abs(place - _HALF * (extent - _ONE)) - _HALF * extent


@pasted_kernel
def _why_placed(limits: Any, agreement: Any, doubt: Any, gap: Any, place: Any, spread: Any) -> Any:
    """Flags of a pixel's place: what orders told, and its variance."""
    disagreement, reach, extent = limits
    wrong = (agreement > disagreement) | (doubt > _DOUBT) | (gap > reach)
    beyond = beyond_pattern(extent, place)
    off = (beyond > _HALF) & (beyond * beyond > _THREE * _THREE * spread)
    fine = (abs(place) < _INF) & (spread < _INF)
    return why_order(wrong, off) | (_NONE if fine else _INVALID)


@apart_kernel
def _store_finest(
    n: int,
    limits: Any,
    fitted: Any,
    told: Any,
    why: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    a, c, s, variance, misfit = fitted
    agreement, doubt, gap, place, spread = told
    read2, gain, of_fit, of_place = limits
    for x in range(n):
        level = a[x] if a[x] > _ZERO else _ZERO
        noise, power = read2 + gain * level, c[x] * c[x] + s[x] * s[x]
        seen = why_seen(of_fit, power, noise, level, variance[x], misfit[x])
        lies = _why_placed(of_place, agreement[x], doubt[x], gap[x], place[x], spread[x])
        flags[x] = why[x] | seen | lies
        amplitude[x] = np.sqrt(power)
        offset[x] = a[x]
        order_error[x] = doubt[x] if doubt[x] < _ONE else _ONE


@apart_kernel
def _merge_finest(
    n: int,
    limits: Any,
    fitted: Any,
    told: Any,
    why: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    a, c, s, variance, misfit = fitted
    agreement, doubt, gap, place, spread = told
    read2, gain, of_fit, of_place = limits
    for x in range(n):
        level = a[x] if a[x] > _ZERO else _ZERO
        noise, power = read2 + gain * level, c[x] * c[x] + s[x] * s[x]
        height = np.sqrt(power)
        wrong = doubt[x] if doubt[x] < _ONE else _ONE
        seen = why_seen(of_fit, power, noise, level, variance[x], misfit[x])
        lies = _why_placed(of_place, agreement[x], doubt[x], gap[x], place[x], spread[x])
        flags[x] |= why[x] | seen | lies
        amplitude[x] = height if height < amplitude[x] else amplitude[x]
        offset[x] = _HALF * (offset[x] + a[x])
        order_error[x] = either(order_error[x], wrong)


@apart_kernel
def flag_fit(
    n: int, worst: Any, read2: Any, gain: Any, a: Array, variance: Array, misfit: Array, why: Array
) -> None:
    """SATURATED and MOVED of another period, as in finest_tile."""
    for x in range(n):
        lost = _SATURATED if variance[x] > _UNKNOWN else _NONE
        noise = read2 + gain * (a[x] if a[x] > _ZERO else _ZERO)
        why[x] |= lost | (MOVED if misfit[x] > worst * noise else _NONE)


@apart_kernel
def _common_tile(
    n: int,
    joined: bool,
    why: Array,
    height: Array,
    mean: Array,
    doubt: Array,
    row: int,
    first: int,
    all_flags: Array,
    all_amplitudes: Array,
    all_offsets: Array,
    all_errors: Array,
) -> None:
    """Write (first axis) or merge (second axis) what both axes share, from column `first` of a row on."""
    end = first + n
    flags, amplitude = all_flags[row, first:end], all_amplitudes[row, first:end]
    offset, order_error = all_offsets[row, first:end], all_errors[row, first:end]
    if not joined:
        for x in range(n):
            flags[x] = why[x]
            amplitude[x] = height[x]
            offset[x] = mean[x]
            order_error[x] = doubt[x] if doubt[x] < _ONE else _ONE
        return
    for x in range(n):
        flags[x] |= why[x]
        amplitude[x] = height[x] if height[x] < amplitude[x] else amplitude[x]
        offset[x] = _HALF * (offset[x] + mean[x])
        wrong = doubt[x] if doubt[x] < _ONE else _ONE
        order_error[x] = either(order_error[x], wrong)


@leaf_kernel
def code_tile_flags(
    n: int,
    first: int,
    joined: bool,
    camera: Camera,
    code: CodeRecord,
    found: CellLines,
    spread: Array,
    shared: Shared,
) -> None:
    """Flags of a code that stands alone (contrast, clipped bits, doubtful bits, cells off the pattern), half
    contrast, mid level and the probability that a bit is wrong: into the maps, from pixel `first` on; and the
    variance of the place."""
    end, (read2, gain) = first + n, camera.of_code
    limits, square = (read2, gain, camera.dark, code.most), code.pitch * code.pitch
    levels, doubts = (found.half, found.middle, found.clipped), (found.far, found.up, found.down)
    flags, amplitude = shared.flat_flags[0, first:end], shared.flat_amplitude[0, first:end]
    offset, error = shared.flat_offset[0, first:end], shared.flat_error[0, first:end]
    told = limits, levels, doubts, found.cell, flags, amplitude, offset, error
    if joined:
        _merge_cells(n, *told)
    else:
        _store_cells(n, *told)
    for x in range(n):
        spread[x] = square * found.place[x]


@pasted_kernel
def why_misread(clipped: Any, far: Any) -> Any:
    """Flags of a code's pixel whose bits are in doubt; far: probability that one leads far away."""
    return (_SATURATED if np.int32(clipped) > _NONE else _NONE) | (_ORDER if far > _DOUBT else _NONE)


@pasted_kernel
def why_cell(limits: Any, half: Any, middle: Any, clipped: Any, cell: Any, far: Any) -> Any:
    """Flags of a pixel of a code: see code_tile_flags."""
    read2, gain, black, most = limits
    noise = _LEAST_CONTRAST2 * (read2 + gain * (middle if middle > _ZERO else _ZERO))
    low = (half <= _ZERO) | (half * half < noise)
    dark = low & ((middle < black) | (middle * middle < _FOUR * noise))
    contrast = (_LOW if low else _NONE) | (_DARK if dark else _NONE)
    off = _OFF if (cell < _NONE) | (cell >= most) else _NONE
    return contrast | off | why_misread(clipped, far)


@apart_kernel
def _store_cells(
    n: int,
    limits: Any,
    levels: Any,
    doubts: Any,
    cell: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    (half, middle, clipped), (far, up, down) = levels, doubts
    for x in range(n):
        flags[x] = why_cell(limits, half[x], middle[x], clipped[x], cell[x], far[x])
        amplitude[x], offset[x] = half[x], middle[x]
        wrong = far[x] + up[x] + down[x]  # a bit may be wrong anywhere
        order_error[x] = wrong if wrong < _ONE else _ONE


@apart_kernel
def _merge_cells(
    n: int,
    limits: Any,
    levels: Any,
    doubts: Any,
    cell: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    (half, middle, clipped), (far, up, down) = levels, doubts
    for x in range(n):
        flags[x] |= why_cell(limits, half[x], middle[x], clipped[x], cell[x], far[x])
        amplitude[x] = half[x] if half[x] < amplitude[x] else amplitude[x]
        offset[x] = _HALF * (offset[x] + middle[x])
        wrong = far[x] + up[x] + down[x]
        wrong = wrong if wrong < _ONE else _ONE
        order_error[x] = either(order_error[x], wrong)


@outer_kernel
def merge_rows(
    start: int,
    stop: int,
    joined: bool,
    why: Array,
    height: Array,
    mean: Array,
    doubt: Array,
    flags: Array,
    amplitude: Array,
    offset: Array,
    order_error: Array,
) -> None:
    """_common_tile for a block: why, height, mean, doubt (stop - start, W) into the maps."""
    for row in range(start, stop):
        at = row - start
        _common_tile(
            why.shape[1],
            joined,
            why[at],
            height[at],
            mean[at],
            doubt[at],
            row,
            0,
            flags,
            amplitude,
            offset,
            order_error,
        )


@leaf_kernel
def outlier_rows(start: int, stop: int, least: Any, flags: Array, kept: Array) -> None:
    """Flag a pixel that leaves a line on which its two neighbours on either side agree.

    Folds and edges pass: there the neighbours do not agree with each other. kept (R, W or more): coordinates
    of the rows (see Scratch).
    """
    for row in range(start, stop):
        _outliers(least, kept[row % len(kept), : flags.shape[1]], flags[row])


@apart_kernel
def _outliers(limit: Any, line: Array, why: Array) -> None:
    inner = max(len(line) - 4, 0)
    left2, left, middle, right, right2 = line[:inner], line[1:], line[2:], line[3:], line[4:]
    some = _ZERO
    for x in range(inner):
        some += _ONE if abs(middle[x] - _HALF * (left[x] + right[x])) > limit else _ZERO
    if some == _ZERO:  # as a rule
        return
    for x in range(inner):
        jump = abs(middle[x] - _HALF * (left[x] + right[x]))
        beside = abs(left[x] - left2[x]) + abs(right2[x] - right[x])
        calm = _THREE * (abs(right[x] - left[x]) + beside)
        why[x + 2] |= _OUTLIER if jump > (calm if calm > limit else limit) else _GOOD
