"""Plain integration on a full rectangle: two cosine transforms, and little beside them.

The least-squares heights of edge increments g solve the Neumann Laplacian L z = D^T g, which the DCT-II
diagonalises with eigenvalues (2 - 2 cos(pi k / rows)) + (2 - 2 cos(pi l / cols)); no boundary terms. The
increments are formed where they are needed, twice, and never stored.
"""

import math

import numpy as np
import scipy.fft

from optolever.blocks import over_rows, threads
from optolever.kernels import exact, inlined

from .arrays import Floats
from .edges import cubic_at_end, cubic_inside

__all__ = ["rectangle"]


def rectangle(p: Floats, q: Floats, cubic: bool) -> tuple[Floats, float]:
    """Heights of mean zero (H, W) whose slopes per pixel are p (along columns) and q (along rows), and the
    rms edge defect. cubic: increments of the cubic through four pixels, else of the trapezoid.
    """
    rows, cols = p.shape
    down, across = _eigenvalues(rows), _eigenvalues(cols)
    rhs = np.empty(p.shape)
    over_rows(lambda start, stop: _divergence(p, q, cubic, rhs, start, stop), rows)
    workers = threads()
    modes = scipy.fft.dctn(rhs, norm="ortho", workers=workers, overwrite_x=True)
    over_rows(lambda start, stop: _divide(modes, down, across, start, stop), rows)
    z: Floats = scipy.fft.idctn(modes, norm="ortho", workers=workers, overwrite_x=True)
    left = np.empty(rows)
    over_rows(lambda start, stop: _defects(p, q, z, cubic, left, start, stop), rows)
    edges = rows * (cols - 1) + cols * (rows - 1)
    return z, math.sqrt(float(left.sum()) / max(edges, 1))


def _eigenvalues(count: int) -> Floats:
    values: Floats = 2.0 - 2.0 * np.cos(np.pi * np.arange(count) / count)
    return values


@inlined
def _increment(f, i, j, di, dj, cubic):  # type: ignore[no-untyped-def]
    """From (i, j) to (i + di, j + dj)."""
    k, n = (i, f.shape[0]) if di == 1 else (j, f.shape[1])
    g0, g1 = f[i, j], f[i + di, j + dj]
    if not cubic or n < 4:
        return 0.5 * (g0 + g1)
    if k == 0:
        return cubic_at_end(g0, g1, f[i + 2 * di, j + 2 * dj], f[i + 3 * di, j + 3 * dj])
    if k == n - 2:
        return cubic_at_end(g1, g0, f[i - di, j - dj], f[i - 2 * di, j - 2 * dj])
    return cubic_inside(f[i - di, j - dj], g0, g1, f[i + 2 * di, j + 2 * dj])


@exact
def _divergence(p, q, cubic, rhs, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = p.shape
    for i in range(start, stop):
        before = 0.0
        for j in range(cols - 1):
            after = _increment(p, i, j, 0, 1, cubic)
            rhs[i, j] = before - after
            before = after
        rhs[i, cols - 1] = before
        if i > 0:
            for j in range(cols):
                rhs[i, j] += _increment(q, i - 1, j, 1, 0, cubic)
        if i < rows - 1:
            for j in range(cols):
                rhs[i, j] -= _increment(q, i, j, 1, 0, cubic)


@exact
def _divide(modes, down, across, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        for j in range(modes.shape[1]):
            if i == 0 and j == 0:
                modes[i, j] = 0.0
            else:
                modes[i, j] /= down[i] + across[j]


@exact
def _defects(p, q, z, cubic, left, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = p.shape
    for i in range(start, stop):
        total = 0.0
        for j in range(cols - 1):
            total += (_increment(p, i, j, 0, 1, cubic) - z[i, j + 1] + z[i, j]) ** 2
        if i < rows - 1:
            for j in range(cols):
                total += (_increment(q, i, j, 1, 0, cubic) - z[i + 1, j] + z[i, j]) ** 2
        left[i] = total
