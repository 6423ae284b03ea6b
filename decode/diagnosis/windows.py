"""Faults in a part of the image, by windows.

Bits against fringes of an axis, 15 x 15 pixels, by a sample: in a right capture the fringe's place lies in
the interval of the bits: over a window the mean of cos 2 pi (fringe - middle of the interval), over
sinc(width / period), is 1 (real and drawn captures: .69 at least), and no place lies outside of its interval.
A window below one half of whose places more than a tenth lie outside contradicts itself. Intervals nearly as
wide as a period contradict nothing. Residuals of the fringes, 9 x 9 pixels: mean square over its median.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I64

from ..codes.bits import BitTable, ends_row, read_row
from ..codes.fringe import FringeTable, fit_row
from ..pixels import AxisTable
from ..plan import AxisPlan, Plan
from ..records import Flag

__all__ = ["EVERY", "contradictions", "residual_windows"]

Mask = NDArray[np.bool_]
Numbers = tuple[NDArray[Any], F32 | None, np.float32]
#: Side of a tile, pixels, three of which are a window's; samples of one; pixels up to which all are samples.
_TILE, _SAMPLES, _ALL = 5, 4, 1 << 16
#: Least mean phasor of a window, by one sample of a tile and by all; greatest share outside; slack of an
#: interval, periods; its widths, periods, up to which phasors and shares count; places for a quantile.
_SUSPECT, _LEAST, _OUTSIDE, _SLACK, _NARROW, _WIDE, _FEW = 0.75, 0.5, 0.1, 0.05, 0.7, 0.87, 10000
#: Phasor and shift (periods) of all pixels of a wrong shift, shift if the mirror moved.
_COHERENT, _SHIFT, _MOVED = 0.75, 0.06, 0.2
#: Share of the windows from which on an axis has no good pixel.
_MOST = 0.5
#: Pixels between the residuals along either axis; least median of their squares, amplitudes^2.
EVERY, _LITTLE = 3, 0.06**2
#: No pixel's samples count with these flags.
_UNLIT = Flag.DARK | Flag.LOW_CONTRAST | Flag.SATURATED | Flag.INVALID


class _View(NamedTuple):
    """Sample pixels (K,) of one axis: tile; phase, periods; middle and width of the bits' interval, px; what
    the fringe is off the middle, periods, and its phasor."""

    tile: I64
    phase: F32
    middle: F32
    width: F32
    off: F32
    phasor: NDArray[np.complex64]

    def outside(self, period: float) -> Mask:
        """Fringes beyond the interval of their bits, (K,)."""
        return np.asarray(np.abs(self.off) > 0.5 / period * self.width + _SLACK)


def residual_windows(square: F32, flags: NDArray[np.uint16]) -> F64:
    """Mean square of the fringes' residuals over its median, in windows of three by three pixels of every
    EVERY-th one, as an image (H, W); square (h, w): amplitudes^2; 0 where none of a window is good."""
    good = flags[::EVERY, ::EVERY] == 0
    number, total = (
        scipy.ndimage.uniform_filter(one, 3, mode="constant")
        for one in (good.astype(np.float64), np.where(good, square, 0.0).astype(np.float64))
    )
    usual = max(float(np.median(square[good])), _LITTLE) if good.any() else 1.0
    ratio = total / np.maximum(number, 1e-9) / usual
    return np.repeat(np.repeat(ratio, EVERY, axis=0), EVERY, axis=1)[: flags.shape[0], : flags.shape[1]]


def contradictions(
    flags: NDArray[np.uint16],
    light: Numbers,
    noise: tuple[np.float32, np.float32],
    p: Plan,
    tables: tuple[AxisTable, ...],
    moved: bool,
) -> tuple[Mask, dict[str, float]]:
    """Pixels (H, W) where bits and fringes contradict each other, and their share of each axis that has both;
    moved: a mirror that moves shifts bits and fringes."""
    wrong, shares = np.zeros(flags.shape, np.bool_), dict[str, float]()
    shape = -(-flags.shape[0] // _TILE), -(-flags.shape[1] // _TILE)
    for axis, (fringes, code, *_) in zip(p.axes, tables, strict=True):
        if axis.code is None or axis.looked_up or not axis.fringes or code.cell > _WIDE * fringes.period[0]:
            continue
        shares[axis.axis] = 0.0
        for count, least in ((1, _SUSPECT), (_SAMPLES, _LEAST)):
            view = _view(flags, light, noise, fringes, code, count)
            bad, known = _windows(view, float(fringes.period[0]), shape, least)
            everywhere = _everywhere(axis, view, _MOVED if moved else _SHIFT)
            if not (everywhere or bad.any()):
                break
        else:
            share = float(bad.sum() / max(known.sum(), 1))
            everywhere = everywhere or share > _MOST
            shares[axis.axis] = 1.0 if everywhere else share
            bad = np.ones_like(bad) if everywhere else scipy.ndimage.maximum_filter(bad, 3)
            tiles = np.repeat(np.repeat(bad, _TILE, axis=0), _TILE, axis=1)
            wrong |= tiles[: flags.shape[0], : flags.shape[1]]
    return wrong, shares


def _places(shape: tuple[int, ...], count: int) -> tuple[I64, I64]:
    """Rows and columns of the samples: some of every tile, at irregular places, or all pixels."""
    if shape[0] * shape[1] <= _ALL:
        row, col = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
        return row, col
    rows, cols = shape[0] // _TILE, shape[1] // _TILE
    down, along = (np.random.default_rng(0).integers(0, _TILE, (rows, one, count)) for one in (1, cols))
    row = np.broadcast_to(_TILE * np.arange(rows)[:, None, None] + down, along.shape)  # few lines of memory
    return row.ravel(), (_TILE * np.arange(cols)[:, None] + along).ravel()


def _view(
    flags: NDArray[np.uint16],
    light: Numbers,
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    code: BitTable,
    count: int,
) -> _View:
    """Samples that are no doubt by themselves, so many of a tile."""
    (row, col), width = _places(flags.shape, count), flags.shape[1]
    tile, place = row // _TILE * -(-width // _TILE) + col // _TILE, row * width + col
    lit = flags.ravel()[place] & _UNLIT == 0
    tile, place = tile[lit], place[lit]
    raw, used = (
        light[0].reshape(len(light[0]), -1),
        {*fringe.frames[0], *code.plain, *code.inverse, *code.ends},
    )
    few = np.zeros((len(raw), 1, len(place)), raw.dtype)
    for i in used - {-1}:
        np.take(raw[i], place, out=few[i, 0])
    lines, words, doubt = np.zeros((15, len(place)), np.float32), *np.zeros((2, 2, len(place)), np.int32)
    offset, amplitude, phase, variance, middle, reach, error, chi2, low, high = lines[5:]
    fit = lines[:4], np.zeros_like(few[0, 0]), offset, amplitude, phase, variance
    fit_row(few, *light[1:], noise, fringe, (0, 0), *fit, chi2, doubt[0])
    if code.fringe:
        low[:], high[:] = offset - amplitude, offset + amplitude
    else:
        ends_row(few, light[1], code.ends, 0, low, high)
    read_row(few, light[1], noise, code, 0, low, high, lines[:3], words, middle, reach, error, doubt[0])
    period = float(fringe.period[0])
    kept = (doubt[0] == 0) & (2 * reach < _WIDE * period)
    maps = phase[kept], middle[kept], 2 * reach[kept]
    return _View(tile[kept], *maps, *_phasors(*maps, period))


def _phasors(phase: F32, middle: F32, width: F32, period: float) -> tuple[F32, NDArray[np.complex64]]:
    """Fringe less middle, periods, and exp 2 pi i of it over sinc of the width, (K,)."""
    off = phase - middle / np.float32(period)
    off -= np.rint(off)
    turn, share = np.float32(2 * np.pi) * off, np.sinc(np.minimum(width / np.float32(period), _NARROW))
    z = np.empty(off.shape, np.complex64)
    z.real, z.imag = np.cos(turn) / share, np.sin(turn) / share
    return off, z


def _windows(view: _View, period: float, shape: tuple[int, ...], least: float) -> tuple[Mask, Mask]:
    """Tiles amid a window that contradicts itself; those amid enough pixels."""
    outside, narrow, count = view.outside(period), view.width <= _NARROW * period, int(np.prod(shape))

    def sums(weights: NDArray[Any] | None) -> F64:
        whole = np.bincount(view.tile, weights, count).reshape(shape).astype(np.float64)
        return np.asarray(9 * scipy.ndimage.uniform_filter(whole, 3, mode="constant"))

    number = sums(None)
    narrower = number if narrow.all() else sums(narrow)
    known = number >= max(0.25 * float(number.max(initial=0.0)), 8)
    if not outside.any():
        return np.zeros(shape, np.bool_), known
    low = (sums(np.where(narrow, view.phasor.real, 0.0)) < least * narrower) | (narrower < 0.25 * number)
    return known & low & (sums(outside) > _OUTSIDE * number), known


def _everywhere(axis: AxisPlan, view: _View, shift: float) -> bool:
    """Whether all pixels have a fault in common: places beyond the pattern, or shifted fringes."""
    period = axis.fringes[0].period
    narrow = view.width <= _NARROW * period
    mean = complex(view.phasor[narrow].mean()) if narrow.any() else 0j
    if abs(mean) <= _COHERENT:
        return False
    low, high = np.quantile(view.middle[:: 1 + len(view.middle) // _FEW], (0.1, 0.9))
    if low < -period or high > axis.extent + period:
        return True
    # pixels that see few places of a cell have another mean than its middle, and lie inside
    turned = abs(float(np.angle(mean))) / (2 * np.pi) > shift
    return bool(turned and view.outside(period)[narrow].mean() > 0.5 * _OUTSIDE)
