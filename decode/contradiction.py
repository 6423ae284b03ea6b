"""Do bits and fringes of an axis say the same? In windows of 15 x 15 pixels, by a sample of them.

In a right capture the fringe's place lies in the interval of the bits: over a window the mean of
cos 2 pi (fringe - middle of the interval), over sinc(width / period), is 1 (real and drawn captures: .69 at
least), and no place lies outside of its interval. A window below one half of whose places more than a tenth
lie outside contradicts itself: none of its pixels is good. Intervals nearly as wide as a period contradict
nothing. The cause is the shift of the fringes, the size of the cells or the bit by which the windows agree.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from optolever.kernels import F32, F64, I64
from optolever.notices import Notice

from .causes import off_the_end
from .codes.bits import BitTable, ends_of, read_rows
from .codes.fringe import Fit, FringeTable, fringe_rows
from .pixels import Tables
from .plan import AxisPlan, Plan
from .records import Flag

__all__ = ["contradictions"]

Mask = NDArray[np.bool_]
Numbers = tuple[NDArray[Any], F32 | None, np.float32]
#: Side of a tile, pixels, three of which are a window's; samples of one; pixels up to which all are samples.
_TILE, _SAMPLES, _ALL = 5, 4, 1 << 16
#: Least mean phasor, and greatest share outside, of a window; slack of an interval, periods; its widths,
#: periods, up to which phasors and shares count.
_LEAST, _OUTSIDE, _SLACK, _NARROW, _WIDE = 0.5, 0.1, 0.05, 0.7, 0.87
#: Phasor and shift (periods) of all pixels of a wrong shift, shift if the mirror moved; share of wrong pixels
#: that a bit explains.
_COHERENT, _SHIFT, _MOVED, _EXPLAINED = 0.75, 0.06, 0.2, 0.8
#: Sizes of cells that are tried, of the one described.
_SIZES = (0.5, 2 / 3, 0.75, 0.8, 1.25, 4 / 3, 1.5, 2.0)
#: Share of the windows from which on an axis has no good pixel.
_MOST = 0.5
#: No pixel's samples count with these flags.
_UNLIT = Flag.DARK | Flag.LOW_CONTRAST | Flag.SATURATED | Flag.INVALID


class _View(NamedTuple):
    """Sample pixels (K,) of one axis: tile; phase, periods; middle and width of the bits' interval, px."""

    tile: I64
    phase: F64
    middle: F64
    width: F64


def contradictions(
    flags: NDArray[np.uint16],
    light: Numbers,
    noise: tuple[np.float32, np.float32],
    p: Plan,
    tables: Tables,
    moved: bool,
) -> tuple[Mask, tuple[Notice, ...]]:
    """Pixels (H, W) where bits and fringes contradict each other, and the causes; moved: a mirror that moves
    shifts bits and fringes."""
    wrong, notices = np.zeros(flags.shape, np.bool_), []
    for axis, fringes, code in zip(p.axes, tables.fringes, tables.bits, strict=True):
        if code is None or axis.looked_up or not fringes or code.cell > _WIDE * fringes[0].period:
            continue
        shape = -(-flags.shape[0] // _TILE), -(-flags.shape[1] // _TILE)
        row, col = _places(flags.shape)
        lit = flags[row, col] & _UNLIT == 0
        row, col = row[lit], col[lit]
        few: Numbers = (np.ascontiguousarray(light[0][:, row, col][:, None]), *light[1:])
        view, kept = _view(few, noise, fringes[0], code, row // _TILE * shape[1] + col // _TILE)
        bad, known = _windows(view, float(fringes[0].period), shape)
        share = float(bad.sum() / max(known.sum(), 1))
        cause, everywhere = _cause(axis, code, view, few[0][:, 0, kept], bad, _MOVED if moved else _SHIFT)
        if not cause:
            continue
        everywhere |= share > _MOST
        bad = np.ones_like(bad) if everywhere else maximum_filter(bad, 3)
        tiles = np.repeat(np.repeat(bad, _TILE, axis=0), _TILE, axis=1)
        wrong |= tiles[: flags.shape[0], : flags.shape[1]]
        cure = "not good there: check the frames and their description"
        notices.append(Notice(cause, 1.0 if everywhere else share, 0.0, cure))
    return wrong, tuple(notices)


def _places(shape: tuple[int, ...]) -> tuple[I64, I64]:
    """Rows and columns of the samples: some of every tile, at irregular places, or all pixels."""
    if shape[0] * shape[1] <= _ALL:
        row, col = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
        return row, col
    rows, cols = shape[0] // _TILE, shape[1] // _TILE
    inside = np.random.default_rng(0).integers(0, _TILE, (2, rows, cols, _SAMPLES))
    first = _TILE * np.indices((rows, cols))[..., None]
    row, col = (first + inside).reshape(2, -1)
    return row, col


def _view(
    few: Numbers, noise: tuple[np.float32, np.float32], fringe: FringeTable, code: BitTable, tile: I64
) -> tuple[_View, Mask]:
    """Samples that are no doubt by themselves, and which these are."""
    shape = 1, len(tile)
    offset, amplitude, phase, own, place, error, chi2 = np.zeros((7, *shape), np.float32)
    flags = np.zeros(shape, np.int32)
    fringe_rows(few, noise, fringe, 0, Fit(offset, amplitude, phase, own), chi2, flags)
    known = offset - amplitude, offset + amplitude
    ends = known if code.fringe else ends_of(few[0], few[1], code, 0, 1)
    reach = read_rows(few[0], few[1], noise, code, 0, ends, place, error, flags)
    kept = (flags[0] == 0) & (2 * reach[0] < _WIDE * fringe.period)
    one, two, three = (each[0, kept].astype(np.float64) for each in (phase, place, 2 * reach))
    return _View(tile[kept], one, two, three), kept


def _phasors(view: _View, period: float, middle: F64 | None = None, width: F64 | None = None) -> NDArray[Any]:
    """exp 2 pi i (fringe - middle) over sinc of the width, (K,)."""
    middle, width = view.middle if middle is None else middle, view.width if width is None else width
    mean = np.sinc(np.minimum(width / period, _NARROW))
    return np.asarray(np.exp(2j * np.pi * (view.phase - middle / period)) / mean)


def _outside(view: _View, period: float) -> Mask:
    """Fringes beyond the interval of their bits, (K,)."""
    away = np.abs(np.angle(_phasors(view, period))) / (2 * np.pi) * period
    return np.asarray(away > 0.5 * view.width + _SLACK * period)


def _windows(view: _View, period: float, shape: tuple[int, ...]) -> tuple[Mask, Mask]:
    """Tiles amid a window that contradicts itself; those amid enough pixels."""
    z, count = _phasors(view, period), int(np.prod(shape))
    outside = _outside(view, period)
    narrow = view.width <= _NARROW * period

    def sums(weights: NDArray[Any]) -> F64:
        whole = np.bincount(view.tile, weights, count).reshape(shape)
        return np.asarray(9 * uniform_filter(whole, 3, mode="constant"))

    number, narrower = sums(np.ones(len(z))), sums(narrow * 1.0)
    known = number >= max(0.25 * float(number.max(initial=0.0)), 8)
    low = (sums(np.where(narrow, z.real, 0.0)) < _LEAST * narrower) | (narrower < 0.25 * number)
    return known & low & (sums(outside * 1.0) > _OUTSIDE * number), known


def _cause(
    axis: AxisPlan, code: BitTable, view: _View, levels: NDArray[Any], bad: Mask, shift: float
) -> tuple[str, bool]:
    """Name of the cause, and whether it is one of the whole picture; "": nothing is wrong."""
    period, name = axis.fringes[0].period, axis.axis
    narrow = view.width <= _NARROW * period
    z = _phasors(view, period)[narrow]
    mean = z.mean() if len(z) else 0j
    turn = float(np.angle(mean)) / (2 * np.pi)
    low, high = np.quantile(view.middle, (0.1, 0.9)) if len(z) else (0.0, 0.0)
    if abs(mean) > _COHERENT and (low < -period or high > axis.extent + period):
        return off_the_end(name, axis.extent, view.middle), True
    # pixels that see few places of a cell have another mean than its middle, and lie inside
    outside = float(_outside(view, period)[narrow].mean()) if len(z) else 0.0
    if abs(mean) > _COHERENT and abs(turn) > shift and outside > 0.5 * _OUTSIDE:
        return f"fringes of {name} are {turn:+.2f} periods ({turn * period:+.3g} px) off its bits", True
    if not bad.any():
        return "", False
    first = code.origin - 0.5
    for by in _SIZES:
        middle, width = first + by * (view.middle - first), by * view.width
        if (
            np.median(width) <= _NARROW * period
            and _phasors(view, period, middle, width).real.mean() > _COHERENT
        ):
            return f"cells of {name} are {by * code.cell:.3g} px, not {code.cell:.3g} px", True
    inside = bad.ravel()[view.tile] & (view.width < 1.01 * code.cell) & (_phasors(view, period).real < 0)
    some = _View(view.tile[inside], view.phase[inside], view.middle[inside], view.width[inside])
    return _wrong_bit(axis, code, some, levels, bad.shape), False


def _wrong_bit(
    axis: AxisPlan, code: BitTable, view: _View, levels: NDArray[Any], shape: tuple[int, ...]
) -> str:
    """The bit whose other value brings contradicting pixels together: one whose frame is black or white in
    all levels (N, K), or that makes the smoothest map of tiles."""
    period, name = axis.fringes[0].period, axis.axis
    text = f"bits and fringes of {name} contradict each other"
    cell = np.rint((view.middle - code.origin - 0.5 * (code.cell - 1)) / code.cell).astype(np.int64)
    word = np.argsort(code.cells)[np.clip(cell, 0, len(code.cells) - 1)]
    low, high = levels.min(axis=0), levels.max(axis=0)
    best, words, number = np.inf, "", np.bincount(view.tile, minlength=int(np.prod(shape))).reshape(shape)
    for b, (plain, inverse) in enumerate(zip(code.plain.tolist(), code.inverse.tolist(), strict=True)):
        middle = code.cells[word ^ (1 << b)] * float(code.cell) + 0.5 * (code.cell - 1) + code.origin
        if not len(cell) or np.mean(_phasors(view, period, middle).real > 0) < _EXPLAINED:
            continue
        mean = np.bincount(view.tile, middle, number.size).reshape(shape) / np.maximum(number, 1)
        steps = np.abs(np.diff(mean, axis=1))[(number[:, 1:] > 0) & (number[:, :-1] > 0)]
        rough = float(steps.mean()) if len(steps) else 0.0
        i, bright = max(plain, inverse), float(np.mean(levels[max(plain, inverse)] > 0.5 * (low + high)))
        seen = "black" if bright < 0.02 else "white" if bright > 0.98 else "wrong"
        rough -= 1e6 if seen != "wrong" and np.median(middle) < axis.extent else 0.0
        best, words = (rough, f": bit {b} of {name} (frame {i}) is {seen}") if rough < best else (best, words)
    return text + words
