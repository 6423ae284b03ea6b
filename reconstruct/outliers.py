"""Outliers: measurements that agree with no continuation of their neighbours.

A pixel of a mirror continues the coordinates on one side of it at least, also beside a crease, a rim or a
hole: three pixels of its row or column, extrapolated, or the cubic through two on either side. One that
misses all of these by many times its noise is wrong. Where gaps leave no such continuation, the plane through
the pixels around takes their place. Only large errors show in this way; what is left shows in the curl of the
slopes (see `curl`).
"""

import math

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact

from .arrays import Floats, Mask
from .measured import Measured

__all__ = ["outliers"]

_LIMIT = 6.0  # standard deviations of the nearest continuation's own noise
_FEWEST = 3  # continuations: fewer of them prove nothing
_LEAST = 0.02  # pattern pixels: what a curve may be off by from its continuation
_STANDS_OUT = 5.0  # times what most of the eight neighbours miss theirs by: finer data is curved everywhere
_ROWS, _COLS = np.array([0, 0, 0, 1, 1, 2, 2, 2]), np.array([0, 1, 2, 0, 2, 0, 1, 2])
_AROUND, _ENOUGH = 2, 8  # pixels: reach of the plane, and how many it takes
_CURVED = 3.0  # times what the plane misses the others by
_NOISE_CENTRE, _NOISE_SIDE = 1.30, 4.47  # of the difference to a continuation, per pixel's sigma


def outliers(data: Measured, seen: Mask | None = None) -> Mask:
    """Pixels of the mask whose u or v agrees with no neighbours, (rows, cols). seen: the mask without what
    was interpolated.
    """
    mask = data.mask if seen is None else np.ascontiguousarray(data.mask & seen)
    found = np.zeros(mask.shape, dtype=np.bool_)
    for field, sigma in ((data.u, data.sigma_u), (data.v, data.sigma_v)):
        missed = _missed(field, mask)
        at = np.argwhere(missed > np.maximum(_LIMIT * sigma, _LEAST))
        if at.size:
            row, col = at.T
            near = row[:, None] + _ROWS, col[:, None] + _COLS
            around = np.where(np.pad(mask, 1)[near], np.pad(missed, 1)[near], np.nan)
            around[np.isnan(around).all(axis=1)] = 0.0
            alone = missed[row, col] > _STANDS_OUT * np.nanmedian(around, axis=1)
            found[row[alone], col[alone]] = True
    return found


def _missed(field: Floats, mask: Mask) -> Floats:
    """Distance to the nearest continuation over that one's noise for a sigma of one."""
    missed = np.zeros(field.shape)
    over_image(lambda start, stop: _nearest(field, mask, missed, start, stop), field.shape)
    return missed


@exact
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
            missed[i, j] = nearest if count >= _FEWEST else _off_plane(f, mask, i, j)


@exact
def _off_plane(f, mask, i, j):  # type: ignore[no-untyped-def]
    """What a pixel misses the plane through the pixels around by, beyond what these miss it by; 0 if they are
    too few.
    """
    rows, cols = f.shape
    n, a1, b1, a2, ab, b2 = 0, 0, 0, 0, 0, 0
    z, za, zb, squares = 0.0, 0.0, 0.0, 0.0
    for a in range(-_AROUND, _AROUND + 1):
        for b in range(-_AROUND, _AROUND + 1):
            r, c = i + a, j + b
            if (a == 0 and b == 0) or not (0 <= r < rows and 0 <= c < cols) or not mask[r, c]:
                continue
            rise = f[r, c] - f[i, j]
            n, a1, b1, a2, ab, b2 = n + 1, a1 + a, b1 + b, a2 + a * a, ab + a * b, b2 + b * b
            z, za, zb, squares = z + rise, za + a * rise, zb + b * rise, squares + rise * rise
    # normal equations by cofactors, exact in whole numbers; numpy.linalg takes seconds to compile
    c00, c01, c02 = a2 * b2 - ab * ab, b1 * ab - a1 * b2, a1 * ab - b1 * a2
    c11, c12, c22 = n * b2 - b1 * b1, a1 * b1 - n * ab, n * a2 - a1 * a1
    det = n * c00 + a1 * c01 + b1 * c02
    if n < _ENOUGH or det == 0:
        return 0.0
    level = (c00 * z + c01 * za + c02 * zb) / det
    by_a = (c01 * z + c11 * za + c12 * zb) / det
    by_b = (c02 * z + c12 * za + c22 * zb) / det
    left = max(0.0, squares - (level * z + by_a * za + by_b * zb))
    return max(0.0, abs(level) - _CURVED * math.sqrt(left / (n - 3)))
