"""Circulation of the slopes around blocks of cells: zero for every surface.

Its size by noise is measured when a rig is prepared; wrong fringe orders, torn frames and folds increase it.
`reconstruct` has one of blocks of all sizes by sigma, which takes seven times as long."""

import cv2
import numpy as np

from optolever.arrays import Cells, Floats, Mask

__all__ = ["BLOCKS", "circulations"]

BLOCKS = (8, 32)  # cells along a block's side
_OVER = 8  # blocks overlap by all but so many parts of a side


def circulations(slopes: Cells, good: Mask) -> Floats:
    """Mean square circulation around the complete blocks of each size (2,), mm^2, by the trapezoidal rule; 0
    without one. slopes (2, R, C): mm per cell, along columns and rows."""
    p, q = np.where(good, slopes, 0).astype(np.float64)
    from_left, from_top = np.zeros_like(p), np.zeros_like(q)
    known = np.asarray(cv2.integral(good.view(np.uint8)), np.float64)
    from_left[:, 1:] = np.cumsum(0.5 * (p[:, :-1] + p[:, 1:]), axis=1)
    from_top[1:] = np.cumsum(0.5 * (q[:-1] + q[1:]), axis=0)
    return np.array([_mean_square(from_left - from_top, known, block) for block in BLOCKS])


def _mean_square(line: Floats, known: Floats, block: int) -> float:
    """line (R, C): line integrals from the left less those from the top; known: good cells above and left."""
    every = max(block // _OVER, 1)
    rows, cols = (count - block for count in line.shape)
    if min(rows, cols) <= 0:
        return 0.0

    def over(values: Floats, side: int) -> Floats:
        """Second difference over the corners of every block."""
        a, b = values[:rows:every], values[side : side + rows : every]
        after = slice(side, side + cols, every)
        return np.asarray(a[:, after] - a[:, :cols:every] - b[:, after] + b[:, :cols:every])

    whole = over(known, block + 1) == -((block + 1) ** 2)
    return float(np.mean(np.square(over(line, block)[whole]))) if whole.any() else 0.0
