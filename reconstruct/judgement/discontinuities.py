"""Discontinuities: edges along which the slope changes too fast between pixels for any quadrature.

An edge's increment comes from the cubic through four slopes, two on either side. Where the surface is smooth
on one side up to the edge, the slopes of that side alone, extrapolated (Adams-Bashforth, three pixels), give
the same increment. Where neither side does, slopes jump inside the edge (a cusp, a ridge, the rim of a
contact) or one of its pixels is wrong, and the smaller of the two differences estimates the increment's
error: the doubt. Neighbouring edges share it, as the jump may lie in any of them. Its square adds to the
edge's variance, so that the solve goes around the crease, and the sigma of pixels behind it contains the
doubt.
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Mask

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
_REACH = 4  # pixels on either side
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
    fields = _field(p, var_p, mask), _field(q.T, var_q.T, mask.T)
    found = [_axis(field, noise) for field in fields]
    sure, doubtful = found[0][2] | found[1][2].T, (found[0][0] > 0) | (found[1][0].T > 0)
    _, parts, boxes, _ = cv2.connectedComponentsWithStats(doubtful.astype(np.uint8))
    sure |= doubtful & (boxes[:, cv2.CC_STAT_AREA] >= _CHAIN)[parts]
    if not sure.any():
        return None
    chain, near = doubtful & np.isin(parts, parts[sure]), scipy.ndimage.maximum_filter(sure, _BESIDE)
    doubts = []
    for field, (doubt, plain, _), beside, kept in zip(
        fields, found, (near, near.T), (chain, chain.T), strict=True
    ):
        at = beside & field.edges
        plain[at] = np.fmax(plain[at], _residuals(field, at, noise)[1])
        doubts.append(np.where(beside, plain, np.where(kept, doubt, 0.0)))
    # a line of two pixels has no estimate: the largest one around
    most = scipy.ndimage.maximum_filter(np.nan_to_num(np.fmax(doubts[0], doubts[1].T)), _AROUND)
    dx, dy = (np.where(np.isnan(doubt), m, doubt) for doubt, m in zip(doubts, (most, most.T), strict=True))
    return Doubt(_shared(dx, mask), _shared(dy, mask.T).T.copy())


def _shared(doubt: Floats, mask: Mask) -> Floats:
    """The doubts along rows, and their share in the cubics of the edges before and after."""
    wide = doubt.copy()
    np.maximum(wide[:, 1:], _SHARE * doubt[:, :-1], out=wide[:, 1:])
    np.maximum(wide[:, :-1], _SHARE * doubt[:, 1:], out=wide[:, :-1])
    wide[:, :-1] *= mask[:, :-1] & mask[:, 1:]
    wide[:, -1] = 0.0
    return wide


class _Field(NamedTuple):
    """slopes: (H, W + 2 _REACH + 1), NaN where missing; sigma, edges (H, W): of the edges to the next column,
    and where there are any."""

    slopes: Floats
    sigma: Floats
    edges: Mask


def _field(slopes: Floats, variance: Floats, mask: Mask) -> _Field:
    padded = np.full((len(mask), mask.shape[1] + 2 * _REACH + 1), np.nan)
    np.copyto(padded[:, _REACH : -_REACH - 1], slopes, where=mask)
    edges = mask & np.roll(mask, -1, axis=1)
    edges[:, -1] = False
    return _Field(padded, np.sqrt(0.5 * (variance + np.roll(variance, -1, axis=1)), order="C"), edges)


def _axis(field: _Field, noise: float) -> tuple[Floats, Floats, Mask]:
    """Of the edges along rows: doubts beyond the noise, doubts whatever the noise (NaN where neither side has
    two pixels), and where they are beyond any noise."""
    rough = _rough(field, noise)
    out, plain, most, sure = (np.zeros(rough.shape, kind) for kind in (float, float, float, np.bool_))
    for image, values in zip((out, plain, most, sure), _residuals(field, rough, noise), strict=True):
        image[rough] = values
    if most.any():
        # next to an edge that neither side explains, one side always fails
        highest, explained = (
            scipy.ndimage.maximum_filter1d(part, 3) for part in (most, np.nan_to_num(plain))
        )
        kink = (most > 0) & (most >= highest) & (explained < _ONE_SIDED * most)
        for doubt in (out, plain):
            doubt[kink] = np.fmax(doubt, _KINK * most)[kink]
        sure |= kink
    return out, plain, sure


@np.errstate(invalid="ignore")
def _rough(field: _Field, noise: float) -> Mask:
    """Edges that may have a doubt, and their neighbours: third differences bound what both sides leave."""
    g, size = field.slopes, field.edges.shape[1]
    third = np.abs(g[:, 3:] - g[:, :-3] - 3.0 * (g[:, 2:-1] - g[:, 1:-2]))
    before, inner, after = (third[:, k : k + size] for k in (2, 3, 4))
    left = np.maximum(10.0 / 24.0 * before + inner / 24.0, _BEND * third[:, 1 : 1 + size])
    right = np.maximum(10.0 / 24.0 * after + inner / 24.0, _BEND * third[:, 5 : 5 + size])
    least = np.maximum(np.minimum(left, right) * (_CERTAIN / _FAINT), np.maximum(left, right))
    rough = ~(least <= (_CERTAIN * _NOISE_CUBIC * noise) * field.sigma)
    return field.edges & (rough | np.roll(rough, 1, axis=1) | np.roll(rough, -1, axis=1))


@np.errstate(all="ignore")
def _residuals(field: _Field, at: Mask, noise: float) -> tuple[Floats, Floats, Floats, Mask]:
    """Of some edges: the smaller residual of both sides, beyond the noise and regardless of it; the largest
    one that is certain; whether the smaller exceeds the noise for certain."""
    row, col = np.nonzero(at)
    g, sigma = field.slopes[row, np.arange(2 * _REACH + 2)[:, None] + col], field.sigma[at]
    inner, ends = cubic_inside(*g[_REACH - 1 :][:4]), (g[_REACH:][:4], g[_REACH + 1 :: -1][:4])
    centre = np.where(np.isfinite(inner), inner, 0.5 * (g[_REACH] + g[_REACH + 1]))
    for end in (cubic_at_end(*part) for part in reversed(ends)):
        centre = np.where(np.isfinite(inner) | ~np.isfinite(end), centre, end)
    rise, sides = np.abs(g[_REACH + 1] - g[_REACH]), []
    for other, g0, g1, g2, g3, g4 in (g[_REACH + 1 :: -1][:6], g[_REACH:][:6]):
        two, three, step = np.isfinite(g2), np.isfinite(g3), np.fmax(rise, np.abs(g1 - g0))
        step = np.where(two, np.fmax(step, np.abs(g2 - g1)), step)
        away = np.abs(centre - (23.0 * g0 - 16.0 * g1 + 5.0 * g2) / 12.0)
        away = np.maximum(away, np.abs(centre - (5.0 * other + 8.0 * g0 - g1) / 12.0))
        bent = np.maximum(away, _BEND * np.abs(g0 - g3 - 3.0 * (g1 - g2)))
        finer = np.abs(centre - (55.0 * g0 - 59.0 * g1 + 37.0 * g2 - 9.0 * g3) / 24.0)
        finer = np.maximum(finer, np.abs(centre - cubic_at_end(other, g0, g1, g2)))
        finer = np.fmax(finer, _BEND4 * np.abs(g0 + g4 - 4.0 * (g1 + g3) + 6.0 * g2))
        bent = np.where(finer < _CONVERGES * bent, finer, bent)
        away = np.where(three, bent, np.where(two, away, np.abs(centre - 0.5 * (3.0 * g0 - g1))))
        noisy = sigma * (noise * np.where(two, _NOISE_CUBIC, _NOISE_LINEAR))
        beyond = np.minimum(away, np.fmax(0.0, _RISE * (away - np.fmax(_FAINT * noisy, _ROUGH * step))))
        # a border's pixels may be noisier than this edge's
        high = three & (away > np.fmax(np.fmax(_CERTAIN * noisy, _MATTERS * sigma), _ABRUPT * step))
        ratio = away / np.fmax(_SIGMAS * noisy, _MATTERS * sigma)
        sides.append((beyond, away, ratio, np.where(high, away, 0.0)))
    least, plain, certain = (np.fmin(sides[0][k], sides[1][k]) for k in range(3))
    out = np.where(least > _FEEBLE * sigma, least, 0.0)
    return out, plain, np.maximum(sides[0][3], sides[1][3]), (least > 0) & (certain > 1)


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
