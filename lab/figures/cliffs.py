"""A surface with a cliff behind a mask, and the plain way to integrate its slopes robustly: what
`integrate(robust=True)` has to beat.
"""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from optolever.experiments.arrays import Floats, Mask

_TURNS = 30
_TUNING = 2.385 * 1.4826  # Cauchy's constant (doi:10.1080/03610927708827533), of the scaled median


def cliff(rows: int, cols: int, noise: float, seed: int = 0) -> tuple[Floats, Floats, Floats, Mask]:
    """z, its noisy slopes per pixel along columns and rows, and a star for a mask, (rows, cols) each.

    The cliff rises along a curve from nothing to a few units; no slope shows it.
    """
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x, y = x / cols, y / rows
    above = y > 0.5 + 0.12 * np.sin(6 * x)
    rise = np.clip(x - 0.25, 0, None)
    z = 5 * np.sin(3 * x) * np.cos(2.5 * y) + 14 * above * rise**2
    gx = (15 * np.cos(3 * x) * np.cos(2.5 * y) + 28 * above * rise) / cols
    gy = -12.5 * np.sin(3 * x) * np.sin(2.5 * y) / rows
    rng = np.random.default_rng(seed)
    gx, gy = (g + noise * rng.standard_normal(g.shape) for g in (gx, gy))
    away = np.hypot((x - 0.5) / 0.45, (y - 0.5) / 0.46)
    return z, gx, gy, away < 0.8 + 0.18 * np.cos(5 * np.arctan2(y - 0.5, x - 0.5))


def cauchy_loop(gx: Floats, gy: Floats, mask: Mask) -> Floats:
    """Heights (H, W) by normal equations of edge increments, reweighted and solved thirty times by SciPy's
    sparse solver; NaN outside the mask, whose first pixel is at zero.
    """
    number = np.cumsum(mask).reshape(mask.shape) - 1
    ends, data = [], []
    for slope, inside, pixel in ((gx, mask, number), (gy.T, mask.T, number.T)):
        exists = inside[:, :-1] & inside[:, 1:]
        ends.append((pixel[:, :-1][exists], pixel[:, 1:][exists]))
        data.append(_increments(slope, inside)[exists])
    tail, head = np.concatenate(ends, axis=1)
    g, every = np.concatenate(data), np.arange(tail.size)
    signs = np.repeat([-1.0, 1.0], tail.size)
    shape = (tail.size, int(mask.sum()))
    step = scipy.sparse.csr_array((signs, (np.tile(every, 2), np.r_[tail, head])), shape=shape)[:, 1:]
    weight = np.ones(g.shape)
    for _ in range(_TURNS):
        normal = (step.T @ scipy.sparse.diags_array(weight) @ step).tocsc()
        found = scipy.sparse.linalg.spsolve(normal, step.T @ (weight * g))
        left = g - step @ found
        weight = 1 / (1 + (left / (_TUNING * np.median(np.abs(left)))) ** 2)
    z = np.full(mask.shape, np.nan)
    z[mask] = np.r_[0.0, found]
    return z


def _increments(g: Floats, mask: Mask) -> Floats:
    """From pixel to pixel of every row, (H, W - 1): of the cubic through four slopes, or the trapezoid."""
    rise = 0.5 * (g[:, :-1] + g[:, 1:])
    four = mask[:, :-3] & mask[:, 1:-2] & mask[:, 2:-1] & mask[:, 3:]
    cubic = (13 * (g[:, 1:-2] + g[:, 2:-1]) - g[:, :-3] - g[:, 3:]) / 24
    rise[:, 1:-1] = np.where(four, cubic, rise[:, 1:-1])
    return rise
