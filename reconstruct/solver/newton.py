"""Newton's method on the coupled equations, with an integrating factor.

The linearised system grad(dw) = r + (p_w, q_w) dw becomes a plain gradient by dw = E g with grad log E =
(p_w, q_w) (Poisson problem one): grad g = r / E (Poisson problem two, weighted by E^2 / var). E is also the
free mode, settled by the anchors.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Labels, Mask, Pair, middle, some_rows

from ..measured import Measured
from .anchors import AnchorRows, Samples, anchor_rows, free_constants
from .edges import Doubt, SomeEdges, defects, edge_weights, factor_increments, scaled_weights
from .poisson import Accuracy, EdgeProblem, edge_problem

__all__ = ["State", "chord_step", "edge_errors", "linear_changes", "response", "solve"]

_ONE, _ZERO = np.ones((1, 1)), np.zeros((1, 1))
_TOLERANCE = 1e-11  # rms change of w, relative to its range, at which to stop
_MAX_STEPS = 15
_FACTOR_ACCURACY = Accuracy(peak=0.02)  # of log E, in every pixel: E only has to be near
_LINEAR_SHARE = 0.02  # of an edge's standard deviation: the energy of what a linear solve may leave
_FIRST_RELATIVE, _RELATIVE = 1e-2, 1e-10  # of the first error: there is a second step; rounding
_SMALL_STEP = 1e-2  # of the range of w: steps below it cannot leave the medium
_NOISE_SHARE = 0.02  # of a slope's standard deviation: a change below the noise
_RESPONSE = 1e-3  # of the first error: beside doubts, 1e-2 halves sigma
_ASTRAY = 0.1  # of a slope's standard deviation: a pixel's step in the end that counts as moving
_PATIENCE, _SHRINKS = 3, 0.5  # steps, of the smallest before: converging steps shrink more
_MEDIAN = 2.0 * math.log(2.0)  # of chi squared with two degrees of freedom
_MOVING = 0.05  # of the pixels: more are not single noisy ones
_SLOWEST = 0.99  # ratio of successive steps: the upper limit in extrapolation
_LARGEST = 1e12  # of the median variance: a slope without information
_CHORD_RATE = 1e-2  # refit the integrating factor while a step leaves more than this of the last one


@dataclass(frozen=True, slots=True)
class State:
    """The end of a solve.

    w: the unknown (rows, cols), outside the mask as it started; before: w before the last step; root:
    square root of the integrating factor; problem: the last weighted problem; rows, share: the anchors,
    and each one's share in its component's constant; slopes: p and q at `before`; variances: of these;
    steps: rms change of w in every step; iterations: linear solves and conjugate-gradient iterations;
    converged: whether the last step met the tolerance, or noise hides the rest in every pixel; energy:
    sum of the squared edge defects over their variances, before the last step; bend: how much curves may
    mislead every anchor; doubt: of the edges; unsettled (rows, cols): pixels that steps like the last
    ones would still move, if it did not converge; misfit: see `_misfit`.
    """

    w: Floats
    before: Floats
    root: Floats
    problem: EdgeProblem
    rows: AnchorRows
    share: Floats
    slopes: tuple[Floats, Floats]
    variances: tuple[Floats, Floats]
    steps: tuple[float, ...]
    iterations: int
    converged: bool
    energy: float
    bend: Floats
    doubt: Doubt | None = None
    unsettled: Mask | None = None
    misfit: float = 1.0

    @property
    def diverges(self) -> bool:
        """Whether more pixels are unsettled than single noisy ones."""
        return self.unsettled is not None and bool(np.mean(self.unsettled) >= _MOVING)


def solve(
    data: Measured,
    samples: Samples,
    labels: Labels,
    w: Floats,
    doubt: Doubt | None = None,
    variances: Pair | None = None,
) -> State:
    """Iterate from w. labels: connected components of the mask from 1 on,
    each with an anchor sample at least; doubt: of the edges' increments, see `discontinuities`; variances: of
    the slopes at w, if they are known.
    """
    rows, few = anchor_rows(samples, data, labels), some_rows(w)
    variances = _guarded(data.variances(w) if variances is None else variances, data.mask)
    tolerance = _TOLERANCE * float(np.ptp(w[data.mask]))
    noise = math.sqrt(middle(variances[0], data.mask))
    own = edge_weights(*variances, _ONE, data.mask, doubt)
    plain = edge_problem(*own, data.mask, doubt is None)
    problem, root, phi = plain, _ONE, None
    sample: tuple[Floats, ...] = ()
    iterations = 0
    energies: list[float] = []
    merits: list[float] = []
    steps: list[float] = []
    change, share = np.zeros(w.shape), np.zeros(rows.pixel.shape)
    while True:
        p, q, p_w, q_w = data.slopes(w)
        if _rate(steps) > _CHORD_RATE:
            fit = plain.solve(*factor_increments(p_w, q_w, data.mask), _FACTOR_ACCURACY, phi)
            phi, iterations = fit.x, iterations + fit.iterations
            del fit
            root = _root(phi, labels)
            weights = scaled_weights(own, root)
            # the first factor changes the weights by orders of magnitude, others hardly
            problem = edge_problem(*weights, data.mask, doubt is None, problem if steps else None)
            sample = tuple(part[few].copy() for part in weights)
            del weights
        del p_w, q_w
        gx, gy = defects(p, q, w, root, data.mask)
        energies.append(problem.energy(gx, gy))
        merits.append(energies[-1] + _anchor_energy(root, rows, w, (p, q), variances))
        if _worse(merits) and len(steps) < _MAX_STEPS:  # half of the last step was too much
            change *= 0.5
            w = w - change
            steps[-1] *= 0.5
            energies.pop()
            merits.pop()
            steps.append(steps[-1])
            continue
        misfit = _misfit(sample, gx[few], gy[few])
        # data may be better than announced; a wrong scene may miss most of them
        quiet = max(min(1.0, math.sqrt(energies[-1] / data.mask.sum())), misfit)
        relative = _RELATIVE if steps else _FIRST_RELATIVE
        step = problem.solve(gx, gy, Accuracy(_LINEAR_SHARE * quiet, relative))
        iterations += step.iterations
        del gx, gy
        change, share = _anchored(step.x, root, labels, rows, w, (p, q), variances)
        del step
        change = _limited(change, data, w)
        before, w = w, w + change
        steps.append(float(np.sqrt(np.mean(change**2))))
        converged = _left(steps) <= max(tolerance, _NOISE_SHARE * quiet * noise)
        if converged or len(steps) >= _MAX_STEPS or _stalled(steps):
            left, unsettled = energies[-1], None
            if not converged:
                rest = change / (1 - min(_rate(steps), _SLOWEST))
                unsettled = data.mask & (np.square(rest) > np.square(_ASTRAY) * variances[0])
                converged = not unsettled.any()
            return State(
                w,
                before,
                root,
                problem,
                rows,
                share,
                (p, q),
                variances,
                tuple(steps),
                iterations,
                converged,
                left,
                rows.bend(p, q),
                doubt,
                unsettled,
                misfit,
            )


def chord_step(data: Measured, labels: Labels, state: State, accuracy: Accuracy, share: Floats) -> State:
    """One more step from a state, for a measurement that has changed little: same problem, factor and
    variances. accuracy: of the linear solve; share: of the anchors."""
    p, q, _, _ = data.slopes(state.w)
    gx, gy = defects(p, q, state.w, state.root, data.mask)
    step = state.problem.solve(gx, gy, accuracy)
    change, _ = _anchored(step.x, state.root, labels, state.rows, state.w, (p, q), state.variances, share)
    size = float(np.sqrt(np.mean(change**2)))
    w = state.w + change
    return replace(state, w=w, before=state.w, slopes=(p, q), steps=(size,), iterations=step.iterations)


def linear_changes(
    data: Measured, labels: Labels, state: State, slopes: Pair, known: Floats, steps: int
) -> Floats:
    """Changes of w (m, rows, cols), first order, by changes of the slopes (m, rows, cols) and of the known
    values (m, M): chord steps of all at once."""
    _, _, p_w, q_w = data.slopes(state.w)
    change, rows = np.zeros(slopes[0].shape), state.rows._replace(known=known)
    for _ in range(steps):
        p, q = slopes[0] + p_w * change, slopes[1] + q_w * change
        step = state.problem.solve(
            *defects(p, q, change, state.root, data.mask), Accuracy(relative=_RESPONSE)
        )
        change += _anchored(step.x, state.root, labels, rows, change, (p, q), state.variances, state.share)[0]
    return change


def response(
    data: Measured, labels: Labels, state: State, slopes: Pair | None, edges: SomeEdges | None = None
) -> Floats:
    """Change of the solution (rows, cols) by errors of the slopes (rows, cols), if there are any, and of
    single edges' increments, first order.
    """
    step = state.problem.solve(*edge_errors(data, state, slopes, edges), Accuracy(relative=_RESPONSE))
    rows = state.rows._replace(known=np.zeros(state.rows.known.shape))
    still = np.zeros(state.w.shape)
    slopes = slopes or (still, still)
    return _anchored(step.x, state.root, labels, rows, still, slopes, state.variances, state.share)[0]


def edge_errors(
    data: Measured, state: State, slopes: Pair | None, edges: SomeEdges | None
) -> tuple[Floats, Floats]:
    """Edge defects (rows, cols) by errors of the slopes, if there are any, and of single edges' increments,
    in units of the integrating factor."""
    nothing = np.zeros(data.mask.shape), np.zeros(data.mask.shape)
    gx, gy = nothing if slopes is None else defects(*slopes, _ZERO, state.root, data.mask)
    if edges is not None:
        root: Floats = np.broadcast_to(state.root, gx.shape).ravel()
        gx.ravel()[edges.at_x] += edges.x / (root[edges.at_x] * root[edges.at_x + 1])
        gy.ravel()[edges.at_y] += edges.y / (root[edges.at_y] * root[edges.at_y + gy.shape[1]])
    return gx, gy


def _anchored(
    potential: Floats,
    root: Floats,
    labels: Labels,
    rows: AnchorRows,
    w: Floats,
    slopes: tuple[Floats, Floats],
    variances: tuple[Floats, Floats],
    share: Floats | None = None,
) -> tuple[Floats, Floats]:
    """The change of w: E times the potential and the constant that the anchors ask for; and their shares.
    share given: potential, w, slopes and known values may be stacks."""
    at, count = rows.pixel, int(labels.max())
    factor = np.square(np.broadcast_to(root, labels.shape).ravel()[at])
    error = rows.predict(w, *slopes) - rows.known
    error += factor * potential.reshape(*w.shape[:-2], -1)[..., at]
    if share is None:
        constants, share = free_constants(rows, error, factor, rows.error_variance(variances), count)
    else:
        constants = -(share * error / factor) @ np.eye(count + 1)[rows.component]
    change = potential + (constants[..., 1, None, None] if count == 1 else constants[..., labels])
    change *= root
    change *= root
    if not labels.all():
        change *= labels > 0
    return change, share


def _anchor_energy(
    root: Floats, rows: AnchorRows, w: Floats, slopes: tuple[Floats, Floats], variances: tuple[Floats, Floats]
) -> float:
    """What the anchors ask for, squared over its variance: no slope sees it, and yet a step that brings it
    about is progress.
    """
    if not rows.pixel.size:
        return 0.0
    factor = np.broadcast_to(root**2, w.shape).ravel()[rows.pixel]
    error = rows.predict(w, *slopes) - rows.known
    spread = rows.error_variance(variances)
    constants, share = free_constants(rows, error, factor, spread, int(rows.component.max()))
    weights = np.bincount(rows.component, np.where(share > 0, factor**2 / spread, 0.0), constants.size)
    return float(weights @ np.square(constants))


def _limited(change: Floats, data: Measured, w: Floats) -> Floats:
    """The change, cut to half the way to the pattern where it would lead farther."""
    if float(np.abs(change).max()) < _SMALL_STEP * float(np.ptp(w)):
        return change
    limit = 0.5 * np.sqrt(data.ways(w)[0])
    limit = limit / data.distance(w) if data.rays.logarithmic else limit
    limited: Floats = np.clip(change, -limit, limit, where=np.isfinite(limit), out=change)
    return limited


def _rate(steps: list[float]) -> float:
    """Ratio of the last two steps."""
    return steps[-1] / steps[-2] if len(steps) > 1 and steps[-2] > 0.0 else 1.0


def _left(steps: list[float]) -> float:
    """What the steps to come will add up to, if they shrink as they did."""
    rate = _rate(steps)
    if len(steps) == 1 or steps[-1] == 0.0:
        return steps[-1]
    return steps[-1] * rate / (1 - rate) if rate < 0.9 else float("inf")


def _misfit(weights: tuple[Floats, ...], gx: Floats, gy: Floats) -> float:
    """Robust root mean square of the edge defects over their standard deviations, below 1 for noise as
    announced, independent of single wrong pixels.
    """
    wx, wy = weights
    both = (wx > 0) & (wy > 0)
    if not both.any():
        return 0.0
    return math.sqrt(float(np.median((wx * gx**2 + wy * gy**2)[both])) / _MEDIAN)


def _stalled(steps: list[float]) -> bool:
    """Whether none of the last steps is much smaller than the smallest before."""
    return len(steps) > _PATIENCE and not min(steps[-_PATIENCE:]) < _SHRINKS * min(steps[:-_PATIENCE])


def _worse(energies: list[float]) -> bool:
    return len(energies) > 1 and not energies[-1] <= 2.0 * energies[-2]


def _root(phi: Floats, labels: Labels) -> Floats:
    """sqrt(E), E at most one in every component."""
    count = int(labels.max())
    tops = np.append(phi.max(), scipy.ndimage.maximum(phi, labels, range(1, count + 1)) if count > 1 else [])
    root = phi - (tops[0] if count < 2 else tops[labels])
    root *= 0.5
    return np.asarray(np.exp(root, out=root))


def _guarded(variances: tuple[Floats, Floats], mask: Mask) -> tuple[Floats, Floats]:
    """Variances that are positive everywhere: at least 1e-12 of their median, which also stands outside the
    mask; and at most 1e12 times the median, so that sums over an image resolve the others.
    """
    guarded = []
    for variance in variances:
        usual = middle(variance, mask)
        floor = 1e-24 * usual if usual > 0 else 1.0
        most = _LARGEST * usual if usual > 0 else np.inf
        inside = np.clip(variance, floor, most)
        guarded.append(inside if mask.all() else np.where(mask, inside, max(usual, floor)))
    return guarded[0], guarded[1]
