"""Pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel is refused that its
neighbours confirm.

A place is the mean over a pixel's area and the blur of the lens: half of their second moment times the
Laplacian of the map is subtracted, and the uncertainty of the moment joins the variance. Three excesses over
noise join it, too: of the residuals around a pixel (chi2), of third differences over 7 x 7 pixels, and of the
residual to the quadratic of 5 x 5 (a crease has no third differences beyond its own pixels). At flagged pixels
and at the image's border the place is that of the lit part of the aperture, at the display's border that of
its lit cells.

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

from optolever.kernels import inlined, kernel

from .plan import AxisPlan
from .records import Flag

__all__ = ["HALO", "Block", "Result", "axis_limits", "neighbours"]

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
#: Rows that a block needs on either side of its result.
HALO = 4
#: Usual blur of a camera's lens, and of a soft one, px of the camera; of a display, cells.
_LENS, _SOFT, _BLUR = 0.35, 0.6, 0.6
#: Squared standard deviations beyond which neighbours contradict; thresholds of third differences and of the
#: residual to the quadratic, over noise; one over the share of noise in it.
_SURE2, _THIRD, _REST, _OFF2 = np.float32(25), np.float32(1.2), np.float32(1.6), np.float32(175 / 148)
#: Squared shares of a step between neighbours: beside flagged pixels, one further; least variance, px^2; the
#: display's border is flagged up to so many of its reaches.
_RIM2, _SECOND2, _LEAST, _REACH = np.float32(0.09), np.float32(0.0036), np.float32(1e-4), np.float32(1.2)
_ZERO, _ONE = np.float32(0), np.float32(1)
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
    clean, full, scale, along, down, near = np.empty((6, *shape), np.float32)
    flags = np.empty(shape, np.uint16)
    _cleaned(block.place, block.variance, block.amplitude, block.flags, limits, clean, flags)
    _shared(clean, block.chi2, np.float32(dof), full, scale, along, down, near)
    own = slice(above, above + len(result.flags))
    result.flags[:] = flags[own]
    for k, numbers in enumerate(limits):
        if numbers[_FINE] > 0:
            maps = block.place[k], block.variance[k], clean, block.amplitude
            _axis(
                *maps,
                full,
                scale,
                along,
                down,
                near,
                above,
                numbers,
                result.coordinate[k],
                result.sigma[k],
                result.flags,
            )
        else:
            result.coordinate[k] = block.place[k, own]
            np.sqrt(np.maximum(block.variance[k, own] * scale[own], _LEAST), out=result.sigma[k])


@inlined
def _agrees(off: np.float32, variance: np.float32, jump: np.float32) -> bool:
    """Whether a difference of places is within the jump and noise."""
    beyond = abs(off) - jump
    return beyond * beyond < _SURE2 * variance or beyond < _ZERO


@kernel
def _cleaned(
    place: F32, variance: F32, amplitude: F32, flags: U16, limits: F32, clean: F32, found: U16
) -> None:
    """Good pixels (n, W) that neighbours confirm on every axis and that are lit on more than half of their area."""
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
            some, inner = np.uint16(0), sure[1:]
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
                top = max(
                    top, light[low] if mine[low] == 0 else _ZERO, light[high] if mine[high] == 0 else _ZERO
                )
                if light[x] < half * top:
                    out[x] |= _OUTLIER
        good = clean[y]
        for x in range(width):
            good[x] = _ONE if out[x] == 0 else _ZERO


@kernel
def _shared(
    clean: F32, chi2: F32, dof: np.float32, full: F32, scale: F32, along: F32, down: F32, near: F32
) -> None:
    """Of the pixels (n, W) for all axes: whether 5 x 5 are clean; scale of the variance by chi2; one over the
    number of third differences along the row and down the column in 7 x 7, and of full pixels in 3 x 3."""
    n, width = clean.shape
    count, z, four, rows = np.zeros((4, width + 6), np.float32)
    some = max(dof, _ONE)
    most, share = np.float32(25), _ONE / some
    mean = _ONE + np.float32(1.1314) / np.sqrt(some)  # four deviations of the mean of 25 pixels
    alone = _ONE + np.float32(7.0711) / np.sqrt(some) + np.float32(8) / some
    for y in range(n):
        first, last = max(y - 2, 0), min(y + 3, n)
        for x in range(width + 6):
            count[x], z[x], four[x], rows[x] = _ZERO, _ZERO, _ZERO, _ZERO
        shifted, total = count[2:], z[2:]
        for k in range(first, last):
            c, r = clean[k], chi2[k]
            for x in range(width):
                shifted[x] += c[x]
                total[x] += c[x] * min(share * r[x], most)
        whole, by, own = full[y], scale[y], chi2[y]
        for x in range(width):
            number = count[x] + count[x + 1] + count[x + 2] + count[x + 3] + count[x + 4]
            whole[x] = _ONE if number > np.float32(24.5) else _ZERO
            level = (z[x] + z[x + 1] + z[x + 2] + z[x + 3] + z[x + 4]) / max(number, _ONE)
            level = level if level > mean else _ONE
            alone2 = share * own[x]
            by[x] = max(level, alone2 if alone2 > alone else _ONE) if dof > _ZERO else _ONE
        shifted, total = four[3:], rows[3:]
        for k in range(max(y - 3, 0), min(y + 4, n)):
            c = clean[k]
            for x in range(width - 3):
                shifted[x] += c[x] * c[x + 1] * c[x + 2] * c[x + 3]
        for k in range(max(y - 3, 0), min(y + 1, n - 3)):
            c, c1, c2, c3 = clean[k], clean[k + 1], clean[k + 2], clean[k + 3]
            for x in range(width):
                total[x] += c[x] * c1[x] * c2[x] * c3[x]
        row, column, three = along[y], down[y], np.float32(3.5)
        for x in range(width):
            number = four[x] + four[x + 1] + four[x + 2] + four[x + 3]
            row[x] = _ONE / number if number > three else _ZERO
        for x in range(width):
            number = (
                rows[x] + rows[x + 1] + rows[x + 2] + rows[x + 3] + rows[x + 4] + rows[x + 5] + rows[x + 6]
            )
            column[x] = _ONE / number if number > three else _ZERO
    for y in range(n):
        for x in range(width + 2):
            count[x] = _ZERO
        shifted = count[1:]
        for k in range(max(y - 1, 0), min(y + 2, n)):
            c = full[k]
            for x in range(width):
                shifted[x] += c[x]
        out = near[y]
        for x in range(width):
            number = count[x] + count[x + 1] + count[x + 2]
            out[x] = _ONE / number if number > _ZERO else _ZERO


@kernel
def _edge(
    p: F32, clean: F32, amplitude: F32, y: int, x: int, full: np.float32, limits: F32
) -> tuple[np.float32, np.float32]:
    """Variance of a clean pixel by the border of the image, of flagged pixels and of the display; distance to
    the display's border over its reach."""
    n, width = p.shape
    step2, loss, number, top, all_clean = _ZERO, _ZERO, 0, _ZERO, True
    flagged = False
    for axis in range(2):
        slope, sides = _ZERO, 0
        for sign in (-1, 1):
            j, i = (y, x + sign) if axis == 0 else (y + sign, x)
            if j < 0 or j >= n or i < 0 or i >= width:
                all_clean = False
            elif clean[j, i] > _ZERO:
                slope += np.float32(sign) * (p[j, i] - p[y, x])
                top = max(top, amplitude[j, i])
                sides += 1
            else:
                all_clean, flagged = False, True
        slope = slope / np.float32(max(sides, 1))
        step2 += slope * slope
    extra = _ZERO
    if full == _ZERO:
        extra = step2 * (_RIM2 if not all_clean else _SECOND2)
    if flagged:
        loss = np.float32(0.5) * max(_ONE - amplitude[y, x] / max(top, np.float32(1e-6)), _ZERO)
        extra += loss * loss * step2
    if full == _ZERO and 0 < y < n - 1 and 0 < x < width - 1:
        number, bend = 0, _ZERO
        for i in range(-1, 2):
            for j in range(-1, 2):
                if clean[y + i, x + j] > _ZERO:
                    number += 1
                    bend += (np.float32(i * i + j * j) - np.float32(4 / 3)) * (p[y + i, x + j] - p[y, x])
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


@kernel
def _axis(
    p: F32,
    v: F32,
    clean: F32,
    amplitude: F32,
    full: F32,
    scale: F32,
    along: F32,
    down: F32,
    near: F32,
    above: int,
    limits: F32,
    coordinate: F32,
    sigma: F32,
    flags: U16,
) -> None:
    """One axis with places within a cell: aperture, excesses over noise, rims and borders."""
    n, width = p.shape
    rows = len(flags)
    _, extent, border, aperture, unsure, _ = limits
    third_row, third_col = np.zeros((n, width + 3), np.float32), np.zeros((n, width + 6), np.float32)
    rest, bend = np.zeros((n, width + 2), np.float32), np.zeros((n, width), np.float32)
    s0, s2, best, slow = np.zeros((4, width + 6), np.float32)
    three, four, five, most, share = (
        np.float32(3),
        np.float32(4),
        np.float32(5),
        np.float32(25),
        np.float32(0.05),
    )
    half, sixteen, quarter = np.float32(0.5), np.float32(16), np.float32(0.25)
    for y in range(max(above - 3, 0), min(above + rows + 3, n)):
        q, c, w, e = p[y], clean[y], v[y, 1:], third_row[y, 3:]
        for x in range(width - 3):
            h = q[x + 3] - q[x] + three * (q[x + 1] - q[x + 2])
            ok = c[x] * c[x + 1] * c[x + 2] * c[x + 3]
            e[x] = min(share * h * h, most * w[x]) if ok > _ZERO else _ZERO
    for y in range(max(above - 3, 0), min(above + rows, n - 3)):
        q, q1, q2, q3 = p[y], p[y + 1], p[y + 2], p[y + 3]
        c, c1, c2, c3 = clean[y], clean[y + 1], clean[y + 2], clean[y + 3]
        w, e = v[y + 1], third_col[y, 3:]
        for x in range(width):
            best[x] = c[x] * c1[x] * c2[x] * c3[x]
        for x in range(width):
            h = q3[x] - q[x] + three * (q1[x] - q2[x])
            e[x] = min(share * h * h, most * w[x]) if best[x] > _ZERO else _ZERO
    for y in range(max(above - 1, 2), min(above + rows + 1, n - 2)):
        q, q1, q2, q3, q4 = p[y], p[y - 2], p[y - 1], p[y + 1], p[y + 2]
        for x in range(width):
            outer, inner = q1[x] + q4[x] - q[x] - q[x], q2[x] + q3[x] - q[x] - q[x]
            s0[x], s2[x] = outer + inner, four * outer + inner
        whole, out, left = full[y, 2:], bend[y, 2:], rest[y, 3:]
        for x in range(width - 4):
            mid = q[x + 2]
            e1, e2, e3, e4 = q[x] - mid, q[x + 1] - mid, q[x + 3] - mid, q[x + 4] - mid
            ends, inner = five * (e1 + e4) + s0[x] + s0[x + 4], five * (e2 + e3) + s0[x + 1] + s0[x + 3]
            total = ends + inner + s0[x + 2]
            curve = (
                s2[x] + s2[x + 1] + s2[x + 2] + s2[x + 3] + s2[x + 4] + np.float32(10) * (e1 + e2 + e3 + e4)
            )
            curve = (curve + four * ends + inner - four * total) * np.float32(1 / 35)
            off = total * np.float32(0.04) - curve
            out[x] = curve if whole[x] > _ZERO else _ZERO
            left[x] = off * off * _OFF2 if whole[x] > _ZERO else _ZERO
    for r in range(rows):
        y = r + above
        for x in range(width + 6):
            s0[x], s2[x], best[x] = _ZERO, _ZERO, _ZERO
        for k in range(max(y - 3, 0), min(y + 4, n)):
            e = third_row[k]
            for x in range(width + 3):
                s0[x] += e[x]
        for k in range(max(y - 3, 0), min(y + 1, n - 3)):
            e = third_col[k]
            for x in range(width + 6):
                s2[x] += e[x]
        one, other = along[y], down[y]
        for x in range(width):
            best[x] = (s0[x] + s0[x + 1] + s0[x + 2] + s0[x + 3]) * one[x]
        for x in range(width):
            total = s2[x] + s2[x + 1] + s2[x + 2] + s2[x + 3] + s2[x + 4] + s2[x + 5] + s2[x + 6]
            best[x] = max(best[x], total * other[x])
        for x in range(width + 2):
            s0[x] = _ZERO
        for k in range(max(y - 1, 0), min(y + 2, n)):
            e = rest[k]
            for x in range(width + 2):
                s0[x] += e[x]
        out, w, by, share3, lap = sigma[r], v[y], scale[y], near[y], bend[y]
        for x in range(width):
            noise = w[x] * by[x]
            third = max(best[x] - _THIRD * noise, _ZERO)
            fourth = max((s0[x] + s0[x + 1] + s0[x + 2]) * share3[x] - _REST * noise, _ZERO)
            moved = unsure * lap[x]
            out[x] = noise + third + fourth + moved * moved
        q, to, whole = p[y], coordinate[r], full[y]
        for x in range(width):
            to[x] = q[x] - aperture * lap[x]
        upper, lower = p[max(y - 1, 0)], p[min(y + 1, n - 1)]
        for x in range(width):
            slow[x] = _ONE - whole[x]
        inner, outside = slow[1:], whole[1:]
        for x in range(width - 2):
            dx, dy = q[x + 2] - q[x], lower[x + 1] - upper[x + 1]
            reach2 = (half * aperture * (dx * dx + dy * dy) + border) * sixteen
            away = min(q[x + 1] + half, extent - half - q[x + 1])
            inner[x] = _ONE if (away * abs(away) < reach2) & (border > _ZERO) else _ONE - outside[x]
        c, mark = clean[y], flags[r]
        for x in range(width):
            if slow[x] > _ZERO and c[x] > _ZERO:
                extra, t = _edge(p, clean, amplitude, y, x, whole[x], limits)
                out[x] += extra
                if t < _REACH:
                    mark[x] |= _OFF
        for x in range(width):
            out[x] = np.sqrt(max(out[x], _LEAST))
