"""Variance of the height by rounding to the cells of a discrete code.

A discrete code yields the middle of the cell at which a pixel looks. Its errors are a sawtooth of the
coordinate, not noise: where sampling is commensurate (one cell a pixel, two, one and a half) regions share
one error, along lines of constant coordinate all pixels do. They may have neither scatter nor curl, and tilt
the height like a true slope. Their covariance is that of the sawtooth itself, over all places where the cells
may begin: the measured coordinates, smoothed, are rounded again with the cells shifted by parts of a cell,
and every such error field is carried to the height by one linear solve (a parametric bootstrap: Efron,
10.1214/aos/1176344552).
"""

from dataclasses import replace

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from ..problem import Problem
from ..solver.newton import State, chord_step

__all__ = ["rounding_variance"]

_PLACES = 8  # of the cells' beginning
_SMOOTH = 4.0  # pixels, rms: over more than the sawtooth of two cells a pixel
_WIDE = 6.0  # pixels, rms: smoothing of the variance from _PLACES solves


def rounding_variance(problem: Problem, state: State) -> Floats | None:
    """Variance of the unknown (rows, cols) by rounding to cells; None for other coordinates."""
    data = problem.data
    if not data.whole_cells(problem.bridged):
        return None
    smooth = [_twiced(coord, data.mask) for coord in (data.u, data.v)]
    # misread neighbours make sigma larger than a cell's 1 / sqrt(12), and share their errors likewise
    widths = [np.sqrt(12.0) * np.where(data.mask, sigma, 0.0) for sigma in (data.sigma_u, data.sigma_v)]
    cells = [float(width[data.mask].min()) for width in widths]
    still = chord_step(data, problem.labels, state).w
    total = np.zeros(state.w.shape)
    for k in range(_PLACES):
        # 3 k mod 8 keeps u and v out of step
        place = ((k + 0.5) / _PLACES, ((3 * k) % _PLACES + 0.5) / _PLACES)
        errors = [
            width * _rounding(coord / cell + shift)
            for coord, cell, width, shift in zip(smooth, cells, widths, place, strict=True)
        ]
        moved = replace(data, u=data.u + errors[0], v=data.v + errors[1])
        total += np.square(chord_step(moved, problem.labels, state).w - still)
    return _smoothed(total / _PLACES, data.mask, _WIDE)


def _rounding(coord: Floats) -> Floats:
    return np.asarray(np.rint(coord) - coord)


def _twiced(coord: Floats, mask: Mask) -> Floats:
    """Smoothed, plus the smoothed residual, which restores curvature (twicing: Tukey, Exploratory Data
    Analysis, 1977): the slope determines where sampling is commensurate."""
    once = _smoothed(coord, mask)
    return once + _smoothed(coord - once, mask)


def _smoothed(values: Floats, mask: Mask, width: float = _SMOOTH) -> Floats:
    """Gaussian mean over the mask, (rows, cols)."""
    share = scipy.ndimage.gaussian_filter(mask.astype(np.float64), width)
    total = scipy.ndimage.gaussian_filter(np.where(mask, values, 0.0), width)
    return np.asarray(total / np.maximum(share, 1e-12))
