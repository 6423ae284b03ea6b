"""Discontinuities: edges along which the slope changes too fast between pixels for any quadrature.

An edge's increment comes from the cubic through four slopes, two on either side. Where the surface is smooth
on one side up to the edge, the slopes of that side alone, extrapolated (Adams-Bashforth, three pixels), give
the same increment. Where neither side does, slopes jump inside the edge (a cusp, a ridge, the rim of a
contact) or one of its pixels is wrong, and the smaller of the two differences estimates the increment's
error: the doubt. Neighbouring edges share it, as the jump may lie in any of them. Its square adds to the
edge's variance, so that the solve goes around the crease, and the sigma of pixels behind it contains the
doubt.
"""

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.csgraph

from optolever.blocks import over_image
from optolever.kernels import exact, inlined

from ..arrays import Floats, Ints, Mask
from ..solver.edges import Doubt, cubic_at_end, stencil

__all__ = ["cut_off", "edge_doubt", "surest", "touched", "widened"]

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
_SHARE = 1.0 / 12.0  # a jump inside an edge moves that edge's increment by half of it, the next one's by 1/24
_BESIDE = 5  # pixels: reach of a crease's surroundings, in which doubts below the noise count too
_CERTAIN, _ABRUPT = 8.0, 0.2  # of its noise, of the largest step: residual of one side at a kink
_ONE_SIDED = 0.25  # of that, at most: the other side's residual
_KINK = 0.5  # of one side's residual, at the edge of three where it is largest
_FEEBLE = 0.5  # of a slope's sigma
_AROUND = 7  # pixels: reach of a doubt over pixels that were interpolated
_BY_LINE = 2  # pixels from a line of doubts to one that is missing along it
_MISSING = 0.02  # of the line, at least
_CHANCE = 5.0  # standard deviations of a count: no more are missing along a line by chance


def edge_doubt(
    p: Floats,
    q: Floats,
    var_p: Floats,
    var_q: Floats,
    mask: Mask,
    noise: float = 1.0,
) -> Doubt | None:
    """The doubts of slopes p, q (H, W); None if no edge is doubtful.

    noise: factor on the slopes' standard deviations.
    """
    dx, plain_x, sure_x = _axis(p, var_p, mask, (0, 1), noise)
    dy, plain_y, sure_y = _axis(q, var_q, mask, (1, 0), noise)
    sure, doubtful = sure_x | sure_y, (dx > 0) | (dy > 0)
    parts, count = scipy.ndimage.label(doubtful, structure=np.ones((3, 3)))
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    long = (sizes >= _CHAIN)[parts]
    sure |= long
    if not sure.any():
        return None
    found = np.zeros(count + 1, dtype=np.bool_)
    found[parts[sure]] = True
    found[0] = False
    near = scipy.ndimage.maximum_filter(sure, _BESIDE)
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
    f: Floats, variance: Floats, mask: Mask, step: tuple[int, int], noise: float
) -> tuple[Floats, Floats, Mask]:
    """Doubts beyond the noise, doubts whatever the noise, and where they are beyond any noise."""
    di, dj = step
    out, plain, most = (np.zeros(f.shape) for _ in range(3))
    sure = np.zeros(f.shape, dtype=np.bool_)
    over_image(
        lambda start, stop: _doubt(f, variance, mask, di, dj, noise, out, plain, most, sure, start, stop),
        f.shape,
    )
    if most.any():
        # next to an edge that neither side explains, one side always fails
        highest, explained = (
            scipy.ndimage.maximum_filter1d(part, 3, axis=1 if dj else 0) for part in (most, plain)
        )
        kink = (most >= highest) & (explained < _ONE_SIDED * most)
        for doubt in (out, plain):
            doubt[kink] = np.maximum(doubt, _KINK * most)[kink]
        sure |= kink
    return out, plain, sure


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


def cut_off(doubt: Doubt, limit: tuple[Floats, Floats], mask: Mask, anchors: Ints, lost: Mask) -> Mask:
    """Pixels that doubts beyond the limits (H, W) and missing pixels together part from every anchor.

    Where pixels are missing along a line of doubts, slopes may exceed the range, and a step of any height
    may hide between two pixels: no doubt is large enough. Where none is missing, sigma contains the doubts. A
    gap lies between an island and the anchored part: pixels missing at an island's other rim separate
    nothing. lost: pixels without a measurement.
    """
    index = np.arange(mask.size).reshape(mask.shape)
    inner = (mask[:, :-1] & mask[:, 1:], mask[:-1] & mask[1:])
    open_x, open_y = inner[0] & (doubt[0] <= limit[0])[:, :-1], inner[1] & (doubt[1] <= limit[1])[:-1]
    tail = np.concatenate([index[:, :-1][open_x], index[:-1][open_y]])
    head = np.concatenate([index[:, 1:][open_x], index[1:][open_y]])
    graph = scipy.sparse.coo_array((np.ones(tail.size), (tail, head)), shape=(mask.size, mask.size))
    parts = scipy.sparse.csgraph.connected_components(graph, directed=False)[1].reshape(mask.shape)
    held = np.zeros(parts.max() + 1, dtype=np.bool_)
    held[parts.ravel()[anchors]] = True
    islands, count = scipy.ndimage.label(mask & ~held[parts])
    if count == 0:
        return np.zeros(mask.shape, dtype=np.bool_)
    line = np.zeros(mask.shape, dtype=np.bool_)
    for closed, apart, ends in (
        (inner[0] & ~open_x, parts[:, 1:] != parts[:, :-1], (line[:, :-1], line[:, 1:])),
        (inner[1] & ~open_y, parts[1:] != parts[:-1], (line[:-1], line[1:])),
    ):
        for end in ends:
            end |= closed & apart
    along = np.where(line, islands, 0)
    near, sides = (
        scipy.ndimage.maximum_filter(part, 2 * _BY_LINE + 1) for part in (along, mask & held[parts])
    )
    missing, area, length = (
        np.bincount(part.ravel(), minlength=count + 1) for part in (near[lost & sides], near[sides], along)
    )
    usual = area * (missing[0] / max(area[0], 1))
    torn = (missing > usual + _CHANCE * np.sqrt(usual)) & (missing >= _MISSING * length)
    torn[0] = False
    away: Mask = torn[islands]
    return away


@inlined
def _edge(f, var, mask, i, j, di, dj, before, after, scale):  # type: ignore[no-untyped-def]
    """Of the edge from (i, j): the smaller residual of both sides, beyond the noise and regardless of it (inf
    without a side of enough pixels); whether it exceeds the noise for certain; the largest certain residual.
    """
    i1, j1 = i + di, j + dj
    centre = stencil(f, mask, i, j, di, dj, before, after)
    sigma = np.sqrt(0.5 * (var[i, j] + var[i1, j1]))
    rise = abs(f[i1, j1] - f[i, j])
    least, certain, whatever, largest = np.inf, np.inf, np.inf, 0.0
    for side in range(2):
        s = -1 if side == 0 else 1
        a, b, c, d = (i, j, i1, j1) if side == 0 else (i1, j1, i, j)
        room = before if side == 0 else after - 1
        ai, aj = s * di, s * dj
        if room < 1 or not mask[a + ai, b + aj]:
            continue
        g, g0, g1 = f[c, d], f[a, b], f[a + ai, b + aj]
        step = max(rise, abs(g1 - g0))
        if room >= 2 and mask[a + 2 * ai, b + 2 * aj]:
            g2 = f[a + 2 * ai, b + 2 * aj]
            step = max(step, abs(g2 - g1))
            away = abs(centre - (23.0 * g0 - 16.0 * g1 + 5.0 * g2) / 12.0)
            away = max(away, abs(centre - (5.0 * g + 8.0 * g0 - g1) / 12.0))
            if room >= 3 and mask[a + 3 * ai, b + 3 * aj]:
                g3 = f[a + 3 * ai, b + 3 * aj]
                away = max(away, _BEND * abs(g0 - g3 - 3.0 * (g1 - g2)))
                finer = abs(centre - (55.0 * g0 - 59.0 * g1 + 37.0 * g2 - 9.0 * g3) / 24.0)
                finer = max(finer, abs(centre - cubic_at_end(g, g0, g1, g2)))
                if room >= 4 and mask[a + 4 * ai, b + 4 * aj]:
                    g4 = f[a + 4 * ai, b + 4 * aj]
                    finer = max(finer, _BEND4 * abs(g0 + g4 - 4.0 * (g1 + g3) + 6.0 * g2))
                if finer < _CONVERGES * away:
                    away = finer
            noise = sigma * scale * _NOISE_CUBIC
        else:
            away = abs(centre - 0.5 * (3.0 * g0 - g1))
            noise = sigma * scale * _NOISE_LINEAR
        limit = max(_FAINT * noise, _ROUGH * step)
        least = min(least, min(away, max(0.0, _RISE * (away - limit))))
        whatever = min(whatever, away)
        # a border's pixels may be noisier than this edge's
        if room >= 3 and away > max(_CERTAIN * noise, _MATTERS * sigma, _ABRUPT * step):
            largest = max(largest, away)
        certain = min(certain, away / max(_SIGMAS * noise, _MATTERS * sigma))
    sure = least > 0.0 and certain > 1.0 and np.isfinite(least)
    return least if least > _FEEBLE * sigma else 0.0, whatever, sure, largest


@exact
def _doubt(f, var, mask, di, dj, scale, out, plain, most, sure, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = f.shape
    for i in range(start, min(stop, rows - di)):
        for j in range(cols - dj):
            if not (mask[i, j] and mask[i + di, j + dj]):
                continue
            before, after = (i, rows - 1 - i) if di == 1 else (j, cols - 1 - j)
            least, whatever, certain, largest = _edge(f, var, mask, i, j, di, dj, before, after, scale)
            if np.isfinite(whatever):
                out[i, j], plain[i, j], most[i, j], sure[i, j] = least, whatever, largest, certain
