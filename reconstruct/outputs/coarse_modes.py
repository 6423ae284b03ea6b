"""Smooth maps on every step-th pixel, linear between: the modes of a rig, in memory as in files."""

import numpy as np
import scipy.ndimage
import scipy.sparse
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.errors import InputError
from optolever.memory import require_room

__all__ = ["Modes", "coarse_step", "expanded", "filled", "sum_of_squares"]

#: (r, rows, cols) on every step-th pixel; gaps are filled where step > 1.
Modes = NDArray[np.float32]
_LINES = 75  # rows or columns, at least


def coarse_step(shape: tuple[int, ...]) -> int:
    """Pixels from line to line of the coarse grid of an image."""
    return max(1, min(shape) // _LINES)


def filled(coarse: Floats) -> Modes:
    """The modes, gaps from their nearest neighbours. InputError where one has nothing but gaps."""
    with np.errstate(over="ignore"):  # of a solution that diverges, whose pixels are flagged
        modes = coarse.astype(np.float32)
    nearest, before = (), np.zeros(0, np.bool_)
    for mode in modes:
        gaps = ~np.isfinite(mode)
        if gaps.all():
            raise InputError("calibration: no height is left where a number of the scene is off by its sigma")
        if gaps.any():
            if not np.array_equal(gaps, before):
                found = scipy.ndimage.distance_transform_edt(
                    gaps, return_distances=False, return_indices=True
                )
                nearest, before = tuple(found), gaps
            mode[:] = mode[nearest]
    return modes


def expanded(coarse: Modes, step: int, known: Mask) -> Modes:
    """The modes (r, H, W) on the known pixels, NaN elsewhere."""
    if step == 1:
        return coarse
    require_room("modes", 4 * len(coarse) * known.size)
    rows, cols = (_linear(size, step) for size in known.shape)
    modes = np.full((len(coarse), *known.shape), np.nan, np.float32)
    for mode, nodes in zip(modes, coarse, strict=True):
        mode[known] = (rows @ (cols @ nodes.T).T)[known]
    return modes


def sum_of_squares(coarse: Modes, step: int, shape: tuple[int, ...]) -> Floats:
    """Of the modes in every pixel, (H, W): between nodes a parabola along either axis."""
    if step == 1:
        return np.asarray(np.einsum("rij,rij->ij", coarse, coarse, dtype=np.float64))
    nodes, (down, across) = coarse.astype(np.float64), [_quadratic(size, step) for size in shape]
    squares = np.empty([2 * size - 1 for size in coarse.shape[1:]])
    left, above = nodes[..., :-1] + nodes[..., 1:], nodes[:, :-1] + nodes[:, 1:]
    for part, amid in (
        (squares[::2, ::2], nodes),
        (squares[::2, 1::2], 0.5 * left),
        (squares[1::2, ::2], 0.5 * above),
        (squares[1::2, 1::2], 0.25 * (left[:, :-1] + left[:, 1:])),
    ):
        np.einsum("rij,rij->ij", amid, amid, out=part)
    return np.asarray(np.maximum(down @ (across @ squares.T).T, 0.0))


def _places(size: int, step: int) -> tuple[NDArray[np.intp], Floats]:
    """Of every pixel the node before it, and how far it is towards the next one; constant beyond the last."""
    last = (size - 1) // step
    place = np.minimum(np.arange(size) / step, last)
    low = np.minimum(place.astype(np.intp), max(0, last - 1))
    return low, place - low


def _linear(size: int, step: int) -> scipy.sparse.csr_array:
    """Weights (size, nodes) of linear interpolation."""
    low, share = _places(size, step)
    return _weights([low, low + 1], [1 - share, share], (size - 1) // step + 1)


def _quadratic(size: int, step: int) -> scipy.sparse.csr_array:
    """Weights (size, 2 nodes - 1) of the parabola through two nodes and the value amid them."""
    low, s = _places(size, step)
    shares = [(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)]
    return _weights([2 * low, 2 * low + 1, 2 * low + 2], shares, 2 * ((size - 1) // step) + 1)


def _weights(nodes: list[NDArray[np.intp]], shares: list[Floats], count: int) -> scipy.sparse.csr_array:
    at = np.tile(np.arange(nodes[0].size), len(nodes)), np.minimum(np.concatenate(nodes), count - 1)
    return scipy.sparse.csr_array((np.concatenate(shares), at), shape=(nodes[0].size, count))
