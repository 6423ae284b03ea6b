"""Variance of the height where no closed form holds: noise as announced, drawn and carried through the solve.

The same draw is carried through the unbroken rectangle, whose variance R is known (see `uncertainty`), as a
control variate: of normal errors a of the solve and r of the rectangle, a = b r + e, the maximum-likelihood
variance of a with R known is b^2 R + mean(e^2) (T. W. Anderson, 1957, doi:10.1080/01621459.1957.10501379),
after n draws uncertain by 2 (1 - rho^4) / n of itself, squared, rho the correlation of a and r: four draws
are enough where a mask changes little; where it changes all, b tends to zero and the draws decide.
"""

import numpy as np
import scipy.ndimage

from .arrays import Floats, Labels, Pair
from .edges import divergence
from .measured import Measured
from .newton import State, edge_errors, response
from .poisson import ColumnPoisson

__all__ = ["FLOOR", "monte_carlo_variance"]

FLOOR = 0.02  # of a slope's variance: the least that a height next to an exact anchor is given
_DRAWS = 48
_PIXELS = 1 << 22  # solved in all: fewer draws for large images
_FEWEST = 4
_MOSTLY = 0.9  # of the pixels: those that decide how many draws are made
_PRIOR = 6.0  # draws that the mean over a block counts as
_BLOCK = 25  # pixels
_SEED = 20140318


def monte_carlo_variance(
    data: Measured, state: State, labels: Labels, rectangle: Floats, load: Floats
) -> Floats:
    """The variance of w, (rows, cols). rectangle: that of the rectangle without holes, pinned by its anchors'
    pixels with weights load (rows, cols)."""
    inside = labels > 0
    most = int(np.clip(_PIXELS // np.count_nonzero(inside), _FEWEST, _DRAWS))
    rng = np.random.default_rng(_SEED)
    sums = np.zeros((3, *rectangle.shape))
    # weights that do not go by columns: the rectangle's variance says nothing of the solution's size
    scale = np.maximum(rectangle, FLOOR * state.variances[0])
    for count in range(1, most + 1):
        own, control = (
            np.divide(errors, np.sqrt(size), out=np.zeros_like(errors), where=size > 0)
            for errors, size in zip(_drawn(data, state, labels, load, rng), (scale, rectangle), strict=True)
        )
        sums += np.stack([own * own, own * control, control * control])
        if count >= _FEWEST and _unexplained(sums[:, inside]) * _DRAWS <= count:
            break
    share = np.maximum(_block_means(inside.astype(np.float64)), 1e-3)
    means = np.where(inside, sums / count, 0.0)
    nearby = np.stack([_block_means(part) / share for part in means])
    own, both, control = (count * means + _PRIOR * nearby) / (count + _PRIOR)
    slope = np.divide(both, control, out=np.zeros_like(both), where=control > 0)
    left = np.maximum(own - slope * both, 0.0) * count / (count - 1)
    return np.where(inside, scale * (slope**2 + left), rectangle)


def _unexplained(sums: Floats) -> float:
    """1 - rho^4 of the sums (3, N) of squares and products, at most, in nearly all pixels."""
    own, both, control = sums
    rho2 = np.divide(both**2, own * control, out=np.zeros_like(own), where=own * control > 0)
    return float(np.quantile(1.0 - rho2**2, _MOSTLY))


def _block_means(values: Floats) -> Floats:
    """Over blocks around every pixel. Summed one by one: running sums (`uniform_filter`) leave what rounding
    makes of a pixel 1e16 times larger, squares below zero."""
    weights = np.full(_BLOCK, 1.0 / _BLOCK)
    means: Floats = values
    for axis in (0, 1):
        means = scipy.ndimage.correlate1d(means, weights, axis)
    return means


def _drawn(
    data: Measured, state: State, labels: Labels, load: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Answers (rows, cols) of the solution and of the rectangle to one draw of noise, and of what is in doubt
    of the edges: STEEP is what a path costs beyond both, as a rough mirror has doubts everywhere.
    """
    mask, rows = data.mask, state.rows
    p, q = data.slopes(state.w)[:2]
    du, dv = (
        np.where(mask, sigma, 0.0) * rng.standard_normal(mask.shape) for sigma in (data.sigma_u, data.sigma_v)
    )
    noisy_p, noisy_q = data.shifted(du, dv).slopes(state.w)[:2]
    slopes = np.where(mask, noisy_p - p, 0.0), np.where(mask, noisy_q - q, 0.0)
    doubts = None
    if state.doubt is not None:
        dx, dy = state.doubt[:2]
        # each by itself, and all that rise alike: a rim is misjudged in the same way all around
        one, other, alike = (rng.standard_normal(shape) for shape in (mask.shape, mask.shape, ()))
        one[:, :-1] += alike * np.sign(np.nan_to_num(p[:, :-1] + p[:, 1:]))
        other[:-1] += alike * np.sign(np.nan_to_num(q[:-1] + q[1:]))
        doubts = dx * one, dy * other
    edges = edge_errors(data, state, slopes, doubts)
    known = rows.sigma * rng.standard_normal(rows.sigma.shape)
    own = response(labels, state, edges, slopes, known)
    factor = np.broadcast_to(state.root**2, own.shape)
    control = state.problem.columns.solve(_divergence(edges, state, rng))
    way = rows.predict(np.zeros(own.shape), *slopes) - known
    pinned = np.vdot(load, control) + load.reshape(-1)[rows.pixel] @ (way / factor.ravel()[rows.pixel])
    return own, factor * (control - pinned)


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
        noise = np.divide(rng.standard_normal(g.shape), root, out=np.zeros(g.shape), where=root > 0)
        known = np.divide(np.sqrt(weights[axis]) * g, root, out=np.zeros(g.shape), where=root > 0)
        scaled.append(np.where(weights[axis] > 0, known, noise))
    scaled[1][-1] = 0.0
    return divergence(scaled[0], scaled[1], wx[None], columns.wy[None])
