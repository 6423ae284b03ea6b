"""What a display does to a fringe besides its cells: grey values are whole numbers, and the surface ends.

A shown table differs from the cosine by up to half a grey level, and beyond the border there is darkness.
Both shift the decoded coordinate by a known amount: with T_n[k] the table of step n and W_k(u) the light that
cell k sends to a camera pixel at u, the decoder sees the phase of

    Z(u) = sum_k W_k(u) z_k,    z_k = c_k + i s_k, the least-squares fringe through T_n[k] over n.

The shift against the unrounded, endless cosine is tabled along u and taken off. It hardly depends on W, for
which a pixel's footprint of the median width and a Gaussian serve; the stairs of `cells`, which depend on it
strongly, drop out of the difference.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from optolever.blocks import over_rows
from optolever.patterns import Frame, Sequence

from .correspondence import Flag
from .jit import kernel
from .plan import AxisPlan, Fringe
from .unwrap_kernels import MUCH_FINER

__all__ = ["correct_display", "display_shift"]

Map = NDArray[Any]
Complex = NDArray[np.complex128]
#: Samples of the table per cell, cells that it reaches beyond the border.
_PER_CELL = 8
_BEYOND = 4
#: Share of the light beyond the border under which a place is not tabled.
_LEAST_LIGHT = 0.2
#: Share of the light lost beyond the border above which a pixel counts as off the pattern.
_MOST_LOST = 0.2
_OFF = int(Flag.OFF_PATTERN)
#: Rms blur that is assumed where the frames do not tell it, cells.
_USUAL_BLUR = 0.5


def correct_display(
    sequence: Sequence, axis: AxisPlan, coord: Map, sigma: Map, flags: Map, blur: float | None
) -> None:
    """Take the display's shift off coord (H, W) and add the border's share of it to sigma (H, W), in place.

    Pixels that lose more than a fifth of their light beyond the border are flagged OFF_PATTERN.
    """
    footprint = _median_footprint(coord)
    shift, border, lost = display_shift(sequence, axis, footprint, _USUAL_BLUR if blur is None else blur)
    rows = coord.shape[0]
    over_rows(
        lambda start, stop: _shift_rows(start, stop, shift, border, lost, coord, sigma, flags), rows, 64
    )


def display_shift(
    sequence: Sequence, axis: AxisPlan, footprint: float, blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(shift, the border's part of it, share of the light lost beyond the border) at decoded coordinates -_BEYOND, -_BEYOND + 1/_PER_CELL, ..., pattern px.

    footprint: width of a camera pixel, blur: rms, both in cells.
    """
    total = np.zeros((3, (axis.extent + 2 * _BEYOND) * _PER_CELL))
    information = 0.0
    previous = np.inf
    for fringe in axis.fringes:
        own = len(fringe.index) / fringe.period**2
        # the same combination of periods as in unwrap_kernels
        alone = fringe.period * MUCH_FINER < previous
        gain = 1.0 if alone else own / (information + own)
        total += gain * (np.stack(_fringe_shift(sequence, fringe, axis, footprint, blur)) - total)
        information = own if alone else information + own
        previous = fringe.period
    return total[0], total[1], total[2]


def _fringe_shift(
    sequence: Sequence, fringe: Fringe, axis: AxisPlan, footprint: float, blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    tables = np.stack([_table(sequence.frames[i], sequence, axis.axis) for i in fringe.index])
    solve = np.linalg.pinv(
        np.stack([np.ones(len(tables)), np.cos(fringe.shifts), np.sin(fringe.shifts)], axis=1)
    )
    shown = (solve[1] + 1j * solve[2]) @ tables
    pad = _BEYOND + int(np.ceil(footprint / 2 + 4 * blur)) + 1
    cells = np.arange(-pad, axis.extent + pad)
    ideal = 127.5 * np.exp(2j * np.pi * cells / fringe.period)
    endless = ideal.copy()
    endless[pad:-pad] = shown
    dark = np.zeros_like(ideal)
    dark[pad:-pad] = shown
    light = _cell_light(footprint, blur)
    seen_ideal, seen_endless, seen_dark = (_seen(row, light) for row in (ideal, endless, dark))
    turn = fringe.period / (2 * np.pi)
    rounding = turn * np.angle(seen_endless * seen_ideal.conj())
    border = turn * np.angle(seen_dark * seen_endless.conj())
    at = -pad - 0.5 + (np.arange(len(rounding)) + 0.5) / _PER_CELL
    wanted = np.arange(-_BEYOND * _PER_CELL, (axis.extent + _BEYOND) * _PER_CELL) / _PER_CELL
    left = np.abs(seen_dark) / np.abs(seen_ideal)
    lit = left > _LEAST_LIGHT
    decoded = np.maximum.accumulate((at + rounding + border)[lit])
    shift, border, left = (
        np.interp(wanted, decoded, part[lit]) for part in (rounding + border, border, left)
    )
    return shift, border, 1 - left


def _table(frame: Frame, sequence: Sequence, axis: str) -> NDArray[np.float64]:
    return frame.tables(sequence.rows, sequence.cols)["uv".index(axis)].astype(np.float64)


def _cell_light(footprint: float, blur: float) -> NDArray[np.float64]:
    """Weights, one per 1/_PER_CELL cell: footprint's box and Gaussian blur; the cell is in `_seen`."""
    reach = int(np.ceil((footprint / 2 + 4 * blur) * _PER_CELL)) + 1
    place = np.arange(-reach, reach + 1) / _PER_CELL
    step = 1 / _PER_CELL
    gauss = np.exp(-0.5 * (place / max(blur, 0.3 * step)) ** 2)
    box = np.clip((footprint + step) / 2 - np.abs(place), 0, step)
    weights = np.convolve(gauss, box, mode="same")
    return np.asarray(weights / weights.sum())


def _seen(cells: Complex, light: NDArray[np.float64]) -> Complex:
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
    last = len(shift) - 2
    for row in range(start, stop):
        for col in range(coord.shape[1]):
            place = (coord[row, col] + _BEYOND) * _PER_CELL
            if not (place >= 0 and place <= last):
                continue
            k = int(place)
            part = place - k
            coord[row, col] -= shift[k] + part * (shift[k + 1] - shift[k])
            extra = border[k] + part * (border[k + 1] - border[k])
            if abs(extra) > 1e-3:
                sigma[row, col] = np.sqrt(sigma[row, col] ** 2 + extra * extra)
            if lost[k] > _MOST_LOST:
                flags[row, col] |= _OFF
