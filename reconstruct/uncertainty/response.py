"""The one response operator: what an error of a measurement does to the height.

An error field of unit variance adds to u and v. One linear solve of the equations that made the height,
weights and anchors' shares unchanged, carries it there; the variance by a source of errors is the sum of the
squared responses of its fields.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask, Pair
from ..measured import Measured
from ..problem import Problem
from ..solver.newton import State, response

__all__ = ["ErrorField", "slope_errors", "smoothed", "variance_by"]

_WIDE = 6.0  # pixels, rms: smoothing of the variance by a few drawn fields


class ErrorField(NamedTuple):
    """One error of unit variance: what it adds to u and v (rows, cols), pattern px, and to the edges'
    increments."""

    u: Floats
    v: Floats
    edges: Pair | None = None


def variance_by(problem: Problem, state: State, fields: Iterable[ErrorField]) -> Floats:
    """Variance of the unknown (rows, cols) by a source of errors."""
    p, q, _, _ = problem.data.slopes(state.w)
    total, nothing = np.zeros(problem.labels.shape), np.zeros(problem.labels.shape)
    for field in fields:
        moved = bool(field.u.any() or field.v.any())
        if field.edges is None and not moved:
            continue
        slopes = slope_errors(problem.data, state, (p, q), field) if moved else (nothing, nothing)
        total += np.square(response(problem.data, problem.labels, state, slopes, field.edges))
    return smoothed(total, problem.labels > 0, _WIDE)


def slope_errors(data: Measured, state: State, still: Pair, field: ErrorField) -> Pair:
    """Errors of both slopes (rows, cols); still: the slopes without."""
    moved = replace(data, u=data.u + field.u, v=data.v + field.v).slopes(state.w)[:2]
    p, q = (np.where(data.mask, one - other, 0.0) for one, other in zip(moved, still, strict=True))
    return p, q


def smoothed(values: Floats, mask: Mask, width: float) -> Floats:
    """Gaussian mean over the mask, (rows, cols)."""
    share = scipy.ndimage.gaussian_filter(mask.astype(np.float64), width)
    total = scipy.ndimage.gaussian_filter(np.where(mask, values, 0.0), width)
    return np.asarray(total / np.maximum(share, 1e-12))
