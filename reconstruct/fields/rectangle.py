"""Integration on a full rectangle by two cosine transforms.

The least-squares heights of edge increments g solve the Neumann Laplacian L z = D^T g, which the DCT-II
diagonalises with eigenvalues (2 - 2 cos(pi k / rows)) + (2 - 2 cos(pi l / cols)); no boundary terms.
"""

import math

import numpy as np
import scipy.fft

from optolever.blocks import threads

from ..arrays import Floats
from ..solver.edges import divergence, increments

__all__ = ["rectangle"]


def rectangle(p: Floats, q: Floats, cubic: bool) -> tuple[Floats, float]:
    """Heights of mean zero (H, W) whose slopes per pixel are p (along columns) and q (along rows), and the
    rms edge defect. cubic: increments of the cubic through four pixels, else of the trapezoid.
    """
    rows, cols = p.shape
    gx, gy = increments(p, q, np.ones(p.shape, np.bool_)) if cubic else _trapezoids(p, q)
    alike = np.ones((1, cols))
    modes = divergence(gx, gy, alike, alike)
    modes = scipy.fft.dctn(modes, norm="ortho", workers=threads(), overwrite_x=True)
    eigenvalues = np.add.outer(_eigenvalues(rows), _eigenvalues(cols))
    eigenvalues[0, 0] = np.inf
    modes /= eigenvalues
    z: Floats = scipy.fft.idctn(modes, norm="ortho", workers=threads(), overwrite_x=True)
    gx[:, :-1] -= np.diff(z, axis=1)
    gy[:-1] -= np.diff(z, axis=0)
    edges = rows * (cols - 1) + cols * (rows - 1)
    squares = sum(float(np.einsum("ij,ij->", g, g)) for g in (gx, gy))
    return z, math.sqrt(squares / max(edges, 1))


def _trapezoids(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    gx, gy = np.zeros(p.shape), np.zeros(q.shape)
    gx[:, :-1] = 0.5 * (p[:, :-1] + p[:, 1:])
    gy[:-1] = 0.5 * (q[:-1] + q[1:])
    return gx, gy


def _eigenvalues(count: int) -> Floats:
    values: Floats = 2.0 - 2.0 * np.cos(np.pi * np.arange(count) / count)
    return values
