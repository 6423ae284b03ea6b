"""Holes of a few pixels, bridged from their neighbours, so that scattered bad pixels cost no masked solve.

The bridged values only serve the neighbours' edges; a bridged pixel stays flagged and gets no height.
"""

from dataclasses import replace

import numpy as np
import scipy.ndimage
from numba import njit
from numpy.typing import NDArray

from .measured import Measured

__all__ = ["bridged", "small_holes"]

Mask = NDArray[np.bool_]

LARGEST = 9  # pixels
SHARE = 0.15  # of the image: where more is missing, bridging would count neighbours' noise too often


def small_holes(mask: Mask) -> Mask:
    """Pixels outside the mask in holes of at most LARGEST pixels (eight neighbours)."""
    outside = ~mask
    if not outside.any():
        return outside
    labels, _ = scipy.ndimage.label(outside, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    sizes[0] = LARGEST + 1
    small: Mask = sizes[labels] <= LARGEST
    return small if np.count_nonzero(small) <= SHARE * mask.size else np.zeros_like(mask)


def bridged(data: Measured, holes: Mask) -> Measured:
    """The measurement with u, v and the sigmas interpolated across the holes, which join the mask."""
    if not holes.any():
        return data
    mask = data.mask & ~holes
    at = np.argwhere(holes)
    fields = {name: getattr(data, name).copy() for name in ("u", "v", "sigma_u", "sigma_v")}
    for name, field in fields.items():
        filled = mask.copy()
        for _ in range(LARGEST):
            _bridge(field, filled, at, name in ("u", "v"))
        joined = filled
    return replace(data, mask=joined, **fields)


@njit(cache=True, nogil=True)
def _bridge(field, mask, at, smooth):  # type: ignore[no-untyped-def]
    """One pass over the pixels (M, 2): mean over the axes of cubic (smooth) or linear interpolation; the mask
    grows.

    Where no axis has neighbours on both sides: linear extrapolation from one, or the neighbour's value.
    """
    rows, cols = field.shape
    fresh = np.zeros(at.shape[0], dtype=np.bool_)  # joins after the pass: the order of pixels does not count
    for m in range(at.shape[0]):
        i, j = at[m, 0], at[m, 1]
        if mask[i, j]:
            continue
        cubic, cubics, linear, linears, one_sided, ones = 0.0, 0, 0.0, 0, 0.0, 0
        for axis in range(2):
            di, dj = (1, 0) if axis == 0 else (0, 1)
            near = 0.0
            sides = 0
            far = 0.0
            fars = 0
            for sign in (-1, 1):
                a, b = i + sign * di, j + sign * dj
                if not (0 <= a < rows and 0 <= b < cols and mask[a, b]):
                    continue
                near += field[a, b]
                sides += 1
                a2, b2 = a + sign * di, b + sign * dj
                if 0 <= a2 < rows and 0 <= b2 < cols and mask[a2, b2]:
                    far += field[a2, b2]
                    fars += 1
            if sides == 2 and fars == 2 and smooth:
                cubic += (4.0 * near - far) / 6.0
                cubics += 1
            elif sides == 2:
                linear += 0.5 * near
                linears += 1
            elif sides == 1:
                one_sided += 2.0 * near - far if smooth and fars == 1 else near
                ones += 1
        if cubics > 0:
            field[i, j] = cubic / cubics
        elif linears > 0:
            field[i, j] = linear / linears
        elif ones > 0:
            field[i, j] = one_sided / ones
        fresh[m] = cubics + linears + ones > 0
    for m in range(at.shape[0]):
        if fresh[m]:
            mask[at[m, 0], at[m, 1]] = True
