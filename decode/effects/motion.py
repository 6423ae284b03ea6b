"""Motion of the mirror while bits and fringes are shown: edges of bits against the fringe's place there.

At a bit's edge the fringe's place less the edge's is proportional to the bit's level, whatever the blur.
What remains has noise and, of bits shown dt frames from the fringe, the motion of that time: its mean square
grows by rate^2 dt^2.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.kernels import F64

from ..noise import quantile
from ..plan import AxisPlan
from . import Correction, Effect, View

__all__ = ["Edges", "correct", "edges_of", "smooth_places"]

#: Level, share of the half contrast, below which a pixel is at an edge; fewest of them in a part; chance.
_EDGE, _FEWEST, _CHANCE = 0.5, 6, 1e-6
#: Limit of a residual, over the 0.9 quantile of its bit (four deviations).
_FAR = 2.5
#: Largest second difference of places that mix no other ones, px.
_BENT = 0.5
#: Ratio of variances below which no number of parts has a chance of 1e-6: SciPy's takes .1 s to load.
_LIKELY = 1.5
#: Parts of the image along each side: a motion of either sign within a part hides it.
_SIDES = (6, 7, 8, 9)


def correct(view: View) -> Correction | None:
    """Rate where it moved, pattern px per frame, of the partition of the image that shows it best; variance
    of a steady motion against an end of the capture."""
    if not any(axis.code is not None and axis.fringes for axis in view.plan.axes):
        return None
    view = view._replace(sample=view.wide)
    if not len(view.wide.places):
        return None
    smooth = [smooth_places(view, place) for place in view.places(view.wide)]
    edges = [edges_of(view, axis, place) for axis, place in zip(view.plan.axes, smooth, strict=False)]
    best, least = None, _CHANCE / len(_SIDES)
    for side in _SIDES:
        rows, cols = (np.arange(one + 1) * side // (one + 1) for one in view.sample.places.max(axis=0))
        part = rows[view.sample.places[:, 0]] * side + cols[view.sample.places[:, 1]]
        parts = [_parts(one, part, side**2) for one in edges if one is not None]
        rates, explained, rest, freedom = np.concatenate(parts, axis=1) if parts else np.zeros((4, 0))
        if not len(rates):
            continue
        ratio = float(explained.mean() / max(rest.sum() / freedom.sum(), 1e-12))
        if ratio < _LIKELY:
            continue
        chance = float(scipy.special.fdtrc(len(rates), freedom.sum(), ratio))
        if chance < least:
            rate, least = float(np.sqrt((rates**4).sum() / (rates**2).sum())), chance
            found = Effect("motion", rate, rate / float(np.sqrt(2 * len(rates))), "px per frame")
            best = Correction((found,), np.array((rate * (len(view.plan.exposures) - 1)) ** 2 / 3))
    return best


def smooth_places(view: View, place: F64) -> F64:
    """Places (K,) amid two neighbours of the row on whose line they lie to _BENT px, else NaN: at a rim two
    places mix."""
    first, found = view.sample.adjacent(3), np.full(place.shape, np.nan)
    bend = np.abs(place[first] - 2 * place[first + 1] + place[first + 2])
    kept = first[bend < _BENT] + 1
    found[kept] = place[kept]
    return found


class Edges(NamedTuple):
    """B bits: time to the fringe, exposures (B,); number of a frame of each. Pixels at their edges (E,):
    number of the bit, pixel; place less the edge's, px; level."""

    time: F64
    frames: NDArray[np.int64]
    bit: NDArray[np.int64]
    at: NDArray[np.int64]
    away: F64
    level: F64


def _parts(edges: Edges, part: NDArray[np.int64], parts: int) -> F64:
    """(4, parts of the image): rate by a line through the bits' means over time; sums of squares that it
    explains and leaves, degrees of freedom. A part has edges of one width, in px per level."""
    own = part[edges.at]
    cell, size = edges.bit * parts + own, (len(edges.time), parts)

    def sums(of: F64 | None) -> F64:
        """(bits, parts)"""
        return np.bincount(cell, of, minlength=size[0] * size[1]).reshape(size).astype(np.float64)

    count = sums(None)
    product, square = (np.bincount(own, edges.level * one, parts) for one in (edges.away, edges.level))
    width = product / np.maximum(square, 1e-6)
    several = (count >= _FEWEST) & (np.count_nonzero(count >= _FEWEST, axis=0) > 2)
    kept = several.any(axis=0)
    weight = np.where(several, count, 0.0)[:, kept]
    mean = ((sums(edges.away) - width * sums(edges.level)) / np.maximum(count, 1))[:, kept]
    total, time = weight.sum(axis=0), edges.time[:, None]
    time, mean = time - (weight * time).sum(axis=0) / total, mean - (weight * mean).sum(axis=0) / total
    rate = (weight * time * mean).sum(axis=0) / (weight * time * time).sum(axis=0)
    left = (weight * (mean - rate * time) ** 2).sum(axis=0)
    explained, freedom = (weight * mean**2).sum(axis=0) - left, several.sum(axis=0)[kept] - 2.0
    return np.stack([rate, explained, left, freedom])


def edges_of(view: View, axis: AxisPlan, place: F64) -> Edges | None:
    code, p, known = axis.code, view.plan, np.flatnonzero(np.isfinite(place))
    if code is None or not axis.fringes or min(p.white, p.black) < 0:
        return None
    place = place[known]
    levels = {
        i: view.sample.levels[i, known] for i in (*code.plain, *code.inverse, p.white, p.black) if i >= 0
    }
    white, black = levels[p.white], levels[p.black]
    middle, half = 0.5 * (white + black), 0.5 * np.maximum(white - black, 0)
    word = np.empty(len(code.cells), np.int64)
    word[code.cells] = np.arange(len(code.cells))
    times = p.times()
    then, found = float(np.mean(times[list(axis.fringes[-1].index)])), []
    for b, pair in enumerate(zip(code.plain.tolist(), code.inverse.tolist(), strict=True)):
        bright, shown = (word >> b) & 1, [i for i in pair if i >= 0]
        at = np.flatnonzero(np.diff(bright)) + 1
        edge = at * code.cell - 0.5 + code.origin
        signed = [levels[i] - middle if i == pair[0] else middle - levels[i] for i in shown]
        mean = signed[0] if len(signed) == 1 else 0.5 * (signed[0] + signed[1])
        keep = np.flatnonzero(np.abs(mean) < np.float32(_EDGE) * half)
        if not len(at) or len(keep) < _FEWEST:
            continue
        there, level = place[keep], mean[keep].astype(np.float64) / half[keep]
        nearest = np.searchsorted(0.5 * (edge[1:] + edge[:-1]), there)
        away, level = there - edge[nearest], level * np.where(bright[at[nearest]] > 0, 1.0, -1.0)
        proportional = quantile(away * level, 0.5) / max(quantile(level * level, 0.5), 1e-6) * level
        far = _FAR * quantile(np.abs(away - proportional), 0.9)  # rims are no motion
        away = proportional + np.clip(away - proportional, -far, far)
        found.append((float(np.mean(times[shown])) - then, known[keep], away, level, shown[0]))
    if not found:
        return None
    bit = np.repeat(np.arange(len(found)), [len(one[1]) for one in found])
    at, away, level = (np.concatenate([one[k] for one in found]) for k in (1, 2, 3))
    time = np.array([one[0] for one in found])
    frames = np.array([one[4] for one in found])
    return Edges(time, frames, bit, at.astype(np.int64), away, level)
