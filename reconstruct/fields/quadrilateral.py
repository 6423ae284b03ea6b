"""Edge increments of slopes on a grid whose pixels lie anywhere: irregular and quadrilateral grids.

Around every edge a polynomial of fifth degree in both coordinates, a potential, is fitted to the slopes of
its neighbours, by least squares at their true places; the increment is its difference between the edge's
ends. Exact for surfaces of fifth degree wherever the pixels lie; a chain rule would differentiate the places
too.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.errors import InputError

from ..arrays import Floats, Mask

__all__ = ["quadrilateral_increments", "quadrilateral_weights"]

#: Neighbours (rows, cols) around an edge along a row; the wider windows where a mask hides some.
_WINDOWS = ((3, 6), (5, 8))
_DEGREE = 5
_POWERS = np.array([(m, n - m) for n in range(1, _DEGREE + 1) for m in range(n, -1, -1)])
_DEGREES = _POWERS.sum(axis=1)
#: Neighbours from which on a term of the second, third, ... degree is fitted: as many as a polynomial of one
#: degree less has coefficients. Each brings two slopes.
_NEEDED = np.array([d * (d + 1) // 2 for d in range(2, _DEGREE + 1)])
#: Ridge of a term by its degree: of terms that neighbours on a line or a lattice do not separate, the lowest
#: remains. And the ridge of a term that is not fitted.
_RIDGE, _NEVER = np.array([0.0, 1e-12, 1e-11, 1e-10, 1e-9])[_DEGREES - 1], 1e12
_BLOCK = 8  # rows whose edges are fitted together


def quadrilateral_increments(p: Floats, q: Floats, x: Floats, y: Floats, mask: Mask) -> tuple[Floats, Floats]:
    """Increments (H, W) along the edges (i, j) - (i, j + 1) and (i, j) - (i + 1, j), zero where none is.

    p = dz/dx and q = dz/dy (H, W) at x, y (H, W) in the pixels of the mask.
    """
    samples = np.stack([np.where(mask, part, 0.0) for part in (x, y, p, q, mask)])
    return _along_rows(samples), _along_rows(samples.transpose(0, 2, 1)).T


def quadrilateral_weights(wp: Floats, wq: Floats, x: Floats, y: Floats, mask: Mask) -> tuple[Floats, Floats]:
    """Weights (H, W) of the same edges: mean square length of all over the variance of the increment, for
    slopes of the inverse variances wp, wq (H, W). InputError if two neighbours lie at the same place.
    """
    x, y = (np.where(mask, part, 0.0) for part in (x, y))
    variances = [np.where(mask, 1.0 / np.where(mask, w, 1.0), 0.0) for w in (wp, wq)]
    squares, weights = [], []
    for axis, first, second in ((1, np.s_[:, :-1], np.s_[:, 1:]), (0, np.s_[:-1], np.s_[1:])):
        exists = mask[first] & mask[second]
        dx2, dy2 = (np.diff(part, axis=axis) ** 2 for part in (x, y))
        if not (dx2 + dy2)[exists].all():
            row, col = np.argwhere(exists & (dx2 + dy2 == 0))[0]
            raise InputError(f"spacing: pixel ({row}, {col}) lies where its neighbour does")
        var_p, var_q = (0.5 * (part[first] + part[second]) for part in variances)
        weight = np.zeros(mask.shape)
        weight[first][exists] = 1.0 / (dx2 * var_p + dy2 * var_q)[exists]
        squares.append((dx2 + dy2)[exists])
        weights.append(weight)
    lengths = np.concatenate(squares)
    unit = float(lengths.mean()) if lengths.size else 1.0
    return weights[0] * unit, weights[1] * unit


def _along_rows(samples: Floats) -> Floats:
    """Increments from (i, j) to (i, j + 1) of samples x, y, p, q, mask (5, H, W)."""
    mask = samples[4] > 0
    out = np.zeros(mask.shape)
    edges = np.zeros(mask.shape, dtype=np.bool_)
    edges[:, :-1] = mask[:, :-1] & mask[:, 1:]

    def work(start: int, stop: int) -> None:
        left = np.nonzero(edges[start:stop])
        rows, cols = left[0] + start, left[1]
        for last, size in ((False, _WINDOWS[0]), (True, _WINDOWS[1])):
            window = _window(samples, rows, cols, size)
            full = last | (window[4] > 0).all(axis=1)
            ends = samples[:2, rows[full], cols[full]], samples[:2, rows[full], cols[full] + 1]
            out[rows[full], cols[full]] = _increments(window[:, full], *ends)
            rows, cols = rows[~full], cols[~full]

    over_rows(work, mask.shape[0], _BLOCK)
    return out


def _window(samples: Floats, rows: NDArray[np.intp], cols: NDArray[np.intp], size: tuple[int, int]) -> Floats:
    """Neighbours (5, N, K) of the edges, on one side of them where the image ends."""
    height, width = min(size[0], samples.shape[1]), min(size[1], samples.shape[2])
    top = np.clip(rows - size[0] // 2, 0, samples.shape[1] - height)
    left = np.clip(cols - size[1] // 2 + 1, 0, samples.shape[2] - width)
    windows = sliding_window_view(samples, (height, width), axis=(1, 2))
    return windows[:, top, left].reshape(5, rows.size, height * width)


def _increments(window: Floats, first: Floats, second: Floats) -> Floats:
    """Differences of the fitted potentials between the places first and second (2, N)."""
    used = window[4]
    middle, along = 0.5 * (first + second), second - first
    away = (window[:2] - middle[..., None]) * used
    # the frame in which the neighbours extend as far along the edge as across it
    length = np.hypot(*along)
    across = np.array([-along[1], along[0]]) / length
    height = np.abs(np.einsum("cn,cnk->nk", across, away)).max(axis=1)
    across *= np.where(height > 0, height, length)
    frame = np.stack([along, across])  # (axis, coordinate, N)
    inverse = np.linalg.inv(frame.transpose(2, 1, 0))  # (N, axis, coordinate)
    u, v = np.einsum("nac,cnk->ank", inverse, away)
    slopes = np.einsum("acn,cnk->ank", frame, window[2:4]) * used
    by_u, by_v = _monomials(u, v)[1:]
    fit = np.concatenate([by_u * used[..., None], by_v * used[..., None]], axis=1)
    degree = 1 + np.searchsorted(_NEEDED, used.sum(axis=1), side="right")
    cost = np.where(degree[:, None] < _DEGREES, _NEVER, _RIDGE)
    normal = fit.transpose(0, 2, 1) @ fit + cost[..., None] * np.eye(len(_DEGREES))
    right = fit.transpose(0, 2, 1) @ np.concatenate([slopes[0], slopes[1]], axis=1)[..., None]
    half = np.full((1, 1), 0.5)
    difference = (_monomials(half, 0 * half)[0] - _monomials(-half, 0 * half)[0])[0, 0]
    found: Floats = np.linalg.solve(normal, right)[..., 0] @ difference
    return found


def _monomials(u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """u^m v^n of all terms, (..., terms), and their derivatives by u and by v."""
    m, n = _POWERS.T
    powers_u, powers_v = _powers(u), _powers(v)
    terms = powers_u[..., m] * powers_v[..., n]
    by_u = m * powers_u[..., np.maximum(m - 1, 0)] * powers_v[..., n]
    by_v = n * powers_u[..., m] * powers_v[..., np.maximum(n - 1, 0)]
    return terms, by_u, by_v


def _powers(u: Floats) -> Floats:
    """1, u, u^2, ... (..., degree + 1)."""
    return np.multiply.accumulate(np.stack([np.ones(u.shape), *[u] * _DEGREE], axis=-1), axis=-1)
