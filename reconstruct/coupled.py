"""reconstruct(): Correspondence + Scene -> HeightMap."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.records import LOG, Progress, logged, silent
from optolever.scene import TYPED, Scene, without_rest_form

from .arrays import Floats, Mask
from .heightmap import HeightMap
from .judgement.circulation import circulation_chi2, contradiction
from .judgement.discontinuities import edge_doubt, touched, widened
from .judgement.holes import noise_gain, whole_lines
from .judgement.reweighting import CAUCHY, patches, wrong_pixels
from .problem import Problem, prepare
from .result import anchors_apart, height_map, loaded, off_mirror, refused, with_references, without_loose
from .rig.calibration import same_capture
from .rig.hypotheses import likely_mistake, likely_mistake_at_rest
from .rig.model import (
    LINEAR,
    Measurement,
    RigJudgement,
    judged_rig,
    raw_chi2,
    rig_model,
    rig_modes,
    rig_solutions,
)
from .rig.motion import limited_motion, unpressed
from .solver.anchors import Anchors
from .solver.edges import Doubt, defects, edge_weights
from .solver.newton import State, missed, solve
from .uncertainty.sources import CELLS, NOISE, noise_sources

__all__ = ["Solution", "method_names", "reconstruct", "solved_height", "with_rig"]

_METHODS = ("coupled",)
_ATTEMPTS = 3  # each without the pixels that have no normal at the last solution
#: Of w's change over a pixel: slopes that a wrong scene, any error, amplifies.
_SENSITIVE, _UNSTABLE = 0.25, 1.0
_MISSED = 5.0  # standard deviations of an edge
_DOUBTED = 0.2  # chi2 that the errors of such a rig leave, from which on other descriptions are tried
_SAME_CAPTURE = Notice(
    "The press and the rest capture are one and the same capture, so that every height is 0",
    math.nan,
    math.nan,
    "give the capture of the mirror at rest as --rest",
)
_ROBUST = 6  # solves without what misses the heights
_MOST_WRONG = 0.1  # of the pixels: more is a wrong scene
_FEW = 2e-3  # doubtful edges a pixel, two of which each has: fewer leave the closed form


_ONE = np.ones((1, 1))


class Solution(NamedTuple):
    """What was solved, how it ended, the variance of the unknown by source (see `sources`), and the map.

    correspondence: less the rest capture's deviation, if there is one.
    """

    correspondence: Correspondence
    problem: Problem
    state: State
    noise: dict[str, Floats]
    height: HeightMap


def method_names() -> tuple[str, ...]:
    """Names that `reconstruct` takes as method."""
    return _METHODS


def reconstruct(
    correspondence: Correspondence,
    scene: Scene,
    method: str = "coupled",
    anchor: Anchors = None,
    mask: Mask | None = None,
    *,
    rest: Correspondence | None = None,
    start: HeightMap | None = None,
    accept: bool = False,
    progress: Progress = silent,
) -> HeightMap:
    """The mirror behind a correspondence.

    method: 'coupled', Newton with an integrating factor; DCT or conjugate gradients, as the weights ask.
    anchor: what settles the free mode: 'edge' (default: the camera-side edge x = L0 rests), 'middle' (default
    in open air without that edge in view), a point (x, y, z) in mm, or anchors of `anchors`. mask (H, W):
    pixels to use, among those without a flag. rest: what was decoded from the mirror at rest; its deviation
    from the scene's prediction is taken off as an error of calibration. start: a height map of the same
    camera to start from, say of the last frame.
    accept: keep the heights of a capture that no rig of this scene's accuracy can have taken; else all its
    pixels are flagged IMPLAUSIBLE.
    progress: called with what is being done, how many steps are done, and of how many. Raises InputError if
    the arrays do not fit the scene, no pixel remains, or no anchor can be used.
    """
    if method not in _METHODS:
        raise InputError(f"method = {method!r}: unknown, must be one of {', '.join(method_names())}")
    if rest is not None:
        if rest.u.shape == correspondence.u.shape and same_capture(correspondence, rest):
            correspondence = replace(correspondence, notices=(*correspondence.notices, _SAME_CAPTURE))
        scene = without_rest_form(scene)  # heights are those above the mirror at rest
    measured = Measurement(correspondence, anchor, mask, rest)
    correspondence = measured.corrected(scene)
    steps = 1 if scene.exact else 2
    progress("height", 0, steps)
    with logged(f"reconstruct {correspondence.u.shape}"), _explained(rest, scene):
        solution = solved_height(correspondence, scene, anchor, mask, start)
    progress("errors of the rig", 1, steps)
    solution = with_rig(solution, measured, scene, accept)
    problem, state = solution.problem, solution.state
    height = with_references(solution.height, problem, state, solution.noise, correspondence, anchor, rest)
    if rest is not None:
        height = loaded(height, problem, state, scene, anchor)
    height = without_loose(height)
    if not height.implausible:
        doubts = (*anchors_apart(problem, state, height), *off_mirror(height, scene.mirror))
        height = replace(height, notices=(*height.notices, *doubts))
    for notice in height.notices:
        LOG.warning("%s", notice)
    progress("reconstructed", steps, steps)
    return height


def with_rig(
    solution: Solution,
    measured: Measurement,
    scene: Scene,
    accept: bool = False,
) -> Solution:
    """The solution with the modes of its rig, its slopes judged after the errors of the rig are taken off;
    all pixels are flagged where no such rig can have taken the capture, unless `accept`."""
    known = solution.height.diagnostics
    contradicted = bool(contradiction(known.chi2, known.freedom))
    if scene.exact and not (contradicted and known.chi2 > LINEAR):  # type: ignore[operator]
        return solution
    typed = replace(scene, accuracy=TYPED) if scene.exact else scene
    if measured.rest is not None and not accept:
        mistake = likely_mistake_at_rest(measured.rest, scene)
        if mistake is not None:
            return solution._replace(height=refused(solution.height, mistake))
    model = rig_model(_solved_coarse, measured, typed, solution.height)
    if model is None:
        return solution
    solutions = rig_solutions(model)
    if contradicted:
        gain = noise_gain(solution.problem.data.mask, solution.problem.bridged)
        left = judged_rig(model, solutions, solution.problem, solution.state, gain)
        if not scene.exact:
            solution = _judged(*solution[:-1], left.chi2, left.freedom, rig=True)
        doubted = not left.exact and not (left.likely and left.chi2 < _DOUBTED)
        if doubted and measured.rest is None and not accept:
            mistake = likely_mistake(_judge_coarse, measured, typed, left)
            if mistake or not left.likely:
                return solution._replace(height=refused(solution.height, mistake))
    if scene.exact:
        return solution
    modes = rig_modes(model, solutions)
    height = replace(solution.height, **modes._asdict())
    if measured.rest is not None and modes.own:
        height = limited_motion(height, unpressed(measured.correspondence, measured.rest)[0])
    return solution._replace(height=height)


@contextmanager
def _explained(rest: Correspondence | None, scene: Scene) -> Iterator[None]:
    """A capture that cannot be solved names the mistake in its scene that its rest capture shows."""
    try:
        yield
    except InputError as error:
        mistake = None if rest is None else likely_mistake_at_rest(rest, scene)
        if mistake is None:
            raise
        raise InputError(f"{error}; with one change of the scene the rest capture fits: {mistake}") from error


def _judge_coarse(measured: Measurement, scene: Scene, limit: float) -> RigJudgement | None:
    """None, at the price of one solve, where chi2 is not below the limit whatever the rig's errors are."""
    model = rig_model(_solved_coarse, measured, scene, None)
    assert model is not None
    if raw_chi2(model) >= limit:
        return None
    gain = noise_gain(model.problem.data.mask, model.problem.bridged)
    return judged_rig(model, rig_solutions(model), model.problem, model.state, gain)


def _solved_coarse(measured: Measurement, scene: Scene, start: HeightMap | None) -> tuple[Problem, State]:
    """Problem and state, without a look at outliers and discontinuities."""
    return _first(measured.corrected(scene), scene, measured.anchor, measured.mask, start)


def solved_height(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors = None,
    mask: Mask | None = None,
    start: HeightMap | None = None,
) -> Solution:
    """`reconstruct` of a scene without errors."""
    problem, state = _first(correspondence, scene, anchor, mask, start)
    doubt = _doubted(problem, state)
    wrong = np.zeros(1, np.bool_) if doubt is None else _wrong_pixels(problem, state, doubt)
    if wrong.any():
        used = ~wrong if mask is None else np.asarray(mask) & ~wrong
        with suppress(InputError):  # an anchor among them
            problem, state = _first(correspondence, scene, anchor, used, start)
            problem, doubt = replace(problem, suspects=wrong), _doubted(problem, state)
    if doubt is not None:
        state = _around_discontinuities(problem, state, doubt)
    gain = noise_gain(problem.data.mask, problem.bridged)
    noise = noise_sources(problem, state, gain, correspondence.shared_noise)
    chi2, freedom = circulation_chi2(problem.data, state, gain)
    if CELLS in noise:  # neighbours share their errors
        chi2 /= 1 + float(np.median((noise[CELLS] / noise[NOISE])[problem.data.mask]))
    return _judged(correspondence, problem, state, noise, chi2, freedom)


def _judged(
    correspondence: Correspondence,
    problem: Problem,
    state: State,
    noise: dict[str, Floats],
    chi2: float,
    freedom: int,
    rig: bool = False,
) -> Solution:
    """The solution under the chi2 of its slopes; rig: that errors of the rig leave."""
    known = None if math.isnan(chi2) else chi2
    height = height_map(problem, state, correspondence, noise, known, freedom, rig)
    return Solution(correspondence, problem, state, noise, height)


def _first(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors,
    mask: Mask | None,
    start: HeightMap | None,
) -> tuple[Problem, State]:
    """The problem and its solution. Pixels that cannot be solved with the mirror at rest are excluded first,
    then those that cannot at the solution. If Newton's method does not converge, so are pixels close to the
    pattern with a large edge defect: in a scene that is slightly wrong they lie beyond the pattern.
    """
    singular = np.zeros(correspondence.u.shape, dtype=np.bool_)
    for _ in range(_ATTEMPTS):
        problem = prepare(correspondence, scene, anchor, mask, singular)
        first = _warm(problem, start) if start is not None else None
        state = _solve(problem, problem.data.rest() if first is None else first)
        hollow = problem.data.singular(state.w)
        if not state.converged:
            limit = _UNSTABLE if hollow.any() else _SENSITIVE
            places = state.w, problem.data.rest()
            beside = np.logical_or(*(problem.data.sensitive(w, limit) for w in places))
            hollow = whole_lines(hollow | (beside & missed(problem.data, state, _MISSED)))
        singular |= problem.to_image(hollow, False)
        problem = replace(problem, singular=problem.singular | (singular & problem.valid))
        if not hollow.any():
            break
    return problem, state


def _solve(problem: Problem, first: Floats) -> State:
    return solve(problem.data, problem.samples, problem.labels, first)


def _wrong_pixels(problem: Problem, state: State, jumps: Doubt) -> Mask:
    """Pixels of the image that a robust solve misses, where slopes jump."""
    robust, wrong, mask = state, np.zeros_like(problem.data.mask), problem.data.mask
    weights = edge_weights(*state.variances, _ONE, mask)
    for _ in range(_ROBUST):
        defect, scale = defects(*robust.slopes, robust.w, _ONE, mask), max(1.0, robust.misfit)
        before, wrong = wrong, wrong_pixels(defect, weights, scale) & ~problem.bridged
        if not wrong.any() or np.array_equal(wrong, before):
            break
        doubt = Doubt(*(np.abs(part) / (CAUCHY * scale) for part in defect))
        robust = solve(problem.data, problem.samples, problem.labels, robust.w, doubt)
    surely = wrong & wrong_pixels(defect, edge_weights(*state.variances, _ONE, mask, jumps), scale)
    wrong = patches(wrong, surely, touched(jumps)) & mask & ~problem.bridged
    few = np.count_nonzero(wrong) <= _MOST_WRONG * wrong.size
    return problem.to_image(wrong & few, False)


def _around_discontinuities(problem: Problem, state: State, doubt: Doubt) -> State:
    """The solution with the doubts in the edges' variances; where there are few, they are in sigma alone (see
    `sources`). The slopes depend a little on the height: once more."""
    if state.problem.closed and np.count_nonzero(doubt) < _FEW * doubt.x.size:
        return replace(state, doubt=doubt)
    state = solve(problem.data, problem.samples, problem.labels, state.w, doubt)
    again = _doubted(problem, state)
    return state if again is None else solve(problem.data, problem.samples, problem.labels, state.w, again)


def _doubted(problem: Problem, state: State) -> Doubt | None:
    """The doubts of a solution's edges, those of interpolated pixels included; a residual that most edges
    have is no discontinuity."""
    doubt = edge_doubt(*state.slopes, *state.variances, problem.data.mask, max(1.0, state.misfit))
    return doubt if doubt is None or not problem.bridged.any() else widened(doubt, problem.bridged)


def _warm(problem: Problem, start: HeightMap) -> Floats | None:
    """The unknown of an earlier height map, its gaps filled from the nearest pixel;
    None if it has no height.
    """
    if start.z.shape != problem.valid.shape:
        raise InputError(f"start: {start.z.shape} pixels, the scene's camera has {problem.valid.shape}")
    o, d = problem.rays.inner_origins, problem.rays.inner_directions
    along = (start.x - o[0]) * d[0] + (start.y - o[1]) * d[1] + (start.z - o[2]) * d[2]
    rest = problem.data.rest()
    distance = problem.to_grid(along)
    known = np.isfinite(distance)
    if not known.any():
        return None
    offset = problem.data.unknown(np.where(known, distance, 1.0)) - rest
    if not known.all():
        nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        offset = offset[tuple(nearest)]
    first: Floats = rest + offset
    return first
