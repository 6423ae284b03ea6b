"""Variance of the height by noise of the slopes, after the least-squares solve and the anchors.

With independent edge noise of variance var_e the solve w = E g has the covariance E L^-1 E, L = D^T w D. In
the DCT basis along the rows L is tridiagonal, and two Schur sweeps give the diagonal of its inverse, mode by
mode. Edges share pixels: an edge averages the slopes of its neighbours, A A^T = 1 - |..|, so that the
covariance is smaller,

    E L^-1 E - c,    c = < sum_a w_a l_a (1 - |A_a|^2) / (sum_a w_a l_a)^2 >,   l = 2 - 2 cos k, a = x, y,

averaged over the Brillouin zone: c is local (the correction is an operator of order zero), about a fifth of
the slopes' variance; all of this is for weights by columns. |A| = (13 cos(k/2) - cos(3k/2)) / 12 for the
four-pixel increments.
An anchor sum_m a_m w_m = known subtracts the covariance with it: var_i = G_ii - 2 (G a)_i + a.G a.
"""

from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.ndimage

from optolever.arrays import Floats, Labels
from optolever.blocks import threads

from ..measured import Measured
from ..solver.newton import State
from ..solver.poisson import ColumnPoisson
from .monte_carlo import FLOOR, monte_carlo_variance

__all__ = ["averaging_gain", "edge_diagonal", "unknown_variance"]


def unknown_variance(data: Measured, state: State, labels: Labels) -> Floats:
    """Variance of w in every pixel, (rows, cols): the closed form on a rectangle with weights by
    columns; else drawn noise (see `monte_carlo`).
    """
    rows, problem = state.rows, state.problem
    factor = np.broadcast_to(state.root**2, state.w.shape)
    columns = problem.columns
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
    potential += edge_diagonal(columns)
    potential -= gain
    variance: Floats = np.maximum(potential, FLOOR * along_cols, out=potential)
    variance *= factor**2
    if problem.weights is not None:
        return monte_carlo_variance(data, state, labels, variance, load)
    return variance


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
