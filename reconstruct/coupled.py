"""reconstruct(): Correspondence + Scene -> HeightMap."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Mask, Pair
from optolever.blocks import blas_on_one
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.records import LOG, Progress, logged, silent
from optolever.scene import TYPED, Scene, rig_covariance, without_rest_form
from optolever.schema import checked

from .heightmap import HeightMap
from .judgement.circulation import circulation_chi2, contradicted
from .judgement.discontinuities import edge_doubt, touched, widened
from .judgement.holes import noise_gain
from .judgement.map_tests import Solved, judged
from .judgement.reweighting import CAUCHY, patches, wrong_pixels
from .load import SAG, free_mode, less_sag
from .problem import Problem, first_solution
from .result import height_map, refused, with_references, without_unknown
from .rig.calibration import same_capture
from .rig.hypotheses import mistakes, of_another_rig
from .rig.model import LINEAR, Measurement, RigJudgement, judged_rig, rig_model, rig_modes
from .rig.since_rest import PictureShift, picture_shift, shift_modes
from .solver.anchors import EDGE_OR_BORDER, Anchors
from .solver.edges import Doubt, defects, edge_weights
from .solver.newton import State, solve
from .uncertainty.sources import CELLS, NOISE, lens_errors, noise_sources

__all__ = ["Solution", "reconstruct", "solved_height"]

_DOUBTED = 0.2  # chi2 that the errors of such a rig leave, from which on other descriptions are tried
_SAME_CAPTURE = Notice(
    "The press and the rest capture are one and the same capture, so that every height is 0",
    math.nan,
    math.nan,
    "reconstruct --rest takes the capture of the mirror at rest",
)
_ROBUST = 6  # solves without what misses the heights
_MOST_WRONG = 0.1  # of the pixels: more is a wrong scene
_TURNED = 0.05  # rad: typed rigs are off by .04
_FEW = 2e-3  # doubtful edges a pixel, two of which each has: fewer leave the closed form
_ONE = np.ones((1, 1))
_MIDDLE = Notice(
    "the camera does not see the mirror's edge: its middle counts as at rest, at z = 0", math.nan, math.nan,
    "if it is pressed there, heights are wrong: reconstruct --rest, or --anchor border, or --anchor X,Y,0",
)  # fmt: skip


class Solution(NamedTuple):
    """What was solved, how it ended, the variance of the unknown by source (see `sources`), and chi2 of the
    slopes' circulation with its degrees of freedom.

    correspondence: less the rest capture's deviation, if there is one.
    """

    correspondence: Correspondence
    problem: Problem
    state: State
    noise: dict[str, Floats]
    chi2: float
    freedom: int


@checked(correspondence=Correspondence, scene=Scene, rest=Correspondence)
@blas_on_one()
def reconstruct(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors = None,
    mask: Mask | None = None,
    *,
    rest: Correspondence | None = None,
    accept: bool = False,
    progress: Progress = silent,
) -> HeightMap:
    """The mirror behind a correspondence, by Newton's method with an integrating factor.

    anchor: what settles the free mode: 'edge' (default: the camera-side edge x = L0 rests), 'border' (of the
    camera's view: default without that edge in it, if rest is given), 'middle' (default else in open air), a
    point (x, y, z) in mm, or anchors of `anchors`. mask (H, W): pixels to use, of those without a flag.
    rest: what was decoded from the mirror at rest; its deviation from the scene's prediction is taken off as
    an error of calibration.
    accept: keep the heights of a capture that no rig of this scene's accuracy can have taken; else all its
    pixels are flagged IMPLAUSIBLE.
    progress: called with what is being done, how many steps are done, and of how many. Raises InputError if
    the arrays do not fit the scene, no pixel remains, or no anchor can be used.
    """
    if rest is not None:
        if same_capture(correspondence, rest):
            correspondence = replace(correspondence, notices=(*correspondence.notices, _SAME_CAPTURE))
        scene, anchor = _above_rest(scene, anchor)
    measured = Measurement(correspondence, anchor, mask, rest)
    corrected = measured.corrected(scene)
    steps = 1 if scene.exact else 2
    progress("height", 0, steps)
    with logged(f"reconstruct {correspondence.u.shape}"), _explained(measured, scene):
        solution = solved_height(corrected, scene, anchor, mask, lens_errors(correspondence, rest))
    progress("errors of the rig", 1, steps)
    height, rig, mistake = _with_rig(solution, measured, scene, accept)
    problem, state = solution.problem, solution.state
    height = with_references(height, problem, state, solution.noise, corrected, anchor, rest)
    shift = None
    if rest is not None and not height.implausible:
        height, shift = _less_motion(height, solution, measured, scene)
    height = without_unknown(height, scene.mirror)
    loaded = SAG in height.sources
    solved = Solved(height, problem, state, scene, measured, corrected, rig, mistake, shift, loaded)
    tests = judged(solved)
    notices = [*height.notices, *(test.notice for test in tests if test.fails)]
    if anchor is None and problem.samples.row.size == 1:
        notices.append(_MIDDLE)
        height = replace(height, free=free_mode(problem, state))
    height = replace(height, notices=tuple(notices), tests=tests)
    for notice in height.notices:
        LOG.warning("%s", notice)
    progress("reconstructed", steps, steps)
    return height


def _above_rest(scene: Scene, anchor: Anchors) -> tuple[Scene, Anchors]:
    """Scene and anchor of heights above the mirror at rest."""
    return without_rest_form(scene), EDGE_OR_BORDER if anchor is None else anchor


class _Judged(NamedTuple):
    """A map with the modes of its rig, how its slopes were judged beside the rig's errors (None: they fit
    without), and the mistake for which it is refused, in words."""

    height: HeightMap
    rig: RigJudgement | None = None
    mistake: str | None = None


def _with_rig(solution: Solution, measured: Measurement, scene: Scene, accept: bool) -> _Judged:
    """The height, its slopes judged after the errors of the rig are taken off; all pixels are flagged where
    no such rig can have taken the capture, unless `accept`."""
    (seen, problem, state, noise, chi2, freedom), at_rest = solution, measured.rest is not None
    height = height_map(problem, state, seen, noise, None if math.isnan(chi2) else chi2, freedom)
    apart = contradicted(chi2, freedom)
    exact = scene.exact and measured.common_u(0.0) == 0
    if exact and not (apart and chi2 > LINEAR):
        return _Judged(height)
    typed = replace(scene, accuracy=TYPED) if exact else scene
    if at_rest and not accept and (found := mistakes(measured, scene)):
        return _Judged(refused(height), None, found[0])
    unsettled = None if state.unsettled is None else problem.to_image(state.unsettled, False)
    model = rig_model(measured, typed, height, unsettled)
    if model is None:
        return _Judged(height)
    solutions, left = model.solutions(), None
    if apart:
        left = judged_rig(model, solutions, chi2, freedom)
        if not exact:
            known = replace(height.diagnostics, chi2=left.chi2, freedom=left.freedom)
            height = replace(height, diagnostics=known)
        doubted = not left.exact and not (left.likely and left.chi2 < _DOUBTED)
        if doubted and not accept:
            found = () if at_rest else mistakes(measured, typed, left)
            if found or not left.likely:
                return _Judged(refused(height), left, *found[:1])
    if exact:
        return _Judged(height, left)
    return _Judged(replace(height, **rig_modes(model, solutions)._asdict()), left)


def _less_motion(
    height: HeightMap, solution: Solution, measured: Measurement, scene: Scene
) -> tuple[HeightMap, PictureShift]:
    """A map less rest without sag and motion, and the picture's shift by that motion, which may be a sinking
    of the mirror; of a rig without motion, which takes it for one, by a fit with a motion beside it."""
    problem, state = solution.problem, solution.state
    before = height if height.own else shift_modes(height, problem, state, measured.correspondence)
    after = less_sag(before, problem, state, scene)
    shift = picture_shift(before, after, scene)
    if not height.own:
        tests = tuple(test for test in after.tests if test.test != "motion")
        shift = shift._replace(prior=0.0)
        after = replace(less_sag(height, problem, state, scene), tests=tests)
    return replace(after, sinking=shift.unsure), shift


@contextmanager
def _explained(measured: Measurement, scene: Scene) -> Iterator[None]:
    """A capture that cannot be solved names the likeliest mistake in its scene."""
    try:
        yield
    except InputError as error:
        for mistake in mistakes(measured, scene):
            raise InputError(f"{error}; with one change of the scene it fits: {mistake}") from error
        found = of_another_rig(measured, scene)
        if found is None or not found.fails:
            raise
        raise InputError(f"{error}; {found.notice}") from error


def solved_height(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors = None,
    mask: Mask | None = None,
    lens: Pair | None = None,
) -> Solution:
    """`reconstruct` of a scene without errors; lens: see `lens_errors`."""
    problem, state = first_solution(correspondence, scene, anchor, mask)
    doubt = _doubted(problem, state)
    wrong = np.zeros(1, np.bool_) if doubt is None else _wrong_pixels(problem, state, doubt, scene)
    if wrong.any():
        used = ~wrong if mask is None else np.asarray(mask) & ~wrong
        with suppress(InputError):  # an anchor among them
            problem, state = first_solution(correspondence, scene, anchor, used)
            problem, doubt = replace(problem, suspects=wrong), _doubted(problem, state)
    if doubt is not None:
        state = _around_discontinuities(problem, state, doubt)
    gain = noise_gain(problem.data.mask, problem.bridged)
    noise = noise_sources(problem, state, gain, correspondence.shared_noise, lens)
    chi2, freedom = circulation_chi2(problem.data, state, gain)
    if CELLS in noise:  # neighbours share their errors
        chi2 /= 1 + float(np.median((noise[CELLS] / noise[NOISE])[problem.data.mask]))
    return Solution(correspondence, problem, state, noise, chi2, freedom)


def _wrong_pixels(problem: Problem, state: State, jumps: Doubt, scene: Scene) -> Mask:
    """Pixels of the image that a robust solve misses, where slopes jump."""
    robust, wrong, mask = state, np.zeros_like(problem.data.mask), problem.data.mask
    weights = edge_weights(*state.variances, _ONE, mask, _turned(problem, state, scene))
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


def _turned(problem: Problem, state: State, scene: Scene) -> Doubt | None:
    """Standard deviations of the edges' increments by the rig's rotations, which turn and shear what slopes
    changed by since rest."""
    covariance = rig_covariance(scene)
    if covariance is None:
        return None
    turns = [name.rpartition(".")[2] in ("rx", "ry", "rz") for name in covariance.names]
    change = np.hypot(*defects(*state.slopes, problem.data.rest(), _ONE, problem.data.mask))
    share = min(float(np.linalg.norm(covariance.root[:, turns])), _TURNED)
    return Doubt(*2 * [share * scipy.ndimage.maximum_filter(change, 3)])


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
