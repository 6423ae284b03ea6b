"""What errors of a measurement do to the height; its variance where no closed form holds.

An error field of unit variance adds to u and v. One linear solve of the equations that made the height,
weights and anchors' shares unchanged, carries it there; the variance by a source of errors is the sum of the
squared responses of its fields. Without a closed form noise as announced is drawn and carried through so.

The same draw is carried through the unbroken rectangle, whose variance R is known (see `uncertainty`), as a
control variate: of normal errors a of the solve and r of the rectangle, a = b r + e, the maximum-likelihood
variance of a with R known is b^2 R + mean(e^2) (T. W. Anderson, 1957, doi:10.1080/01621459.1957.10501379),
after n draws uncertain by 2 (1 - rho^4) / n of itself, squared, rho the correlation of a and r: four draws
are enough where a mask changes little; where it changes all, b tends to zero and the draws decide.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Labels, Mask, Pair

from ..judgement.discontinuities import touched
from ..measured import Measured
from ..problem import Problem
from ..solver.edges import Doubt, SomeEdges, apply_laplacian, divergence
from ..solver.newton import State, edge_errors, response
from ..solver.poisson import ColumnPoisson

__all__ = [
    *("FLOOR", "ErrorField", "drawn_doubts", "monte_carlo_variance", "smoothed"),
    "variance_by",
]

FLOOR = 0.02  # of a slope's variance: the least that a height next to an exact anchor is given
_DRAWS = 64
_PIXELS = 1 << 21  # solved in all: fewer draws for large images
_FEWEST = 4
_MOSTLY = 0.9  # of the pixels: their quantile sets the number of draws
_SOME = 1 << 15  # pixels
_PRIOR = 6.0  # draws that the mean around counts as
_WIDE = 7.0  # pixels, rms
_SEED = 20140318
_SMOOTHED = 6.0  # pixels, rms: smoothing of the variance by a few drawn fields


class ErrorField(NamedTuple):
    """One error of unit variance: its change of u and v (rows, cols), pattern px, and of the edges'
    increments."""

    u: Floats
    v: Floats
    edges: SomeEdges | None = None


def variance_by(problem: Problem, state: State, fields: Iterable[ErrorField]) -> Floats:
    """Variance of the unknown (rows, cols) by a source of errors."""
    total = np.zeros(problem.labels.shape)
    for field in fields:
        moved = bool(field.u.any() or field.v.any())
        if field.edges is None and not moved:
            continue
        slopes = _slope_errors(problem.data, state, field) if moved else None
        total += np.square(response(problem.data, problem.labels, state, slopes, field.edges))
    return smoothed(total, problem.labels > 0, _SMOOTHED) if total.any() else total


def _slope_errors(data: Measured, state: State, field: ErrorField) -> Pair:
    """Errors of both slopes (rows, cols)."""
    moved = replace(data, u=data.u + field.u, v=data.v + field.v).slopes(state.before)[:2]
    p, q = (np.where(data.mask, one - other, 0.0) for one, other in zip(moved, state.slopes, strict=True))
    return p, q


def smoothed(values: Floats, mask: Mask, width: float) -> Floats:
    """Gaussian mean over the mask, (rows, cols)."""
    if mask.all():
        return np.asarray(scipy.ndimage.gaussian_filter(values, width))
    share = scipy.ndimage.gaussian_filter(mask.astype(np.float64), width)
    total = scipy.ndimage.gaussian_filter(np.where(mask, values, 0.0), width)
    return np.asarray(total / np.maximum(share, 1e-12))


def monte_carlo_variance(
    data: Measured, state: State, labels: Labels, rectangle: Floats, load: Floats
) -> Floats:
    """The variance of w, (rows, cols). rectangle: that of the rectangle without holes, pinned by its anchors'
    pixels with weights load (rows, cols)."""
    inside = labels > 0
    most = int(np.clip(_PIXELS // np.count_nonzero(inside), _FEWEST, _DRAWS))
    rng = np.random.default_rng(_SEED)
    sums = np.zeros((3, *rectangle.shape))
    doubts = None if state.doubt is None else drawn_doubts(state.doubt, state.w - data.rest(), rng)
    scale = rectangle + _beside_known(state)
    for count in range(1, most + 1):
        own, control = (
            np.divide(errors, np.sqrt(size), out=np.zeros_like(errors), where=size > 0)
            for errors, size in zip(
                _drawn(data, state, labels, load, rng, doubts), (scale, rectangle), strict=True
            )
        )
        sums += np.stack([own * own, own * control, control * control])
        if count >= _FEWEST and _unexplained(sums[:, inside]) * _DRAWS <= count:
            break
    means = np.where(inside, sums / count, 0.0)
    nearby = np.stack([smoothed(part, inside, _WIDE) for part in means])
    own, both, control = (count * means + _PRIOR * nearby) / (count + _PRIOR)
    slope = np.divide(both, control, out=np.zeros_like(both), where=control > 0)
    left = np.maximum(own - slope * both, 0.0) * count / (count - 1)
    return np.where(inside, scale * (slope**2 + left), rectangle)


def _beside_known(state: State) -> Floats:
    """Variance of w (rows, cols) in a pixel, given its neighbours."""
    columns: ColumnPoisson = state.problem.columns
    wx, wy = state.problem.weights or (np.tile(part, (columns.rows, 1)) for part in (columns.wx, columns.wy))
    board = 1.0 - 2.0 * (np.indices(wx.shape).sum(axis=0) % 2)
    total = 0.5 * board * apply_laplacian(board, wx, wy)[0]  # every edge counts twice
    variance: Floats = np.divide(state.root**4, total, out=np.zeros_like(total), where=total > 0)
    return variance


def _unexplained(sums: Floats) -> float:
    """1 - rho^4 of the sums (3, N) of squares and products, at most, in nearly all pixels."""
    own, both, control = sums[:, :: max(1, sums.shape[1] // _SOME)]
    rho2 = np.divide(both**2, own * control, out=np.zeros_like(own), where=own * control > 0)
    return float(np.quantile(1.0 - rho2**2, _MOSTLY))


def _drawn(
    data: Measured,
    state: State,
    labels: Labels,
    load: Floats,
    rng: np.random.Generator,
    doubts: Iterator[tuple[SomeEdges, SomeEdges]] | None,
) -> tuple[Floats, Floats]:
    """Answers (rows, cols) of the solution and of the rectangle to one draw of noise and of the
    edges' doubts.
    """
    rows = state.rows
    du, dv = (
        np.where(data.mask, sigma, 0.0) * rng.standard_normal(labels.shape)
        for sigma in (data.sigma_u, data.sigma_v)
    )
    slopes, alone, together = _slope_errors(data, state, ErrorField(du, dv)), None, None
    if doubts is not None:
        alone, common = next(doubts)
        together = alone.plus(common)
    own = response(data, labels, state, slopes, together)
    factor = np.broadcast_to(state.root**2, own.shape)
    edges = edge_errors(data, state, slopes, alone)
    control = state.problem.columns.solve(_divergence(edges, state, rng))
    way = rows.predict(np.zeros(own.shape), *slopes)
    pinned = np.vdot(load, control) + load.reshape(-1)[rows.pixel] @ (way / factor.ravel()[rows.pixel])
    return own, factor * (control - pinned)


def drawn_doubts(
    doubt: Doubt, rise: Floats, rng: np.random.Generator
) -> Iterator[tuple[SomeEdges, SomeEdges]]:
    """Draws of the edges' doubts: independent, as the rectangle's edges are, and common to each rim with the
    sign of the rise (rows, cols) above the mirror at rest along every edge, as a rim is misjudged in the same
    way all around: a jump lies evenly in its edge and a doubt bounds it, the variance is a third.
    """
    rims, count = scipy.ndimage.label(touched(doubt), np.ones((3, 3)))
    steps = 1, rise.shape[1]
    rims, rise = rims.ravel(), rise.ravel()
    at = [np.flatnonzero(part) for part in doubt]  # no edge leads beyond the image
    sizes = [part.ravel()[these] for part, these in zip(doubt, at, strict=True)]
    up = [
        np.sign(np.nan_to_num(rise[these + step]) - np.nan_to_num(rise[these]))
        for these, step in zip(at, steps, strict=True)
    ]
    while True:
        shared = rng.choice([-1.0, 1.0], count + 1) / np.sqrt(3.0)
        alone = [size * rng.standard_normal(size.size) for size in sizes]
        common = [size * shared[rims[these]] * sign for size, these, sign in zip(sizes, at, up, strict=True)]
        yield SomeEdges(at[0], at[1], *alone), SomeEdges(at[0], at[1], *common)


def _divergence(edges: Pair, state: State, rng: np.random.Generator) -> Floats:
    """D^T w g of the rectangle: the edges' errors, scaled to its weights; others are drawn."""
    columns: ColumnPoisson = state.problem.columns
    wx = columns.wx.copy()
    wx[-1] = 0.0  # no edge
    weights, scaled = state.problem.weights, []
    for axis, (g, full) in enumerate(zip(edges, (wx, columns.wy), strict=True)):
        root = np.sqrt(full)
        if weights is None:
            scaled.append(g)
            continue
        own = np.divide(np.sqrt(weights[axis]) * g, root, out=np.zeros(g.shape), where=root > 0)
        lost = (weights[axis] == 0) & (root > 0)
        own[lost] = rng.standard_normal(np.count_nonzero(lost)) / np.broadcast_to(root, g.shape)[lost]
        scaled.append(own)
    scaled[1][-1] = 0.0
    return divergence(scaled[0], scaled[1], wx[None], columns.wy[None])
