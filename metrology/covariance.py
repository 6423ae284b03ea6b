"""Covariance of linear functionals of the heights by slope noise.

Heights are integrated from slopes by least squares. White noise of the slopes gives increments from pixel to
pixel the variance (dx sigma_x)^2 + (dy sigma_y)^2. The heights' covariance is the inverse of the graph
Laplacian L, whose edge weights are the inverses of these variances. A functional g.z whose weights sum to
zero (any parameter of a form with a piston) is independent of the anchor and has the variance g L^-1 g. L is
solved on blocks of pixels, since low-order forms are smooth: a block's increments have the variance of its
pixels' (the longer step is compensated by the average over more slopes).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg
from numpy.typing import NDArray

__all__ = ["SlopeNoise", "noise_covariance"]

Floats = NDArray[np.float64]
_BLOCKS = 64  # along the longer side of the image
_LEAST = 1e-30  # mm^2, minimum variance of an increment, for slopes without noise


@dataclass(frozen=True, slots=True, eq=False)
class SlopeNoise:
    """Standard deviations of dz/dx and dz/dy, numbers or (H, W), mm per mm."""

    x: Floats | float
    y: Floats | float


def noise_covariance(
    weights: Floats, x: Floats, y: Floats, good: NDArray[np.bool_], noise: SlopeNoise
) -> Floats:
    """Covariance (m, m) of sum_i weights[i, k] z_i over the good pixels, weights (n, m), by slope noise.

    x, y (H, W): positions of the pixels, mm; good (H, W).
    """
    step = max(1, -(-max(good.shape) // _BLOCKS))
    rows, cols = (-(-size // step) for size in good.shape)
    row, col = np.nonzero(good)
    block = row // step * cols + col // step
    count = np.bincount(block, minlength=rows * cols).astype(np.float64)
    held = count > 0

    def mean(values: Floats | float) -> Floats:
        each = np.broadcast_to(values, good.shape)[good].astype(np.float64)
        sums = np.bincount(block, each, rows * cols)
        return np.asarray(np.where(held, sums / np.maximum(count, 1), 0.0).reshape(rows, cols))

    places, variances = (mean(x), mean(y)), (mean(np.square(noise.x)), mean(np.square(noise.y)))
    number = np.where(held, np.cumsum(held) - 1, -1).reshape(rows, cols)
    fill = (count / step**2).reshape(rows, cols)
    pairs, edges = [], []
    for axis in (0, 1):
        first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        both = (number[first] >= 0) & (number[second] >= 0)
        # increments over one pixel: those over a block have the same variance
        lengths = [(place[second] - place[first])[both] / step for place in places]
        spread = [0.5 * (own[first] + own[second])[both] for own in variances]
        variance = lengths[0] ** 2 * spread[0] + lengths[1] ** 2 * spread[1]
        share = np.minimum(fill[first], fill[second])[both]
        pairs.append((number[first][both], number[second][both]))
        edges.append(share / np.maximum(variance, _LEAST))
    one, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
    weight, size = np.concatenate(edges), int(np.count_nonzero(held))
    graph = scipy.sparse.coo_matrix((weight, (one, other)), (size, size))
    graph = (graph + graph.T).tocsr()
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    degree = np.asarray(graph.sum(axis=1)).ravel()
    ground = np.zeros(size)
    ground[np.unique(label, return_index=True)[1]] = degree.max(initial=1.0) or 1.0
    laplacian = scipy.sparse.diags(degree + ground) - graph
    load: Floats = np.stack([np.bincount(block, each, rows * cols)[held] for each in weights.T])
    sums = np.stack([np.bincount(label, each, label.max() + 1) for each in load])
    load = np.asarray(load - (sums / np.bincount(label))[:, label])  # one piston per connected component
    solved = scipy.sparse.linalg.splu(laplacian.tocsc()).solve(load.T)
    return np.asarray(load @ solved)
