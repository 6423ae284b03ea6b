"""Newton's method on the coupled equations, with an integrating factor.

The linearised system grad(dw) = r + (p_w, q_w) dw becomes a plain gradient by dw = E g with grad log E =
(p_w, q_w)
(Poisson problem one): grad g = r / E (Poisson problem two, weighted by E^2 / var). E is also the free mode,
settled by
the anchors. The fixed point dw = integral of r alone converges linearly; it is kept as a cross-check.
"""

from dataclasses import dataclass

import numpy as np
import scipy.interpolate
import scipy.ndimage
from numpy.typing import NDArray

from .anchors import Samples
from .edges import defects, edge_weights, factor_increments
from .linear import EdgeProblem, edge_problem
from .measured import Measured
from .pinning import AnchorRows, anchor_rows, free_constants

__all__ = ["Options", "State", "coarse_start", "solve"]

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]

_ONE = np.ones((1, 1))
_COARSE = 96  # pixels along the shorter side of the grid that gives the start
_FACTOR_TOLERANCE = 1e-3  # relative, of the integrating factor's own problem: any E > 0 serves
_NOISE_SHARE = 1e-4  # of a slope's standard deviation: a change that no noise lets one see
_CHORD_RATE = 1e-3  # refit the integrating factor while a step leaves more than this of the last one


@dataclass(frozen=True, slots=True)
class Options:
    """tolerance: rms change of w, relative to its range, at which to stop; newton False:
    the plain fixed point.
    """

    tolerance: float = 1e-11
    max_steps: int = 15
    newton: bool = True


@dataclass(frozen=True, slots=True)
class State:
    """The end of a solve.

    w: the unknown (rows, cols), outside the mask as it started; root: square root of the integrating factor;
    problem: the last weighted problem; share: every anchor row's share in its component's constant;
    steps: rms change of w in every step; converged: whether the last one met the tolerance;
    energy: sum of the squared edge defects over their variances, at the last but one iterate.
    """

    w: Floats
    root: Floats
    problem: EdgeProblem
    rows: AnchorRows
    share: Floats
    variances: tuple[Floats, Floats]
    steps: tuple[float, ...]
    iterations: int
    converged: bool
    energy: float


def solve(data: Measured, samples: Samples, labels: Labels, w: Floats, options: Options) -> State:
    """Iterate from w. labels: connected components of the mask from 1 on,
    each with at least one anchor sample.
    """
    count = int(labels.max())
    rows = anchor_rows(samples, data, labels)
    variances = _guarded(data.variances(w), data.mask)
    noise = float(np.sqrt(np.median(variances[0][data.mask])))
    inside = data.mask.all()
    span = float(np.ptp(w if inside else w[data.mask]))
    tolerance = max(options.tolerance * span, _NOISE_SHARE * noise)
    root = _ONE
    problem: EdgeProblem | None = None
    steps: list[float] = []
    iterations = 0
    share = np.zeros(rows.pixel.shape)
    converged, rate, energy = False, 1.0, np.inf
    while len(steps) < options.max_steps and not converged:
        p, q, p_w, q_w = data.slopes(w)
        if problem is None:
            problem = edge_problem(*edge_weights(*variances, _ONE, data.mask), data.mask)
        if options.newton and rate > _CHORD_RATE:
            result = problem.solve(*factor_increments(p_w, q_w, data.mask), 0.0, _FACTOR_TOLERANCE)
            iterations += result.iterations
            root = _root(result.x, labels, count)
            problem = edge_problem(*edge_weights(*variances, root, data.mask), data.mask)
        gx, gy = defects(p, q, w, root, data.mask)
        energy = problem.energy(gx, gy)
        result = problem.solve(gx, gy, 1e-3, 1e-10)
        iterations += result.iterations
        factor = np.broadcast_to(root**2, w.shape)
        change = factor * result.x
        error = rows.predict(w + change, p, q)
        constants, share = free_constants(
            rows, error - rows.known, factor.ravel()[rows.pixel], variances[0].ravel()[rows.pixel], count
        )
        change += factor * (constants[1] if count == 1 else constants[labels])
        if not inside:
            change *= data.mask
        w = w + change
        steps.append(float(np.sqrt(np.mean(change**2))))
        rate = steps[-1] / steps[-2] if len(steps) > 1 else 1.0
        left = steps[-1] * (rate / (1 - rate) if rate < 0.9 else 1e9) if len(steps) > 1 else steps[-1]
        converged = left < tolerance
    assert problem is not None
    return State(w, root, problem, rows, share, variances, tuple(steps), iterations, converged, energy)


def coarse_start(data: Measured, samples: Samples, labels: Labels, options: Options) -> Floats:
    """The unknown at rest, or the solution on every k-th pixel brought up to the grid by a cubic spline."""
    rest = data.rest()
    step = min(data.mask.shape) // _COARSE
    if step < 3:
        return rest
    coarse = data.strided(step)
    parts = scipy.ndimage.label(coarse.mask)[0].astype(np.int32)
    local = samples.window(0, 0, step)
    rows = anchor_rows(local, coarse, parts)
    anchored = np.isin(parts, np.unique(rows.component)) & (parts > 0)
    if np.count_nonzero(anchored) < 0.5 * np.count_nonzero(coarse.mask):
        return rest
    coarse.mask[...] = anchored
    parts = scipy.ndimage.label(anchored)[0].astype(np.int32)
    state = solve(coarse, local, parts, coarse.rest(), options)
    offset = state.w - coarse.rest()
    if not np.isfinite(offset[anchored]).all():
        return rest
    if not anchored.all():
        nearest = scipy.ndimage.distance_transform_edt(~anchored, return_distances=False, return_indices=True)
        offset = offset[tuple(nearest)]
    shape = data.mask.shape
    along_rows, along_cols = (_spline(shape[k], offset.shape[k], step) for k in (0, 1))
    fine: Floats = rest + along_rows @ offset @ along_cols.T
    return fine


def _spline(fine: int, coarse: int, step: int) -> Floats:
    """Matrix (fine, coarse) of the cubic spline through every step-th sample; constant beyond the last."""
    spline = scipy.interpolate.make_interp_spline(np.arange(coarse, dtype=np.float64), np.eye(coarse), k=3)
    matrix: Floats = spline(np.minimum(np.arange(fine) / step, coarse - 1.0))
    return matrix


def _root(phi: Floats, labels: Labels, count: int) -> Floats:
    """sqrt(E), E scaled to at most one in every component."""
    if count == 1:
        top = phi.max() if labels.all() else phi[labels > 0].max()
        single: Floats = np.exp(0.5 * np.minimum(phi - top, 0.0))
        return single
    tops = np.zeros(count + 1)
    tops[1:] = scipy.ndimage.maximum(phi, labels, np.arange(1, count + 1))
    root: Floats = np.exp(0.5 * np.minimum(phi - tops[labels], 0.0))
    return root


def _guarded(variances: tuple[Floats, Floats], mask: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Variances that are positive everywhere: at least 1e-12 of their median,
    which also stands outside the mask.
    """
    guarded = []
    for variance in variances:
        middle = float(np.median(variance[mask]))
        floor = 1e-24 * middle if middle > 0 else 1.0
        guarded.append(np.where(mask, np.maximum(variance, floor), max(middle, floor)))
    return guarded[0], guarded[1]
