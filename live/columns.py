"""Weighted least squares of increments on a rectangle whose weights go by its columns, in float32.

min sum w (x_j - x_i - g)^2 over neighbours: a cosine transform along the rows' axis makes tridiagonal systems
along the columns' (R. W. Hockney, J. ACM 12:95, 1965), which are swept for all modes at once, so that the
loops are vector instructions."""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from optolever.blocks import over_rows
from optolever.kernels import kernel

from .arrays import Cells, Float

__all__ = ["Columns", "columns_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The factorised systems. weights (C,): of the edges along a row, 0 last; pivots (C, R); mirrored:
    columns are in falling order, as the elimination starts at the light end."""

    weights: Cells
    pivots: Cells
    mirrored: bool

    def solve(self, divergence: Cells) -> Cells:
        """x (R, C), of mean mode 0, of which D^T w D x is the right-hand side (R, C)."""
        turned = np.ascontiguousarray((divergence[:, ::-1] if self.mirrored else divergence).T)
        modes = scipy.fft.dct(turned, axis=1, norm="ortho", overwrite_x=True)
        count = modes.shape[1]
        over_rows(
            lambda start, stop: _sweep(self.weights, self.pivots, modes, start, stop), count, count // 2 + 1
        )
        x = scipy.fft.idct(modes, axis=1, norm="ortho", overwrite_x=True).T
        return np.ascontiguousarray(x[:, ::-1] if self.mirrored else x)


def columns_of(along: Float, across: Float, rows: int) -> Columns:
    """along (C,): weights of the edges from each column to the next, the last one 0; across (C,): of the
    edges within each column."""
    count = along.size
    mirrored = bool(along[: count // 2].sum() < along[count // 2 : -1].sum())
    if mirrored:
        along, across = np.append(along[:-1][::-1], 0.0), across[::-1]
    eigen = 4 * np.sin(0.5 * np.pi * np.arange(rows) / rows) ** 2
    pivots, excess = np.zeros((count, rows)), np.zeros(rows)
    for j in range(count - 1, 0, -1):
        excess = excess + eigen * across[j]
        pivots[j] = 1 / (along[j - 1] + excess)
        excess = along[j - 1] * excess * pivots[j]
    excess = excess + eigen * across[0]
    pivots[0, 1:] = 1 / excess[1:]
    return Columns(along.astype(np.float32), pivots.astype(np.float32), mirrored)


@kernel
def _sweep(weights, pivots, b, start, stop):  # type: ignore[no-untyped-def]
    """b (C, modes), column 0 is the heavy end."""
    count = b.shape[0]
    for j in range(count - 1, 0, -1):
        for k in range(start, stop):
            b[j - 1, k] += weights[j - 1] * pivots[j, k] * b[j, k]
    for k in range(start, stop):
        b[0, k] *= pivots[0, k]
    for j in range(1, count):
        for k in range(start, stop):
            b[j, k] = (b[j, k] + weights[j - 1] * b[j - 1, k]) * pivots[j, k]
