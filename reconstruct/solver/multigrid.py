"""Multigrid for weighted Poisson problems on pixel edges whose weights jump: masks, creases, noisy borders.

Every second pixel of every second row is kept; the others are interpolated by the operator itself (Dendy's
black box multigrid, doi:10.1016/0021-9991(82)90057-2), and the coarse operator is the energy of what is so
interpolated. Both keep constants exactly: an operator is stored as its edge weights alone, eight neighbours
from the second level on. One V-cycle with a zebra Gauss-Seidel sweep before and its mirror image after is
symmetric and serves conjugate gradients as preconditioner: about ten iterations whatever size and mask. It is
computed in single precision, as what a preconditioner rounds costs no digit of the solution.

Levels have an even number of rows and columns, if need be by pixels without edges, and a border of such
pixels around weights and unknowns, so that no pixel is a special case. In the kernels w are the weights;
across, along, corners as in `_Level`.
"""

from dataclasses import dataclass

import numpy as np

from optolever.arrays import Floats
from optolever.blocks import over_image
from optolever.kernels import F32, ONE, ZERO, exact, inlined

__all__ = ["Multigrid"]

_COARSEST = 60  # pixels that are solved by a dense inverse
_LEAST = 1e-30  # of the largest weight: single precision holds it
_STEPS = (0, 1), (1, 0), (1, 1), (1, -1)  # rows and columns to the pixel at the other end of an edge


@dataclass(frozen=True, slots=True)
class _Level:
    """weights (4, rows + 2, cols + 2) of the edges to the right, down, down right and down left; nine:
    whether there are any of the last two; inverse of the diagonal (rows, cols); interpolation from the next
    level: share of the left or upper neighbour in the pixels between two (across, along), and of the four
    corners between four.
    """

    weights: F32
    nine: bool
    inverse: F32
    across: F32
    along: F32
    corners: F32


class Multigrid:
    """A V-cycle for D^T w D x = rhs.

    wx, wy: (rows, cols) weights of the edges (i, j) - (i, j + 1) and (i, j) - (i + 1, j), positive wherever
    both pixels exist.
    """

    def __init__(self, wx: Floats, wy: Floats) -> None:
        weights = _bordered(wx.shape)
        rows, cols = wx.shape
        self._largest = max(float(wx.max()), float(wy.max())) or 1.0
        for level, weight in zip(weights, (wx, wy), strict=False):
            part = weight / self._largest
            level[1 : rows + 1, 1 : cols + 1] = np.where(part > 0, np.maximum(part, _LEAST), 0.0)
        self._levels: list[_Level] = []
        while (weights.shape[1] - 2) * (weights.shape[2] - 2) > _COARSEST:
            self._levels.append(_level(weights, bool(self._levels)))
            weights = _coarser(self._levels[-1])
        self._dense = _dense_inverse(weights.astype(np.float64)).astype(np.float32)

    def cycle(self, rhs: Floats) -> F32:
        """About the solution, up to a constant."""
        rows, cols = rhs.shape
        size = float(np.abs(rhs).max()) or 1.0
        even = np.zeros((rows + rows % 2, cols + cols % 2), np.float32)
        np.divide(rhs, size, out=even[:rows, :cols], casting="same_kind")
        return np.float32(size / self._largest) * self._cycle(0, even)[1 : rows + 1, 1 : cols + 1]

    def _cycle(self, depth: int, rhs: F32) -> F32:
        """The solution (rows + 2, cols + 2), zero on the border."""
        rows, cols = rhs.shape
        x = np.zeros((rows + 2, cols + 2), np.float32)
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


def _bordered(shape: tuple[int, ...]) -> F32:
    """No weights, for so many pixels."""
    rows, cols = (size + size % 2 + 2 for size in shape)
    return np.zeros((4, rows, cols), np.float32)


def _level(weights: F32, nine: bool) -> _Level:
    right, down, falling, rising = weights
    inner = np.s_[1:-1, 1:-1]
    east, south, south_east, south_west = right[inner], down[inner], falling[inner], rising[inner]
    west, north = right[1:-1, :-2], down[:-2, 1:-1]
    north_west, north_east = falling[:-2, :-2], rising[:-2, 2:]
    total = east + south
    for part in (south_east, south_west, west, north, north_west, north_east):
        total += part
    inverse = np.divide(ONE, total, out=np.zeros_like(total), where=total > 0)

    across = _share((north_west, west, south_west), (north_east, east, south_east), np.s_[::2, 1::2])
    along = _share((north_west, north, north_east), (south_west, south, south_east), np.s_[1::2, ::2])
    four = np.s_[1::2, 1::2]
    low, far = np.roll(across, -1, axis=0), np.roll(along, -1, axis=1)
    corners = np.empty((*across.shape, 4), np.float32)
    for k, (corner, vertical, v, horizontal, h) in enumerate(
        (
            (north_west, north, across, west, along),
            (north_east, north, ONE - across, east, far),
            (south_west, south, low, west, ONE - along),
            (south_east, south, ONE - low, east, ONE - far),
        )
    ):
        corners[..., k] = inverse[four] * (corner[four] + vertical[four] * v + horizontal[four] * h)
    return _Level(weights, nine, inverse, across, along, corners)


def _share(one: tuple[F32, ...], other: tuple[F32, ...], where: tuple[slice, slice]) -> F32:
    """one / (one + other) of the sums of weights there, all of one if there are none."""
    first, second = (np.asarray(sum(part[where] for part in side)) for side in (one, other))
    total = first + second
    share: F32 = np.divide(first, total, out=np.ones_like(total), where=total > 0)
    return np.clip(share, ZERO, ONE, out=share)


def _coarser(level: _Level) -> F32:
    """The weights of the next level: energy of what is interpolated."""
    rows, cols = level.across.shape
    weights, below = _bordered((rows, cols)), np.zeros((rows, cols), np.float32)
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


def _relax(level: _Level, x: F32, rhs: F32, parity: int, forward: bool) -> None:
    """One Gauss-Seidel sweep over every second row."""
    over_image(
        lambda start, stop: _sweep(
            level.weights, level.nine, level.inverse, x, rhs, parity, forward, start, stop
        ),
        (len(rhs) // 2, 2 * rhs.shape[1]),
    )


def _restricted(level: _Level, x: F32, rhs: F32) -> F32:
    """P^T (rhs - A x), even in rows and columns."""
    left = np.zeros_like(x)
    over_image(lambda start, stop: _residual(level.weights, level.nine, x, rhs, left, start, stop), rhs.shape)
    rows, cols = level.across.shape
    out = np.zeros((rows + rows % 2, cols + cols % 2), np.float32)
    over_image(
        lambda start, stop: _restrict(left, level.across, level.along, level.corners, out, start, stop),
        (rows, 4 * cols),
    )
    return out


@exact
def _sweep(w, nine, inverse, x, rhs, parity, forward, start, stop):  # type: ignore[no-untyped-def]
    """Row by row: what does not depend on the pixel before at once, then x of one after the other."""
    cols = rhs.shape[1]
    known, share = np.empty(cols + 2, np.float32), np.empty(cols + 2, np.float32)
    step = 1 if forward else -1
    for r in range(start, stop):
        i = 2 * r + parity + 1
        here, above, below, right = x[i], x[i - 1], x[i + 1], w[0, i]
        up, down, scale, b = w[1, i - 1], w[1, i], inverse[i - 1], rhs[i - 1]
        for j in range(1, cols + 1):
            known[j] = b[j - 1] + up[j] * above[j] + down[j] * below[j]
        if nine:
            falls, fall, rises, rise = w[2, i - 1], w[2, i], w[3, i - 1], w[3, i]
            for j in range(1, cols + 1):
                known[j] += falls[j - 1] * above[j - 1] + fall[j] * below[j + 1]
                known[j] += rises[j + 1] * above[j + 1] + rise[j] * below[j - 1]
        if forward:
            for j in range(1, cols + 1):
                known[j] = (known[j] + right[j] * here[j + 1]) * scale[j - 1]
                share[j] = right[j - 1] * scale[j - 1]
        else:
            for j in range(1, cols + 1):
                known[j] = (known[j] + right[j - 1] * here[j - 1]) * scale[j - 1]
                share[j] = right[j] * scale[j - 1]
        last = ZERO
        j = 1 if forward else cols
        for _ in range(cols):
            last = known[j] + share[j] * last
            here[j] = last
            j += step


@exact
def _residual(w, nine, x, rhs, out, start, stop):  # type: ignore[no-untyped-def]
    cols = rhs.shape[1]
    for i in range(start + 1, stop + 1):
        here, above, below, right, left = x[i], x[i - 1], x[i + 1], w[0, i], out[i]
        up, down, b = w[1, i - 1], w[1, i], rhs[i - 1]
        for j in range(1, cols + 1):
            flow = right[j - 1] * (here[j - 1] - here[j]) + right[j] * (here[j + 1] - here[j])
            left[j] = b[j - 1] + flow + up[j] * (above[j] - here[j]) + down[j] * (below[j] - here[j])
        if nine:
            falls, fall, rises, rise = w[2, i - 1], w[2, i], w[3, i - 1], w[3, i]
            for j in range(1, cols + 1):
                flow = falls[j - 1] * (above[j - 1] - here[j]) + fall[j] * (below[j + 1] - here[j])
                left[j] += flow + rises[j + 1] * (above[j + 1] - here[j]) + rise[j] * (below[j - 1] - here[j])


@exact
def _restrict(fine, across, along, corners, out, start, stop):  # type: ignore[no-untyped-def]
    for r in range(start, stop):
        i = 2 * r + 1
        for c in range(across.shape[1]):
            j = 2 * c + 1
            total = fine[i, j] + across[r, c] * fine[i, j + 1] + (ONE - across[r, c - 1]) * fine[i, j - 1]
            total += along[r, c] * fine[i + 1, j] + (ONE - along[r - 1, c]) * fine[i - 1, j]
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
            x[i, j + 1] += across[r, c] * here + (ONE - across[r, c]) * after
            x[i + 1, j] += along[r, c] * here + (ONE - along[r, c]) * under
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
            for k in range(4):  # an assignment of the line compiles numba's message of shapes, 2 s
                p[1, 1, k] = corners[r, c, k]
            p[1, 2, 1], p[1, 2, 3] = far, 1.0 - far
            p[2, 1, 2], p[2, 1, 3] = low, 1.0 - low
            for k in range(6):
                sums[k] = 0.0
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
