"""Edges across interpolated pixels: nobody saw how the slopes change in between.

Carried straight on from either side of a gap, slopes rise by as much where the surface goes on as smoothly as
it came, and by something else where a crease or a ridge hides in it: half of the difference is the doubt of
the edges across (see `discontinuities`), which share it.
"""

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Ints, Mask, Pair
from ..solver.edges import Doubt
from .discontinuities import CONVERGES, RISE, SIGMAS

__all__ = ["across_gaps", "widened"]

_NEAR = 7  # pixels: reach of a doubt over pixels that were interpolated


def widened(doubt: Doubt, guessed: Mask) -> Doubt:
    """Edges of interpolated pixels (guessed, (H, W)) get the largest doubt nearby."""
    dx, dy = doubt
    near = np.maximum(dx, dy)
    near[:, 1:] = np.maximum(near[:, 1:], dx[:, :-1])
    near[1:] = np.maximum(near[1:], dy[:-1])
    near = np.where(guessed, scipy.ndimage.maximum_filter(near, _NEAR), 0.0)
    wide_x, wide_y = dx.copy(), dy.copy()
    wide_x[:, :-1] = np.maximum(wide_x[:, :-1], np.maximum(near[:, :-1], near[:, 1:]))
    wide_y[:-1] = np.maximum(wide_y[:-1], np.maximum(near[:-1], near[1:]))
    return Doubt(wide_x, wide_y)


def across_gaps(p: Floats, q: Floats, variances: Pair, mask: Mask, guessed: Mask) -> Doubt:
    """Doubts of the edges across interpolated pixels (guessed), of slopes p, q and their variances; all
    (H, W)."""
    along = _across(p, variances[0], mask, guessed)
    return Doubt(along, _across(q.T, variances[1].T, mask.T, guessed.T).T.copy())


def _across(f: Floats, variance: Floats, mask: Mask, guessed: Mask) -> Floats:
    """Doubts along the rows."""
    seen = mask & ~guessed
    row, before, after = _gaps(seen, guessed)
    edges = after - before
    ways = [
        [
            _straight_on(f, variance, seen, row, at, out, edges, curved)
            for at, out in ((before, -1), (after, 1))
        ]
        for curved in (False, True)
    ]
    by_lines, by_parabolas = (0.5 * np.abs(left[0] - right[0]) for left, right in ways)
    noise = 0.5 * np.sqrt(ways[0][0][1] + ways[0][1][1])
    off = np.where(by_parabolas < CONVERGES * by_lines, by_parabolas, by_lines)
    doubt = np.minimum(off, np.maximum(RISE * (off - SIGMAS * noise), 0.0)) / edges
    found = np.zeros(f.shape)
    inside = np.arange(edges.sum()) - np.repeat(np.cumsum(edges) - edges, edges)
    found[np.repeat(row, edges), np.repeat(before, edges) + inside] = np.repeat(doubt, edges)
    return found


def _gaps(seen: Mask, guessed: Mask) -> tuple[Ints, Ints, Ints]:
    """Row, and the measured pixels before and after, of the interpolated runs that have both."""
    ends = np.diff(np.pad(guessed, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, first), after = np.nonzero(ends == 1), np.nonzero(ends == -1)[1]
    inside = np.pad(seen, ((0, 0), (1, 1)))
    both = inside[row, first] & inside[row, after + 1]
    return row[both], first[both] - 1, after[both]


def _straight_on(
    f: Floats, variance: Floats, seen: Mask, row: Ints, at: Ints, outward: int, edges: Ints, curved: bool
) -> tuple[Floats, Floats]:
    """What slopes rise by over so many edges, by the line through a side's pixels (level where there is one)
    or the parabola (NaN where there are not three); and the variance of that.
    """
    steps = [at + k * outward for k in range(3)]
    places = [np.clip(step, 0, f.shape[1] - 1) for step in steps]
    there = [seen[row, place] & (place == step) for place, step in zip(places, steps, strict=True)]
    line = np.where(there[1], edges**2 / 2, 0.0)
    bend = np.where(there[1] & there[2], edges**3 / 6 + edges**2 / 4, np.nan) if curved else 0.0 * line
    weights = edges + line + bend, -line - 2 * bend, bend
    rise, noise = np.zeros(at.shape), np.zeros(at.shape)
    for weight, place in zip(weights, places, strict=True):
        rise += np.where(weight == 0, 0.0, weight * f[row, place])
        noise += weight**2 * variance[row, place]
    return rise, noise
