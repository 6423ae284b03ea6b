"""Creases: edges along which the slope changes too fast between pixels for any quadrature to be trusted.

An edge's increment comes from the cubic through four slopes, two on either side. Where the surface is smooth
on one side up to the edge, the slopes of that side alone, extrapolated (Adams-Bashforth, three pixels), give
the same increment. Where neither side does, slopes jump inside the edge (a cusp, a ridge, the rim of a
contact) or one of its pixels is wrong, and the smaller of the two differences is about what the increment may
be off by: the doubt. Its square joins the edge's variance, so that the solve goes around the crease, and what
can only be reached across it gets a sigma that says so.
"""

import numpy as np
import scipy.ndimage
from numba import njit
from numpy.typing import NDArray

from optolever.blocks import over_rows

from .edges import _stencil

__all__ = ["Doubt", "edge_doubt", "reached_across", "touched", "widened"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Doubt = tuple[Floats, Floats]

SIGMAS = 5.0  # of the difference's own noise: both sides exceed it by chance in no edge of a megapixel
FAINT = 2.0  # of the same, for edges that continue a crease
RISE = 3.0  # from zero at the limit: what depends continuously on the slopes is the same from any start
MATTERS = 2.0  # of a slope's announced sigma: smaller doubts change nothing
ROUGH = 0.03  # of the largest step between neighbouring slopes; waves of 20 pixels and longer stay below
_NOISE_CUBIC, _NOISE_LINEAR = 2.01, 1.19  # of cubic minus one side's three or two pixels, per slope's sigma
_SHARE = 1.0 / 12.0  # a jump inside an edge moves that edge's increment by half of it, the next one's by 1/24
_NEAR = 7  # pixels: reach of a doubt over pixels that were interpolated


def edge_doubt(
    p: Floats, q: Floats, var_p: Floats, var_q: Floats, mask: Mask, noise: float = 1.0
) -> Doubt | None:
    """What every edge's increment may be off by beyond its noise, (H, W) along columns and rows;
    None if no edge is doubtful.

    noise: what the slopes' noise really is, over what the variances say.
    """
    dx, sure_x = _axis(p, var_p, mask, 0, 1, noise)
    dy, sure_y = _axis(q, var_q, mask, 1, 0, noise)
    sure = sure_x | sure_y
    if not sure.any():
        return None
    parts, count = scipy.ndimage.label((dx > 0) | (dy > 0), structure=np.ones((3, 3)))
    found = np.zeros(count + 1, dtype=np.bool_)
    found[parts[sure]] = True
    keep = found[parts]
    dx, dy = np.where(keep, dx, 0.0), np.where(keep, dy, 0.0)
    return _shared(dx, mask), _shared(dy.T, mask.T).T.copy()


def _shared(doubt: Floats, mask: Mask) -> Floats:
    """The doubts, and their share in the cubics of the edges before and after."""
    wide = doubt.copy()
    np.maximum(wide[:, 1:], _SHARE * doubt[:, :-1], out=wide[:, 1:])
    np.maximum(wide[:, :-1], _SHARE * doubt[:, 1:], out=wide[:, :-1])
    wide[:, :-1] *= mask[:, :-1] & mask[:, 1:]
    return wide


def _axis(f: Floats, variance: Floats, mask: Mask, di: int, dj: int, noise: float) -> tuple[Floats, Mask]:
    out, sure = np.zeros(f.shape), np.zeros(f.shape, dtype=np.bool_)
    over_rows(
        lambda start, stop: _doubt(f, variance, mask, di, dj, noise, out, sure, start, stop), f.shape[0]
    )
    return out, sure


def widened(doubt: Doubt, bridged: Mask) -> Doubt:
    """Edges of interpolated pixels get the largest doubt nearby: nobody saw what is between."""
    if not bridged.any():
        return doubt
    dx, dy = doubt
    near = np.maximum(dx, dy)
    near[:, 1:] = np.maximum(near[:, 1:], dx[:, :-1])
    near[1:] = np.maximum(near[1:], dy[:-1])
    near = np.where(bridged, scipy.ndimage.maximum_filter(near, _NEAR), 0.0)
    wide_x, wide_y = dx.copy(), dy.copy()
    wide_x[:, :-1] = np.maximum(wide_x[:, :-1], np.maximum(near[:, :-1], near[:, 1:]))
    wide_y[:-1] = np.maximum(wide_y[:-1], np.maximum(near[:-1], near[1:]))
    return wide_x, wide_y


def touched(doubt: Doubt) -> Mask:
    """Pixels with a doubtful edge, (H, W)."""
    pixels: Mask = (doubt[0] > 0) | (doubt[1] > 0)
    pixels[:, 1:] |= doubt[0][:, :-1] > 0
    pixels[1:] |= doubt[1][:-1] > 0
    return pixels


def reached_across(doubt: Doubt, root: Floats, mask: Mask, anchors: NDArray[np.int64]) -> Floats:
    """Variance that the doubtful edges leave in every pixel, (H, W): the sum of the squared doubts along the
    path from an anchor (pixel numbers) that has the least of them, carried by the integrating factor root^2.
    """
    rows, cols = mask.shape
    factor = np.ascontiguousarray(np.broadcast_to(root, mask.shape))
    least = np.full(mask.shape, np.inf)
    least.reshape(-1)[anchors] = 0.0
    for _ in range(4 * (rows + cols)):
        if not _sweep(doubt[0], doubt[1], factor, mask, least):
            break
    least[~np.isfinite(least)] = 0.0
    variance: Floats = least * factor**4
    return variance


@njit(cache=True, nogil=True)
def _doubt(f, var, mask, di, dj, scale, out, sure, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = f.shape
    for i in range(start, stop):
        for j in range(cols):
            i1, j1 = i + di, j + dj
            if i1 >= rows or j1 >= cols or not mask[i, j] or not mask[i1, j1]:
                continue
            before, after = (i, rows - 1 - i) if di == 1 else (j, cols - 1 - j)
            centre = _stencil(f, mask, i, j, di, dj, before, after)
            sigma = np.sqrt(0.5 * (var[i, j] + var[i1, j1]))
            least, step, order = np.inf, abs(f[i1, j1] - f[i, j]), 2
            for side in range(2):
                s = -1 if side == 0 else 1
                a, b = (i, j) if side == 0 else (i1, j1)
                room = before if side == 0 else after - 1
                ai, aj = s * di, s * dj
                if room < 1 or not mask[a + ai, b + aj]:
                    continue
                g0, g1 = f[a, b], f[a + ai, b + aj]
                step = max(step, abs(g1 - g0))
                if room >= 2 and mask[a + 2 * ai, b + 2 * aj]:
                    g2 = f[a + 2 * ai, b + 2 * aj]
                    step = max(step, abs(g2 - g1))
                    away = abs(centre - (23.0 * g0 - 16.0 * g1 + 5.0 * g2) / 12.0)
                    least = away if order == 2 else min(least, away)
                    order = 3
                elif order == 2:
                    least = min(least, abs(centre - 0.5 * (3.0 * g0 - g1)))
            noise = sigma * scale * (_NOISE_CUBIC if order == 3 else _NOISE_LINEAR)
            limit = max(FAINT * noise, ROUGH * step)
            if np.isfinite(least) and least > limit:
                out[i, j] = min(least, RISE * (least - limit))
                sure[i, j] = least > max(SIGMAS * noise, MATTERS * sigma)


@njit(cache=True, nogil=True)
def _sweep(dx, dy, root, mask, least):  # type: ignore[no-untyped-def]
    """Shorten paths in four orders of the pixels; whether any became shorter."""
    rows, cols = mask.shape
    changed = False
    for order in range(4):
        for m in range(rows):
            i = m if order & 1 else rows - 1 - m
            for n in range(cols):
                j = n if order & 2 else cols - 1 - n
                if not mask[i, j]:
                    continue
                best = least[i, j]
                if j > 0 and mask[i, j - 1]:
                    best = min(best, least[i, j - 1] + (dx[i, j - 1] / (root[i, j] * root[i, j - 1])) ** 2)
                if j + 1 < cols and mask[i, j + 1]:
                    best = min(best, least[i, j + 1] + (dx[i, j] / (root[i, j] * root[i, j + 1])) ** 2)
                if i > 0 and mask[i - 1, j]:
                    best = min(best, least[i - 1, j] + (dy[i - 1, j] / (root[i, j] * root[i - 1, j])) ** 2)
                if i + 1 < rows and mask[i + 1, j]:
                    best = min(best, least[i + 1, j] + (dy[i, j] / (root[i, j] * root[i + 1, j])) ** 2)
                if best < least[i, j]:
                    least[i, j] = best
                    changed = True
    return changed
