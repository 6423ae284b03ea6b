"""Variance of the height: what the slopes' noise leaves after the least-squares solve and the anchors.

With independent edge noise of variance var_e the solve w = E g has the covariance E L^-1 E, L = D^T w D. In
the DCT basis along the rows L is tridiagonal, and two Schur sweeps give the diagonal of its inverse, mode by
mode. Edges share pixels: an edge averages the slopes of its neighbours, A A^T = 1 - |..|, so that the
covariance is smaller,

    E L^-1 E - c,    c = < sum_a w_a l_a (1 - |A_a|^2) / (sum_a w_a l_a)^2 >,   l = 2 - 2 cos k, a = x, y,

averaged over the Brillouin zone: c is local (the correction is an operator of order zero) and a fifth of the
slopes' variance, about. |A| = (13 cos(k/2) - cos(3k/2)) / 12 for the four-pixel increments.
An anchor sum_m a_m w_m = known subtracts the covariance with it: var_i = G_ii - 2 (G a)_i + a.G a. What a
curve adds on the way to the anchors, it adds to all of them alike: the square of its weighted sum joins.
"""

from functools import lru_cache

import cv2
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from .mask_variance import mask_excess
from .measured import Measured
from .newton import State
from .poisson import ColumnPoisson
from .sampled import settled

__all__ = ["averaging_gain", "edge_diagonal", "unknown_variance"]

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]

_LARGE = 0.01  # of the image: smaller components are taken as parts of an unbroken rectangle
_PASSAGE = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))  # fits into no passage of one or two pixels
_SPECK = 64  # pixels: components that are a path to their anchor
_RAGGED = 0.1  # of the pixels without one of their neighbours: more of them, and blocks are no conductors
_FLOOR = 0.02  # of a slope's variance: the least that a height next to an exact anchor is given


def unknown_variance(data: Measured, state: State, labels: Labels, broken: bool = True) -> Floats:
    """Variance of w in every pixel, (rows, cols).

    broken: whether the mask or many light edges make detours; otherwise as if there were none.
    Exact for weights by columns on a rectangle without holes; a mask adds what `mask_variance` finds, and
    where it leaves mostly pixels without one of their neighbours, or parts that only a few pixels join, drawn
    noise has the last word.
    """
    factor = np.broadcast_to(state.root**2, state.w.shape)
    square = factor**2
    alone = _alone(labels)
    # what is averaged is no noisier than its neighbours
    least = cv2.erode(averaging_gain(*state.variances), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    gain = np.where(alone, 0.0, least)
    own = _anchor_variance(state, factor, gain)
    lean = state.share * state.bend / factor.ravel()[state.rows.pixel]
    variance = _of_components(state, labels, broken, own, lean, square)
    alone &= labels > 0
    if broken and state.problem.weights is not None and alone.any():
        variance[alone] += _hanging(*state.problem.weights, state.problem.columns)[alone]
    variance *= square
    variance -= gain
    variance = np.maximum(variance, _FLOOR * state.variances[0])
    ragged = np.count_nonzero(alone) > _RAGGED * np.count_nonzero(labels)
    if ragged or (broken and _narrow(labels > 0)):
        variance = settled(data, state, labels, variance)
    return variance


def _narrow(inside: Mask) -> bool:
    """Whether large parts of a mask are joined by passages of few pixels, which no block shows."""
    parts = [_large_parts(inside), _large_parts(cv2.erode(inside.astype(np.uint8), _PASSAGE) > 0)]
    return parts[1] > parts[0]


def _large_parts(inside: Mask) -> int:
    areas = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=4)[2][1:, cv2.CC_STAT_AREA]
    return int(np.count_nonzero(areas > _LARGE * inside.size))


def _of_components(
    state: State, labels: Labels, broken: bool, own: Floats, lean: Floats, square: Floats
) -> Floats:
    """Variance of the potential, component by component; own: of its anchors; lean: what they share."""
    columns = state.problem.columns
    variance = edge_diagonal(columns)
    sizes = np.bincount(labels.ravel())
    boxes = scipy.ndimage.find_objects(labels)
    for label in np.unique(state.rows.component):
        pick = state.rows.component == label
        known = float(own[pick].sum() + lean[pick].sum() ** 2)
        if sizes[label] <= _SPECK:
            box = boxes[label - 1]
            assert box is not None
            inside = labels[box] == label
            rise = (np.maximum(*state.variances) / square)[box]
            variance[box][inside] = (known + _steps(state, pick, labels.shape)[box] * rise)[inside]
            continue
        load = np.zeros(labels.shape)
        np.add.at(load.reshape(-1), state.rows.pixel[pick], state.share[pick])
        green = columns.solve(load)
        inside = labels == label
        variance[inside] += (float(np.vdot(load, green)) + known - 2.0 * green)[inside]
        if broken and state.problem.weights is not None and sizes[label] >= _LARGE * labels.size:
            wx, wy = (weight * inside for weight in state.problem.weights)
            scale = square / state.variances[0]
            variance[inside] += (mask_excess(wx, wy, columns, inside, load, scale) / scale)[inside]
    return variance


def _anchor_variance(state: State, factor: Floats, gain: Floats) -> Floats:
    """What every anchor row's own uncertainty adds to its component's potential, (M,)."""
    rows = state.rows
    gained, at = (part.ravel()[rows.pixel] for part in (gain, factor))
    variance: Floats = state.share**2 * (rows.sigma**2 + rows.spread(*state.variances) - gained) / at**2
    return variance


def _steps(state: State, pick: Mask, shape: tuple[int, int]) -> Floats:
    """Pixel edges from a component's anchors, at least."""
    row, col = np.divmod(state.rows.pixel[pick], shape[1])
    share = state.share[pick]
    i, j = np.ogrid[: shape[0], : shape[1]]
    steps: Floats = np.abs(i - share @ row) + np.abs(j - share @ col)
    return steps


def _alone(labels: Labels) -> Mask:
    """Pixels beside one that is missing: their errors are not averaged with that neighbour's."""
    missing = labels == 0
    alone = np.zeros(labels.shape, dtype=np.bool_)
    if missing.any():
        alone[1:] |= missing[:-1]
        alone[:-1] |= missing[1:]
        alone[:, 1:] |= missing[:, :-1]
        alone[:, :-1] |= missing[:, 1:]
    return alone


def _hanging(wx: Floats, wy: Floats, columns: ColumnPoisson) -> Floats:
    """What a pixel's own edges conduct less than the rectangle's would: as a variance that is its own."""
    full_x, full_y = np.tile(columns.wx, (wx.shape[0], 1)), np.tile(columns.wy, (wy.shape[0], 1))
    full_x[:, -1], full_y[-1] = 0.0, 0.0
    own, whole = _conductance(wx, wy), _conductance(full_x, full_y)
    present = own > 0
    more = np.where(present, 1.0 / np.where(present, own, 1.0), 0.0) - 1.0 / whole
    hanging: Floats = np.maximum(more, 0.0)
    return hanging


def _conductance(wx: Floats, wy: Floats) -> Floats:
    """Sum of the weights of a pixel's edges."""
    total = wx + wy
    total[:, 1:] += wx[:, :-1]
    total[1:] += wy[:-1]
    return total


def averaging_gain(var_p: Floats, var_q: Floats) -> Floats:
    """What the averaging of neighbouring slopes takes off the height's variance, same shape."""
    ratios, values = _gain_table()
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(var_p / var_q)
    gain: Floats = var_p * np.interp(ratio, ratios, values)
    return gain


@lru_cache(maxsize=1)
def _gain_table() -> tuple[Floats, Floats]:
    """c / var_p as a function of log(var_p / var_q), by the midpoint rule over the Brillouin zone."""
    count = 512
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
