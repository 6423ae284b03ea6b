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
An anchor sum_m a_m w_m = known subtracts the covariance with it: var_i = G_ii - 2 (G a)_i + a.G a.
"""

from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.ndimage

from optolever.blocks import threads

from ..arrays import Floats, Labels, Pair
from ..measured import Measured
from ..solver.newton import State
from ..solver.poisson import ColumnPoisson
from .monte_carlo import FLOOR, monte_carlo_variance

__all__ = ["averaging_gain", "edge_diagonal", "unknown_variance", "unlike_columns"]

#: Pixels: noise farther away is that of its column, on average; the reach of an answer's square (1 / r^2).
_NEAR = 64


def unknown_variance(data: Measured, state: State, labels: Labels) -> Floats:
    """Variance of w in every pixel, (rows, cols): the closed form of a least-squares solve with weights by
    columns on a rectangle without holes; for others drawn noise (see `monte_carlo`).
    """
    rows, columns = state.rows, state.problem.columns
    factor = np.broadcast_to(state.root**2, state.w.shape)
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
    if state.problem.closed:
        del load
        more = unlike_columns(state.variances, factor**2, diagonal)
        potential += more
        # errors of the anchors as fully correlated
        potential += max(float(share @ more.ravel()[rows.pixel]), 0.0)
    potential -= gain
    variance: Floats = np.maximum(potential, FLOOR * along_cols, out=potential)
    variance *= factor**2
    if not state.problem.closed:
        variance = monte_carlo_variance(data, state, labels, variance, load)
    return variance


def unlike_columns(variances: Pair, square: Floats, diagonal: Floats) -> Floats:
    """What slopes' variances (rows, cols; of p and q, over the square of the integrating factor) other than
    their columns' means, for which the solve is weighted, add to the potential's variance `diagonal`, same
    units (rows, cols).

    Near a pixel the solve is a convolution: a slope along x is answered by h, of the transform
    -2i sin(k_x / 2) |A| / (l_x + r l_y), r = var_p / var_q, one along y likewise; the variance is the sum
    of h^2 times that of the slopes. Beyond the border all is mirrored. Where noise grows from column to
    column the response is rather its quiet side's: a decrease is at most `diagonal`.
    """
    usual = [(variance / square).mean(axis=0) for variance in variances]
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
        more = np.pad((variance / square / own - 1).astype(np.float32), _NEAR, mode="symmetric")
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
    modes = columns.inverse_diagonal()
    rows = columns.rows
    upper = (rows + 1) // 2
    angle = np.pi * np.outer(np.arange(upper) + 0.5, np.arange(rows)) / rows
    squares = np.cos(angle) ** 2 * (2.0 / rows)
    squares[:, 0] = 1.0 / rows
    half = squares @ modes
    return np.concatenate([half, half[: rows - upper][::-1]])
