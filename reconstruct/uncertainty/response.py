"""The one response operator: what an error of a measurement does to the height.

An error field of unit variance adds to u and v. One linear solve of the equations that made the height,
weights and anchors' shares unchanged, carries it there; the variance by a source of errors is the sum of the
squared responses of its fields.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from ..arrays import Floats, Labels, Mask, Pair
from ..geometry import PAD, RayField
from ..measured import Measured
from ..outputs.coarse_modes import expanded
from ..problem import Problem
from ..solver.edges import SomeEdges, edge_weights
from ..solver.newton import State, response
from ..solver.poisson import edge_problem

__all__ = ["ErrorField", "slope_errors", "smooth_variance", "smoothed", "variance_by"]

_WIDE = 6.0  # pixels, rms: smoothing of the variance by a few drawn fields
_STEP = 3  # pixels from line to line of the grid on which smooth errors are answered
_FEWEST = 8  # lines of it


class ErrorField(NamedTuple):
    """One error of unit variance: what it adds to u and v (rows, cols), pattern px, and to the edges'
    increments."""

    u: Floats
    v: Floats
    edges: SomeEdges | None = None


def variance_by(problem: Problem, state: State, fields: Iterable[ErrorField]) -> Floats:
    """Variance of the unknown (rows, cols) by a source of errors."""
    total = np.zeros(problem.labels.shape)
    for field in fields:
        moved = bool(field.u.any() or field.v.any())
        if field.edges is None and not moved:
            continue
        slopes = slope_errors(problem.data, state, field) if moved else None
        total += np.square(response(problem.data, problem.labels, state, slopes, field.edges))
    return smoothed(total, problem.labels > 0, _WIDE) if total.any() else total


def smooth_variance(problem: Problem, state: State, field: ErrorField) -> Floats:
    """`variance_by` of one field that is smooth: on a rectangle by every third pixel."""
    if not (state.problem.closed and problem.data.mask.all()) or min(problem.labels.shape) < _STEP * _FEWEST:
        return variance_by(problem, state, [field])
    data, labels, small = _thinned(problem, state)
    # the mean of the pixels between: what alternates from one to the next is no longer there
    u, v = (_every(np.asarray(cv2.blur(part, (_STEP, _STEP)))) for part in field[:2])
    slopes = slope_errors(data, small, ErrorField(u, v))
    variance = np.square(response(data, labels, small, slopes))
    coarse = smoothed(variance, data.mask, _WIDE / _STEP)[None].astype(np.float32)
    return np.asarray(expanded(coarse, _STEP, problem.data.mask)[0], np.float64)


def _every(values: NDArray[Any]) -> NDArray[Any]:
    """Of every third pixel of every third row (..., rows, cols)."""
    return np.ascontiguousarray(values[..., ::_STEP, ::_STEP])


def _thinned(problem: Problem, state: State) -> tuple[Measured, Labels, State]:
    """Every third pixel of a full rectangle's solution, an anchor's way from its pixel left out."""
    data, rays, rows = problem.data, problem.data.rays, state.rows
    beyond = [(0, 0), (PAD, PAD), (PAD, PAD)]
    origins, directions = (
        np.pad(_every(part), beyond, mode="reflect", reflect_type="odd")
        for part in (rays.inner_origins, rays.inner_directions)
    )
    names = ("u", "v", "sigma_u", "sigma_v", "mask")
    parts: dict[str, Any] = {name: _every(getattr(data, name)) for name in names}
    parts["rays"] = RayField(origins, directions, rays.logarithmic, parallel=rays.parallel)
    small, labels, w = replace(data, **parts), _every(problem.labels), _every(state.before)
    down, along = (
        np.minimum(np.rint(at / _STEP).astype(np.int64), size - 1)
        for at, size in zip(np.divmod(rows.pixel, data.mask.shape[1]), labels.shape, strict=True)
    )
    pixel = down * labels.shape[1] + along
    still = rows._replace(pixel=pixel, at=0 * rows.at + pixel[:, None], by=0 * rows.by, more=0 * rows.more)
    variances, root = (_every(state.variances[0]), _every(state.variances[1])), _every(state.root)
    edges = edge_problem(*edge_weights(*variances, root, small.mask), small.mask)
    p, q, _, _ = small.slopes(w)
    return (
        small,
        labels,
        replace(
            state, w=w, before=w, root=root, problem=edges, rows=still, slopes=(p, q), variances=variances
        ),
    )


def slope_errors(data: Measured, state: State, field: ErrorField) -> Pair:
    """Errors of both slopes (rows, cols)."""
    moved = replace(data, u=data.u + field.u, v=data.v + field.v).slopes(state.before)[:2]
    p, q = (np.where(data.mask, one - other, 0.0) for one, other in zip(moved, state.slopes, strict=True))
    return p, q


def smoothed(values: Floats, mask: Mask, width: float) -> Floats:
    """Gaussian mean over the mask, (rows, cols)."""
    if mask.all():
        return np.asarray(scipy.ndimage.gaussian_filter(values, width))
    share = scipy.ndimage.gaussian_filter(mask.astype(np.float64), width)
    total = scipy.ndimage.gaussian_filter(np.where(mask, values, 0.0), width)
    return np.asarray(total / np.maximum(share, 1e-12))
