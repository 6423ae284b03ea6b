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

from optolever.arrays import Floats
from optolever.errors import InputError

__all__ = [
    "ResidualNoise", "SlopeNoise", "mean_square_variance", "modes_variance", "noise_covariance",
    "residual_noise", "root_sigma",
]  # fmt: skip

_BLOCKS = 64  # along the longer side of the image
_DENSE = 32  # of the covariance of all blocks
_RANK = 1e-9  # of the largest column: below, a column of the basis is a combination of others
_LEAST = 1e-30  # mm^2, minimum variance of an increment, for slopes without noise


@dataclass(frozen=True, slots=True, eq=False)
class SlopeNoise:
    """Standard deviations of dz/dx and dz/dy, numbers or (H, W), mm per mm."""

    x: Floats | float
    y: Floats | float


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Heights on blocks of pixels: number (n,) of each good pixel's block; count (size,): pixels in each;
    laplacian; label (size,) of connected components; variance (size,) of an increment; step: pixels a side.
    """

    number: NDArray[np.intp]
    count: Floats
    laplacian: scipy.sparse.csc_matrix
    label: NDArray[np.intp]
    variance: Floats
    step: int

    def sums(self, values: Floats) -> Floats:
        """Sums over blocks (k, size) of values (n, k) of the good pixels."""
        return np.stack([np.bincount(self.number, each, len(self.count)) for each in values.T])


def _blocks(x: Floats, y: Floats, good: NDArray[np.bool_], noise: SlopeNoise, along: int) -> _Blocks:
    """along: blocks along the longer side of the image, at most."""
    step = max(1, -(-max(good.shape) // along))
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
    pairs, edges, size = [], [], int(np.count_nonzero(held))
    ends = np.zeros((2, 2, size))  # per axis: sum and number of the variances of a block's increments
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
        for side in pairs[-1]:
            ends[axis, 0] += np.bincount(side, variance, size)
            ends[axis, 1] += np.bincount(side, minlength=size)
    one, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
    weight = np.concatenate(edges)
    graph = scipy.sparse.coo_matrix((weight, (one, other)), (size, size))
    graph = (graph + graph.T).tocsr()
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    degree = np.asarray(graph.sum(axis=1)).ravel()
    ground = np.zeros(size)
    ground[np.unique(label, return_index=True)[1]] = degree.max(initial=1.0) or 1.0
    laplacian = (scipy.sparse.diags(degree + ground) - graph).tocsc()
    own = ends[:, 0] / np.maximum(ends[:, 1], 1)
    mean_variance = np.sqrt(own[0] * own[1]) if own.all() else own.max(axis=0)
    return _Blocks(number.ravel()[block], count[held], laplacian, label, mean_variance, step)


def noise_covariance(
    weights: Floats, x: Floats, y: Floats, good: NDArray[np.bool_], noise: SlopeNoise
) -> Floats:
    """Covariance (m, m) of sum_i weights[i, k] z_i over the good pixels, weights (n, m), by slope noise.

    x, y (H, W): positions of the pixels, mm; good (H, W).
    """
    blocks = _blocks(x, y, good, noise, _BLOCKS)
    label, load = blocks.label, blocks.sums(weights)
    sums = np.stack([np.bincount(label, each, label.max() + 1) for each in load])
    load = np.asarray(load - (sums / np.bincount(label))[:, label])  # one piston per connected component
    try:
        return np.asarray(load @ scipy.sparse.linalg.splu(blocks.laplacian).solve(load.T))
    except RuntimeError as error:  # singular by rounding
        spread = "slope map: its sigmas span too many decades; make it again by reconstruct --slopes"
        raise InputError(spread) from error


@dataclass(frozen=True, slots=True, eq=False)
class ResidualNoise:
    """Noise of heights less a fit: sigma (n,) of each good pixel, mm; number (n,) of its block; count (size,)
    of the blocks' pixels, covariance (size, size) of their means, mm^2; step_variance: that of increments.
    """

    sigma: Floats
    number: NDArray[np.intp]
    count: Floats
    covariance: Floats
    step_variance: float

    def rms_variance(self, residual: Floats) -> tuple[float, float]:
        """Variances, mm^4, of the mean square of residual (n,) + noise and of that of the noise alone."""
        each = np.bincount(self.number, residual, len(self.count)) / len(residual)
        weighted = self.covariance * self.count / len(residual)
        trace = 2 * float(np.sum(weighted * weighted.T))
        return mean_square_variance(4 * float(each @ self.covariance @ each), trace), trace


def mean_square_variance(linear: float, trace: float) -> float:
    """Variance of the mean square of s + n, n Gaussian noise of covariance C: 4 s'Cs + 2 tr C^2 (over n^2).
    linear: 4 r'Cr of the measured r = s + n, whose noise adds 4 tr C^2 on average; trace: 2 tr C^2."""
    return max(linear - 2 * trace, 0.0) + trace


def modes_variance(modes: Floats, values: Floats) -> float:
    """Variance of the mean square of values (n,) by modes (r, n) of standard deviation 1."""
    count = len(values)
    own, common = np.sum((modes @ values / count) ** 2), np.sum((modes @ modes.T / count) ** 2)
    return float(4 * own + 2 * common)


def root_sigma(rms: float, variance: float) -> float:
    """Standard deviation of an rms whose square has this variance, which may exceed the square."""
    spread = float(np.sqrt(variance))
    return spread / float(np.sqrt(4 * rms**2 + spread)) if spread else 0.0


def residual_noise(
    basis: Floats, x: Floats, y: Floats, good: NDArray[np.bool_], noise: SlopeNoise
) -> ResidualNoise:
    """Noise that a least-squares fit of `basis` (n, k; one column or more, a piston among their combinations)
    leaves in the heights.

    The covariance is that of blocks. Within a block the variance of a lattice's potential grows by v / 2 pi
    for each e-fold of the distance, v the variance of an increment.
    """
    blocks = _blocks(x, y, good, noise, _DENSE)
    covariance = np.linalg.inv(blocks.laplacian.toarray())
    means = (blocks.sums(basis) / blocks.count).T
    root = np.sqrt(blocks.count)
    pistons = np.stack([blocks.label == k for k in range(blocks.label.max() + 1)], axis=1)
    q, r = np.linalg.qr(root[:, None] * np.hstack([means, pistons]))
    q = q[:, np.abs(np.diag(r)) > _RANK * np.abs(np.diag(r)).max()]
    left = np.eye(len(root)) - (q / root[:, None]) @ (q.T * root)
    covariance = left @ covariance @ left.T
    variance = np.diag(covariance) + np.log(blocks.step) / (2 * np.pi) * blocks.variance
    sigma = np.sqrt(np.maximum(variance, 0.0))[blocks.number]
    return ResidualNoise(sigma, blocks.number, blocks.count, covariance, float(blocks.variance.mean()))
