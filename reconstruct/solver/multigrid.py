"""Multigrid for weighted Poisson problems on pixel edges whose weights jump: masks, creases, noisy borders.

Every second pixel of every second row is kept; the others are interpolated by the operator itself (Dendy's
black box multigrid, doi:10.1016/0021-9991(82)90057-2), and the coarse operator is the energy of what is so
interpolated. Both keep constants exactly: an operator is stored as its edge weights alone, eight neighbours
from the second level on. One V-cycle with a zebra Gauss-Seidel sweep before and its mirror image after is
symmetric and serves conjugate gradients as preconditioner: about ten iterations whatever size and mask.

Levels have an even number of rows and columns, if need be by pixels without edges, and a border of such
pixels around weights and unknowns, so that no pixel is a special case. In the kernels w are the weights;
across, along, corners as in `_Level`.
"""

from dataclasses import dataclass

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact, inlined

from ..arrays import Floats

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
            lambda start, stop: _interpolate(below, level.across, level.along, level.corners, x, start, stop),
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
        lambda start, stop: _galerkin(
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
        lambda start, stop: _sweep(level.weights, level.inverse, x, rhs, parity, forward, start, stop),
        (len(rhs) // 2, 2 * rhs.shape[1]),
    )


def _restricted(level: _Level, x: Floats, rhs: Floats) -> Floats:
    """P^T (rhs - A x), even in rows and columns."""
    left = np.zeros(x.shape)
    over_image(lambda start, stop: _residual(level.weights, x, rhs, left, start, stop), rhs.shape)
    rows, cols = level.across.shape
    out = np.zeros((rows + rows % 2, cols + cols % 2))
    over_image(
        lambda start, stop: _restrict(left, level.across, level.along, level.corners, out, start, stop),
        (rows, 4 * cols),
    )
    return out


@exact
def _sweep(w, inverse, x, rhs, parity, forward, start, stop):  # type: ignore[no-untyped-def]
    cols = rhs.shape[1]
    for r in range(start, stop):
        i = 2 * r + parity + 1
        for k in range(cols):
            j = k + 1 if forward else cols - k
            around = w[0, i, j - 1] * x[i, j - 1] + w[0, i, j] * x[i, j + 1]
            around += w[1, i - 1, j] * x[i - 1, j] + w[1, i, j] * x[i + 1, j]
            around += w[2, i - 1, j - 1] * x[i - 1, j - 1] + w[2, i, j] * x[i + 1, j + 1]
            around += w[3, i - 1, j + 1] * x[i - 1, j + 1] + w[3, i, j] * x[i + 1, j - 1]
            x[i, j] = (rhs[i - 1, j - 1] + around) * inverse[i - 1, j - 1]


@exact
def _residual(w, x, rhs, out, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start + 1, stop + 1):
        for j in range(1, rhs.shape[1] + 1):
            here = x[i, j]
            flow = w[0, i, j - 1] * (x[i, j - 1] - here) + w[0, i, j] * (x[i, j + 1] - here)
            flow += w[1, i - 1, j] * (x[i - 1, j] - here) + w[1, i, j] * (x[i + 1, j] - here)
            flow += w[2, i - 1, j - 1] * (x[i - 1, j - 1] - here) + w[2, i, j] * (x[i + 1, j + 1] - here)
            flow += w[3, i - 1, j + 1] * (x[i - 1, j + 1] - here) + w[3, i, j] * (x[i + 1, j - 1] - here)
            out[i, j] = rhs[i - 1, j - 1] + flow


@exact
def _restrict(fine, across, along, corners, out, start, stop):  # type: ignore[no-untyped-def]
    for r in range(start, stop):
        i = 2 * r + 1
        for c in range(across.shape[1]):
            j = 2 * c + 1
            total = fine[i, j] + across[r, c] * fine[i, j + 1] + (1.0 - across[r, c - 1]) * fine[i, j - 1]
            total += along[r, c] * fine[i + 1, j] + (1.0 - along[r - 1, c]) * fine[i - 1, j]
            total += corners[r, c, 0] * fine[i + 1, j + 1] + corners[r, c - 1, 1] * fine[i + 1, j - 1]
            total += corners[r - 1, c, 2] * fine[i - 1, j + 1] + corners[r - 1, c - 1, 3] * fine[i - 1, j - 1]
            out[r, c] = total


@exact
def _interpolate(below, across, along, corners, x, start, stop):  # type: ignore[no-untyped-def]
    for r in range(start, stop):
        i = 2 * r + 1
        for c in range(across.shape[1]):
            j = 2 * c + 1
            here, after = below[r + 1, c + 1], below[r + 1, c + 2]
            under, beyond = below[r + 2, c + 1], below[r + 2, c + 2]
            x[i, j] += here
            x[i, j + 1] += across[r, c] * here + (1.0 - across[r, c]) * after
            x[i + 1, j] += along[r, c] * here + (1.0 - along[r, c]) * under
            x[i + 1, j + 1] += corners[r, c, 0] * here + corners[r, c, 1] * after
            x[i + 1, j + 1] += corners[r, c, 2] * under + corners[r, c, 3] * beyond


@inlined
def _pairs(w, a, b, out):  # type: ignore[no-untyped-def]
    """Energy w (a - b)^2 of interpolated values as couplings of the four corners: top, left, falling, rising,
    right, bottom.
    """
    d0, d1, d2, d3 = a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]
    out[0] -= w * d0 * d1
    out[1] -= w * d0 * d2
    out[2] -= w * d0 * d3
    out[3] -= w * d1 * d2
    out[4] -= w * d1 * d3
    out[5] -= w * d2 * d3


@exact
def _galerkin(w, across, along, corners, coarse, below, start, stop):  # type: ignore[no-untyped-def]
    """Coarse couplings, cell by cell: a cell owns the fine edges that begin in its first two rows and
    columns, all of which end within its four corners' reach. below: of the cell's lower side.
    """
    rows, cols = across.shape
    p = np.zeros((3, 3, 4))
    sums = np.zeros(6)
    p[0, 0, 0] = p[0, 2, 1] = p[2, 0, 2] = p[2, 2, 3] = 1.0
    for r in range(start, stop):
        for c in range(cols):
            low, far = across[min(r + 1, rows - 1), c], along[r, min(c + 1, cols - 1)]
            p[0, 1, 0], p[0, 1, 1] = across[r, c], 1.0 - across[r, c]
            p[1, 0, 0], p[1, 0, 2] = along[r, c], 1.0 - along[r, c]
            p[1, 1] = corners[r, c]
            p[1, 2, 1], p[1, 2, 3] = far, 1.0 - far
            p[2, 1, 2], p[2, 1, 3] = low, 1.0 - low
            sums[:] = 0.0
            for a in range(2):
                for b in range(2):
                    i, j = 2 * r + a + 1, 2 * c + b + 1
                    _pairs(w[0, i, j], p[a, b], p[a, b + 1], sums)
                    _pairs(w[1, i, j], p[a, b], p[a + 1, b], sums)
                    _pairs(w[2, i, j], p[a, b], p[a + 1, b + 1], sums)
                    _pairs(w[3, i, j + 1], p[a, b + 1], p[a + 1, b], sums)
            i, j = r + 1, c + 1
            coarse[0, i, j] = sums[0]
            coarse[1, i, j] += sums[1]
            coarse[2, i, j] = sums[2]
            coarse[3, i, j + 1] = sums[3]
            coarse[1, i, j + 1] += sums[4]
            below[r, c] = sums[5]
