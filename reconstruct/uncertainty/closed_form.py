"""Variance of the height by noise of the slopes, after the least-squares solve and the anchors.

With independent edge noise of variance var_e the solve w = E g has the covariance E L^-1 E, L = D^T w D. In
the DCT basis along the rows L is tridiagonal, and two Schur sweeps give the diagonal of its inverse, mode by
mode. Edges share pixels: an edge averages the slopes of its neighbours, A A^T = 1 - |..|, so that the
covariance is smaller,

    E L^-1 E - c,    c = < sum_a w_a l_a (1 - |A_a|^2) / (sum_a w_a l_a)^2 >,   l = 2 - 2 cos k, a = x, y,

averaged over the Brillouin zone: c is local (the correction is an operator of order zero), about a fifth of
the slopes' variance; all of this is for weights by columns. |A| = (13 cos(k/2) - cos(3k/2)) / 12 for the
four-pixel increments.
Deviations of the slopes' variances from their columns' means add by the solve's response: `unlike_columns`.
A solve that weights every edge by its own variance has less of them: `_effective`.
An anchor sum_m a_m w_m = known subtracts the covariance with it: var_i = G_ii - 2 (G a)_i + a.G a.
"""

import math
from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.ndimage

from optolever.blocks import threads

from ..arrays import Floats, Labels, Mask, Pair
from ..judgement.holes import noise_gain
from ..measured import Measured
from ..solver.newton import State
from ..solver.poisson import ColumnPoisson, spread
from .monte_carlo import FLOOR, monte_carlo_variance

__all__ = ["averaging_gain", "edge_diagonal", "unknown_variance", "unlike_columns"]

#: Pixels: noise farther away is that of its column, on average; the reach of an answer's square (1 / r^2).
_NEAR = 64
_MISSING, _HOLE = 1e-3, 64  # of the pixels; pixels of a hole: the noise behind it is that without it
#: rms of the log weights about their columns' mean: of more, which lie in lines, it errs by a fifth.
_UNEVEN = 0.6
_ROWS, _ROUNDS = 256, 4  # rows that tell of a column, about; fixed point steps, each leaves less than a tenth


def unknown_variance(data: Measured, state: State, labels: Labels) -> Floats:
    """Variance of w in every pixel, (rows, cols): the closed form on a rectangle whose holes are small and
    whose edges are not in doubt; else drawn noise (see `monte_carlo`).
    """
    rows, problem = state.rows, state.problem
    factor = np.broadcast_to(state.root**2, state.w.shape)
    weights, whole = problem.weights, state.doubt is None and _whole(data.mask)
    known = weights is None or (whole and max(map(spread, weights)) < _UNEVEN)
    if known and weights is not None:
        columns, (var_p, var_q) = _effective(weights)
    else:
        columns, (var_p, var_q) = problem.columns, (each / factor**2 for each in state.variances)
    at = factor.ravel()[rows.pixel]
    along_rows = 1.0 / columns.wy
    # of the edges on either side of a pixel
    edges = np.pad(1.0 / columns.wx[:-1], 1, mode="edge") if len(columns.wx) > 1 else along_rows.repeat(2)
    along_cols = 0.5 * (edges[:-1] + edges[1:])
    # what is averaged is no noisier than its neighbours
    gain = scipy.ndimage.minimum_filter1d(averaging_gain(along_cols, along_rows), 3)
    share = state.share / state.share.sum()
    own = share**2 * (rows.spread(*state.variances) / at**2 - gain[rows.pixel % gain.size])
    load: Floats = np.bincount(rows.pixel, share, labels.size).astype(np.float64).reshape(labels.shape)
    potential = columns.solve(load)
    constant = float(share @ potential.ravel()[rows.pixel]) + own.sum()
    potential *= -2.0
    potential += constant
    diagonal = edge_diagonal(columns)
    potential += diagonal
    if known:
        more = unlike_columns((var_p, var_q), diagonal)
        potential += more
        # errors of the anchors as fully correlated
        potential += max(float(share @ more.ravel()[rows.pixel]), 0.0)
    potential -= gain
    variance: Floats = np.maximum(potential, FLOOR * along_cols, out=potential)
    variance *= factor**2
    if not known:
        return monte_carlo_variance(data, state, labels, variance, load)
    return variance if data.mask.all() else variance * noise_gain(np.ones_like(data.mask), ~data.mask)


def _whole(mask: Mask) -> bool:
    """Whether no pixel is missing but in few holes, around which alone the noise is larger."""
    outside = ~mask
    if np.count_nonzero(outside) > _MISSING * mask.size:
        return False
    sizes = np.bincount(scipy.ndimage.label(outside, np.ones((3, 3)))[0].ravel())
    return bool((sizes[1:] <= _HOLE).all())


def _effective(weights: Pair) -> tuple[ColumnPoisson, Pair]:
    """The problem by columns whose noise is that of a solve with these weights (rows, cols), and the
    variances of single edges that do to it what they do to that solve.

    Effective medium: in the network of the columns' variances V an edge of the variance v answers by
    V (v - V) / ((1 - g) v + g V), g the share of a current between its ends that it carries; V is such that
    these vanish on average (Kirkpatrick, doi:10.1103/RevModPhys.45.574; anisotropic: Bernasconi,
    doi:10.1103/PhysRevB.9.4575).
    """
    middle = [float(np.median(part[part > 0])) for part in (w[:: max(1, len(w) // _ROWS)] for w in weights)]
    share = 2 / math.pi * math.atan(math.sqrt(middle[0] / middle[1]))
    profiles, found = [], []
    for w, g in ((weights[0][:, :-1], share), (weights[1][:-1], 1 - share)):
        there = w > 0
        v = np.divide(1.0, w, out=np.ones(w.shape), where=there)
        some, present = v[:: max(1, len(v) // _ROWS)], there[:: max(1, len(v) // _ROWS)]
        usual = (present * some).sum(axis=0) / present.sum(axis=0)
        for _ in range(_ROUNDS):
            each = present / ((1 - g) * some + g * usual)
            usual = (some * each).sum(axis=0) / each.sum(axis=0)
        found.append(usual + there * (usual * (v - usual) / ((1 - g) * v + g * usual)))
        profiles.append(1 / usual)
    columns = ColumnPoisson(np.append(profiles[0], profiles[0][-1:]), profiles[1], len(weights[0]))
    along_cols, along_rows = (np.pad(part, ((0, k), (0, 1 - k)), mode="edge") for k, part in enumerate(found))
    return columns, (along_cols, along_rows)


def unlike_columns(variances: Pair, diagonal: Floats) -> Floats:
    """What slopes' variances (rows, cols; of p and q, over the square of the integrating factor) other than
    their columns' means, for which the solve is weighted, add to the potential's variance `diagonal`, same
    units (rows, cols).

    Near a pixel the solve is a convolution: a slope along x is answered by h, of the transform
    -2i sin(k_x / 2) |A| / (l_x + r l_y), r = var_p / var_q, one along y likewise; the variance is the sum
    of h^2 times that of the slopes. Beyond the border all is mirrored. Where noise grows from column to
    column the response is rather its quiet side's: a decrease is at most `diagonal`.
    """
    usual = [variance.mean(axis=0) for variance in variances]
    r = float(np.median(usual[0] / usual[1]))
    k = 2 * np.pi * np.fft.fftfreq(4 * _NEAR)
    l = 2 - 2 * np.cos(k)
    answer = 2 * np.sin(k / 2) * (13 * np.cos(k / 2) - np.cos(3 * k / 2)) / 12
    both = l + r * l[:, None]
    both[0, 0] = np.inf
    kernels = (np.square(np.fft.ifft2(part / both).imag) for part in (answer, np.sqrt(r) * answer[:, None]))
    total, parts, shape = 0.0, 0.0, [n + 2 * _NEAR for n in variances[0].shape]
    size = [scipy.fft.next_fast_len(n, real=True) for n in shape]
    for variance, own, kernel in zip(variances, usual, kernels, strict=True):
        more = np.pad((variance / own - 1).astype(np.float32), _NEAR, mode="symmetric")
        near = np.roll(kernel, (_NEAR, _NEAR), (0, 1))[: 2 * _NEAR + 1, : 2 * _NEAR + 1].astype(np.float32)
        spectra = (scipy.fft.rfft2(part, size, workers=threads()) for part in (more, near))
        total, parts = total + np.prod(list(spectra), axis=0), parts + float(near.sum())
    found = scipy.fft.irfft2(total, size, workers=threads())[2 * _NEAR : shape[0], 2 * _NEAR : shape[1]]
    return np.asarray(
        np.where(found > 0, usual[0], np.minimum(usual[0], diagonal / parts)) * found, np.float64
    )


def averaging_gain(var_p: Floats, var_q: Floats) -> Floats:
    """Decrease of the height's variance by the averaging of neighbouring slopes, same shape."""
    ratios, values = _gain_table()
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(var_p / var_q)
    gain: Floats = var_p * np.interp(ratio, ratios, values)
    return gain


@lru_cache(maxsize=1)
def _gain_table() -> tuple[Floats, Floats]:
    """c / var_p as a function of log(var_p / var_q), by the midpoint rule over the Brillouin zone."""
    count = 128
    k = np.pi * (np.arange(count) + 0.5) / count
    transfer = (13 * np.cos(k / 2) - np.cos(3 * k / 2)) / 12
    l = 2 - 2 * np.cos(k)
    lost = l * (1 - transfer**2)
    ratios = np.linspace(np.log(1e-3), np.log(1e3), 61)
    values = [float(np.mean((lost[:, None] + r * lost) / (l[:, None] + r * l) ** 2)) for r in np.exp(ratios)]
    return ratios, np.array(values)


def edge_diagonal(columns: ColumnPoisson) -> Floats:
    """Diagonal of the rectangle's inverse, (rows, cols): sum_k v_k(col) phi_k(row)^2,
    symmetric in the rows.
    """
    modes, rows = columns.inverse_diagonal(), columns.rows
    # phi_k^2 = (1 + cos 2 k x) / rows, x = pi (row + 1/2) / rows: itself a sum of cosines, 2 k folded back
    even, low, high = np.zeros(modes.shape), np.arange(1, (rows + 1) // 2), np.arange(rows // 2 + 1, rows)
    even[0] = modes.sum(axis=0)
    even[2 * low] = 0.5 * modes[low]
    even[2 * (rows - high)] -= 0.5 * modes[high]
    found: Floats = scipy.fft.dct(even, type=3, axis=0, overwrite_x=True, workers=threads())
    return found / rows
