"""Discontinuities: edges along which the slope changes too fast between pixels for any quadrature.

An edge's increment comes from the cubic through four slopes, two on either side. Where the surface is smooth
on one side up to the edge, the slopes of that side alone, extrapolated (Adams-Bashforth, three pixels), give
the same increment. Where neither side does, slopes jump inside the edge (a cusp, a ridge, the rim of a
contact) or one of its pixels is wrong, and the smaller of the two differences estimates the increment's
error: the doubt. Neighbouring edges share it, as the jump may lie in any of them. Its square adds to the
edge's variance, so that the solve goes around the crease, and the sigma of pixels behind it contains the
doubt.
"""

from itertools import accumulate

import cv2
import numpy as np
import scipy.ndimage

from optolever.blocks import over_rows

from ..arrays import Floats, Ints, Mask
from ..solver.edges import Doubt, cubic_at_end, cubic_inside

__all__ = ["edge_doubt", "surest", "touched", "widened"]

_SIGMAS = 5.0  # of the difference's noise: both sides exceed it by chance in no edge of a megapixel
_FAINT = 2.0  # of the same, for edges that continue a crease
_CHAIN = 16  # such edges side by side are a crease too: noise alone strings together a dozen in a megapixel
_RISE = 3.0  # from zero at the limit: what depends continuously on the slopes is the same from any start
_MATTERS = 2.0  # of a slope's announced sigma: smaller doubts change nothing
_ROUGH = 0.03  # of the largest step between neighbouring slopes; waves of 20 pixels and longer stay below
_NOISE_CUBIC, _NOISE_LINEAR = 2.01, 1.19  # of cubic minus one side's three or two pixels, per slope's sigma
_BEND = 0.375  # of a side's third difference: the error of its extrapolation
_BEND4 = 0.349  # of its fourth difference: that of the next order
_CONVERGES = 0.5  # errors that fall so from one order to the next are those of a curve, not of a jump
_REACH, _BLOCK = 4, 1 << 15  # pixels on either side; pixels at once: what they need stays in the cache
_SHARE = 1.0 / 12.0  # a jump inside an edge moves that edge's increment by half of it, the next one's by 1/24
_BESIDE = 5  # pixels: reach of a crease's surroundings, in which doubts below the noise count too
_CERTAIN, _ABRUPT = 8.0, 0.2  # of its noise, of the largest step: residual of one side at a kink
_ONE_SIDED = 0.25  # of that, at most: the other side's residual
_KINK = 0.5  # of one side's residual, at the edge of three where it is largest
_FEEBLE = 0.5  # of a slope's sigma
_AROUND = 7  # pixels: reach of a doubt over pixels that were interpolated


def edge_doubt(
    p: Floats, q: Floats, var_p: Floats, var_q: Floats, mask: Mask, noise: float = 1.0
) -> Doubt | None:
    """The doubts of slopes p, q (H, W); None if no edge is doubtful.

    noise: factor on the slopes' standard deviations.
    """
    along, down = (p, var_p, mask, 1, noise), (q, var_q, mask, 0, noise)
    (dx, plain_x, sure_x, seen_x), (dy, plain_y, sure_y, seen_y) = _axis(*along), _axis(*down)
    sure, doubtful = sure_x | sure_y, (dx > 0) | (dy > 0)
    count, parts, boxes, _ = cv2.connectedComponentsWithStats(doubtful.view(np.uint8))
    long = boxes[:, cv2.CC_STAT_AREA] >= _CHAIN
    long[0] = False
    if long.any():
        sure |= long[parts]
    if not sure.any():
        return None
    found = np.zeros(count, dtype=np.bool_)
    found[parts[sure]] = True
    found[0] = False
    near = scipy.ndimage.maximum_filter(sure, _BESIDE)
    for plain, seen, field in ((plain_x, seen_x, along), (plain_y, seen_y, down)):
        at = np.flatnonzero(near & ~seen)
        plain.flat[at] = _residuals(*field, at)[1]
    dx, dy = (
        np.where(near, plain, np.where(found[parts], doubt, 0.0))
        for doubt, plain in ((dx, plain_x), (dy, plain_y))
    )
    return Doubt(_shared(dx, mask), _shared(dy.T, mask.T).T.copy())


def _shared(doubt: Floats, mask: Mask) -> Floats:
    """The doubts along rows, and their share in the cubics of the edges before and after."""
    wide = doubt.copy()
    np.maximum(wide[:, 1:], _SHARE * doubt[:, :-1], out=wide[:, 1:])
    np.maximum(wide[:, :-1], _SHARE * doubt[:, 1:], out=wide[:, :-1])
    wide[:, :-1] *= mask[:, :-1] & mask[:, 1:]
    wide[:, -1] = 0.0
    return wide


def _axis(
    f: Floats, variance: Floats, mask: Mask, axis: int, noise: float
) -> tuple[Floats, Floats, Mask, Mask]:
    """Doubts beyond the noise, doubts whatever the noise, and where they are beyond any noise; of the edges
    of the last mask alone, beside which all others have none."""
    seen = _rough(f, variance, mask, axis, noise)
    at = np.flatnonzero(seen)
    out, plain, most = (np.zeros(f.shape) for _ in range(3))
    sure = np.zeros(f.shape, np.bool_)
    for image, values in zip(
        (out, plain, most, sure), _residuals(f, variance, mask, axis, noise, at), strict=True
    ):
        image.flat[at] = values
    if most.any():
        # next to an edge that neither side explains, one side always fails
        highest, explained = (scipy.ndimage.maximum_filter1d(part, 3, axis=axis) for part in (most, plain))
        kink = (most >= highest) & (explained < _ONE_SIDED * most)
        for doubt in (out, plain):
            doubt[kink] = np.maximum(doubt, _KINK * most)[kink]
        sure |= kink
    return out, plain, sure, seen


def touched(doubt: Doubt) -> Mask:
    """Pixels with a doubtful edge, (H, W)."""
    pixels: Mask = (doubt[0] > 0) | (doubt[1] > 0)
    pixels[:, 1:] |= doubt[0][:, :-1] > 0
    pixels[1:] |= doubt[1][:-1] > 0
    return pixels


def widened(doubt: Doubt, guessed: Mask) -> Doubt:
    """Edges of interpolated pixels (guessed, (H, W)) get the largest doubt nearby."""
    dx, dy = doubt
    near = np.maximum(dx, dy)
    near[:, 1:] = np.maximum(near[:, 1:], dx[:, :-1])
    near[1:] = np.maximum(near[1:], dy[:-1])
    near = np.where(guessed, scipy.ndimage.maximum_filter(near, _AROUND), 0.0)
    wide_x, wide_y = dx.copy(), dy.copy()
    wide_x[:, :-1] = np.maximum(wide_x[:, :-1], np.maximum(near[:, :-1], near[:, 1:]))
    wide_y[:-1] = np.maximum(wide_y[:-1], np.maximum(near[:-1], near[1:]))
    return Doubt(wide_x, wide_y)


def surest(doubt: Doubt, mask: Mask) -> Floats:
    """The doubt of every pixel's surest edge, (H, W)."""
    x, y = np.full(mask.shape, np.inf), np.full(mask.shape, np.inf)
    x[:, :-1] = np.where(mask[:, :-1] & mask[:, 1:], doubt.x[:, :-1], np.inf)
    y[:-1] = np.where(mask[:-1] & mask[1:], doubt.y[:-1], np.inf)
    least = np.minimum(x, y)
    least[:, 1:] = np.minimum(least[:, 1:], x[:, :-1])
    least[1:] = np.minimum(least[1:], y[:-1])
    return np.where(np.isfinite(least), least, 0.0)


def _rough(f: Floats, variance: Floats, mask: Mask, axis: int, noise: float) -> Mask:
    """Edges along an axis that may have a doubt, and their neighbours along it: third differences bound what
    both sides leave, where no pixel is missing."""
    rough, size = np.zeros(f.shape, np.bool_), f.shape[axis]
    lines = np.moveaxis(rough, axis, 0)
    if size <= 2 * _REACH + 2:
        rough[:] = True
        return rough
    lines[:_REACH], lines[-_REACH - 2 :] = True, True
    bound = 2.0 * _CERTAIN**2 * _NOISE_CUBIC**2 * noise**2
    inner = slice(_REACH, size - _REACH - 2)

    def work(start: int, stop: int) -> None:
        """Rows or, along columns, rows of edges."""
        if axis == 1:
            field, spread, out = f[start:stop].T, variance[start:stop].T, rough[start:stop].T[inner]
        else:
            start, stop = max(start, inner.start), min(stop, inner.stop)
            if start >= stop:
                return
            around = slice(start - _REACH, stop + _REACH + 2)
            field, spread, out = f[around], variance[around], rough[start:stop]
        count = len(out)
        third = np.abs(field[3:] - field[:-3] - 3.0 * (field[2:-1] - field[1:-2]))
        beside, centre, far = third * (10.0 / 24.0), third[_REACH - 1 :][:count] / 24.0, third * _BEND
        one, other = (
            np.maximum(beside[_REACH - 1 + k :][:count] + centre, far[_REACH - 1 + 2 * k :][:count])
            for k in (-1, 1)
        )
        least = np.maximum(np.minimum(one, other) * (_CERTAIN / _FAINT), np.maximum(one, other))
        least *= least
        np.greater(least, 0.25 * bound * (spread[_REACH:][:count] + spread[_REACH + 1 :][:count]), out=out)

    with np.errstate(invalid="ignore", over="ignore"):
        over_rows(work, len(f), max(8, _BLOCK // f.shape[1]))
    if not mask.all():
        part = np.moveaxis(~mask, axis, 0)
        for k in range(-_REACH, _REACH + 2):  # pixels that an edge's residuals ask for
            lines[max(0, -k) : size - max(0, k)] |= part[max(0, k) : size - max(0, -k)]
    wide = np.moveaxis(rough.copy(), axis, 0)
    wide[1:] |= lines[:-1]
    wide[:-1] |= lines[1:]
    inside = np.moveaxis(mask, axis, 0)
    wide &= inside
    wide[:-1] &= inside[1:]
    wide[-1] = False
    return np.moveaxis(wide, 0, axis)


def _residuals(
    f: Floats, variance: Floats, mask: Mask, axis: int, noise: float, at: Ints
) -> tuple[Floats, Floats, Floats, Mask]:
    """Of edges along an axis (0: to the next row), by the numbers of their first pixels: the smaller residual
    of both sides, beyond the noise and regardless of it; the largest one that is certain; whether the smaller
    exceeds the noise for certain.
    """
    size, step = f.shape[axis], f.shape[1] if axis == 0 else 1
    place = at // f.shape[1] if axis == 0 else at % f.shape[1]
    known, values = mask.ravel(), f.ravel()
    g, there = {}, {}
    for k in range(-_REACH, _REACH + 2):
        inside = (place + k >= 0) & (place + k < size)
        pixel = np.where(inside, at + k * step, at)
        there[k] = inside & known[pixel]
        g[k] = np.where(there[k], values[pixel], 0.0)
    with np.errstate(all="ignore"):
        centre = cubic_inside(g[-1], g[0], g[1], g[2])
        end = np.where(there[-1] & there[-2], cubic_at_end(g[1], g[0], g[-1], g[-2]), 0.5 * (g[0] + g[1]))
        end = np.where(there[2] & there[3], cubic_at_end(g[0], g[1], g[2], g[3]), end)
        centre = np.where(there[-1] & there[2], centre, end)
        beyond_edge = variance.ravel()[np.where(place + 1 < size, at + step, at)]
        sigma = np.sqrt(0.5 * (variance.ravel()[at] + beyond_edge))
        rise, sides = np.abs(g[1] - g[0]), []
        for sign in (-1, 1):
            near = 0 if sign < 0 else 1
            g0, g1, g2, g3, g4 = (g[near + sign * k] for k in range(5))
            one, two, three, four = accumulate((there[near + sign * k] for k in range(1, 5)), np.logical_and)
            other = g[1 - near]
            step_size = np.maximum(rise, np.abs(g1 - g0))
            step_size = np.where(two, np.maximum(step_size, np.abs(g2 - g1)), step_size)
            away = np.abs(centre - (23.0 * g0 - 16.0 * g1 + 5.0 * g2) / 12.0)
            away = np.maximum(away, np.abs(centre - (5.0 * other + 8.0 * g0 - g1) / 12.0))
            bent = np.maximum(away, _BEND * np.abs(g0 - g3 - 3.0 * (g1 - g2)))
            finer = np.abs(centre - (55.0 * g0 - 59.0 * g1 + 37.0 * g2 - 9.0 * g3) / 24.0)
            finer = np.maximum(finer, np.abs(centre - cubic_at_end(other, g0, g1, g2)))
            fourth = _BEND4 * np.abs(g0 + g4 - 4.0 * (g1 + g3) + 6.0 * g2)
            finer = np.where(four, np.maximum(finer, fourth), finer)
            bent = np.where(finer < _CONVERGES * bent, finer, bent)
            away = np.where(two, away, np.abs(centre - 0.5 * (3.0 * g0 - g1)))
            away = np.where(three, bent, away)
            noisy = sigma * (noise * np.where(two, _NOISE_CUBIC, _NOISE_LINEAR))
            limit = np.maximum(_FAINT * noisy, _ROUGH * step_size)
            beyond = np.minimum(away, np.maximum(0.0, _RISE * (away - limit)))
            # a border's pixels may be noisier than this edge's
            high = away > np.maximum(np.maximum(_CERTAIN * noisy, _MATTERS * sigma), _ABRUPT * step_size)
            high &= one & (place >= 3 if sign < 0 else place < size - 4)
            ratio = away / np.maximum(_SIGMAS * noisy, _MATTERS * sigma)
            sides.append((*(np.where(one, part, np.inf) for part in (beyond, away, ratio)), high * away))
        least, whatever, certain = (np.minimum(sides[0][k], sides[1][k]) for k in range(3))
        edge = there[0] & there[1] & np.isfinite(whatever)
        out = np.where(edge & (least > _FEEBLE * sigma), least, 0.0)
        most = np.where(edge, np.maximum(sides[0][3], sides[1][3]), 0.0)
        return out, np.where(edge, whatever, 0.0), most, edge & (least > 0) & (certain > 1)
