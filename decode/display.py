"""What a display does to a fringe besides its cells: grey values are whole numbers, and the surface ends.

A shown table differs from the cosine by up to half a grey level, and beyond the border there is darkness.
Both shift the decoded coordinate by a known amount: with T_n[k] the table of step n and W_k(u) the light that
cell k sends to a camera pixel at u, the decoder sees the phase of

    Z(u) = sum_k W_k(u) z_k,    z_k = c_k + i s_k, the least-squares fringe through T_n[k] over n.

The shift against the unrounded, endless cosine is tabled along u and taken off, with a footprint of the
median width and a Gaussian for W; the Gaussian's width is what the fringe has lost in contrast against white
and black. The stairs of `cells` are in the table as long as blur leaves little of them; where they are high,
they depend too much on each pixel's footprint, drop out of the difference and stay in sigma.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from optolever.blocks import over_rows
from optolever.patterns import Frame, Sequence

from .correspondence import Flag
from .jit import fast_kernel, kernel
from .plan import AxisPlan, Fringe
from .unwrap_kernels import MUCH_FINER

__all__ = ["correct_display", "display_shift"]

Map = NDArray[Any]
Complex = NDArray[np.complex128]
F64 = NDArray[np.float64]
#: Samples of the table per cell, cells that it reaches beyond the border.
_PER_CELL = 8
_BEYOND = 4
#: Share of the light beyond the border under which a place is not tabled.
_LEAST_LIGHT = 0.2
#: Share of the light lost beyond the border above which a pixel counts as off the pattern.
_MOST_LOST = 0.2
_OFF = int(Flag.OFF_PATTERN)
#: Share of the border in a shift that sigma has to hold, pattern pixels.
_BORDER = 1e-3
#: What blur leaves of the cells' fundamental, under which stairs (then below 0.03 px) are taken off.
_LOW_STAIRS = 0.1
#: Rms blur that is assumed where the frames do not tell it, cells.
_USUAL_BLUR = 0.5


def correct_display(
    sequence: Sequence, axis: AxisPlan, coord: Map, sigma: Map, flags: Map, blur: float | None
) -> bool:
    """Take the display's shift off coord (H, W) and add the border's part of it to sigma (H, W), in place.

    Pixels that lose more than a fifth of their light beyond the border are flagged OFF_PATTERN.
    True if the stairs of the cells were low enough to be taken off, too.
    """
    soft = blur is not None and np.exp(-2 * (np.pi * blur) ** 2) < _LOW_STAIRS
    used = _USUAL_BLUR if blur is None else blur
    shift, border, lost = display_shift(sequence, axis, _median_footprint(coord), used, stairs=soft)
    rows = coord.shape[0]
    over_rows(
        lambda start, stop: _shift_rows(start, stop, shift, border, lost, coord, sigma, flags), rows, 64
    )
    return soft


def display_shift(
    sequence: Sequence, axis: AxisPlan, footprint: float, blur: float, *, stairs: bool
) -> tuple[F64, F64, F64]:
    """(shift, the border's part of it, share of the light lost beyond the border), pattern px.

    Tabled at decoded coordinates -_BEYOND, -_BEYOND + 1 / _PER_CELL, ... footprint: width of a camera pixel,
    blur: rms, both in cells; stairs: those of the cells are part of the shift.
    """
    total = np.zeros((3, (axis.extent + 2 * _BEYOND) * _PER_CELL))
    information = 0.0
    previous = np.inf
    for fringe in axis.fringes:
        own = len(fringe.index) / fringe.period**2
        # the same combination of periods as in unwrap_kernels
        alone = fringe.period * MUCH_FINER < previous
        gain = 1.0 if alone else own / (information + own)
        total += gain * (_fringe_shift(sequence, fringe, axis, footprint, blur, stairs) - total)
        information = own if alone else information + own
        previous = fringe.period
    return total[0], total[1], total[2]


def _fringe_shift(
    sequence: Sequence, fringe: Fringe, axis: AxisPlan, footprint: float, blur: float, stairs: bool
) -> F64:
    """display_shift for one period, (3, K)."""
    pad = _BEYOND + int(np.ceil(footprint / 2 + 4 * blur)) + 1
    shown = _fundamental(sequence, fringe, axis)
    ideal = 127.5 * np.exp(2j * np.pi * np.arange(-pad, axis.extent + pad) / fringe.period)
    endless, dark = ideal.copy(), np.zeros_like(ideal)
    endless[pad:-pad] = dark[pad:-pad] = shown
    light = _cell_light(footprint, blur)
    seen_ideal, seen_endless, seen_dark = (_seen(row, light) for row in (ideal, endless, dark))
    at = -pad - 0.5 + (np.arange(len(seen_dark)) + 0.5) / _PER_CELL
    turn = fringe.period / (2 * np.pi)
    truth = np.exp(2j * np.pi * at / fringe.period) if stairs else seen_ideal
    shift = turn * np.angle(seen_dark * truth.conj())
    border = turn * np.angle(seen_dark * seen_endless.conj())
    left = np.abs(seen_dark) / np.abs(seen_ideal)
    lit = left > _LEAST_LIGHT
    wanted = np.arange(-_BEYOND * _PER_CELL, (axis.extent + _BEYOND) * _PER_CELL) / _PER_CELL
    decoded = np.maximum.accumulate((at + shift)[lit])
    return np.stack([np.interp(wanted, decoded, part[lit]) for part in (shift, border, 1 - left)])


def _fundamental(sequence: Sequence, fringe: Fringe, axis: AxisPlan) -> Complex:
    """c + i s of the fringe through the shown levels of every cell (extent,)."""
    tables = np.stack([_table(sequence.frames[i], sequence, axis.axis) for i in fringe.index])
    design = np.stack([np.ones(len(tables)), np.cos(fringe.shifts), np.sin(fringe.shifts)], axis=1)
    solve = np.linalg.pinv(design)
    return np.asarray((solve[1] + 1j * solve[2]) @ tables)


def _table(frame: Frame, sequence: Sequence, axis: str) -> F64:
    return frame.tables(sequence.rows, sequence.cols)["uv".index(axis)].astype(np.float64)


def _cell_light(footprint: float, blur: float) -> F64:
    """Weights, one per 1/_PER_CELL cell: footprint's box and Gaussian blur; the cell is in `_seen`."""
    reach = int(np.ceil((footprint / 2 + 4 * blur) * _PER_CELL)) + 1
    place = np.arange(-reach, reach + 1) / _PER_CELL
    step = 1 / _PER_CELL
    gauss = np.exp(-0.5 * (place / max(blur, 0.3 * step)) ** 2)
    box = np.clip((footprint + step) / 2 - np.abs(place), 0, step)
    weights = np.convolve(gauss, box, mode="same")
    return np.asarray(weights / weights.sum())


def _seen(cells: Complex, light: F64) -> Complex:
    """What is seen at the centres of the _PER_CELL parts of every cell."""
    return np.asarray(fftconvolve(np.repeat(cells, _PER_CELL), light, mode="same"))


def _median_footprint(coord: Map) -> float:
    """Median extent of a camera pixel in pattern cells, from a sample of the decoded map."""
    total = 0.0
    for axis, size in enumerate(coord.shape):
        chosen = coord if axis == 1 else coord.T
        change = np.abs(np.diff(chosen[:: max(1, chosen.shape[0] // 64)], axis=1))
        change = change[np.isfinite(change)]
        total += float(np.median(change)) if size > 1 and len(change) else 0.0
    return min(total, 8.0)


@kernel
def _shift_rows(
    start: int, stop: int, shift: Map, border: Map, lost: Map, coord: Map, sigma: Map, flags: Map
) -> None:
    """Take the tabled shift off; what the border does is looked at only where it does anything."""
    width = coord.shape[1]
    last = len(shift) - 2
    low, high = 0, last
    while low < last and (abs(border[low]) > _BORDER or lost[low] > _MOST_LOST):
        low += 1
    while high > 0 and (abs(border[high]) > _BORDER or lost[high] > _MOST_LOST):
        high -= 1
    place, change = np.empty(width), np.empty(width)
    for row in range(start, stop):
        for col in range(width):
            place[col] = (coord[row, col] + _BEYOND) * _PER_CELL
        if _shifts(width, last, shift, place, change, low, high):
            for col in range(width):
                if place[col] >= 0 and place[col] <= last and not (low < place[col] < high):
                    k = int(place[col])
                    extra = border[k] + (place[col] - k) * (border[k + 1] - border[k])
                    if abs(extra) > _BORDER:
                        sigma[row, col] = np.sqrt(sigma[row, col] ** 2 + extra * extra)
                    if lost[k] > _MOST_LOST:
                        flags[row, col] |= _OFF
        for col in range(width):
            coord[row, col] -= change[col]


@fast_kernel
def _shifts(n: int, last: int, shift: Map, place: Map, change: Map, low: int, high: int) -> bool:
    """Interpolated shift, 0 beyond the table; True if any place is near the border."""
    for col in range(n):
        inside = (place[col] >= 0) & (place[col] <= last)
        at = place[col] if inside else 0.0
        k = np.int32(at)
        change[col] = shift[k] + (at - k) * (shift[k + 1] - shift[k]) if inside else 0.0
    near = 0
    for col in range(n):
        near += (place[col] <= low) | (place[col] >= high)
    return near > 0
