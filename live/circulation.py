"""Circulation of the slopes around blocks of cells: zero for every surface.

Its size by noise is measured when a rig is prepared; wrong fringe orders, torn frames and folds increase it.
`reconstruct` has one of overlapping blocks of all sizes by sigma, which takes 28 times as long."""

import numpy as np

from .arrays import Cells, Float, Mask

__all__ = ["BLOCKS", "circulations"]

BLOCKS = (8, 32)  # cells along a block's side


def circulations(slopes: Cells, good: Mask) -> Float:
    """Mean square circulation around the complete blocks of each size (2,), mm^2, by the trapezoidal rule;
    infinite without one. slopes (2, R, C): mm per cell, along columns and rows."""
    found = np.full(len(BLOCKS), np.inf)
    for k, block in enumerate(BLOCKS):
        rows, cols = (max(count - 1, 0) // block for count in good.shape)
        p, q = slopes[:, : rows * block + 1, : cols * block + 1]
        whole = good[: rows * block, : cols * block].reshape(rows, block, cols, block).all(axis=(1, 3))
        top = 0.5 * (p[::block, :-1] + p[::block, 1:]).reshape(rows + 1, cols, block).sum(2)
        side = 0.5 * (q[:-1, ::block] + q[1:, ::block]).reshape(rows, block, cols + 1).sum(1)
        around = (top[:-1] - top[1:] + side[:, 1:] - side[:, :-1])[whole]
        if around.size:
            found[k] = float(np.mean(np.square(around)))
    return found
