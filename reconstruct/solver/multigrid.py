"""Multigrid for weighted Poisson problems on pixel edges whose weights jump: masks, creases, noisy borders.

Every second pixel of every second row is kept; the others are interpolated by the operator itself (Dendy's
black box multigrid, doi:10.1016/0021-9991(82)90057-2), and the coarse operator is the energy of what is so
interpolated. Both keep constants exactly: an operator is stored as its edge weights alone, eight neighbours
from the second level on. One V-cycle with a zebra Gauss-Seidel sweep before and its mirror image after is
symmetric and serves conjugate gradients as preconditioner: about ten iterations whatever size and mask.

Levels have an even number of rows and columns, if need be by pixels without edges, and a border of such
pixels around weights and unknowns, so that no pixel is a special case.
"""

from dataclasses import dataclass

import numpy as np

from optolever.blocks import over_image

from ..arrays import Floats
from .multigrid_kernels import galerkin, interpolate, residual, restrict, sweep

__all__ = ["Multigrid"]

_COARSEST = 60  # pixels that are solved by a dense inverse
_STEPS = (0, 1), (1, 0), (1, 1), (1, -1)  # rows and columns to the pixel at the other end of an edge


@dataclass(frozen=True, slots=True)
class _Level:
    """weights (4, rows + 2, cols + 2) of the edges to the right, down, down right and down left; inverse of
    the diagonal (rows, cols); interpolation from the next level: share of the left or upper neighbour in the
    pixels between two (across, along), and of the four corners between four.
    """

    weights: Floats
    inverse: Floats
    across: Floats
    along: Floats
    corners: Floats


class Multigrid:
    """A V-cycle for D^T w D x = rhs.

    wx, wy: (rows, cols) weights of the edges (i, j) - (i, j + 1) and (i, j) - (i + 1, j), positive wherever
    both pixels exist.
    """

    def __init__(self, wx: Floats, wy: Floats) -> None:
        weights = _bordered(wx.shape)
        rows, cols = wx.shape
        weights[0, 1 : rows + 1, 1 : cols + 1], weights[1, 1 : rows + 1, 1 : cols + 1] = wx, wy
        self._levels: list[_Level] = []
        while (weights.shape[1] - 2) * (weights.shape[2] - 2) > _COARSEST:
            self._levels.append(_level(weights))
            weights = _coarser(self._levels[-1])
        self._dense = _dense_inverse(weights)

    def cycle(self, rhs: Floats) -> Floats:
        """About the solution, up to a constant."""
        rows, cols = rhs.shape
        if rows % 2 or cols % 2:
            rhs = np.pad(rhs, ((0, rows % 2), (0, cols % 2)))
        return self._cycle(0, rhs)[1 : rows + 1, 1 : cols + 1]

    def _cycle(self, depth: int, rhs: Floats) -> Floats:
        """The solution (rows + 2, cols + 2), zero on the border."""
        rows, cols = rhs.shape
        x = np.zeros((rows + 2, cols + 2))
        if depth == len(self._levels):
            x[1:-1, 1:-1] = (self._dense @ rhs.ravel()).reshape(rhs.shape)
            return x
        level = self._levels[depth]
        for parity in (0, 1):
            _relax(level, x, rhs, parity, True)
        below = self._cycle(depth + 1, _restricted(level, x, rhs))
        over_image(
            lambda start, stop: interpolate(below, level.across, level.along, level.corners, x, start, stop),
            (rows // 2, 2 * cols),
        )
        for parity in (1, 0):
            _relax(level, x, rhs, parity, False)
        return x


def _bordered(shape: tuple[int, ...]) -> Floats:
    """No weights, for so many pixels."""
    rows, cols = (size + size % 2 + 2 for size in shape)
    return np.zeros((4, rows, cols))


def _level(weights: Floats) -> _Level:
    right, down, falling, rising = weights
    inner = np.s_[1:-1, 1:-1]
    east, south, south_east, south_west = right[inner], down[inner], falling[inner], rising[inner]
    west, north = right[1:-1, :-2], down[:-2, 1:-1]
    north_west, north_east = falling[:-2, :-2], rising[:-2, 2:]
    total = east + south
    for part in (south_east, south_west, west, north, north_west, north_east):
        total += part
    inverse = np.divide(1.0, total, out=np.zeros(total.shape), where=total > 0)

    across = _share((north_west, west, south_west), (north_east, east, south_east), np.s_[::2, 1::2])
    along = _share((north_west, north, north_east), (south_west, south, south_east), np.s_[1::2, ::2])
    four = np.s_[1::2, 1::2]
    low, far = np.roll(across, -1, axis=0), np.roll(along, -1, axis=1)
    corners = np.empty((*across.shape, 4))
    for k, (corner, vertical, v, horizontal, h) in enumerate(
        (
            (north_west, north, across, west, along),
            (north_east, north, 1 - across, east, far),
            (south_west, south, low, west, 1 - along),
            (south_east, south, 1 - low, east, 1 - far),
        )
    ):
        corners[..., k] = inverse[four] * (corner[four] + vertical[four] * v + horizontal[four] * h)
    return _Level(weights, inverse, across, along, corners)


def _share(one: tuple[Floats, ...], other: tuple[Floats, ...], where: tuple[slice, slice]) -> Floats:
    """one / (one + other) of the sums of weights there, all of one if there are none."""
    first, second = (np.asarray(sum(part[where] for part in side)) for side in (one, other))
    total = first + second
    share: Floats = np.divide(first, total, out=np.ones(total.shape), where=total > 0)
    return np.clip(share, 0.0, 1.0, out=share)


def _coarser(level: _Level) -> Floats:
    """The weights of the next level: energy of what is interpolated."""
    rows, cols = level.across.shape
    weights, below = _bordered((rows, cols)), np.zeros((rows, cols))
    over_image(
        lambda start, stop: galerkin(
            level.weights, level.across, level.along, level.corners, weights, below, start, stop
        ),
        (rows, 4 * cols),
    )
    weights[0, 2 : rows + 1, 1 : cols + 1] += below[:-1]
    return weights


def _dense_inverse(weights: Floats) -> Floats:
    """Inverse of the coarsest operator with its heaviest pixel pinned to zero."""
    rows, cols = weights.shape[1] - 2, weights.shape[2] - 2
    count = rows * cols
    matrix = np.zeros((count, count))
    for weight, (dr, dc) in zip(weights, _STEPS, strict=True):
        row, col = np.nonzero(weight)
        here, there = (row - 1) * cols + col - 1, (row - 1 + dr) * cols + col - 1 + dc
        matrix[here, there] = matrix[there, here] = -weight[row, col]
    diagonal = -matrix.sum(axis=1)
    np.fill_diagonal(matrix, diagonal)
    keep = diagonal > 0
    keep[np.argmax(diagonal)] = False
    inverse = np.zeros((count, count))
    scale = 1.0 / np.sqrt(diagonal[keep])
    part = np.linalg.inv(scale[:, None] * matrix[np.ix_(keep, keep)] * scale)
    inverse[np.ix_(keep, keep)] = scale[:, None] * (0.5 * (part + part.T)) * scale
    return inverse


def _relax(level: _Level, x: Floats, rhs: Floats, parity: int, forward: bool) -> None:
    """One Gauss-Seidel sweep over every second row."""
    over_image(
        lambda start, stop: sweep(level.weights, level.inverse, x, rhs, parity, forward, start, stop),
        (len(rhs) // 2, 2 * rhs.shape[1]),
    )


def _restricted(level: _Level, x: Floats, rhs: Floats) -> Floats:
    """P^T (rhs - A x), even in rows and columns."""
    left = np.zeros(x.shape)
    over_image(lambda start, stop: residual(level.weights, x, rhs, left, start, stop), rhs.shape)
    rows, cols = level.across.shape
    out = np.zeros((rows + rows % 2, cols + cols % 2))
    over_image(
        lambda start, stop: restrict(left, level.across, level.along, level.corners, out, start, stop),
        (rows, 4 * cols),
    )
    return out
