"""What a mask adds to the variance that its rectangle would have.

The mask's edges are gathered into a network of at most NODES blocks. A square block of a lattice conducts
like one edge (rows in parallel, columns in series), so that the network holds the same long paths at any
block size; the difference between the networks with and without the mask is smooth, is computed by dense
algebra, and brought back to the pixels.
"""

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.sparse
import scipy.sparse.csgraph
from numpy.typing import NDArray

from .poisson import ColumnPoisson

__all__ = ["mask_excess", "network"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

NODES = 900


def mask_excess(
    wx: Floats, wy: Floats, columns: ColumnPoisson, inside: Mask, load: Floats, scale: Floats
) -> Floats:
    """Variance of the potential with the mask minus that of the full rectangle, times scale, (rows, cols).

    wx, wy (rows, cols): the edges of one connected component; columns: the rectangle's weights; inside: the
    component's pixels; load (rows, cols): the weights, of sum one, with which the anchors pin the potential;
    scale (rows, cols): smooths the result, which is interpolated as difference * scale (variances fall by
    orders of magnitude along a prism); the mean of a block is taken.
    """
    step = max(1, int(np.ceil(np.sqrt(inside.size / NODES))))
    gx, gy = network(wx, wy, step)
    cells = gx.shape
    pin = _gather(load, step)
    used = _connected(gx, gy, pin)
    full_x, full_y = np.tile(columns.wx, (wx.shape[0], 1)), np.tile(columns.wy, (wy.shape[0], 1))
    full_x[:, -1], full_y[-1] = 0.0, 0.0
    rx, ry = network(full_x, full_y, step)
    every = np.ones(cells, dtype=np.bool_)
    difference = np.full(cells, np.nan)
    pin = np.where(used, pin, 0.0)
    if not pin.any():
        return np.zeros(inside.shape)
    pin /= pin.sum()
    difference[used] = _variance(gx, gy, used, pin) - _variance(rx, ry, every, pin)[used.ravel()]
    middle = _gather(scale * inside, step) / np.maximum(_gather(inside.astype(np.float64), step), 1.0)
    difference *= middle
    nearest = scipy.ndimage.distance_transform_edt(
        ~np.isfinite(difference), return_distances=False, return_indices=True
    )
    difference = np.maximum(difference[tuple(nearest)], 0.0)
    rows, cols = inside.shape
    spread: Floats = _hats(rows, cells[0], step) @ difference @ _hats(cols, cells[1], step).T
    return spread


def network(wx: Floats, wy: Floats, step: int) -> tuple[Floats, Floats]:
    """Conductances between blocks of step x step pixels, in edge arrays of the blocks' shape.

    Between the centres of two blocks: the edges that cross each of the cuts on the way in parallel, the cuts
    in series.
    """
    return _links(wx, step), _links(wy.T, step).T


def _links(wx: Floats, step: int) -> Floats:
    rows, cols = wx.shape
    across = np.add.reduceat(wx, np.arange(0, rows, step), axis=0)
    centres = np.minimum(np.arange(0, cols, step) + step // 2, cols - 1)
    links = np.zeros((across.shape[0], centres.size))
    if centres.size > 1:
        present = across > 0
        resistance = np.where(present, 1.0 / np.where(present, across, 1.0), 0.0)
        whole = np.add.reduceat((~present).astype(np.int64), centres, axis=1)[:, :-1] == 0
        series = np.add.reduceat(resistance, centres, axis=1)[:, :-1]
        links[:, :-1] = np.where(whole, 1.0 / np.where(whole, series, 1.0), 0.0)
    return links


def _connected(gx: Floats, gy: Floats, pin: Floats) -> Mask:
    """Blocks that hang together with the heaviest anchors: one part of the network, which they pin."""
    index = np.arange(gx.size).reshape(gx.shape)
    ends = [
        (index[:, :-1][gx[:, :-1] > 0], index[:, 1:][gx[:, :-1] > 0]),
        (index[:-1][gy[:-1] > 0], index[1:][gy[:-1] > 0]),
    ]
    first, second = (np.concatenate(part) for part in zip(*ends, strict=True))
    graph = scipy.sparse.coo_array((np.ones(first.size), (first, second)), shape=(gx.size, gx.size))
    parts = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    heaviest = int(np.argmax(np.bincount(parts, weights=pin.ravel())))
    used: Mask = (parts == heaviest).reshape(gx.shape)
    return used


def _variance(gx: Floats, gy: Floats, used: Mask, pin: Floats) -> Floats:
    """Variance of the potential in the used blocks when its pinned mean is known, in order.

    (L + a a^T / s)^-1 = G + s, scaled to a unit diagonal: weights may differ by many orders of magnitude.
    """
    index = np.full(used.shape, -1)
    index[used] = np.arange(np.count_nonzero(used))
    count = int(index.max()) + 1
    matrix = np.zeros((count, count))
    for g, a, b in ((gx[:, :-1], index[:, :-1], index[:, 1:]), (gy[:-1], index[:-1], index[1:])):
        edge = (g > 0) & (a >= 0) & (b >= 0)
        i, j, w = a[edge], b[edge], g[edge]
        np.add.at(matrix, (i, i), w)
        np.add.at(matrix, (j, j), w)
        matrix[i, j] = matrix[j, i] = -w
    diagonal = np.diag(matrix).copy()
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    load = scale * pin[used]
    size = float(np.linalg.norm(load))
    matrix *= scale[:, None] * scale
    matrix += np.outer(load, load) / size**2
    inverse = scipy.linalg.inv(matrix, overwrite_a=True, assume_a="pos")
    variance: Floats = scale**2 * np.diag(inverse) - size**2
    return variance


def _gather(values: Floats, step: int) -> Floats:
    """Sums over the blocks."""
    rows, cols = values.shape
    sums: Floats = np.add.reduceat(
        np.add.reduceat(values, np.arange(0, rows, step), axis=0), np.arange(0, cols, step), axis=1
    )
    return sums


def _hats(fine: int, coarse: int, step: int) -> Floats:
    """Matrix (fine, coarse) of the linear interpolation between blocks' centres, constant beyond the last."""
    position = np.clip((np.arange(fine) - (step - 1) / 2) / step, 0, coarse - 1)
    matrix: Floats = np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(coarse)))
    return matrix
