"""Pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel is refused that
its neighbours confirm.

A place is the mean over a pixel's area and the blur of the lens: half of their second moment times the
Laplacian of the map is subtracted, and the uncertainty of the moment joins the variance. Three excesses over
noise join it, too: of the residuals around a pixel (chi2), of third differences over 7 x 7 pixels, and of the
residual to the quadratic of 5 x 5 (a crease has third differences at few pixels). Beside flagged pixels the
place is that of the lit part of the aperture, at the display's border that of its lit cells.

    neighbours(block, above, dof, limits, result)

    block    place, variance (A, n, W); chi2, amplitude (n, W); flags (n, W): rows of the result and HALO more
             on either side, fewer at the image's border
    above    rows of the block before the result's first one
    dof      degrees of freedom of chi2, 0: it says nothing
    limits   (A, 6) float32, rows of axis_limits()
    result   coordinate, sigma (A, R, W), flags (R, W), written

Axes without frames have no row in A. Flagged pixels may have any place and variance that is finite.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, exact, inlined
from optolever.kernels import ONE as _ONE
from optolever.kernels import ZERO as _ZERO

from .plan import AxisPlan
from .records import Flag

__all__ = ["HALO", "Block", "Result", "axis_limits", "neighbours"]

U16 = NDArray[np.uint16]
#: Rows that a block needs on either side of its result.
HALO = 4
#: Usual blur of a camera's lens, and of a soft one, px of the camera; of a display, cells.
_LENS, _SOFT, _BLUR = 0.2, 0.6, 0.6
#: Squared standard deviations beyond which neighbours contradict; thresholds of third differences and of the
#: residual to the quadratic, over noise; one over the share of noise in it.
_SURE2, _THIRD, _REST, _OFF2 = np.float32(25), np.float32(1.2), np.float32(1.6), np.float32(175 / 148)
#: Squared shares of a step between neighbours: beside flagged pixels, one further; least variance, px^2; the
#: display's border is flagged up to so many of its reaches.
_RIM2, _SECOND2, _LEAST, _REACH = np.float32(0.09), np.float32(0.0036), np.float32(1e-6), np.float32(2.0)
_OUTLIER, _OFF, _FINE = np.uint16(Flag.OUTLIER), np.uint16(Flag.OFF_PATTERN), 5


class Block(NamedTuple):
    """Output of the pixel kernel.

    place, variance  (A, n, W) float32, pattern px, px^2: by noise alone (bits: of the interval)
    chi2       (n, W) float32, squares of residuals over their noise, summed over all axes
    amplitude  (n, W) float32, levels, the smaller one of both axes
    flags      (n, W) uint16, of both axes
    """

    place: F32
    variance: F32
    chi2: F32
    amplitude: F32
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


def neighbours(block: Block, above: int, dof: int, limits: F32, result: Result) -> None:
    """See the head of the file."""
    shape = block.flags.shape
    clean, scale = np.empty((2, *shape), np.float32)
    flags, windows = np.empty(shape, np.uint16), np.empty((7, *shape), np.float32)
    row_of = np.empty(shape[0], np.int64)
    _cleaned(block.place, block.variance, block.amplitude, block.flags, limits, clean, flags)
    _shared(clean, block.chi2, np.float32(dof), scale, windows, row_of)
    own = slice(above, above + len(result.flags))
    result.flags[:] = flags[own]
    for k, numbers in enumerate(limits):
        if numbers[_FINE] > 0:
            maps = block.place[k], block.variance[k], clean, block.amplitude, scale, windows, row_of
            _axis(*maps, above, numbers, result.coordinate[k], result.sigma[k], result.flags)
        else:
            result.coordinate[k] = block.place[k, own]
            np.sqrt(np.maximum(block.variance[k, own] * scale[own], _LEAST), out=result.sigma[k])


@inlined
def _agrees(off: np.float32, variance: np.float32, jump: np.float32) -> bool:
    """Whether a difference of places is within the jump and noise."""
    beyond = abs(off) - jump
    return bool(beyond < _ZERO or beyond * beyond < _SURE2 * variance)


@exact
def _cleaned(
    place: F32, variance: F32, amplitude: F32, flags: U16, limits: F32, clean: F32, found: U16
) -> None:
    """Good pixels (n, W) that neighbours confirm on every axis and of which more than half is lit."""
    n, width = flags.shape
    sure = np.empty(width, np.float32)
    quarter, two, half = np.float32(0.25), np.float32(2), np.float32(0.5)
    for y in range(n):
        mine, good = flags[y], clean[y]
        for x in range(width):
            good[x] = _ONE if mine[x] == 0 else _ZERO
            found[y, x] = mine[x]
    for a in range(len(place)):
        jump = limits[a, 0]
        for y in range(n):
            p, v, mine, out = place[a, y], variance[a, y], flags[y], found[y]
            sure[0] = sure[width - 1] = _ZERO
            inner = sure[1:]
            for x in range(width - 2):  # both neighbours of the row confirm nearly all
                off = abs(p[x] + p[x + 2] - two * p[x + 1])
                inner[x] = _ONE if (off < two * jump) & ((mine[x] | mine[x + 2]) == 0) else _ZERO
            for x in range(width):
                if sure[x] > _ZERO or mine[x] != 0:
                    continue
                known = False
                for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
                    if y - i < 0 or y + i >= n or min(x - j, x + j) < 0 or max(x - j, x + j) >= width:
                        continue
                    if flags[y - i, x - j] == 0 and flags[y + i, x + j] == 0:
                        b, c = place[a, y - i, x - j], place[a, y + i, x + j]
                        more = variance[a, y - i, x - j] + variance[a, y + i, x + j]
                        known |= _agrees(half * (b + c) - p[x], v[x] + quarter * more, jump)
                for corner in range(4):
                    i, j = 2 * (corner & 1) - 1, (corner & 2) - 1
                    if known or y + i < 0 or y + i >= n or x + j < 0 or x + j >= width:
                        continue
                    if flags[y + i, x] == 0 and flags[y, x + j] == 0 and flags[y + i, x + j] == 0:
                        b, c, d = place[a, y + i, x], p[x + j], place[a, y + i, x + j]
                        more = variance[a, y + i, x] + v[x + j] + variance[a, y + i, x + j]
                        known = _agrees(b + c - d - p[x], v[x] + more, jump)
                if not known:
                    out[x] |= _OUTLIER
    for y in range(n):
        light, mine, out = amplitude[y], flags[y], found[y]
        above, below = flags[max(y - 1, 0)], flags[min(y + 1, n - 1)]
        up, down = amplitude[max(y - 1, 0)], amplitude[min(y + 1, n - 1)]
        for x in range(width):
            low, high = max(x - 1, 0), min(x + 1, width - 1)
            if mine[x] == 0 and (above[x] | below[x] | mine[low] | mine[high]) != 0:
                top = max(up[x] if above[x] == 0 else _ZERO, down[x] if below[x] == 0 else _ZERO)
                top = max(top, light[low] if mine[low] == 0 else _ZERO)
                top = max(top, light[high] if mine[high] == 0 else _ZERO)
                if light[x] < half * top:
                    out[x] |= _OUTLIER
        good = clean[y]
        for x in range(width):
            good[x] = _ONE if out[x] == 0 else _ZERO


@exact
def _shared(
    clean: F32, chi2: F32, dof: np.float32, scale: F32, windows: F32, row_of: NDArray[np.int64]
) -> None:
    """What axes share: scale of the variance by chi2 (n, W); and, in row row_of[y] of `windows` (7, n, W) for
    row y (rows amid clean ones are alike): whether 5 x 5 are clean; whether third differences from here along
    the row, down the column are; one over their numbers in 7 x 7, over those of full pixels in 3 x 3, and
    over those of clean ones in 5 x 5."""
    n, width = clean.shape
    # by index: Numba takes what is unpacked for strided
    full, row_ok, col_ok, along = windows[0], windows[1], windows[2], windows[3]
    down, near, number5, pad = windows[4], windows[5], windows[6], np.zeros((4, width + 6), np.float32)
    count, z, four, rows = pad[0], pad[1], pad[2], pad[3]
    some, three, most = max(dof, _ONE), np.float32(3.5), np.float32(25)
    mean = _ONE + np.float32(1.1314) / np.sqrt(some)  # four deviations of the mean of 25 pixels
    alone = _ONE + np.float32(7.0711) / np.sqrt(some) + np.float32(8) / some
    share, enough = _ONE / some, np.float32(24.5)
    whole_rows = 0  # clean ones in succession, up to row y + 3
    for y in range(-3, n):
        if y + 3 < n:
            c, total = clean[y + 3], _ZERO
            for x in range(width):
                total += c[x]
            whole_rows = whole_rows + 1 if total == np.float32(width) else 0
        else:
            whole_rows = 0
        if y < 0:
            continue
        row_of[y] = y
        if whole_rows >= 8 and y > 3:
            row_of[y] = row_of[y - 1]
            continue
        for x in range(width + 6):
            count[x], four[x], rows[x] = _ZERO, _ZERO, _ZERO
        inner = count[2:]
        for k in range(max(y - 2, 0), min(y + 3, n)):
            c = clean[k]
            for x in range(width):
                inner[x] += c[x]
        out, out5 = full[y], number5[y]
        for x in range(width):
            number = count[x] + count[x + 1] + count[x + 2] + count[x + 3] + count[x + 4]
            out[x] = _ONE if number > enough else _ZERO
            out5[x] = _ONE / max(number, _ONE)
        c, out, inner = clean[y], row_ok[y], four[3:]
        for x in range(width):
            out[x] = _ZERO
        for x in range(width - 3):
            out[x] = c[x] * c[x + 1] * c[x + 2] * c[x + 3]
        for k in range(max(y - 3, 0), min(y + 4, n)):
            c = clean[k]
            for x in range(width - 3):
                inner[x] += c[x] * c[x + 1] * c[x + 2] * c[x + 3]
        out, inner = col_ok[y], rows[3:]
        for x in range(width):
            out[x] = _ZERO
        for k in range(max(y - 3, 0), min(y + 1, n - 3)):
            c, c1, c2, c3 = clean[k], clean[k + 1], clean[k + 2], clean[k + 3]
            for x in range(width):
                out[x] = c[x] * c1[x] * c2[x] * c3[x]
                inner[x] += out[x]
        if y >= n - 3:
            for x in range(width):
                out[x] = _ZERO
        out = along[y]
        for x in range(width):
            number = four[x] + four[x + 1] + four[x + 2] + four[x + 3]
            out[x] = _ONE / number if number > three else _ZERO
        out = down[y]
        for x in range(width):
            number = rows[x] + rows[x + 1] + rows[x + 2] + rows[x + 3] + rows[x + 4]
            number += rows[x + 5] + rows[x + 6]
            out[x] = _ONE / number if number > three else _ZERO
    for y in range(n):
        for x in range(width + 6):
            count[x] = _ZERO
        if row_of[y] == y:
            inner = count[1:]
            for k in range(max(y - 1, 0), min(y + 2, n)):
                c = full[row_of[k]]
                for x in range(width):
                    inner[x] += c[x]
            out = near[y]
            for x in range(width):
                number = count[x] + count[x + 1] + count[x + 2]
                out[x] = _ONE / number if number > _ZERO else _ZERO
    sums = np.zeros((n + 1, width), np.float32)  # the last row: beyond the block
    for y in range(n):
        c, r, inner, out = clean[y], chi2[y], z[2:], sums[y]
        for x in range(width):
            one = share * r[x]
            inner[x] = c[x] * (one if one < most else most)
        for x in range(width):
            out[x] = z[x] + z[x + 1] + z[x + 2] + z[x + 3] + z[x + 4]
    for y in range(n):
        a, b = sums[y - 2 if y > 1 else n], sums[y - 1 if y > 0 else n]
        c, d, e = sums[y], sums[min(y + 1, n)], sums[min(y + 2, n)]
        r, by, out = chi2[y], number5[row_of[y]], scale[y]
        for x in range(width):
            level = (a[x] + b[x] + c[x] + d[x] + e[x]) * by[x]
            one = share * r[x]
            level = level if level > mean else _ONE
            one = one if one > alone else _ONE
            out[x] = level if level > one else one


@exact
def _edge(
    p: F32, clean: F32, amplitude: F32, y: int, x: int, full: np.float32, limits: F32
) -> tuple[np.float32, np.float32]:
    """Variance of a clean pixel by the border of the image, of flagged pixels and of the display; distance to
    the display's border over its reach."""
    n, width = p.shape
    step2, top, extra, flagged, lost = _ZERO, _ZERO, _ZERO, False, False
    for axis in range(2):
        slope, sides = _ZERO, 0
        for sign in (-1, 1):
            j, i = (y, x + sign) if axis == 0 else (y + sign, x)
            if j < 0 or j >= n or i < 0 or i >= width:
                continue
            if clean[j, i] > _ZERO:
                slope += np.float32(sign) * (p[j, i] - p[y, x])
                top = max(top, amplitude[j, i])
                sides += 1
            else:
                flagged = True
        slope = slope / np.float32(max(sides, 1))
        step2 += slope * slope
    if full == _ZERO:
        for j in range(max(y - 2, 0), min(y + 3, n)):
            for i in range(max(x - 2, 0), min(x + 3, width)):
                lost |= clean[j, i] == _ZERO
    if lost:
        extra = step2 * (_RIM2 if flagged else _SECOND2)
    if flagged:
        loss = np.float32(0.5) * max(_ONE - amplitude[y, x] / max(top, np.float32(1e-6)), _ZERO)
        extra += loss * loss * step2
    if full == _ZERO and n > 2 and width > 2:
        number, bend = 0, _ZERO  # of the nearest pixel that has eight neighbours
        k, m = min(max(y, 1), n - 2), min(max(x, 1), width - 2)
        for i in range(-1, 2):
            for j in range(-1, 2):
                if clean[k + i, m + j] > _ZERO:
                    number += 1
                    bend += (np.float32(i * i + j * j) - np.float32(4 / 3)) * (p[k + i, m + j] - p[k, m])
        if number == 9:
            bend *= np.float32(0.5) * (limits[3] + limits[4])
            extra += bend * bend
    if limits[2] == _ZERO:
        return extra, np.float32(9)
    reach2 = np.float32(2) * limits[3] * step2 + limits[2]
    half = np.float32(0.5)
    t = min(p[y, x] + half, limits[1] - half - p[y, x]) / np.sqrt(reach2)
    inside = max(t, _ZERO)
    return extra + np.float32(0.16) * reach2 * np.exp(-inside * inside), t


@exact
def _thirds(
    q: F32, q1: F32, q2: F32, q3: F32, noise: F32, ok: F32, padded: F32, down: bool, out: F32
) -> None:
    """Squares of third differences q .. q3, capped, summed along the row: over 7, down columns; over 4, along
    rows, whose q1 .. q3 are q further on. `padded` is zero at its ends."""
    width, length = len(out), len(q3)
    inner, three, most = padded[3:], np.float32(3), np.float32(500)
    for x in range(length):
        h = q3[x] - q[x] + three * (q1[x] - q2[x])
        h, cap = h * h, most * noise[x]
        inner[x] = (h if h < cap else cap) * ok[x]
    if down:
        for x in range(width):
            total = padded[x] + padded[x + 1] + padded[x + 2] + padded[x + 3]
            out[x] = total + padded[x + 4] + padded[x + 5] + padded[x + 6]
    else:
        for x in range(width):
            out[x] = padded[x] + padded[x + 1] + padded[x + 2] + padded[x + 3]


@exact
def _bent(
    q1: F32, q2: F32, q: F32, q3: F32, q4: F32, whole: F32, s0: F32, s2: F32, square: F32, lap: F32, rest: F32
) -> None:
    """Laplacian of the quadratic through 5 x 5 pixels of five rows, and squares of the residual to it, summed
    over three."""
    width, four, five, ten = len(q), np.float32(4), np.float32(5), np.float32(10)
    for x in range(width):
        s0[x] = q1[x] - q[x] + (q4[x] - q[x]) + (q2[x] - q[x]) + (q3[x] - q[x])
    for x in range(width):
        s2[x] = four * (q1[x] - q[x] + (q4[x] - q[x])) + (q2[x] - q[x]) + (q3[x] - q[x])
    out, inner = lap[2:], square[3:]
    for x in range(width - 4):
        mid = q[x + 2]
        e1, e2, e3, e4 = q[x] - mid, q[x + 1] - mid, q[x + 3] - mid, q[x + 4] - mid
        ends, inside = five * (e1 + e4) + s0[x] + s0[x + 4], five * (e2 + e3) + s0[x + 1] + s0[x + 3]
        total = ends + inside + s0[x + 2]
        curve = s2[x] + s2[x + 1] + s2[x + 2] + s2[x + 3] + s2[x + 4] + ten * (e1 + e2 + e3 + e4)
        curve = (curve + four * ends + inside - four * total) * np.float32(1 / 35)
        off = total * np.float32(0.04) - curve
        out[x] = curve * whole[x + 2]
        inner[x] = off * off * _OFF2 * whole[x + 2]
    lap[0] = lap[1] = lap[width - 2] = lap[width - 1] = _ZERO
    for x in range(width):
        rest[x] = square[x] + square[x + 1] + square[x + 2]


@exact
def _joined(
    rows: F32,
    columns: F32,
    rest: F32,
    y: int,
    by: tuple[F32, F32, F32],
    noise: F32,
    scale: F32,
    lap: F32,
    unsure: np.float32,
    best: F32,
    extra: F32,
    out: F32,
) -> None:
    """Sigma of row y: noise and its excesses, of rings of rows `rows`, `columns`, `rest`; `extra`."""
    width, share = len(out), np.float32(0.05)
    along, down, near = by
    r0, r1, r2, r3 = rows[(y - 3) & 7], rows[(y - 2) & 7], rows[(y - 1) & 7], rows[y & 7]
    r4, r5, r6 = rows[(y + 1) & 7], rows[(y + 2) & 7], rows[(y + 3) & 7]
    for x in range(width):
        best[x] = r0[x] + r1[x] + r2[x] + r3[x]
    for x in range(width):
        best[x] = (best[x] + r4[x] + r5[x] + r6[x]) * along[x]
    r0, r1, r2, r3 = columns[(y - 3) & 7], columns[(y - 2) & 7], columns[(y - 1) & 7], columns[y & 7]
    for x in range(width):
        other = (r0[x] + r1[x] + r2[x] + r3[x]) * down[x]
        best[x] = best[x] if best[x] > other else other
    for x in range(width):
        level, third = noise[x] * scale[x], share * best[x]
        moved, third = unsure * lap[x], third - _THIRD * level
        out[x] = level + (third if third > _ZERO else _ZERO) + moved * moved
    r0, r1, r2 = rest[(y - 1) & 7], rest[y & 7], rest[(y + 1) & 7]
    for x in range(width):
        fourth = (r0[x] + r1[x] + r2[x]) * near[x] - _REST * noise[x] * scale[x]
        fourth = fourth if fourth > _ZERO else _ZERO
        out[x] += fourth + extra[x]
    for x in range(width):
        out[x] = np.sqrt(out[x] if out[x] > _LEAST else _LEAST)


@exact
def _placed(
    upper: F32, q: F32, lower: F32, lap: F32, whole: F32, clean: F32, limits: F32, to: F32, slow: F32
) -> np.float32:
    """Places without their aperture; clean pixels that _edge judges: by windows that are not whole, a jump
    in them, or the display's border; how many."""
    jump, extent, border, aperture = limits[0], limits[1], limits[2], limits[3]
    width, half, sixteen, some = len(q), np.float32(0.5), np.float32(16), _ZERO
    steep = np.float32(0.2) * jump  # of the least Laplacian of a jump by 2 jumps, 2/7
    for x in range(width):
        to[x] = q[x] - aperture * lap[x]
    for x in range(width):
        slow[x] = clean[x] if abs(lap[x]) > steep else (_ONE - whole[x]) * clean[x]
    if border > _ZERO:
        inner, outside, up, down = slow[1:], clean[1:], upper[1:], lower[1:]
        for x in range(width - 2):
            dx, dy = q[x + 2] - q[x], down[x] - up[x]
            reach2 = (half * aperture * (dx * dx + dy * dy) + border) * sixteen
            away, other = q[x + 1] + half, extent - half - q[x + 1]
            away = away if away < other else other
            inner[x] = outside[x] if away * abs(away) < reach2 else inner[x]
    for x in range(width):
        some += slow[x]
    return some


@exact
def _axis(
    p: F32,
    v: F32,
    clean: F32,
    amplitude: F32,
    scale: F32,
    windows: F32,
    row_of: NDArray[np.int64],
    above: int,
    limits: F32,
    coordinate: F32,
    sigma: F32,
    flags: U16,
) -> None:
    """One axis with places within a cell: aperture, excesses over noise, rims and borders. Sums of rows
    lie in rings of 8."""
    n, width = p.shape
    # by index: Numba takes what is unpacked for strided
    full, row_ok, col_ok, along = windows[0], windows[1], windows[2], windows[3]
    down, near, pad = windows[4], windows[5], np.zeros((8, width + 6), np.float32)
    rings = np.zeros((4, 8, width), np.float32)
    third_row, third_col, rest, bend = rings[0], rings[1], rings[2], rings[3]
    by_row, by_col, square, s0 = pad[0], pad[1], pad[2], pad[3]  # zero at their ends
    s2, best, slow, extras = pad[4], pad[5], pad[6], pad[7]
    for k in range(above - 3, above + len(flags) + 3):
        out = third_row[k & 7]
        if 0 <= k < n:
            q, ok = p[k], row_ok[row_of[k]]
            _thirds(q, q[1:], q[2:], q[3:], v[k, 1:], ok, by_row, False, out)
        else:
            for x in range(width):
                out[x] = _ZERO
        j = k - 3
        out = third_col[j & 7]
        if 0 <= j < n - 3:
            ok = col_ok[row_of[j]]
            _thirds(p[j], p[j + 1], p[j + 2], p[j + 3], v[j + 1], ok, by_col, True, out)
        else:
            for x in range(width):
                out[x] = _ZERO
        j = k - 2
        lap, left = bend[j & 7], rest[j & 7]
        if 2 <= j < n - 2:
            whole = full[row_of[j]]
            _bent(p[j - 2], p[j - 1], p[j], p[j + 1], p[j + 2], whole, s0, s2, square, lap, left)
        else:
            for x in range(width):
                lap[x], left[x] = _ZERO, _ZERO
        y, r = k - 3, k - 3 - above
        if r < 0:
            continue
        at, out, lap = row_of[y], sigma[r], bend[y & 7]
        q, to, whole, mark = p[y], coordinate[r], full[at], flags[r]
        for x in range(width):
            extras[x] = _ZERO
        some = _placed(p[max(y - 1, 0)], q, p[min(y + 1, n - 1)], lap, whole, clean[y], limits, to, slow)
        if some > _ZERO:
            for x in range(width):
                if slow[x] > _ZERO:
                    extras[x], t = _edge(p, clean, amplitude, y, x, whole[x], limits)
                    if t < _REACH:
                        mark[x] |= _OFF
                    if whole[x] > _ZERO:
                        rise = p[y - 2, x] + p[y + 2, x] - q[x] - q[x]
                        run = q[x - 2] + q[x + 2] - q[x] - q[x]
                        if max(abs(rise), abs(run)) > limits[0] + limits[0]:
                            to[x] = q[x]  # a jump has no Laplacian
        by = along[at], down[at], near[at]
        _joined(third_row, third_col, rest, y, by, v[y], scale[y], lap, limits[4], best, extras, out)
