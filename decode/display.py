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

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .display_kernels import BEYOND, BORDER, MOST_LOST, PER_CELL
from .plan import AxisPlan, Fringe, plan
from .unwrap_kernels import MUCH_FINER

__all__ = ["NO_TABLES", "BorderTable", "Tables", "border_table", "display_shift", "display_tables"]

Complex = NDArray[np.complex128]
F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
#: Least footprint and blur, in parts of a cell that are tabled.
_LEAST = 0.3
#: Share of the light beyond the border under which a place is not tabled.
_LEAST_LIGHT = 0.2


@dataclass(frozen=True, slots=True)
class Tables:
    """For take_off_run; stairs: those of the cells are in them."""

    kernel: tuple[NDArray[np.int32], float, F32, F32, int, int]
    stairs: bool


_EMPTY = np.zeros(0, np.float32)
NO_TABLES = Tables((np.zeros(0, np.int32), 0.0, _EMPTY, _EMPTY, 0, 0), False)
#: Largest number of a half word.
_FULL = 32767
#: Steps per cell of footprint and blur.
_STEPS = 128
#: What blur leaves of the cells' fundamental, under which stairs (then below 0.03 px) are taken off.
_LOW_STAIRS = 0.1
#: Rms blur that is assumed where the frames do not tell it, cells.
_USUAL_BLUR = 0.5


@dataclass(frozen=True, slots=True)
class BorderTable:
    """What decode takes for the work of the surface's border on fringes, at coordinates `at` (K,) as it reads
    them, pattern px, 1/16 px apart: shift (K,), px, which is taken off; told (K,): where it goes into sigma;
    refused (K,): so much light is lost that pixels are flagged OFF_PATTERN from there to the next entry."""

    at: F64
    shift: F64
    told: NDArray[np.bool_]
    refused: NDArray[np.bool_]


def border_table(sequence: Sequence, axis: str, footprint: float, blur: float | None) -> BorderTable:
    """The table for axis 'u' or 'v', which decode uses with the footprint and blur that it measures (cells;
    blur None: not known). InputError if the sequence shows no fringes along that axis.
    """
    shown = next((one for one in plan(sequence).axes if one.axis == axis and one.fringes), None)
    if shown is None:
        raise InputError(
            f"border_table: axis is {axis!r}, sequence {sequence.name} shows no fringes along it"
        )
    tables = display_tables(sequence, shown, footprint, blur)
    _, _, border, lost, low, high = tables.kernel
    entry = np.arange(len(border))
    near = (entry <= low) | (entry >= high)
    at, told, refused = entry / PER_CELL - BEYOND, np.abs(border) > BORDER, lost > MOST_LOST
    return BorderTable(at, border.astype(np.float64), near & told, near & refused)


def display_tables(sequence: Sequence, axis: AxisPlan, footprint: float, blur: float | None) -> Tables:
    """What take_off_run takes off, and whether the stairs of the cells are low enough to be part of it.

    footprint: width of a camera pixel, blur: rms (None: not known), both in cells; taken in steps that change
    nothing, as a series of captures asks for the same tables again and again.
    """
    rough = None if blur is None else round(blur * _STEPS) / _STEPS
    return _tables(sequence, axis.axis, round(footprint * _STEPS) / _STEPS, rough)


@lru_cache(maxsize=16)
def _tables(sequence: Sequence, name: str, footprint: float, blur: float | None) -> Tables:
    axis = next(axis for axis in plan(sequence).axes if axis.axis == name)
    soft = blur is not None and bool(np.exp(-2 * (np.pi * blur) ** 2) < _LOW_STAIRS)
    used = _USUAL_BLUR if blur is None else blur
    shift, border, lost = display_shift(sequence, axis, footprint, used, stairs=soft).astype(np.float32)
    # between the innermost places where the border does something; its shift swings through zero before
    reached = np.flatnonzero((np.abs(border) > BORDER) | (lost > MOST_LOST))
    left, right = reached[reached < len(shift) // 2], reached[reached >= len(shift) // 2]
    low = int(left[-1]) + 1 if len(left) else 0
    high = int(right[0]) - 1 if len(right) else len(shift)
    return Tables((*_packed(shift), border, lost, low, high), soft)


def _packed(shift: F32) -> tuple[NDArray[np.int32], float]:
    """Shift and its change to the next entry as half words, and their unit; one entry is 0.

    The unit is at most 1/32767 of a period: the rounding of 8-bit frames moves the phase by 20 times more.
    """
    change = np.diff(shift, append=shift[-1])
    unit = float(max(np.abs(shift).max(), np.abs(change).max(), 1e-9)) / _FULL
    lower = np.rint(shift / unit).astype(np.int32)
    upper = np.diff(lower, append=lower[-1]).clip(-_FULL, _FULL)
    return np.append((upper << 16) | (lower & 0xFFFF), 0).astype(np.int32), unit


def display_shift(sequence: Sequence, axis: AxisPlan, footprint: float, blur: float, *, stairs: bool) -> F64:
    """(shift, the border's part of it, share of the light lost beyond the border), pattern px, (3, K).

    Tabled at decoded coordinates -BEYOND, -BEYOND + 1 / PER_CELL, ... footprint: width of a camera pixel,
    blur: rms, both in cells; stairs: those of the cells are part of the shift.
    """
    total = np.zeros((3, (axis.extent + 2 * BEYOND) * PER_CELL))
    information = np.zeros(total.shape[1])
    # the same combination of periods as in unwrap_kernels: what a much finer one replaces does not matter
    periods = [fringe.period for fringe in axis.fringes]
    start = max((g for g in range(1, len(periods)) if periods[g] * MUCH_FINER < periods[g - 1]), default=0)
    for fringe in axis.fringes[start:]:
        part, contrast = _fringe_shift(sequence, fringe, axis, footprint, blur, stairs)
        own = len(fringe.index) * (contrast / fringe.period) ** 2
        information += own
        total += own / information * (part - total)
    return total


def _fringe_shift(
    sequence: Sequence, fringe: Fringe, axis: AxisPlan, footprint: float, blur: float, stairs: bool
) -> tuple[F64, F64]:
    """display_shift for one period, (3, K), and the contrast that it has there (K,)."""
    pad = BEYOND + int(np.ceil(footprint / 2 + 4 * blur)) + 1
    light = _cell_light(footprint, blur)
    dark = _seen(np.pad(_fundamental(sequence, fringe, axis), pad), light).ravel()
    cosine = 127.5 * np.exp(2j * np.pi * np.arange(-pad, axis.extent + pad) / fringe.period)
    at = -pad - 0.5 + (np.arange(len(dark)) + 0.5) / PER_CELL
    turn = fringe.period / (2 * np.pi)
    # the endless cosine is seen with the same change of amplitude and phase in all cells
    change = _seen(cosine[: 2 * pad + 1], light)[pad] / cosine[pad]
    truth = np.exp(2j * np.pi * at / fringe.period) if stairs else np.outer(cosine, change).ravel()
    shift = turn * np.angle(dark * truth.conj())
    border = np.zeros(len(dark))
    missing = _beyond(cosine, pad, light)
    near = missing != 0
    border[near] = turn * np.angle(dark[near] * (dark[near] + missing[near]).conj())
    left = (np.abs(dark).reshape(-1, PER_CELL) / (127.5 * np.abs(change))).ravel()
    lit = left > _LEAST_LIGHT
    wanted = np.arange(-BEYOND * PER_CELL, (axis.extent + BEYOND) * PER_CELL) / PER_CELL
    at, *parts = (_denser(part[lit]) for part in (at, shift, border, 1 - left))
    decoded = np.maximum.accumulate(at + parts[0])
    shift, border, lost = (np.interp(wanted, decoded, part) for part in parts)
    contrast = np.maximum(1 - lost, _LEAST_LIGHT) * np.abs(change).mean()
    return np.stack([_for_lines(shift), border, lost]), contrast


def _denser(values: F64) -> F64:
    """Four times as many samples (4 n - 3,), by cubics through the nearest four: straight lines between the
    samples of a cell would lower its stairs."""
    padded = np.concatenate([2 * values[:1] - values[1:2], values, 2 * values[-1:] - values[-2:-1]])
    t = np.arange(4)[:, None] / 4
    first, last = -t * (t - 1) * (t - 2) / 6, t * (t**2 - 1) / 6
    middle, next_one = (t**2 - 1) * (t - 2) / 2, -t * (t + 1) * (t - 2) / 2
    quads = sliding_window_view(padded, 4).T
    dense = first * quads[0] + middle * quads[1] + next_one * quads[2] + last * quads[3]
    return np.append(dense.T.ravel(), values[-1])


def _for_lines(values: F64) -> F64:
    """Entries whose connecting lines are nearest to the curve through `values`, to its fourth derivative."""
    bend = np.diff(values, 2)
    return values - np.pad(bend, 1) / 12


def _beyond(cosine: Complex, pad: int, light: F64) -> Complex:
    """What the `pad` cells on either side would add, were the fringe endless."""
    added = np.zeros(len(cosine) * PER_CELL, np.complex128)
    reach = min(2 * pad, len(cosine))
    nothing = np.zeros(reach - pad)
    added[: reach * PER_CELL] += _seen(np.append(cosine[:pad], nothing), light).ravel()
    added[-reach * PER_CELL :] += _seen(np.append(nothing, cosine[-pad:]), light).ravel()
    return added


def _fundamental(sequence: Sequence, fringe: Fringe, axis: AxisPlan) -> Complex:
    """c + i s of the fringe through the shown levels of every cell (extent,)."""
    tables = np.stack([_table(sequence.frames[i], sequence, axis.axis) for i in fringe.index])
    design = np.stack([np.ones(len(tables)), np.cos(fringe.shifts), np.sin(fringe.shifts)], axis=1)
    solve = np.linalg.pinv(design)
    return np.asarray(np.einsum("n,nk->k", solve[1] + 1j * solve[2], tables))


def _table(frame: Frame, sequence: Sequence, axis: str) -> F64:
    return frame.tables(sequence.rows, sequence.cols)["uv".index(axis)].astype(np.float64)


def _cell_light(footprint: float, blur: float) -> F64:
    """Light of each 1/PER_CELL of a cell: footprint's box and Gaussian blur; the whole cell is in `_seen`."""
    reach = int(np.ceil((footprint / 2 + 4 * blur) * PER_CELL)) + 1
    place = np.arange(-reach, reach + 1) / PER_CELL
    step = 1 / PER_CELL
    width, spread = max(footprint, _LEAST * step), max(blur, _LEAST * step)

    def twice(at: F64) -> F64:
        """The Gaussian integrated twice."""
        density = np.exp(-0.5 * (at / spread) ** 2) / np.sqrt(2 * np.pi)
        return np.asarray(at * ndtr(at / spread) + spread * density)

    far, near = (width + step) / 2, (width - step) / 2
    weights = twice(place + far) - twice(place + near) - twice(place - near) + twice(place - far)
    return np.asarray(weights / weights.sum())


def _seen(cells: Complex, light: F64) -> Complex:
    """What is seen at the centres of the PER_CELL parts of every cell (K, PER_CELL); dark around them."""
    reach = len(light) // 2
    part, distance = np.arange(PER_CELL)[:, None], np.arange(-reach, reach + 1)
    offset = (part - distance) // PER_CELL
    first = int(offset.min())
    weights = np.zeros((int(offset.max()) - first + 1, PER_CELL))
    np.add.at(weights, (offset - first, part), light)
    padded = np.pad(cells, (-first, len(weights) - 1 + first))
    # einsum, as the threads of a matrix product take longer to wake up than this takes
    return np.asarray(np.einsum("im,mj->ij", sliding_window_view(padded, len(weights)), weights))
