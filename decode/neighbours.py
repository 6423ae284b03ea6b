"""Pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel is refused that
its neighbours confirm.

A place is the mean over a pixel's area and the blur of the lens, weighted by light: their second moment m
times 1/2 laplace u + grad u . grad ln A is subtracted, and the uncertainty of the moment joins the variance.
A is the amplitude of the axis' coarsest fringe, which a nonlinear display makes ripple least. Three excesses
over noise join it, too: of the residuals around a pixel (chi2), of third differences over 7 x 7 pixels, and
of the residual to the quadratic of 5 x 5 (a crease has third differences at few pixels). Beside flagged
pixels the place is that of the lit part of the aperture, at the display's border that of its lit cells.

    neighbours(block, above, dof, limits, result)

    block    place, variance, amplitude (A, n, W); chi2, flags (n, W): rows of the result and HALO more on
             either side, fewer at the image's border
    above    rows of the block before the result's first one
    dof      degrees of freedom of chi2, 0: it says nothing
    limits   (A, 6) float32, rows of axis_limits()
    result   coordinate, sigma (A, R, W), flags (R, W), written

Axes without frames have no row in A. Flagged pixels may have any place and variance that is finite.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, I64, inlined, kernel
from optolever.kernels import ONE as _ONE
from optolever.kernels import ZERO as _ZERO

from .plan import AxisPlan
from .records import Flag

__all__ = ["EITHER", "HALO", "SETTLE", "Block", "Result", "axis_limits", "neighbours", "settle"]

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]
#: Rows that a block needs beside its result; more of them for settle(); flags of two orders by axis.
HALO, SETTLE, EITHER = 4, 2, (np.uint16(1 << 9), np.uint16(1 << 10))
#: Fewest sure pixels of 5 x 5 that choose an order, least share that agrees, to this share of a period.
_CHOOSE, _AGREE, _CHOSEN = 3, 0.9, np.float32(0.25)
#: Usual blur of a camera's lens, and of a soft one, px of the camera; of a display, cells.
_LENS, _SOFT, _BLUR = 0.2, 0.6, 0.6
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
    """Rows of the maps: coordinate, sigma (A, R, W) float32, pattern px; flags (R, W) uint16."""

    coordinate: F32
    sigma: F32
    flags: U16


def axis_limits(axis: AxisPlan, lens_px: float | None = None, on_cells: bool = True) -> F32:
    """Numbers (6,) of an axis, by which the kernel takes them:

    jump      second difference of neighbours that contradicts them, px: a quarter period, two cells
    extent    of the display, px; infinite: no border
    border    variance of the display's blur and a cell, px^2; 0: no border
    aperture  half the second moment of a camera pixel and its lens, px^2 of the camera; 0: places are cells
    unsure    half of its uncertainty
    fine      1: places within a cell, by fringes or a look-up
    """
    fine = axis.code is None or bool(axis.fringes)
    if axis.fringes:
        jump = 0.25 * axis.fringes[-1].period
    else:
        jump = 2 * axis.code.cell if axis.code is not None else 2.0
    lens = _LENS**2 if lens_px is None else lens_px**2
    least, most = 1 / 48, 1 / 12
    most += _SOFT**2 if lens_px is None else 0.0
    aperture, unsure = (0.5 * (1 / 12 + lens), 0.25 * (most - least)) if fine else (0.0, 0.0)
    bordered = on_cells and fine
    border = 1 / 12 + _BLUR**2 if bordered else 0.0
    extent = float(axis.extent) if bordered else np.inf
    return np.array([jump, extent, border, aperture, unsure, fine], np.float32)


def settle(block: Block, above: int, rows: int, periods: F32) -> tuple[Block, int]:
    """A block of HALO + SETTLE rows around `rows` for neighbours(), and its rows above: where two orders of a
    period (A,) fit, the one next to the median of the sure pixels of 5 x 5."""
    place, flags, sure = block.place.copy(), block.flags.copy(), block.flags == 0
    down, along = (one.ravel() for one in np.mgrid[-2:3, -2:3])
    for a, period in enumerate(periods):
        at = np.nonzero(block.flags & EITHER[a])
        y, x = at[0][:, None] + down, at[1][:, None] + along
        known = (y >= 0) & (y < len(flags)) & (x >= 0) & (x < flags.shape[1])
        y, x = np.clip(y, 0, len(flags) - 1), np.clip(x, 0, flags.shape[1] - 1)
        known &= sure[y, x]
        number = np.count_nonzero(known, axis=1)
        values = np.sort(np.where(known, block.place[a][y, x], np.float32(1e9)), axis=1)
        middle = np.take_along_axis(values, np.maximum(number - 1, 0)[:, None] // 2, axis=1)[:, 0]
        off = middle - place[a][at]
        step = np.rint(off / period)
        chosen = place[a][at] + step * period
        near = known & (np.abs(block.place[a][y, x] - chosen[:, None]) < _CHOSEN * period)
        found = (number >= _CHOOSE) & (np.abs(step) <= 1)
        found &= np.count_nonzero(near, axis=1) >= _AGREE * number
        place[a][at] = np.where(found, chosen, place[a][at])
        flags[at] = (flags[at] & ~EITHER[a]) | np.where(found, np.uint16(0), np.uint16(Flag.ORDER_DOUBTFUL))
    first = max(above - HALO, 0)
    kept = slice(first, above + rows + HALO)
    rings = [np.ascontiguousarray(one[:, kept]) for one in (place, block.variance, block.amplitude)]
    return Block(rings[0], rings[1], rings[2], block.chi2[kept], flags[kept]), above - first


def neighbours(block: Block, above: int, dof: int, limits: F32, result: Result) -> None:
    """See the head of the file."""
    rows = len(result.flags)
    top, end = HALO - above, HALO - above + len(block.flags)  # rows of the image; beyond it nothing is clean
    place, variance, amplitude, chi2, flags = block
    if (top, end) != (0, rows + 2 * HALO):
        ends = (0, 0), (top, rows + 2 * HALO - end), (0, 0)
        place, variance, amplitude = (np.pad(one, ends) for one in (place, variance, amplitude))
        chi2 = np.pad(chi2, ends[1:])
        flags = np.pad(flags, ends[1:], constant_values=np.uint16(Flag.INVALID))
    (axes, n, width), found = place.shape, np.empty_like(flags)
    _confirmed(place, variance, amplitude, flags, limits, top, end, np.zeros(width, np.bool_), found)
    clean = found == 0
    windows = _whole(n, width) if clean.all() else _windows(clean)
    rings, work = np.zeros((4 * axes + 1, 8, width + 6), np.float32), np.zeros((8, width + 6), np.float32)
    (coordinate, sigma, _), slow = result, np.zeros((axes, rows, width), np.bool_)
    maps, slopes = (place, variance, amplitude, chi2), np.zeros(width, np.float32)
    _excess(*maps, windows, limits, np.float32(dof), rings, work, slopes, coordinate, sigma, slow)
    result.flags[:] = found[HALO : HALO + rows]
    for a in range(axes):
        at = np.flatnonzero(slow[a])
        if at.size:
            own = place[a], amplitude[a], amplitude, windows[_FULL], windows[_CLEAN], top, end, limits[a], at
            _judge(*own, coordinate[a], sigma[a], result.flags)


@inlined
def least(amplitude: F32, y: int, x: int) -> np.float32:
    """Smallest of all axes."""
    found: np.float32 = min(amplitude[0, y, x], amplitude[len(amplitude) - 1, y, x])
    return found


@inlined
def falling(place: F32, light: F32, y: int, x: int) -> np.float32:
    """2 grad u . grad ln A by central differences."""
    left, right, above, below = light[y, x - 1], light[y, x + 1], light[y - 1, x], light[y + 1, x]
    along = (place[y, x + 1] - place[y, x - 1]) * (right - left) / max(right + left, _LEAST)
    down = (place[y + 1, x] - place[y - 1, x]) * (below - above) / max(below + above, _LEAST)
    return np.float32(along + down)


@kernel
def _confirmed(
    place: F32,
    variance: F32,
    amplitude: F32,
    flags: U16,
    limits: F32,
    top: int,
    end: int,
    sure: Mask,
    found: U16,
) -> None:
    """Flags, and OUTLIER where neighbours contradict or half is unlit; rows of the image: top to end."""
    (axes, n, width), half, two, none = place.shape, np.float32(0.5), np.float32(2), np.uint16(0)
    for y in range(n):
        up, down = max(y - 1, top), min(y + 1, end - 1)
        for x in range(width):
            found[y, x] = flags[y, x]
        if y < top or y >= end:
            continue
        for a in range(axes):
            jump = limits[a, 0]
            for x in range(width - 2):  # both neighbours of the row confirm nearly all
                off = abs(place[a, y, x] + place[a, y, x + 2] - two * place[a, y, x + 1])
                beside = flags[y, x] | flags[y, x + 2] | flags[up, x + 1] | flags[down, x + 1]
                sure[x + 1] = (off < two * jump) & (beside == none)
            for x in range(width):
                if sure[x] or flags[y, x] != none:
                    continue
                brightest, rim = _ZERO, False
                for d in range(4):
                    i, j = (up if d == 0 else down if d == 1 else y), x + (d == 3) - (d == 2)
                    if 0 <= j < width:
                        rim |= flags[i, j] != none
                        other = least(amplitude, i, j) if flags[i, j] == none else _ZERO
                        brightest = max(brightest, other)
                if rim and least(amplitude, y, x) < half * brightest:
                    found[y, x] |= _OUTLIER
                known, p, v = False, place[a, y, x], variance[a, y, x]
                for d in range(8):  # amid two neighbours, on the plane of three
                    i, j = (
                        (min(d, 1), 1 - d if d < 2 else 5 - 2 * d)
                        if d < 4
                        else ((d & 1) * 2 - 1, (d & 2) - 1)
                    )
                    if min(y + i, x + j) < 0 or y + i >= n or x + j >= width:
                        continue
                    if d < 4 and (min(y - i, x - j) < 0 or y - i >= n or x - j >= width):
                        continue
                    if flags[y + i, x + j] != none:
                        continue
                    off, v2 = place[a, y + i, x + j] - p, variance[a, y + i, x + j]
                    if d < 4:
                        if flags[y - i, x - j] != none:
                            continue
                        off = half * (off + place[a, y - i, x - j] - p)
                        v2 = np.float32(0.25) * (v2 + variance[a, y - i, x - j])
                    else:
                        if flags[y + i, x] != none or flags[y, x + j] != none:
                            continue
                        off = place[a, y + i, x] - p + (place[a, y, x + j] - p) - off
                        v2 += variance[a, y + i, x] + variance[a, y, x + j]
                    beyond = abs(off) - jump
                    known |= beyond < _ZERO or beyond * beyond < _SURE2 * (v + v2)
                if not known:
                    found[y, x] |= _OUTLIER


@lru_cache(maxsize=4)
def _whole(rows: int, width: int) -> U8:
    return _windows(np.ones((rows, width), np.bool_))


def _windows(clean: Mask) -> U8:
    """(8, n, W), see _CLEAN, of clean pixels (n, W)."""
    one = clean.astype(np.uint8)
    row, col = _over(one, 0, 3, 1) == 4, _over(one, 0, 3, 0) == 4
    number = _over(_over(one, -2, 2, 0), -2, 2, 1)
    full = number == 25
    along = _over(_over(row.astype(np.uint8), -3, 0, 1), -3, 3, 0)
    down = _over(_over(col.astype(np.uint8), -3, 0, 0), -3, 3, 1)
    near = _over(_over(full.astype(np.uint8), -1, 1, 0), -1, 1, 1)
    return np.stack([one, number, full, row, col, along, down, near])


def _over(of: U8, first: int, last: int, axis: int) -> U8:
    """Sums over pixels from `first` to `last` further along an axis, 0 beyond the block."""
    out, n = np.zeros_like(of), of.shape[axis]
    to, add = np.moveaxis(out, axis, 0), np.moveaxis(of, axis, 0)
    for k in range(first, last + 1):
        to[max(-k, 0) : max(n - k, 0)] += add[max(k, 0) : max(n + k, 0)]
    return out


@kernel
def _excess(
    place: F32, variance: F32, amplitude: F32, chi2: F32, windows: U8, limits: F32, dof: np.float32,
    rings: F32, work: F32, light_slope: F32, coordinate: F32, sigma: F32, slow: Mask,
) -> None:  # fmt: skip
    """Places without their aperture, sigma with its excesses over noise, clean pixels for _judge: by windows
    that are not full, a jump in them, or the display's border. Sums of rows lie in rings of 8."""
    axes, n, width = place.shape
    half, three, four, five, ten = (
        np.float32(0.5),
        np.float32(3),
        np.float32(4),
        np.float32(5),
        np.float32(10),
    )
    share, most, cap = _ONE / max(dof, _ONE), np.float32(25), np.float32(500)
    mean = _ONE + np.float32(1.1314) * np.sqrt(share)  # four deviations of the mean of 25 pixels
    alone = _ONE + np.float32(7.0711) * np.sqrt(share) + np.float32(8) * share
    for k in range(1, n - 1):
        y, r = k - 3, k - 3 - HALO
        for x in range(width):
            one = share * chi2[k, x]
            rings[0, k & 7, x + 2] = (one if one < most else most) * np.float32(windows[_CLEAN, k, x])
        if r >= 0:
            for x in range(width + 4):
                work[7, x] = (rings[0, (y - 2) & 7, x] + rings[0, (y - 1) & 7, x] + rings[0, y & 7, x]
                    + rings[0, (y + 1) & 7, x] + rings[0, (y + 2) & 7, x])  # fmt: skip
            for x in range(width):
                level = work[7, x] + work[7, x + 1] + work[7, x + 2] + work[7, x + 3] + work[7, x + 4]
                level, one = level / max(np.float32(windows[_NUMBER, y, x]), _ONE), share * chi2[y, x]
                level = level if level > mean else _ONE
                one = one if one > alone else _ONE
                work[0, x] = level if level > one else one
        for a in range(axes):
            if limits[a, 5] == _ZERO:
                if r >= 0:
                    for x in range(width):
                        coordinate[a, r, x] = place[a, y, x]
                    for x in range(width):
                        sigma[a, r, x] = np.sqrt(max(variance[a, y, x] * work[0, x], _LEAST))
                continue
            rows, cols, rest, bend = 4 * a + 1, 4 * a + 2, 4 * a + 3, 4 * a + 4
            for x in range(width - 3):  # squares of third differences, capped
                h = place[a, k, x + 3] - place[a, k, x] + three * (place[a, k, x + 1] - place[a, k, x + 2])
                h, c = h * h, cap * variance[a, k, x + 1]
                work[1, x + 3] = (h if h < c else c) * np.float32(windows[_ROW, k, x])
            for x in range(width):
                rings[rows, k & 7, x] = work[1, x] + work[1, x + 1] + work[1, x + 2] + work[1, x + 3]
            j = k - 3
            if j >= 0:
                for x in range(width):
                    h = place[a, k, x] - place[a, j, x] + three * (place[a, j + 1, x] - place[a, j + 2, x])
                    h, c = h * h, cap * variance[a, j + 1, x]
                    work[2, x + 3] = (h if h < c else c) * np.float32(windows[_COL, j, x])
                for x in range(width):
                    rings[cols, j & 7, x] = (work[2, x] + work[2, x + 1] + work[2, x + 2] + work[2, x + 3]
                        + work[2, x + 4] + work[2, x + 5] + work[2, x + 6])  # fmt: skip
            j = k - 2
            if (
                j >= 2
            ):  # Laplacian of the quadratic through 5 x 5, and squares of the residual to it over three
                for x in range(width):
                    q = place[a, j, x]
                    work[3, x] = (place[a, j - 2, x] - q + (place[a, k, x] - q)
                        + (place[a, j - 1, x] - q) + (place[a, j + 1, x] - q))  # fmt: skip
                for x in range(width):
                    q = place[a, j, x]
                    work[4, x] = (four * (place[a, j - 2, x] - q + (place[a, k, x] - q))
                        + (place[a, j - 1, x] - q) + (place[a, j + 1, x] - q))  # fmt: skip
                for x in range(width - 4):
                    q = place[a, j, x + 2]
                    outer, inner = (
                        place[a, j, x] - q + (place[a, j, x + 4] - q),
                        place[a, j, x + 1] - q + (place[a, j, x + 3] - q),
                    )
                    curve = work[4, x] + work[4, x + 1] + work[4, x + 2] + work[4, x + 3] + work[4, x + 4]
                    curve += (ten * (outer + inner) + four * (five * outer + work[3, x] + work[3, x + 4])
                        + (five * inner + work[3, x + 1] + work[3, x + 3]))  # fmt: skip
                    total = (
                        five * (outer + inner)
                        + work[3, x]
                        + work[3, x + 1]
                        + work[3, x + 2]
                        + work[3, x + 3]
                        + work[3, x + 4]
                    )
                    curve = (curve - four * total) * np.float32(1 / 35)
                    rings[bend, j & 7, x + 2] = curve * np.float32(windows[_FULL, j, x + 2])
                for x in range(width - 4):
                    q = place[a, j, x + 2]
                    total = five * (
                        place[a, j, x]
                        - q
                        + (place[a, j, x + 4] - q)
                        + (place[a, j, x + 1] - q)
                        + (place[a, j, x + 3] - q)
                    )
                    total += work[3, x] + work[3, x + 1] + work[3, x + 2] + work[3, x + 3] + work[3, x + 4]
                    off = (
                        total * np.float32(0.04) * np.float32(windows[_FULL, j, x + 2])
                        - rings[bend, j & 7, x + 2]
                    )
                    work[5, x + 3] = off * off
                for x in range(width):
                    rings[rest, j & 7, x] = work[5, x] + work[5, x + 1] + work[5, x + 2]
            if r < 0:
                continue
            for x in range(width):
                number = np.float32(windows[_ALONG, y, x])
                total = (
                    rings[rows, (y - 3) & 7, x] + rings[rows, (y - 2) & 7, x] + rings[rows, (y - 1) & 7, x]
                )
                total += rings[rows, y & 7, x] + rings[rows, (y + 1) & 7, x]
                total += rings[rows, (y + 2) & 7, x] + rings[rows, (y + 3) & 7, x]
                work[7, x] = total / number if number > three else _ZERO
            for x in range(width):
                number = np.float32(windows[_DOWN, y, x])
                total = (
                    rings[cols, (y - 3) & 7, x] + rings[cols, (y - 2) & 7, x] + rings[cols, (y - 1) & 7, x]
                )
                total += rings[cols, y & 7, x]
                total = total / number if number > three else _ZERO
                work[7, x] = work[7, x] if work[7, x] > total else total
            for x in range(1, width - 1):
                full = np.float32(windows[_FULL, y, x])
                light_slope[x] = full * falling(place[a], amplitude[a], y, x)
            for x in range(width):
                level = variance[a, y, x] * work[0, x]
                moved = limits[a, 4] * (rings[bend, y & 7, x] + light_slope[x])
                third = np.float32(0.05) * work[7, x] - _THIRD * level
                work[6, x] = level + (third if third > _ZERO else _ZERO) + moved * moved
            for x in range(width):
                total = rings[rest, (y - 1) & 7, x] + rings[rest, y & 7, x] + rings[rest, (y + 1) & 7, x]
                total = _OFF2 * total / max(np.float32(windows[_NEAR, y, x]), _ONE)
                total -= _REST * variance[a, y, x] * work[0, x]
                total = work[6, x] + (total if total > _ZERO else _ZERO)
                sigma[a, r, x] = np.sqrt(total if total > _LEAST else _LEAST)
            for x in range(width):
                coordinate[a, r, x] = place[a, y, x] - limits[a, 3] * (rings[bend, y & 7, x] + light_slope[x])
            steep = np.float32(0.2) * limits[a, 0]  # of the least Laplacian of a jump by 2 jumps, 2/7
            for x in range(width):
                open_ = (windows[_FULL, y, x] == 0) | (abs(rings[bend, y & 7, x]) > steep)
                slow[a, r, x] = open_ & (windows[_CLEAN, y, x] != 0)
            if limits[a, 2] > _ZERO:
                for x in range(width - 2):
                    dx, dy = (
                        place[a, y, x + 2] - place[a, y, x],
                        place[a, y + 1, x + 1] - place[a, y - 1, x + 1],
                    )
                    reach2 = (half * limits[a, 3] * (dx * dx + dy * dy) + limits[a, 2]) * np.float32(16)
                    t = place[a, y, x + 1] + half
                    other = limits[a, 1] - t
                    t = t if t < other else other
                    slow[a, r, x + 1] |= (t * abs(t) < reach2) & (windows[_CLEAN, y, x + 1] != 0)


@kernel
def _judge(
    place: F32, light: F32, amplitude: F32, full: U8, clean: U8, top: int, end: int, limits: F32, at: I64,
    coordinate: F32, sigma: F32, flags: U16,
) -> None:  # fmt: skip
    """Variance by the border of the image, of flagged pixels and of the display, flags beyond; places amid
    a jump, which has no Laplacian; at: number of each pixel of the result."""
    (_, width), half, two, none = place.shape, np.float32(0.5), np.float32(2), np.uint8(0)
    jump, extent, border, aperture, unsure = limits[0], limits[1], limits[2], limits[3], limits[4]
    for number in at:
        r, x = number // width, number % width
        y, q = r + HALO, place[r + HALO, x]
        brightest, along, down, sides, rows = _ZERO, _ZERO, _ZERO, 0, 0
        flagged, lost = False, False
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
        step2, extra = along * along + down * down, _ZERO
        if flagged:
            loss = half * max(_ONE - least(amplitude, y, x) / max(brightest, np.float32(1e-6)), _ZERO)
            extra = loss * loss * step2
        if full[y, x] == none:
            for i in range(max(y - 2, top), min(y + 3, end)):
                for j in range(max(x - 2, 0), min(x + 3, width)):
                    lost |= clean[i, j] == none
            if lost:
                extra += step2 * (_RIM2 if flagged else _SECOND2)
            bend, nine = _ZERO, 0  # of the nearest pixel that has eight neighbours
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
                coordinate[r, x] = q
        if border > _ZERO:
            reach2 = two * aperture * step2 + border
            t = min(q + half, extent - half - q) / np.sqrt(reach2)
            inside = max(t, _ZERO)
            extra += np.float32(0.16) * reach2 * np.exp(-inside * inside)
            if t < _REACH:
                flags[r, x] |= _OFF
        sigma[r, x] = np.sqrt(sigma[r, x] * sigma[r, x] + extra)
