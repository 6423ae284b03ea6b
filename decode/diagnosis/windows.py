"""Faults in a part of the image, by windows.

Bits against fringes of an axis, 15 x 15 pixels, in large images 30 x 30 by a sample: in a right capture the
fringe's place lies in the interval of the bits: over a window the mean of cos 2 pi (fringe - middle of the
interval), over sinc(width / period), is 1 (real and drawn captures: .69 at least), and no place lies outside
of its interval. A window below one half of whose places more than a tenth lie outside contradicts itself.
Intervals nearly as wide as a period contradict nothing.
Residuals of the fringes, 12 x 12 pixels: mean square over its median.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, I64

from ..codes.bits import BitTable, ends_row, read_row
from ..codes.fringe import FringeTable, fit_row
from ..correspondence import Flag
from ..noise import quantile
from ..pixels import AxisTable
from ..plan import AxisPlan, Plan

__all__ = ["EVERY", "around", "contradictions", "residual_windows", "spread"]

Mask = NDArray[np.bool_]
Numbers = tuple[NDArray[Any], F32 | None, np.float32]
#: Side of a tile, pixels, three of which are a window's, twice as large in images of more pixels than _ALL,
#: of which smaller ones take all; samples of a tile.
_TILE, _SAMPLES, _ALL = 5, 4, 1 << 16
#: Least mean phasor of a window, by one sample of a tile and by all; greatest share outside; slack of an
#: interval, periods; its widths, periods, up to which phasors and shares count.
_SUSPECT, _LEAST, _OUTSIDE, _SLACK, _NARROW, _WIDE = 0.75, 0.5, 0.1, 0.05, 0.7, 0.87
#: Phasor and shift (periods) of all pixels of a wrong shift, shift if the mirror moved.
_COHERENT, _SHIFT, _MOVED = 0.75, 0.06, 0.2
#: Share of the windows from which on an axis has no good pixel.
_MOST = 0.5
#: Pixels between the residuals along either axis; least median of their squares, amplitudes^2.
EVERY, _LITTLE = 4, 0.06**2
#: No pixel's samples count with these flags.
_UNLIT = Flag.DARK | Flag.LOW_CONTRAST | Flag.SATURATED | Flag.INVALID


class _View(NamedTuple):
    """Sample pixels (K,) of one axis: tile; middle and width of the bits' interval, px; fringe less
    middle, periods, and exp 2 pi i of it over sinc of the width."""

    tile: I64
    middle: F32
    width: F32
    off: F32
    phasor: NDArray[np.complex64]

    def outside(self, period: float) -> Mask:
        """Fringes beyond the interval of their bits, (K,)."""
        return np.asarray(np.abs(self.off) > 0.5 / period * self.width + _SLACK)


def spread(some: Mask, side: int, shape: tuple[int, ...]) -> Mask:
    """An image of this shape from one of its tiles."""
    return np.repeat(np.repeat(some, side, axis=0), side, axis=1)[: shape[0], : shape[1]]


def around(image: NDArray[Any]) -> F32:
    """Sums of 3 x 3 around each place of an image (h, w)."""
    own, anchor = np.asarray(image, np.float32), (-1, -1)
    return np.asarray(cv2.boxFilter(own, -1, (3, 3), None, anchor, False, cv2.BORDER_CONSTANT), np.float32)


def residual_windows(square: F32, good: Mask, limit: float) -> F32:
    """Mean square of the fringes' residuals over its median, around each of the pixels (h, w), every EVERY-th
    one of the image, of which half are beyond the limit where it is; square: amplitudes^2; 0 where less than
    half of a window is good."""
    usual = max(quantile(square[good], 0.5), _LITTLE) if good.any() else 1.0
    ratio, number = np.minimum(square / np.float32(usual), np.float32(2 * limit)), around(good)
    return np.where(number > 4.5, around(np.where(good, ratio, 0)) / np.maximum(number, 1), 0)


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
    side = _TILE if flags.size <= _ALL else 2 * _TILE
    shape, first = tuple(-(-size // side) for size in flags.shape), _places(flags, side, 1)
    for axis, (fringes, _, code, *_) in zip(p.axes, tables, strict=True):
        if axis.code is None or axis.looked_up or not axis.fringes or code.cell > _WIDE * fringes.period[0]:
            continue
        shares[axis.axis] = 0.0
        for count, least in ((1, _SUSPECT), (_SAMPLES, _LEAST)):
            view = _view(first if count == 1 else _places(flags, side, count), light, noise, fringes, code)
            bad, known = _windows(view, float(fringes.period[0]), shape, least)
            everywhere = _everywhere(axis, view, _MOVED if moved else _SHIFT)
            if not (everywhere or bad.any()):
                break
        else:
            share = float(bad.sum() / max(known.sum(), 1))
            everywhere = everywhere or share > _MOST
            shares[axis.axis] = 1.0 if everywhere else share
            wrong |= True if everywhere else spread(around(bad) > 0, side, flags.shape)
    return wrong, shares


def _places(flags: NDArray[np.uint16], side: int, count: int) -> tuple[I64, I64]:
    """Tile and place (K,) of the lit samples: some of every tile, at irregular places, or all pixels."""
    height, width = flags.shape
    if flags.size <= _ALL:
        row, col = np.divmod(np.arange(flags.size), width)
    else:
        rows, cols = height // side, width // side
        rng = np.random.default_rng(0)
        down, along = (rng.integers(0, side, (rows, one, count)) for one in (1, cols))
        row = np.broadcast_to(side * np.arange(rows)[:, None, None] + down, along.shape).ravel()  # few lines
        col = (side * np.arange(cols)[:, None] + along).ravel()
    tile, place = row // side * -(-width // side) + col // side, row * width + col
    lit = flags.ravel()[place] & _UNLIT == 0
    return tile[lit], place[lit]


def _view(
    places: tuple[I64, I64],
    light: Numbers,
    noise: tuple[np.float32, np.float32],
    fringe: FringeTable,
    code: BitTable,
) -> _View:
    """Samples (tile, place) that are no doubt by themselves."""
    (tile, place), raw = places, light[0].reshape(len(light[0]), -1)
    used = {*fringe.frames[0], *code.plain, *code.inverse, *code.ends}
    few = np.zeros((len(raw), 1, len(place)), raw.dtype)
    for i in used - {-1}:
        np.take(raw[i], place, out=few[i, 0], mode="clip")  # the others buffer
    lines, words, doubt = np.zeros((15, len(place)), np.float32), *np.zeros((2, 2, len(place)), np.int32)
    offset, amplitude, phase, variance, middle, reach, error, chi2, low, high = lines[5:]
    fit = lines[:4], np.zeros_like(few[0, 0]), offset, amplitude, phase, variance
    fit_row(few, *light[1:], noise, fringe, (0, 0), np.zeros((1, 4, 0), np.float32), *fit, chi2, doubt[0])
    if code.fringe:
        low[:], high[:] = offset - amplitude, offset + amplitude
    else:
        ends_row(few, light[1], code.ends, 0, low, high)
    read_row(few, light[1], noise, code, 0, low, high, lines[:3], words, middle, reach, error, doubt[0])
    period = fringe.period[0]
    kept = (doubt[0] == 0) & (2 * reach < _WIDE * period)
    middle, width = middle[kept], 2 * reach[kept]
    off = phase[kept] - middle / period
    off -= np.rint(off)
    turn = np.float32(2 * np.pi) * off
    z = (np.cos(turn) + 1j * np.sin(turn)) / np.sinc(np.minimum(width / period, _NARROW))
    return _View(tile[kept], middle, width, off, z.astype(np.complex64))


def _windows(view: _View, period: float, shape: tuple[int, ...], least: float) -> tuple[Mask, Mask]:
    """Tiles amid a window that contradicts itself; those amid enough pixels."""
    outside, narrow, count = view.outside(period), view.width <= _NARROW * period, int(np.prod(shape))

    def sums(weights: NDArray[Any] | None) -> F32:
        return around(np.bincount(view.tile, weights, count).reshape(shape))

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
    low, high = (quantile(view.middle, share) for share in (0.1, 0.9))
    if low < -period or high > axis.extent + period:
        return True
    # pixels that see few places of a cell have another mean than its middle, and lie inside
    turned = abs(float(np.angle(mean))) / (2 * np.pi) > shift
    return bool(turned and view.outside(period)[narrow].mean() > 0.5 * _OUTSIDE)
