"""Holes of a few pixels and narrow slits, bridged from their neighbours, so that scattered bad pixels cost no
masked solve, and the flagged seams between the cells of a code do not part the image into islands.

Bridged values are nearest to parabolas along rows and columns, by the least sum of squares of third
differences: across one pixel or two these are polynomials of fifth degree through three neighbours on
either side, beyond a border they are parabolas. What this does not settle is harmonic. They only serve the
neighbours' edges; a bridged pixel stays flagged and gets no height.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg

from optolever.arrays import Floats, Mask, Pair

from ..measured import Measured

__all__ = ["bridged", "interpolation", "noise_gain", "small_holes"]

#: A field (rows, cols) -> the same with its holes filled.
Fill = Callable[[Floats], Floats]
LARGEST = 9  # pixels
NARROW = 2  # pixels between measured ones in a row or a column
SHARE = 0.5  # of the image: where more is missing, it falls apart
_FIRST, _THIRD = (-1.0, 1.0), (-1.0, 3.0, -3.0, 1.0)
_WEAK = 1e-9  # of the squares: what these do not settle stays as it is
_STEPS = 3  # each leaves as little of the last one's error, where the squares settle it
_REACH, _FAR = 4.0, 4.0  # pixels, rms: over which the gain is averaged; of these: where it ends
_UNEVEN = 1.6  # of that ratio: some neighbours count several times, others not at all


def small_holes(mask: Mask) -> Mask:
    """Pixels outside the mask in holes of at most LARGEST pixels (eight neighbours), in slits of at most
    NARROW, and along a border so frayed, if a full rectangle results.
    """
    outside = ~mask
    if not outside.any():
        return outside
    labels, _ = scipy.ndimage.label(outside, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    sizes[0] = LARGEST + 1
    small: Mask = sizes[labels] <= LARGEST
    if not small[outside].all():
        small |= _slit(mask) | _slit(mask.T).T
        framed = np.pad(mask, 1, constant_values=True)
        frayed = small | (_slit(framed) | _slit(framed.T).T)[1:-1, 1:-1]
        small = frayed if (mask | frayed).all() else small
    return small if np.count_nonzero(small) <= SHARE * mask.size else np.zeros_like(mask)


def _slit(mask: Mask) -> Mask:
    """Pixels outside the mask between two of it, at most NARROW + 1 apart along the row."""
    found = np.zeros_like(mask)
    for gap in range(1, NARROW + 1):
        ends = mask[:, : -gap - 1] & mask[:, gap + 1 :]
        for k in range(1, gap + 1):
            found[:, k : k - gap - 1] |= ends
    return found & ~mask


def bridged(data: Measured, holes: Mask) -> Measured:
    """The measurement with u, v and the sigmas interpolated across the holes, which join the mask."""
    if not holes.any():
        return data
    known = data.mask & ~holes
    parts, count = scipy.ndimage.label(known | holes)
    reached = np.zeros(count + 1, np.bool_)
    reached[parts[known]] = True
    holes = holes & reached[parts]
    harmonic, parabolic = _fillers(known, holes)
    u, v = (parabolic(harmonic(part)) for part in (data.u, data.v))
    sigma_u, sigma_v = harmonic(data.sigma_u), harmonic(data.sigma_v)
    return replace(data, u=u, v=v, sigma_u=sigma_u, sigma_v=sigma_v, mask=known | holes)


def interpolation(known: Mask, holes: Mask) -> Callable[[Floats], Pair]:
    """What gives a field (rows, cols) of known pixels with its holes filled: harmonic, and by parabolas."""
    harmonic, parabolic = _fillers(known, holes)

    def fill(field: Floats) -> Pair:
        first = harmonic(field)
        return first, parabolic(first)

    return fill


def _fillers(known: Mask, holes: Mask) -> tuple[Fill, Fill]:
    """Harmonic, and by parabolas, where what is filled is harmonic."""
    harmonic, parabolic = (_Differences(known, holes, coefficients) for coefficients in (_FIRST, _THIRD))
    return harmonic.filled, parabolic.filled


def noise_gain(mask: Mask, holes: Mask) -> Floats:
    """By what factor bridging the holes, which are part of the mask, raises the variance of long waves,
    (rows, cols): all pixels over the measured ones around."""
    if not holes.any():
        return np.ones(mask.shape)
    gain, wide = np.ones(mask.shape), int(_FAR * _REACH) + 1
    box = tuple(
        slice(max(0, int(at[0]) - 2 * wide), int(at[-1]) + 2 * wide + 1)
        for at in (np.flatnonzero(holes.any(axis=axis)) for axis in (1, 0))
    )  # beyond it no hole is in reach
    lost = scipy.ndimage.gaussian_filter(holes[box].astype(float), _REACH, truncate=_FAR)
    every = 1.0
    if not mask[box].all():
        every = scipy.ndimage.gaussian_filter(mask[box].astype(float), _REACH, truncate=_FAR)
    gain[box] = (np.maximum(every, 1e-12) / np.maximum(every - lost, 1e-12)) ** _UNEVEN
    return gain


class _Differences:
    """Differences of such coefficients between known pixels and holes next to each other in rows and columns,
    as far as they hold a hole; the sum of their squares is to be least.
    """

    def __init__(self, known: Mask, holes: Mask, coefficients: tuple[float, ...]) -> None:
        self._coefficients, self._at = np.array(coefficients), np.flatnonzero(holes)
        along, rows = np.arange(len(coefficients)), np.array([holes.shape[1], 1])
        either, windows = (known | holes).ravel(), []
        for step in np.eye(2, dtype=np.int64):
            first = (np.argwhere(holes)[:, None] - along[:, None] * step).reshape(-1, 2)
            inside = (first >= 0) & (first + along[-1] * step < holes.shape)
            pixels = np.unique(first[inside.all(axis=1)] @ rows)[:, None] + along * (step @ rows)
            windows.append(pixels[either[pixels].all(axis=1)])
        self._pixels = np.concatenate(windows)
        row, term = np.nonzero(holes.ravel()[self._pixels])
        place = row, np.searchsorted(self._at, self._pixels[row, term])
        shape = len(self._pixels), self._at.size
        self._of_holes = scipy.sparse.csr_array((self._coefficients[term], place), shape=shape)
        self._to_holes = self._of_holes.T.tocsr()

    @cached_property
    def _normal(self) -> Any:
        """The factors of the normal equations: their rounding goes with the steps."""
        weak = _WEAK * float(self._coefficients @ self._coefficients)
        normal = self._to_holes @ self._of_holes + weak * scipy.sparse.eye_array(self._at.size)
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
        return scipy.sparse.linalg.splu(normal.tocsc(), **options, options={"SymmetricMode": True})

    def filled(self, field: Floats) -> Floats:
        """The field (rows, cols), holes changed as little as the differences ask for."""
        out = field.astype(np.float64)
        values = out.ravel()
        values[self._at] = np.nan_to_num(values[self._at])
        for _ in range(_STEPS):
            off = values[self._pixels] @ self._coefficients
            values[self._at] -= self._normal.solve(self._to_holes @ off)
        return out
