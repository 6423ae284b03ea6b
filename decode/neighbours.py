"""Pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel is refused that
its neighbours confirm.

A place is the mean over a pixel's area and the blur of the lens, weighted by light: their second moment m
times 1/2 laplace u + grad u . grad ln A is subtracted, and the uncertainty of the moment joins the variance.
A is the amplitude of the axis' coarsest fringe, which a nonlinear display makes ripple least. Three excesses
over noise join it, too: of the residuals around a pixel (chi2), of third differences over 7 x 7 pixels, and
of the residual to the quadratic of 5 x 5 (a crease has third differences at few pixels). Beside flagged
pixels the place is that of the lit part of the aperture, at the display's border that of its lit cells.

    neighbours(block, image, dof, limits, start, result)

    block    place, variance, amplitude (A, n, W); chi2, flags (n, W): rows of the result and HALO more on
             either side; image (2,): first of them that is a row of the image, and the one behind the last
    dof      degrees of freedom of chi2, 0: it says nothing
    limits   (A, 7) float32, rows of axis_limits()
    result   coordinate, sigma (A, H, W), flags (H, W) of the whole image, written from row `start` on

Axes without frames have no row in A. Flagged pixels may have any place and variance that is finite, and so
have rows beyond the image, which are flagged.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, HALF, ONE, ZERO, inlined, inner, kernel

from .correspondence import Flag
from .plan import AxisPlan

__all__ = [
    "BLURRED", "EITHER", "HALO", "SETTLE", "Beside", "Block", "Mask", "Result", "axis_limits",
    "neighbours", "settle",
]  # fmt: skip

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]
Span = tuple[int, int]
Beside = Callable[[tuple[NDArray[np.intp], ...], F32, F32], tuple[F32, F32, Mask]]
#: Rows that a block needs beside its result; more of them for settle(); flags of two orders by axis.
HALO, SETTLE, EITHER = 4, 2, (np.uint16(1 << 9), np.uint16(1 << 10))
#: Fewest sure pixels of 5 x 5 that choose an order, least share that agrees, to this share of a period.
_CHOOSE, _AGREE, _CHOSEN = 3, 0.9, np.float32(0.25)
#: Usual blur of a camera's lens, and of a soft one, px of the camera; of a display, cells.
_LENS, _SOFT, _BLUR = 0.2, 0.6, 0.6
#: Standard deviation of half the second moment of a lens that was not given, px^2.
BLURRED = 0.25 * _SOFT**2
#: Squared standard deviations beyond which neighbours contradict; thresholds of third differences and of the
#: residual to the quadratic, over noise; one over the share of noise in it.
_SURE2, _THIRD, _REST, _OFF2 = np.float32(25), np.float32(1.2), np.float32(1.6), np.float32(175 / 148)
#: Squared shares of a step between neighbours: beside flagged pixels, one further; least variance, px^2; the
#: display's border is flagged up to so many of its reaches.
_RIM2, _SECOND2, _LEAST, _REACH = np.float32(0.09), np.float32(0.0036), np.float32(1e-6), np.float32(2.0)
_OUTLIER, _OFF = np.uint16(Flag.OUTLIER), np.uint16(Flag.OFF_PATTERN)
#: Windows of a pixel: whether it is clean; clean ones in 5 x 5, whether all are; whether the third difference
#: from here along the row, down the column is of clean ones; numbers of them in 7 x 7, of full ones in 3 x 3.
_CLEAN, _NUMBER, _FULL, _ROW, _COL, _ALONG, _DOWN, _NEAR = range(8)


class Block(NamedTuple):
    """Output of the pixel kernel.

    place, variance  (A, n, W) float32, pattern px, px^2: by noise alone (bits: of the interval)
    amplitude  (A, n, W) float32, levels, of each axis' coarsest fringe
    chi2       (n, W) float32, squares of residuals over their noise, summed over all axes
    flags      (n, W) uint16, of both axes
    """

    place: F32
    variance: F32
    amplitude: F32
    chi2: F32
    flags: U16


class Result(NamedTuple):
    """Maps: coordinate, sigma (A, H, W) float32, pattern px; flags (H, W) uint16."""

    coordinate: F32
    sigma: F32
    flags: U16


def axis_limits(axis: AxisPlan, lens_px: float | None = None, on_cells: bool = True) -> F32:
    """Numbers (7,) of an axis, by which the kernel takes them:

    jump      second difference of neighbours that contradicts them, px: a quarter period, two cells
    extent    of the display, px; infinite: no border
    border    variance of the display's blur and a cell, px^2; 0: no border
    aperture  half the second moment of a camera pixel and its lens, px^2 of the camera; 0: places are cells
    unsure    half of its uncertainty
    fine      1: places within a cell, by fringes or a look-up
    rim       reach of the lens beside unlit pixels, px of the camera: half a pixel and three rms blurs
    """
    fine = axis.code is None or bool(axis.fringes)
    if axis.fringes:
        jump = 0.25 * axis.fringes[-1].period
    else:
        jump = 2 * axis.code.cell if axis.code is not None else 2.0
    lens = _LENS**2 if lens_px is None else lens_px**2
    unsure = 0.25 * (1 / 12 - 1 / 48) + (BLURRED if lens_px is None else 0.0)
    aperture, unsure = (0.5 * (1 / 12 + lens), unsure) if fine else (0.0, 0.0)
    bordered = on_cells and fine
    border = 1 / 12 + _BLUR**2 if bordered else 0.0
    extent = float(axis.extent) if bordered else np.inf
    rim = 0.5 + 3 * (_SOFT if lens_px is None else lens_px) if fine else 0.0
    return np.array([jump, extent, border, aperture, unsure, fine, rim], np.float32)


def settle(block: Block, periods: F32, look_ups: Sequence[Beside | None]) -> Block:
    """A block for neighbours() of one with SETTLE rows more on either side: where two orders of a period
    (A,), or two places of a look-up, fit, the one next to the median of the sure pixels of 5 x 5.

    look_ups: (rows and columns, their places, other ones) -> places next to these, variances, whether they
    fit; None: orders."""
    place, flags, sure = block.place.copy(), block.flags.copy(), block.flags == 0
    variance = block.variance.copy()
    down, along = (one.ravel() for one in np.mgrid[-2:3, -2:3])
    for a, (period, look_up) in enumerate(zip(periods, look_ups, strict=True)):
        at = np.nonzero(block.flags & EITHER[a])
        y, x = at[0][:, None] + down, at[1][:, None] + along
        known = (y >= 0) & (y < len(flags)) & (x >= 0) & (x < flags.shape[1])
        y, x = np.clip(y, 0, len(flags) - 1), np.clip(x, 0, flags.shape[1] - 1)
        known &= sure[y, x]
        number = np.count_nonzero(known, axis=1)
        values = np.sort(np.where(known, block.place[a][y, x], np.float32(1e9)), axis=1)
        middle = np.take_along_axis(values, np.maximum(number - 1, 0)[:, None] // 2, axis=1)[:, 0]
        own, spread, found = place[a][at], variance[a][at], number >= _CHOOSE
        if look_up is None:
            step = np.rint((middle - own) / period)
            chosen, fits = own + step * period, np.abs(step) <= 1
        else:
            chosen, spread, fits = look_up(at, own, middle)
        found &= fits
        near = known & (np.abs(block.place[a][y, x] - chosen[:, None]) < _CHOSEN * period)
        found &= np.count_nonzero(near, axis=1) >= _AGREE * number
        place[a][at], variance[a][at] = np.where(found, (chosen, spread), (own, variance[a][at]))
        flags[at] = (flags[at] & ~EITHER[a]) | np.where(found, np.uint16(0), np.uint16(Flag.ORDER_DOUBTFUL))
    rings = [np.ascontiguousarray(one[:, SETTLE:-SETTLE]) for one in (place, variance, block.amplitude)]
    return Block(rings[0], rings[1], rings[2], block.chi2[SETTLE:-SETTLE], flags[SETTLE:-SETTLE])


def neighbours(block: Block, image: Span, dof: int, limits: F32, start: int, result: Result) -> None:
    """See the head of the file."""
    (axes, n, width), sure = block.place.shape, np.zeros(block.flags.shape[1], np.bool_)
    found = block.flags.copy()
    _confirmed(block, limits, image, found, sure)
    windows = _windows(found == 0) if found[image[0] : image[1]].any() else _whole(n, width, *image)
    result.flags[start : start + n - 2 * HALO] = found[HALO : n - HALO]
    work = np.zeros((10, width + 6), np.float32)
    rings = np.zeros((4 * axes + 1, 8, width + 6), np.float32)
    _excess(block, windows, limits, np.float32(dof), image, start, result, rings, work, sure)


@inlined
def least(amplitude: F32, y: int, x: int) -> np.float32:
    """Smallest of all axes."""
    found: np.float32 = min(amplitude[0, y, x], amplitude[len(amplitude) - 1, y, x])
    return found


@inlined
def falling(place: F32, light: F32, y: int, x: int) -> np.float32:
    """2 grad u . grad ln A by central differences."""
    left, right, above, below = light[y, x - 1], light[y, x + 1], light[y - 1, x], light[y + 1, x]
    wide, high = max(right + left, _LEAST), max(below + above, _LEAST)
    along = (place[y, x + 1] - place[y, x - 1]) * (right - left) * high
    down = (place[y + 1, x] - place[y - 1, x]) * (below - above) * wide
    return np.float32((along + down) / (wide * high))


@inlined
def _is_near(place: F32, variance: F32, flags: U16, y: int, x: int, jump: np.float32) -> bool:
    """Whether a place lies amid two neighbours, or on the plane of three."""
    n, width = place.shape
    none, half = np.uint16(0), np.float32(0.5)
    known, p, v = False, place[y, x], variance[y, x]
    for d in range(8):
        i, j = (min(d, 1), 1 - d if d < 2 else 5 - 2 * d) if d < 4 else ((d & 1) * 2 - 1, (d & 2) - 1)
        if min(y + i, x + j) < 0 or y + i >= n or x + j >= width:
            continue
        if d < 4 and (min(y - i, x - j) < 0 or y - i >= n or x - j >= width):
            continue
        if flags[y + i, x + j] != none:
            continue
        off, v2 = place[y + i, x + j] - p, variance[y + i, x + j]
        if d < 4:
            if flags[y - i, x - j] != none:
                continue
            off = half * (off + place[y - i, x - j] - p)
            v2 = np.float32(0.25) * (v2 + variance[y - i, x - j])
        else:
            if flags[y + i, x] != none or flags[y, x + j] != none:
                continue
            off = place[y + i, x] - p + (place[y, x + j] - p) - off
            v2 += variance[y + i, x] + variance[y, x + j]
        beyond = abs(off) - jump
        known |= beyond < ZERO or beyond * beyond < _SURE2 * (v + v2)
    return known


@kernel
def _confirmed(block: Block, limits: F32, image: Span, found: U16, sure: Mask) -> None:
    """OUTLIER where neighbours contradict or half is unlit, into found, the flags; sure (W,)."""
    place, variance, amplitude, _, flags = block
    (axes, _, width), (top, end), half, two = place.shape, image, np.float32(0.5), np.float32(2)
    none = np.uint16(0)
    for y in range(top, end):
        up, down = max(y - 1, top), min(y + 1, end - 1)
        for a in range(axes):
            jump = limits[a, 0]
            for x in range(width - 2):  # both neighbours of the row confirm nearly all
                off = abs(place[a, y, x] + place[a, y, x + 2] - two * place[a, y, x + 1])
                beside = flags[y, x] | flags[y, x + 2] | flags[up, x + 1] | flags[down, x + 1]
                sure[x + 1] = (off < two * jump) & (beside == none)
            some = False
            for x in range(1, width - 1):
                some |= not sure[x]
            for number in range(width if some else 2):
                x = number if some else number * (width - 1)
                if sure[x] or flags[y, x] != none:
                    continue
                brightest, rim = ZERO, False
                for d in range(4):
                    i, j = (up if d == 0 else down if d == 1 else y), x + (d == 3) - (d == 2)
                    if 0 <= j < width:
                        rim |= flags[i, j] != none
                        other = least(amplitude, i, j) if flags[i, j] == none else ZERO
                        brightest = max(brightest, other)
                if rim and least(amplitude, y, x) < half * brightest:
                    found[y, x] |= _OUTLIER
                if not _is_near(place[a], variance[a], flags, y, x, jump):
                    found[y, x] |= _OUTLIER


@lru_cache(maxsize=8)
def _whole(rows: int, width: int, top: int, end: int) -> U8:
    clean = np.zeros((rows, width), np.bool_)
    clean[top:end] = True
    return _windows(clean)


def _windows(clean: Mask) -> U8:
    """(8, n, W), see _CLEAN, of clean pixels (n, W)."""
    out = np.empty((8, *clean.shape), np.uint8)

    def sums(of: int, rows: Span, cols: Span) -> U8:
        """Over pixels from rows[0] to rows[1] further down and cols[0] to cols[1] further along, 0 beyond."""
        size, anchor = (cols[1] - cols[0] + 1, rows[1] - rows[0] + 1), (-cols[0], -rows[0])
        found: U8 = cv2.boxFilter(out[of], cv2.CV_8U, size, None, anchor, False, cv2.BORDER_CONSTANT)
        return found

    out[_CLEAN] = clean
    out[_NUMBER] = sums(_CLEAN, (-2, 2), (-2, 2))
    out[_FULL] = out[_NUMBER] == 25
    out[_ROW], out[_COL] = sums(_CLEAN, (0, 0), (0, 3)) == 4, sums(_CLEAN, (0, 3), (0, 0)) == 4
    out[_ALONG], out[_DOWN] = sums(_ROW, (-3, 3), (-3, 0)), sums(_COL, (-3, 0), (-3, 3))
    out[_NEAR] = sums(_FULL, (-1, 1), (-1, 1))
    return out


@kernel
def _excess(
    block: Block,
    windows: U8,
    limits: F32,
    dof: np.float32,
    image: Span,
    start: int,
    result: Result,
    rings: F32,
    work: F32,
    slow: Mask,
) -> None:
    """Places without their aperture, sigma with its excesses over noise.

    Row k joins the sums of its neighbourhoods, those of row k - 3 are then whole. Sums of rows lie in rings
    (4 A + 1, 8, W + 6) of 8; lines of one row, work (10, W + 6), have 0 beside it, the last one only these;
    slow (W,)."""
    (axes, n, _), (place, variance, amplitude, chi2, _) = block.place.shape, block
    full, clean, (coordinate, sigma, _) = windows[_FULL], windows[_CLEAN], result
    residual, across, fall, inner, flat, off = rings[0], work[0], work[1], work[2], work[3], work[4]
    column, inflation, third, bracket, none = work[5], work[6], work[7], work[8], work[9]
    for k in range(1, n - 1):
        y, r, to = k - 3, k - 3 - HALO, start + k - 3 - HALO
        _residuals(chi2[k], windows[_CLEAN, k], dof, residual[k & 7])
        if r >= 0:
            _inflation(residual, y, chi2[y], windows[_NUMBER, y], dof, column, inflation)
        for a in range(axes):
            p, v, own = place[a], variance[a], limits[a]
            if own[5] == ZERO:  # places are cells
                if r >= 0:
                    _result(p[y], v[y], inflation, none, none, own, (coordinate[a, to], sigma[a, to]))
                continue
            own_rings = rings[4 * a + 1 :]
            rows, cols, rest, bend = own_rings[0], own_rings[1], own_rings[2], own_rings[3]
            _along(p[k], v[k], windows[_ROW, k], across, rows[k & 7])
            if k >= 3:
                _down(p, v[k - 2], k - 3, windows[_COL, k - 3], fall, cols[(k - 3) & 7])
            if k >= 4:
                j = k - 2
                _quadratic(p, j, full[j], inner, flat, off, bend[j & 7], rest[j & 7])
            if r >= 0:
                _thirds(rows, cols, y, windows[_ALONG, y], windows[_DOWN, y], third)
                _bracket(p, amplitude[a], y, windows[_FULL, y], bend[y & 7], bracket)
                _creased(rest, y, v[y], inflation, windows[_NEAR, y], third)
                _result(p[y], v[y], inflation, third, bracket, own, (coordinate[a, to], sigma[a, to]))
                _open(bend[y & 7], full[y], clean[y], own, slow)
                if own[2] > ZERO:
                    _bordered(p, y, clean[y], own, slow)
                _judge(block, windows, own, image, (a, y, to), slow, result)


@inner
def _residuals(chi2: F32, clean: U8, dof: np.float32, out: F32) -> None:
    """chi2 per degree of freedom, capped."""
    share, most = ONE / max(dof, ONE), np.float32(25)
    for x in range(chi2.size):
        one = share * chi2[x]
        out[x + 2] = (one if one < most else most) * np.float32(clean[x])


@inner
def _inflation(
    ring: F32, y: int, chi2: F32, number: U8, dof: np.float32, column: F32, inflation: F32
) -> None:
    """Factor of the variance: mean of 5 x 5 residuals, or a pixel's own, where beyond four deviations."""
    share = ONE / max(dof, ONE)
    mean = ONE + np.float32(1.1314) * np.sqrt(share)
    alone = ONE + np.float32(7.0711) * np.sqrt(share) + np.float32(8) * share
    for x in range(chi2.size + 4):
        three = ring[(y - 2) & 7, x] + ring[(y - 1) & 7, x] + ring[y & 7, x]
        column[x] = three + ring[(y + 1) & 7, x] + ring[(y + 2) & 7, x]
    for x in range(chi2.size):
        level = column[x] + column[x + 1] + column[x + 2] + column[x + 3] + column[x + 4]
        level, one = level / max(np.float32(number[x]), ONE), share * chi2[x]
        level = level if level > mean else ONE
        one = one if one > alone else ONE
        inflation[x] = level if level > one else one


@inner
def _along(place: F32, variance: F32, whole: U8, square: F32, out: F32) -> None:
    """Squares of third differences along a row, capped; sums of four."""
    three, cap = np.float32(3), np.float32(500)
    for x in range(place.size - 3):
        h = place[x + 3] - place[x] + three * (place[x + 1] - place[x + 2])
        h, c = h * h, cap * variance[x + 1]
        square[x + 3] = (h if h < c else c) * np.float32(whole[x])
    for x in range(place.size):
        out[x] = square[x] + square[x + 1] + square[x + 2] + square[x + 3]


@inner
def _down(place: F32, variance: F32, j: int, whole: U8, square: F32, out: F32) -> None:
    """Squares of third differences down the columns from row j, capped; sums of seven along the row."""
    three, cap = np.float32(3), np.float32(500)
    for x in range(variance.size):
        h = place[j + 3, x] - place[j, x] + three * (place[j + 1, x] - place[j + 2, x])
        h, c = h * h, cap * variance[x]
        square[x + 3] = (h if h < c else c) * np.float32(whole[x])
    for x in range(variance.size):
        four = square[x] + square[x + 1] + square[x + 2] + square[x + 3]
        out[x] = four + square[x + 4] + square[x + 5] + square[x + 6]


@inner
def _quadratic(place: F32, j: int, full: U8, inner: F32, flat: F32, off: F32, bend: F32, out: F32) -> None:
    """Laplacian of the quadratic through 5 x 5 around row j; squares of the residual to it, sums of three.
    inner, flat: sums of the columns' inner and of all their pixels."""
    three, four, five, ten = np.float32(3), np.float32(4), np.float32(5), np.float32(10)
    for x in range(full.size):
        q = place[j, x]
        near = place[j - 1, x] - q + (place[j + 1, x] - q)
        inner[x] = near
        flat[x] = near + (place[j - 2, x] - q + (place[j + 2, x] - q))
    for x in range(full.size - 4):
        q, whole = place[j, x + 2], np.float32(full[x + 2])
        outer = place[j, x] - q + (place[j, x + 4] - q)
        near = place[j, x + 1] - q + (place[j, x + 3] - q)
        ends, sides = flat[x] + flat[x + 4], flat[x + 1] + flat[x + 3]
        bent = inner[x] + inner[x + 1] + inner[x + 2] + inner[x + 3] + inner[x + 4]
        bent = (four * ends + sides + ten * outer - five * near - three * bent) * np.float32(1 / 35) * whole
        away = (five * (outer + near) + ends + sides + flat[x + 2]) * np.float32(0.04) * whole - bent
        bend[x + 2], off[x + 3] = bent, away * away
    for x in range(full.size):
        out[x] = off[x] + off[x + 1] + off[x + 2]


@inner
def _thirds(rows: F32, cols: F32, y: int, along: U8, down: U8, out: F32) -> None:
    """Larger mean of both third differences over 7 x 7 pixels."""
    three = np.float32(3)
    for x in range(out.size - 6):
        total = rows[(y - 3) & 7, x] + rows[(y - 2) & 7, x] + rows[(y - 1) & 7, x] + rows[y & 7, x]
        out[x] = total + rows[(y + 1) & 7, x] + rows[(y + 2) & 7, x] + rows[(y + 3) & 7, x]
    for x in range(out.size - 6):
        total = cols[(y - 3) & 7, x] + cols[(y - 2) & 7, x] + cols[(y - 1) & 7, x] + cols[y & 7, x]
        one, two = max(np.float32(along[x]), ONE), max(np.float32(down[x]), ONE)
        first, second = out[x] if one > three else ZERO, total if two > three else ZERO
        more = first * two > second * one
        out[x] = (first if more else second) / (one if more else two)


@inner
def _bracket(place: F32, light: F32, y: int, full: U8, bend: F32, out: F32) -> None:
    """laplace u + 2 grad u . grad ln A: a place's shift over half the second moment."""
    for x in range(1, full.size - 1):
        out[x] = bend[x] + np.float32(full[x]) * falling(place, light, y, x)


@inner
def _creased(rest: F32, y: int, variance: F32, inflation: F32, near: U8, third: F32) -> None:
    """Excess of the third differences, and of the residuals to the quadratics of 3 x 3 pixels."""
    for x in range(variance.size):
        total = rest[(y - 1) & 7, x] + rest[y & 7, x] + rest[(y + 1) & 7, x]
        level = variance[x] * inflation[x]
        total = _OFF2 * total / max(np.float32(near[x]), ONE) - _REST * level
        beyond = np.float32(0.05) * third[x] - _THIRD * level
        third[x] = (total if total > ZERO else ZERO) + (beyond if beyond > ZERO else ZERO)


@inner
def _result(
    place: F32, variance: F32, inflation: F32, excess: F32, bracket: F32, limits: F32, out: tuple[F32, F32]
) -> None:
    """Place without its aperture; sigma by noise, excesses and the unsure moment."""
    aperture, unsure, (coordinate, sigma) = limits[3], limits[4], out
    for x in range(place.size):
        moved = unsure * bracket[x]
        level = variance[x] * inflation[x] + excess[x] + moved * moved
        sigma[x] = np.sqrt(level if level > _LEAST else _LEAST)
    for x in range(place.size):
        coordinate[x] = place[x] - aperture * bracket[x]


@inner
def _open(bend: F32, full: U8, clean: U8, limits: F32, slow: Mask) -> None:
    """Clean pixels beside others, or amid a jump: the least Laplacian of one by 2 jumps is 2/7."""
    steep = np.float32(0.2) * limits[0]
    for x in range(full.size):
        slow[x] = ((full[x] == 0) | (abs(bend[x]) > steep)) & (clean[x] != 0)


@inner
def _bordered(place: F32, y: int, clean: U8, limits: F32, slow: Mask) -> None:
    """Clean pixels within four reaches of the display's border."""
    extent, border, aperture = limits[1], limits[2], limits[3]
    for x in range(clean.size - 2):
        dx, dy = place[y, x + 2] - place[y, x], place[y + 1, x + 1] - place[y - 1, x + 1]
        reach2 = (HALF * aperture * (dx * dx + dy * dy) + border) * np.float32(16)
        t = place[y, x + 1] + HALF
        other = extent - t
        t = t if t < other else other
        slow[x + 1] |= (t * abs(t) < reach2) & (clean[x + 1] != 0)


@inner
def _judge(
    block: Block, windows: U8, limits: F32, image: Span, at: tuple[int, int, int], slow: Mask, result: Result
) -> None:
    """Variance by the border of the image, of flagged pixels and of the display, flags beyond; places amid
    a jump, which has no Laplacian; slow (W,): pixels of an axis' row, at: axis, row of block and result."""
    (a, y, to), (top, end), half, two, none = at, image, np.float32(0.5), np.float32(2), np.uint8(0)
    place, amplitude, clean, width = block.place[a], block.amplitude, windows[_CLEAN], slow.size
    jump, extent, border, aperture, unsure = limits[0], limits[1], limits[2], limits[3], limits[4]
    light, coordinate, sigma, some = amplitude[a], result.coordinate[a, to], result.sigma[a, to], width < 4
    for x in range(2, width - 2):
        some |= slow[x]
    for number in range(width if some else 4):  # the ends of a row always are
        x = number if some or number < 2 else width - 4 + number
        if not slow[x]:
            continue
        q, flagged = place[y, x], False
        brightest, along, down, sides, rows = ZERO, ZERO, ZERO, 0, 0
        for d in range(4):
            i, j, sign = y + (d == 1) - (d == 0), x + (d == 3) - (d == 2), np.float32(2 * (d & 1) - 1)
            if i < top or i >= end or j < 0 or j >= width:
                continue
            if clean[i, j] == none:
                flagged = True
            else:
                brightest = max(brightest, least(amplitude, i, j))
                if d < 2:
                    down, rows = down + sign * (place[i, j] - q), rows + 1
                else:
                    along, sides = along + sign * (place[i, j] - q), sides + 1
        along, down = along / np.float32(max(sides, 1)), down / np.float32(max(rows, 1))
        step2, extra = along * along + down * down, ZERO
        if flagged:
            loss = half * max(ONE - least(amplitude, y, x) / max(brightest, np.float32(1e-6)), ZERO)
            extra = loss * loss * step2
        if windows[_FULL, y, x] == none:
            inside = (min(y + 3, end) - max(y - 2, top)) * (min(x + 3, width) - max(x - 2, 0))
            if windows[_NUMBER, y, x] < inside:
                extra += step2 * (_RIM2 if flagged else _SECOND2)
            bend, nine = ZERO, 0  # of the nearest pixel that has eight neighbours
            i, j = min(max(y, top + 1), end - 2), min(max(x, 1), width - 2)
            if end - top > 2 and width > 2:
                for k in range(9):
                    h, m = i + k // 3 - 1, j + k % 3 - 1
                    if clean[h, m] != none:
                        weight = np.float32((h - i) ** 2 + (m - j) ** 2) - np.float32(4 / 3)
                        bend += weight * (place[h, m] - place[i, j])
                        nine += 1
            if nine == 9:
                bend = (half * bend + falling(place, light, i, j)) * (aperture + unsure)
                extra += bend * bend
        else:
            rise = abs(place[y - 2, x] + place[y + 2, x] - two * q)
            run = abs(place[y, x - 2] + place[y, x + 2] - two * q)
            if max(rise, run) > two * jump:
                coordinate[x] = q
        if border > ZERO:
            reach2 = two * aperture * step2 + border
            t = min(q + half, extent - half - q) / np.sqrt(reach2)
            extra += np.float32(0.16) * reach2 * np.exp(-(max(t, ZERO) ** 2))
            if t < _REACH:
                result.flags[to, x] |= _OFF
        sigma[x] = np.sqrt(sigma[x] * sigma[x] + extra)
