"""Circulation of the slopes around blocks of cells: zero for every surface.

Its size by noise is measured when a rig is prepared; wrong fringe orders, torn frames and folds increase
it."""

import numpy as np

from .arrays import Cells, Mask

__all__ = ["BLOCKS", "circulation", "excess"]

BLOCKS = (8, 32)  # cells along a block's side


def circulation(slopes: Cells, good: Mask, block: int) -> Cells:
    """Circulation around the complete blocks of the image (rows, cols), mm, by the trapezoidal rule; NaN
    where a cell is not good. slopes (2, R, C): mm per cell, along columns and rows."""
    p, q = slopes
    rows, cols = (max(count - 1, 0) // block for count in p.shape)
    along = 0.5 * (
        p[: rows * block + 1 : block, : cols * block] + p[: rows * block + 1 : block, 1 : cols * block + 1]
    )
    down = 0.5 * (
        q[: rows * block, : cols * block + 1 : block] + q[1 : rows * block + 1, : cols * block + 1 : block]
    )
    top = along.reshape(-1, cols, block).sum(2)
    side = down.reshape(rows, block, -1).sum(1)
    whole = good[: rows * block, : cols * block].reshape(rows, block, cols, block).all(axis=(1, 3))
    around = top[:-1] - top[1:] + side[:, 1:] - side[:, :-1]
    return np.asarray(np.where(whole, around, np.nan), np.float32)


def excess(around: Cells, sigma: Cells) -> float:
    """Mean square of circulations over their sigma; 1: noise, infinite: no good block."""
    if around.size == 0:
        return 1.0
    ratio = (around / sigma)[np.isfinite(around)]
    return float(np.mean(np.square(ratio))) if ratio.size else np.inf
