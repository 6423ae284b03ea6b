"""Discontinuities: edges along which the slope changes too fast between pixels for any quadrature.

An edge's increment comes from the cubic through four slopes, two on either side. Where the surface is smooth
on one side up to the edge, the slopes of that side alone, extrapolated (Adams-Bashforth, three pixels), give
the same increment. Where neither side does, slopes jump inside the edge (a cusp, a ridge, the rim of a
contact) or one of its pixels is wrong, and the smaller of the two differences is about what the increment may
be off by: the doubt. All come of the third differences of slopes at neighbouring edges. Edges beside a crease
share its doubt, as in which of them the slopes jump is not sure. Its square joins the edge's
variance, so that the solve goes around the crease, and what can only be reached across it gets a sigma that
says so.
"""

import numpy as np
import scipy.ndimage

from optolever.blocks import over_image
from optolever.kernels import inlined, kernel

from .arrays import Floats, Mask
from .edges import Doubt, curl

__all__ = ["CONVERGES", "RISE", "SIGMAS", "edge_doubt", "touched"]

SIGMAS = 5.0  # of the difference's own noise: both sides exceed it by chance in no edge of a megapixel
FAINT = 2.0  # of the same, for edges that continue a crease
_CHAIN = 16  # such edges side by side are a crease too: noise alone strings together a dozen in a megapixel
RISE = 3.0  # from zero at the limit: what depends continuously on the slopes is the same from any start
ROUGH = 0.03  # of the largest step between neighbouring slopes; waves of 20 pixels and longer stay below
_QUIETEST = 0.2  # of the announced noise: smaller doubts change nothing
_NOISE = 2.01  # of what the cubic and a side's three slopes differ by, per slope's sigma
_BEND, _BEND4 = 9.0, 8.37  # of third and fourth differences: what Adams-Bashforth leaves, times 24
_REACH = 3  # edges on either side that tell
CONVERGES = 0.5  # errors that fall so from one order to the next are those of a curve, not of a jump
_QUIET = 8.0  # of a slope's sigma: third differences of noise (4.5) and little more
_BESIDE = 5  # pixels: reach of a crease's surroundings, in which doubts below the noise count too
_BLAME = 13.0 / 12.0  # a wrong slope is in its edges by 13/24, in the curl around it by half
_CERTAIN, _ABRUPT = 8.0, 0.2  # of its noise, of the largest step: what one side alone misses at a kink
_ONE_SIDED = 0.25  # of that, at most, what the other side misses
_KINK = 0.5  # of what one side alone misses, at the edge of three where it misses most
_BY_ACCIDENT = 0.1  # of the doubt beside: next to a jump within one edge, an edge misses a twelfth of that


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

    noise: what the slopes' noise really is, over what the variances say; suspects (H, W): pixels that are
    blamed for a curl and yet in use.
    """
    blamed = suspects is not None and bool(suspects.any())
    noise = max(noise, _QUIETEST)
    axes = (p, var_p, mask, (0, 1)), (q, var_q, mask, (1, 0))
    (dx, plain_x, sure_x), (dy, plain_y, sure_y) = (_axis(*axis, noise) for axis in axes)
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
        along, down = mask[:, :-1] & mask[:, 1:], mask[:-1] & mask[1:]
        dx[:, :-1] = np.maximum(dx[:, :-1], along * np.maximum(curls[:, :-1], curls[:, 1:]))
        dy[:-1] = np.maximum(dy[:-1], down * np.maximum(curls[:-1], curls[1:]))
    return Doubt(dx, dy)


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


def _axis(
    f: Floats, variance: Floats, mask: Mask, step: tuple[int, int], noise: float
) -> tuple[Floats, Floats, Mask]:
    """Doubts beyond the noise, doubts whatever the noise, and where they are beyond any noise."""
    third = np.empty((f.shape[0] + 2 * _REACH, f.shape[1] + 2 * _REACH))
    for edge in (slice(_REACH), slice(-_REACH, None)):
        third[edge] = third[:, edge] = np.nan
    doubt, plain, alone = (np.zeros(f.shape) for _ in range(3))
    sure = np.zeros(f.shape, dtype=np.bool_)
    arrays = f, variance, third, *step, noise, doubt, plain, alone, sure
    over_image(lambda start, stop: _third_differences(f, mask, *step, third, start, stop), f.shape)
    over_image(lambda start, stop: _doubt(*arrays, start, stop), f.shape)
    if alone.any():
        # beside an edge that neither side explains, one side is bound to fail
        highest, explained = (
            scipy.ndimage.maximum_filter1d(part, 3, axis=step[1]) for part in (alone, plain)
        )
        kink = (alone >= highest) & (explained < _ONE_SIDED * alone)
        for part in (doubt, plain):
            part[kink] = np.maximum(part, _KINK * alone)[kink]
        sure |= kink
    return doubt, plain, sure


def touched(doubt: Doubt) -> Mask:
    """Pixels with a doubtful edge, (H, W)."""
    pixels: Mask = (doubt[0] > 0) | (doubt[1] > 0)
    pixels[:, 1:] |= doubt[0][:, :-1] > 0
    pixels[1:] |= doubt[1][:-1] > 0
    return pixels


@kernel
def _third_differences(f, mask, di, dj, third, start, stop):  # type: ignore[no-untyped-def]
    """Of the four slopes around every edge, NaN where one is missing; at the ends of a row of four or more,
    those beside, as the cubic goes on.
    """
    rows, cols = f.shape
    for i in range(start, stop):
        for j in range(cols):
            along, count = (i, rows) if di == 1 else (j, cols)
            found = np.nan
            if along + 1 < count and mask[i, j] and mask[i + di, j + dj]:
                for shift in (0, 1, -1):
                    r, c = i + shift * di, j + shift * dj
                    if 1 <= along + shift < count - 2 and (
                        mask[r - di, c - dj]
                        and mask[r, c]
                        and mask[r + di, c + dj]
                        and mask[r + 2 * di, c + 2 * dj]
                    ):
                        rise = f[r + di, c + dj] - f[r, c]
                        found = f[r + 2 * di, c + 2 * dj] - f[r - di, c - dj] - 3.0 * rise
                        break
            third[i + _REACH, j + _REACH] = found


@inlined
def _missed(here, a, b, c):  # type: ignore[no-untyped-def]
    """What one side misses of an edge's increment: of the third differences at the edge and at the next three
    on that side (NaN where there is none).

    The cubic minus the parabolas through three slopes of the side, and through the edge's and two of it; the
    error of the side's own extrapolation. Where the same of the next order falls, a curve is bent, and that
    is taken.
    """
    away = max(abs(10.0 * a - here), abs(here))
    away = max(away, _BEND * abs(b)) if b == b else away
    finer = max(abs(10.0 * a - 9.0 * b - here), abs(here - a))
    finer = max(finer, _BEND4 * abs(b - c)) if c == c else finer
    return (finer if b == b and finer < CONVERGES * away else away) / 24.0


@kernel
def _doubt(f, var, third, di, dj, scale, doubt, plain, alone, sure, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = f.shape
    for i in range(start, stop - di if stop == rows else stop):
        for j in range(cols - dj):
            r, c = i + _REACH, j + _REACH
            here = third[r, c]
            if here != here:
                continue
            noise = scale * _NOISE * np.sqrt(0.5 * (var[i, j] + var[i + di, j + dj]))
            least, most, largest = np.inf, np.inf, 0.0
            for s in (-1, 1):
                a = third[r + s * di, c + s * dj]
                if a != a:
                    continue
                away = _missed(
                    here, a, third[r + 2 * s * di, c + 2 * s * dj], third[r + 3 * s * di, c + 3 * s * dj]
                )
                most = min(most, away)
                limit = FAINT * noise
                if away > limit:
                    # the largest step between slopes of this side
                    m, n = (i, j) if s < 0 else (i + di, j + dj)
                    rise = abs(f[i + di, j + dj] - f[i, j])
                    rise = max(rise, abs(f[m, n] - f[m + s * di, n + s * dj]))
                    limit = max(limit, ROUGH * rise)
                    whole = third[r + 2 * s * di, c + 2 * s * dj] == third[r + 2 * s * di, c + 2 * s * dj]
                    if whole and away > max(_CERTAIN * noise, _ABRUPT * rise):
                        largest = max(largest, away)
                least = min(least, away, max(0.0, RISE * (away - limit)))
            if most < np.inf:
                doubt[i, j], plain[i, j], alone[i, j] = least, most, largest
                sure[i, j] = least > 0.0 and most > SIGMAS * noise
