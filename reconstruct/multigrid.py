"""Multigrid for weighted Poisson problems on pixel edges whose weights jump: masks, creases, noisy borders.

Every second pixel of every second row is kept; the others are interpolated by the operator itself (Dendy's
black box multigrid, doi:10.1016/0021-9991(82)90057-2), and the coarse operator is the energy of what is so
interpolated. Both keep constants exactly: an operator is stored as its edge weights alone, eight neighbours
from the second level on. One V-cycle with a zebra Gauss-Seidel sweep before and its mirror image after is
symmetric and serves conjugate gradients as preconditioner: about ten iterations whatever size and mask.
"""

from dataclasses import dataclass

import numpy as np

from optolever.blocks import over_image

from .arrays import Floats
from .multigrid_kernels import (
    galerkin,
    interpolate,
    interpolation,
    invert,
    residual,
    restrict,
    sweep,
)

__all__ = ["Multigrid"]

_COARSEST = 60  # pixels that are solved by a dense inverse


@dataclass(frozen=True, slots=True)
class _Level:
    """Weights of the edges to the right, down, down right and down left (rows, cols), the last two (1, 1) on
    the finest level; inverse of the diagonal; interpolation from the next level: share of the left or upper
    neighbour, and of the four corners.
    """

    right: Floats
    down: Floats
    falling: Floats
    rising: Floats
    inverse: Floats
    across: Floats
    along: Floats
    corners: Floats

    @property
    def shape(self) -> tuple[int, int]:
        return self.right.shape[0], self.right.shape[1]

    @property
    def weights(self) -> tuple[Floats, Floats, Floats, Floats]:
        return self.right, self.down, self.falling, self.rising


class Multigrid:
    """A V-cycle for D^T w D x = rhs.

    wx, wy: (rows, cols) weights of the edges (i, j) - (i, j + 1) and (i, j) - (i + 1, j), positive wherever
    both pixels exist.
    """

    def __init__(self, wx: Floats, wy: Floats) -> None:
        none = np.zeros((1, 1))
        weights = wx, wy, none, none
        self._levels: list[_Level] = []
        while weights[0].size > _COARSEST:
            level = _level(weights)
            self._levels.append(level)
            weights = _coarser(level)
        self._shape = weights[0].shape
        self._dense = _dense_inverse(weights)

    def cycle(self, rhs: Floats) -> Floats:
        """About the solution, up to a constant."""
        return self._cycle(0, rhs)

    def _cycle(self, depth: int, rhs: Floats) -> Floats:
        if depth == len(self._levels):
            return (self._dense @ rhs.ravel()).reshape(self._shape)
        level = self._levels[depth]
        x = np.zeros(rhs.shape)
        for parity in (0, 1):
            _relax(level, x, rhs, parity, True)
        below = self._cycle(depth + 1, _restricted(level, x, rhs))
        _prolong(level, x, below)
        for parity in (1, 0):
            _relax(level, x, rhs, parity, False)
        return x


def _halved(size: int) -> int:
    return (size + 1) // 2


def _level(weights: tuple[Floats, Floats, Floats, Floats]) -> _Level:
    rows, cols = weights[0].shape
    inverse = np.empty((rows, cols))
    over_image(lambda start, stop: invert(*weights, inverse, start, stop), (rows, cols))
    small = _halved(rows), _halved(cols)
    across, along, corners = np.ones(small), np.ones(small), np.zeros((*small, 4))
    over_image(
        lambda start, stop: interpolation(*weights, across, along, corners, start, stop),
        (small[0], 4 * small[1]),
    )
    return _Level(*weights, inverse, across, along, corners)


def _coarser(level: _Level) -> tuple[Floats, Floats, Floats, Floats]:
    """The weights of the next level: energy of what is interpolated."""
    shape = level.across.shape
    right, below, down, falling, rising = (np.zeros(shape) for _ in range(5))
    over_image(
        lambda start, stop: galerkin(
            *level.weights,
            level.across,
            level.along,
            level.corners,
            right,
            below,
            down,
            falling,
            rising,
            start,
            stop,
        ),
        (shape[0], 4 * shape[1]),
    )
    right[1:] += below[:-1]
    return right, down, falling, rising


def _dense_inverse(weights: tuple[Floats, Floats, Floats, Floats]) -> Floats:
    """Inverse of the coarsest operator with its heaviest pixel pinned to zero."""
    shape = weights[0].shape
    count = weights[0].size
    matrix = np.zeros((count, count))
    index = np.arange(count).reshape(shape)
    for weight, dr, dc in zip(weights, (0, 1, 1, 1), (1, 0, 1, -1), strict=True):
        for (i, j), here in np.ndenumerate(index):
            if weight.shape == shape and 0 <= i + dr < shape[0] and 0 <= j + dc < shape[1]:
                there = index[i + dr, j + dc]
                matrix[here, there] -= weight[i, j]
                matrix[there, here] -= weight[i, j]
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    diagonal = np.diag(matrix)
    keep = np.arange(count) != int(np.argmax(diagonal))
    inverse = np.zeros((count, count))
    if count > 1:
        scale = 1.0 / np.sqrt(diagonal[keep])
        part = np.linalg.inv(scale[:, None] * matrix[np.ix_(keep, keep)] * scale)
        inverse[np.ix_(keep, keep)] = scale[:, None] * (0.5 * (part + part.T)) * scale
    return inverse


def _relax(level: _Level, x: Floats, rhs: Floats, parity: int, forward: bool) -> None:
    """One Gauss-Seidel sweep over every second row."""
    half = (level.shape[0] - parity + 1) // 2
    over_image(
        lambda start, stop: sweep(*level.weights, level.inverse, x, rhs, parity, forward, start, stop),
        (half, 2 * level.right.shape[1]),
    )


def _restricted(level: _Level, x: Floats, rhs: Floats) -> Floats:
    """P^T (rhs - A x)."""
    left = np.empty(level.shape)
    over_image(lambda start, stop: residual(*level.weights, x, rhs, left, start, stop), level.shape)
    rows, cols = level.across.shape
    out = np.empty((rows, cols))
    over_image(
        lambda start, stop: restrict(left, level.across, level.along, level.corners, out, start, stop),
        (rows, 4 * cols),
    )
    return out


def _prolong(level: _Level, x: Floats, below: Floats) -> None:
    """x += P below"""
    over_image(
        lambda start, stop: interpolate(below, level.across, level.along, level.corners, x, start, stop),
        (below.shape[0], 4 * below.shape[1]),
    )
