"""Compiled: normal equations of a fringe along u and one along v, cell by cell, and their solution."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined

__all__ = ["MOMENTS", "moments", "solve"]

Array = NDArray[Any]
#: Sums that the normal equations of 1, cos u, sin u, cos v, sin v need (in this order below: 1, a, b, c, d):
#: 1, a, b, c, d, aa, ab, ac, ad, bc, bd, cc, cd, and the image times 1, a, b, c, d. bb is 1 - aa, dd 1 - cc.
MOMENTS = 18


@exact
def moments(
    image: Array, known: Array, phase_u: Array, phase_v: Array, size: int, start: int, stop: int, out: Array
) -> None:
    """Means over cells of size x size pixels, out (MOMENTS, R, C); unknown pixels count as 0."""
    rows, cols = image.shape
    scale = np.float32(1 / size**2)
    for cell_row in range(start, stop):
        for cell_col in range(out.shape[2]):
            total = out[:, cell_row, cell_col]
            for row in range(size * cell_row, min(rows, size * (cell_row + 1))):
                for col in range(size * cell_col, min(cols, size * (cell_col + 1))):
                    if not known[row, col]:
                        continue
                    a, b = np.cos(phase_u[row, col]), np.sin(phase_u[row, col])
                    c, d = np.cos(phase_v[row, col]), np.sin(phase_v[row, col])
                    level = image[row, col]
                    total[0] += 1
                    total[1] += a
                    total[2] += b
                    total[3] += c
                    total[4] += d
                    total[5] += a * a
                    total[6] += a * b
                    total[7] += a * c
                    total[8] += a * d
                    total[9] += b * c
                    total[10] += b * d
                    total[11] += c * c
                    total[12] += c * d
                    total[13] += level
                    total[14] += level * a
                    total[15] += level * b
                    total[16] += level * c
                    total[17] += level * d
            for k in range(MOMENTS):
                total[k] *= scale


@exact
def solve(mean: Array, least: float, start: int, stop: int, out: Array) -> None:
    """Coefficients of cos u, sin u, cos v, sin v into out[:4] (7, R, C), from windowed moments.

    out[4:6]: diagonal elements of the inverse for sin u, sin v (2 where the window is whole); out[6]: the
    mean level. 0 and 1e9 where the window holds less than `least` of its weight.
    """
    matrix, right = np.empty((5, 5)), np.zeros((5, 3))
    for row in range(start, stop):
        for col in range(mean.shape[2]):
            m = mean[:, row, col]
            if not m[0] > least:
                out[:4, row, col], out[4:6, row, col], out[6, row, col] = 0.0, 1e9, 0.0
                continue
            _fill(m, matrix)
            for k in range(5):
                right[k, 0], right[k, 1], right[k, 2] = m[13 + k] / m[0], k == 2, k == 4
            _eliminate(matrix, right)
            for k in range(4):
                out[k, row, col] = right[k + 1, 0]
            out[4, row, col], out[5, row, col], out[6, row, col] = right[2, 1], right[4, 2], right[0, 0]


@inlined
def _fill(m: Any, matrix: Any) -> None:
    """The normal matrix over the window's weight; a trace on its diagonal keeps it regular."""
    place = 1
    for i in range(5):
        for j in range(i, 5):
            if (i == 0 and j == 0) or (i == j and i in (2, 4)):
                continue
            matrix[i, j] = matrix[j, i] = m[place] / m[0]
            place += 1
    matrix[0, 0], matrix[2, 2], matrix[4, 4] = 1.0, 1.0 - matrix[1, 1], 1.0 - matrix[3, 3]
    for i in range(5):
        matrix[i, i] += 1e-6


@inlined
def _eliminate(matrix: Any, right: Any) -> None:
    """Solve in place; a positive matrix needs no pivots."""
    for i in range(5):
        for j in range(i + 1, 5):
            factor = matrix[j, i] / matrix[i, i]
            for k in range(i + 1, 5):
                matrix[j, k] -= factor * matrix[i, k]
            for k in range(3):
                right[j, k] -= factor * right[i, k]
    for i in range(4, -1, -1):
        for k in range(3):
            for j in range(i + 1, 5):
                right[i, k] -= matrix[i, j] * right[j, k]
            right[i, k] /= matrix[i, i]
