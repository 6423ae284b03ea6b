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

from optolever.blocks import over_image
from optolever.kernels import exact, inlined

from ..arrays import Floats, Mask
from ..solver.edges import Doubt, cubic_at_end, curl, stencil

__all__ = ["CONVERGES", "RISE", "SIGMAS", "edge_doubt", "touched"]

SIGMAS = 5.0  # of the difference's noise: both sides exceed it by chance in no edge of a megapixel
FAINT = 2.0  # of the same, for edges that continue a crease
_CHAIN = 16  # such edges side by side are a crease too: noise alone strings together a dozen in a megapixel
RISE = 3.0  # from zero at the limit: what depends continuously on the slopes is the same from any start
MATTERS = 2.0  # of a slope's announced sigma: smaller doubts change nothing
ROUGH = 0.03  # of the largest step between neighbouring slopes; waves of 20 pixels and longer stay below
_NOISE_CUBIC, _NOISE_LINEAR = 2.01, 1.19  # of cubic minus one side's three or two pixels, per slope's sigma
_BEND = 0.375  # of a side's third difference: the error of its extrapolation
_BEND4 = 0.349  # of its fourth difference: that of the next order
CONVERGES = 0.5  # errors that fall so from one order to the next are those of a curve, not of a jump
_QUIET = 8.0  # of a slope's sigma: third differences of noise (4.5) and little more
_SHARE = 1.0 / 12.0  # a jump inside an edge moves that edge's increment by half of it, the next one's by 1/24
_BESIDE = 5  # pixels: reach of a crease's surroundings, in which doubts below the noise count too
_BLAME = 13.0 / 12.0  # a wrong slope is in its edges by 13/24, in the curl around it by half
_CERTAIN, _ABRUPT = 8.0, 0.2  # of its noise, of the largest step: residual of one side at a kink
_ONE_SIDED = 0.25  # of that, at most: the other side's residual
_KINK = 0.5  # of one side's residual, at the edge of three where it is largest
_FEEBLE = 0.5  # of a slope's sigma
_BY_ACCIDENT = 0.1  # of the next doubt: after a jump within one edge, the next edge's error is a twelfth


def edge_doubt(
    p: Floats,
    q: Floats,
    var_p: Floats,
    var_q: Floats,
    mask: Mask,
    noise: float = 1.0,
    suspects: Mask | None = None,
) -> Doubt | None:
    """The doubts of slopes p, q (H, W); None if no edge is doubtful.

    noise: factor on the slopes' standard deviations; suspects (H, W): pixels that are blamed for a curl and
    yet in use.
    """
    blamed = suspects is not None and bool(suspects.any())
    dx, plain_x, sure_x = _axis(p, var_p, mask, (0, 1), noise)
    dy, plain_y, sure_y = _axis(q, var_q, mask, (1, 0), noise)
    sure, doubtful = sure_x | sure_y, (dx > 0) | (dy > 0)
    parts, count = scipy.ndimage.label(doubtful, structure=np.ones((3, 3)))
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    long = (sizes >= _CHAIN)[parts]
    sure |= long
    if not (blamed or sure.any()):
        return None
    found = np.zeros(count + 1, dtype=np.bool_)
    found[parts[sure]] = True
    found[0] = False
    near = scipy.ndimage.maximum_filter(sure, _BESIDE)
    dx, dy = (
        np.where(near, plain, np.where(found[parts], doubt, 0.0))
        for doubt, plain in ((dx, plain_x), (dy, plain_y))
    )
    lines = scipy.ndimage.maximum_filter(long, _BESIDE)
    dx, dy = _beside(dx, var_p, lines), _beside(dy, var_q, lines)
    if suspects is not None and blamed:
        curls = np.where(suspects, _BLAME * _largest_curl(p, q, mask), 0.0)
        dx, dy = np.maximum(dx, curls), np.maximum(dy, curls)
        dx[:, :-1], dy[:-1] = np.maximum(dx[:, :-1], curls[:, 1:]), np.maximum(dy[:-1], curls[1:])
    return Doubt(_shared(dx, mask), _shared(dy.T, mask.T).T.copy())


def _largest_curl(p: Floats, q: Floats, mask: Mask) -> Floats:
    """Of the squares around every pixel, (H, W)."""
    size = np.pad(np.abs(np.nan_to_num(curl(p, q, mask))), ((1, 0), (1, 0)))
    largest: Floats = np.maximum(
        np.maximum(size[:-1, :-1], size[:-1, 1:]), np.maximum(size[1:, :-1], size[1:, 1:])
    )
    return largest


def _beside(doubt: Floats, variance: Floats, lines: Mask) -> Floats:
    """Doubts, along lines of them (H, W) at least as large as those of the edges around, unless these say
    nothing of an edge or noise hides what they do.

    Where a crease curves through the pixels, one side explains the very edge it lies in by accident, time and
    again, and always when that is off to the same side: the next edge is in doubt instead.
    """
    most = scipy.ndimage.maximum_filter(doubt, 3)
    shared = lines & (doubt > _BY_ACCIDENT * most) & (most > _QUIET * np.sqrt(variance))
    return np.where(shared, most, doubt)


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
                if finer < CONVERGES * away:
                    away = finer
            noise = sigma * scale * _NOISE_CUBIC
        else:
            away = abs(centre - 0.5 * (3.0 * g0 - g1))
            noise = sigma * scale * _NOISE_LINEAR
        limit = max(FAINT * noise, ROUGH * step)
        least = min(least, min(away, max(0.0, RISE * (away - limit))))
        whatever = min(whatever, away)
        # a border's pixels may be noisier than this edge's
        if room >= 3 and away > max(_CERTAIN * noise, MATTERS * sigma, _ABRUPT * step):
            largest = max(largest, away)
        certain = min(certain, away / max(SIGMAS * noise, MATTERS * sigma))
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
