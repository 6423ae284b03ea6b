"""Smooth maps on every step-th pixel: expanded linearly to all pixels, and found again from these.

The modes of a rig are made on a coarse grid (see `rig`) and expanded for whoever adds them to heights; a file
holds the grid.
"""

from typing import NamedTuple

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.memory import require_room

from ..arrays import Floats, Mask

__all__ = ["LINES", "CoarseModes", "coarsened", "expanded", "interpolated"]

Modes = NDArray[np.float32]
LINES = 75  # rows or columns of a coarse grid, at least
_ALIKE = 1e-3  # of a mode's rms, by which the expanded grid may miss it
_NOTHING = 1e-9  # mm: rms of a mode that is rounding alone
_RIDGE = 1e-9  # of the largest weight, for nodes that no pixel depends on


class CoarseModes(NamedTuple):
    """Modes (r, rows, cols) on every step-th pixel."""

    modes: Modes
    step: int


def coarsened(modes: Modes, known: Mask) -> CoarseModes:
    """The grid of at least LINES lines that expands to the modes (r, H, W) on the known pixels.

    Nodes by least squares over these pixels. Modes that the grid misses by a thousandth of their rms, or that
    are known elsewhere, stay on all pixels.
    """
    step = max(1, min(known.shape) // LINES)
    if step == 1 or not known.any() or not len(modes) or (np.isfinite(modes) != known).any():
        return CoarseModes(modes, 1)
    rows, cols = (_linear(size, step) for size in known.shape)
    weights = scipy.sparse.kron(rows, cols, "csr")[known.ravel()]
    squares = (weights.T @ weights).tocsc()
    ridge = _RIDGE * squares.diagonal().max() * scipy.sparse.eye_array(squares.shape[0], format="csc")
    solver = scipy.sparse.linalg.splu((squares + ridge).tocsc())
    nodes = np.stack([solver.solve(weights.T @ mode[known].astype(np.float64)) for mode in modes])
    found = nodes.reshape(len(modes), rows.shape[1], cols.shape[1]).astype(np.float32)
    for mode, coarse in zip(modes, found, strict=True):
        values = mode[known]
        missed = np.abs((rows @ (cols @ coarse.T).T)[known] - values).max()
        if missed > _ALIKE * max(float(np.sqrt(np.mean(values.astype(np.float64) ** 2))), _NOTHING):
            return CoarseModes(modes, 1)
    return CoarseModes(found, step)


def expanded(coarse: CoarseModes, known: Mask) -> Modes:
    """The modes (r, H, W) on the known pixels, NaN elsewhere. InputError where the grid is not the map's."""
    sizes = tuple((size - 1) // coarse.step + 1 for size in known.shape) if coarse.step >= 1 else ()
    if coarse.modes.ndim != 3 or coarse.modes.shape[1:] != sizes:
        raise InputError(
            f"modes has shape {coarse.modes.shape}, must be (r, *{sizes}) of every {coarse.step}th pixel"
        )
    if coarse.step == 1:
        return coarse.modes
    require_room("modes", 4 * len(coarse.modes) * known.size)
    return interpolated(coarse.modes, coarse.step, known)


def interpolated(coarse: Floats | Modes, step: int, known: Mask) -> Modes:
    """From every step-th pixel to all, linearly; gaps from their nearest neighbours."""
    along_rows, along_cols = (_linear(size, step) for size in known.shape)
    modes = np.full((len(coarse), *known.shape), np.nan, np.float32)
    for mode, found in zip(modes, coarse, strict=True):
        gaps = ~np.isfinite(found)
        if gaps.all():
            raise InputError("calibration: no height is left where a number of the scene is off by its sigma")
        if gaps.any():
            nearest = scipy.ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
            found = found[tuple(nearest)]
        mode[known] = (along_rows @ (along_cols @ found.T).T)[known]
    return modes


def _linear(size: int, step: int) -> scipy.sparse.csr_array:
    """Weights (size, coarse size) of linear interpolation from every step-th pixel, constant beyond."""
    place = np.minimum(np.arange(size) / step, (size - 1) // step)
    low = np.minimum(place.astype(np.intp), max(0, (size - 1) // step - 1))
    high = np.minimum(low + 1, (size - 1) // step)
    share, pixel = place - low, np.arange(size)
    rows, cols = np.concatenate([pixel, pixel]), np.concatenate([low, high])
    weights = np.concatenate([1 - share, share])
    return scipy.sparse.csr_array((weights, (rows, cols)), shape=(size, (size - 1) // step + 1))
