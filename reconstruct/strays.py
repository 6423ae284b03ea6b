"""Stray pixels: measurements that agree with no continuation of their neighbours.

A pixel of a mirror continues the coordinates on one side of it at least, also beside a crease, a rim or a
hole: three pixels of its row or column, extrapolated, or the cubic through two on either side. One that
misses all of these by many times its noise is wrong. Only large errors show in this way; what is left shows
in the curl of the slopes (see `outliers`).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from optolever.blocks import over_image

from .measured import Measured

__all__ = ["strays"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIMIT = 6.0  # standard deviations of the nearest continuation's own noise
_FEWEST = 3  # continuations: fewer of them prove nothing
_LEAST = 0.02  # pattern pixels: what a curve may be off by from its continuation
_STANDS_OUT = 5.0  # times what most of the eight neighbours miss theirs by: finer data is curved everywhere
_ROWS, _COLS = np.array([0, 0, 0, 1, 1, 2, 2, 2]), np.array([0, 1, 2, 0, 2, 0, 1, 2])
_NOISE_CENTRE, _NOISE_SIDE = 1.30, 4.47  # of the difference to a continuation, per pixel's sigma


def strays(data: Measured) -> Mask:
    """Pixels of the mask whose u or v agrees with no neighbours, (rows, cols)."""
    found = np.zeros(data.mask.shape, dtype=np.bool_)
    for field, sigma in ((data.u, data.sigma_u), (data.v, data.sigma_v)):
        missed = _missed(field, data.mask)
        at = np.argwhere(missed > np.maximum(_LIMIT * sigma, _LEAST))
        if at.size:
            row, col = at.T
            around = np.pad(missed, 1)[row[:, None] + _ROWS, col[:, None] + _COLS]
            alone = missed[row, col] > _STANDS_OUT * np.median(around, axis=1)
            found[row[alone], col[alone]] = True
    return found


def _missed(field: Floats, mask: Mask) -> Floats:
    """Distance to the nearest continuation over that one's noise for a sigma of one."""
    missed = np.zeros(field.shape)
    over_image(lambda start, stop: _nearest(field, mask, missed, start, stop), field.shape)
    return missed


@njit(cache=True, nogil=True)
def _nearest(f, mask, missed, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = f.shape
    for i in range(start, stop):
        for j in range(cols):
            if not mask[i, j]:
                continue
            count = 0
            nearest = np.inf
            for axis in range(2):
                di, dj = (0, 1) if axis == 0 else (1, 0)
                sides = 0
                near, far = 0.0, 0.0
                for sign in (-1, 1):
                    values = 0
                    guess = 0.0
                    weight = 3.0
                    for k in range(1, 4):
                        a, b = i + k * sign * di, j + k * sign * dj
                        if not (0 <= a < rows and 0 <= b < cols and mask[a, b]):
                            break
                        values += 1
                        guess += weight * f[a, b]
                        weight = -3.0 if k == 1 else 1.0
                        if k == 1:
                            near += f[a, b]
                        elif k == 2:
                            far += f[a, b]
                    if values == 3:
                        count += 1
                        nearest = min(nearest, abs(f[i, j] - guess) / _NOISE_SIDE)
                    sides += values >= 2
                if sides == 2:
                    count += 1
                    nearest = min(nearest, abs(f[i, j] - (4.0 * near - far) / 6.0) / _NOISE_CENTRE)
            if count >= _FEWEST:
                missed[i, j] = nearest
