"""reconstruct(): Correspondence + Scene -> HeightMap."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.records import LOG, Progress, logged, silent
from optolever.scene import Scene

from .alternatives import DirectEdges, MarchedEdges
from .anchors import Anchors
from .arrays import Floats, Mask
from .calibration import rest_corrected
from .circulation import chi2_limit, circulation_chi2
from .curl import curl_limit, curl_scale, curl_score, curl_suspects, lone
from .discontinuities import edge_doubt, touched
from .edges import Doubt
from .gaps import across_gaps, widened
from .heightmap import HeightMap
from .holes import bridged, noise_gain, whole_lines
from .newton import Options, State, missed, solve
from .paper import SeriesName
from .paper_scene import reconstruct_paper
from .problem import Problem, prepare, require_correspondence
from .propagation import Measurement, calibration_modes
from .result import anchors_apart, height_map, judged
from .reweighting import reweighted
from .rounding import rounding_variance
from .shared_noise import shared_variance
from .uncertainty import unknown_variance

__all__ = ["Solution", "doubted", "method_names", "reconstruct", "solved_height", "with_modes"]

PAPER_METHODS: dict[str, SeriesName] = {"paper": "mean", "paper-rises": "rises", "paper-drops": "drops"}
_METHODS = {
    "coupled": Options(),
    "direct": Options(build=DirectEdges),
    "robust": Options(),
    "march": Options(build=MarchedEdges),
    "fixed-point": Options(newton=False, max_steps=120),
}
_REWEIGHTED = 2  # solves with doubtful edges: the slopes depend a little on the height
_ATTEMPTS = 3  # with pixels left out that have no normal where the mirror turns out to be
_SENSITIVE, _UNSTABLE = (
    0.25,
    1.0,
)  # of w's change over a pixel: slopes that a wrong scene, any error, amplifies
_MISSED = 5.0  # standard deviations of an edge
_BETTER = 3.0  # times: data less better than that by its curl may hide what neighbours share
_NOISIER = 1.2  # times the announced noise, by the curl: sigma grows to what it is
_ROUNDS = 6  # of leaving out lone pixels with a curl


class Solution(NamedTuple):
    """What was solved, how it ended, the variance of the unknown, and the map."""

    problem: Problem
    state: State
    variance: Floats
    height: HeightMap


def method_names() -> tuple[str, ...]:
    """Names that `reconstruct` takes as method."""
    return (*_METHODS, *PAPER_METHODS)


def reconstruct(
    correspondence: Correspondence,
    scene: Scene,
    method: str = "coupled",
    anchor: Anchors = None,
    mask: Mask | None = None,
    *,
    rest: Correspondence | None = None,
    start: HeightMap | None = None,
    progress: Progress = silent,
) -> HeightMap:
    """The mirror behind a correspondence.

    method: 'coupled' (Newton with an integrating factor; DCT or conjugate gradients, as the weights ask),
    'direct' (by sparse factorisation, for extreme weights), 'robust' (defects reweighted, see `reweighting`),
    'march' (along rows from one column, full rectangles only) and 'fixed-point' as cross-checks, or the
    paper's recursion 'paper', 'paper-rises', 'paper-drops' (see `reconstruct_paper`; no anchor, no sigma).
    anchor: what settles the free mode: 'edge' (default: the camera-side edge x = L0 rests), a point (x, y, z)
    in mm, or anchors of `anchors`. mask (H, W): pixels to use, among those without a flag. rest: what was
    decoded from the mirror at rest; its deviation from the scene's prediction is taken off as an error of
    calibration. start: a height map of the same camera to start from, say of the last frame.
    progress: called with what is being done, how many steps are done, and of how many. Raises InputError if
    the arrays do not fit the scene, no pixel is left, or no anchor can be used.
    """
    require_correspondence(correspondence)
    if not isinstance(scene, Scene):
        raise InputError(
            f"scene: is a {type(scene).__name__}, must be a Scene, as scene.load(name) reads one"
        )
    before_rest = correspondence
    if rest is not None:
        require_correspondence(rest, "rest")
        correspondence = rest_corrected(correspondence, rest, scene)
    if method in PAPER_METHODS:
        if mask is not None:
            raise InputError(f"mask: method {method!r} takes none, it solves whole rows")
        height = reconstruct_paper(correspondence, scene, series=PAPER_METHODS[method])
        return replace(height, notices=correspondence.notices)
    if method not in _METHODS:
        raise InputError(f"method = {method!r}: unknown, must be one of {', '.join(method_names())}")
    steps = 1 if scene.covariance is None else 2
    progress("height", 0, steps)
    with logged(f"reconstruct {correspondence.u.shape} by {method}"):
        problem, state, _, height = solved_height(correspondence, scene, anchor, mask, method, start)
    if scene.covariance is not None:
        progress("errors of the rig", 1, steps)
        height = with_modes(height, Measurement(before_rest, anchor, mask, rest, method), scene)
    height = replace(height, notices=(*height.notices, *anchors_apart(problem, state, height)))
    for notice in height.notices:
        LOG.warning("%s", notice)
    progress("reconstructed", steps, steps)
    return height


def with_modes(
    height: HeightMap, measured: Measurement, scene: Scene, modes: NDArray[np.float32] | None = None
) -> HeightMap:
    """The height with what the errors of a calibrated rig do to it, `modes` if they are known."""
    known = scene.covariance
    if known is None:
        return height
    if modes is None:
        modes = calibration_modes(_height_alone, measured, scene, height)
    return replace(height, calibration=modes, sources=known.sources, shares=known.shares)


def _height_alone(measured: Measurement, scene: Scene, start: HeightMap | None) -> HeightMap:
    """Height by a dense method, without sigma and without a look at discontinuities; NaN where unsolved."""
    correspondence = measured.correspondence
    if measured.rest is not None:
        correspondence = rest_corrected(correspondence, measured.rest, scene)
    options = _METHODS[measured.method]
    problem, state = _first(correspondence, scene, measured.anchor, measured.mask, options, start)
    grid = np.where(problem.labels > 0, problem.data.distance(state.w), np.nan)
    o, d = problem.rays.inner_origins, problem.rays.inner_directions
    x, y, z = o + problem.to_image(grid, np.nan) * d
    return HeightMap(x, y, z, np.full_like(z, np.nan), np.zeros(z.shape, np.uint16))


def solved_height(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors = None,
    mask: Mask | None = None,
    method: str = "coupled",
    start: HeightMap | None = None,
) -> Solution:
    """`reconstruct` by one of the dense methods."""
    options = _METHODS[method]
    problem, state = _first(correspondence, scene, anchor, mask, options, start)
    problem, state, scale = _without_outliers(problem, state, options)
    problem, state, noise = _at_its_noise(problem, state, scale, options)
    if method == "robust":
        state = reweighted(problem, state, options)
    elif method == "march":
        state = replace(state, doubt=doubted(problem, state, noise))
    else:
        state = _around_discontinuities(problem, state, options, noise)
    gain = noise_gain(problem.data.mask, problem.bridged)
    rounding = rounding_variance(problem, state)
    chi2, freedom = circulation_chi2(problem.data, state, gain)
    correlation = chi2 if rounding is None and chi2 > chi2_limit(freedom) else 1.0
    variance = correlation * gain * unknown_variance(problem.data, state, problem.labels)
    if correspondence.shared_noise is not None:
        variance += shared_variance(problem, state, correspondence.shared_noise)
    if rounding is not None:  # errors of discrete codes are shared by neighbours
        larger = np.maximum(variance, rounding)
        correlation = float(np.median((larger / variance)[problem.data.mask]))
        variance, chi2 = larger, chi2 / correlation
    height = height_map(problem, state, correspondence.flags, scale, method, variance, correlation)
    height = judged(height, scene.mirror, chi2, freedom, correspondence.notices)
    return Solution(problem, state, variance, height)


def _without_outliers(problem: Problem, state: State, options: Options) -> tuple[Problem, State, float]:
    """The solution without lone pixels that the slopes' curl points to (interpolated instead, as small holes
    are), and the scale of the others' curl, see `curl_scale`.
    """
    for _ in range(_ROUNDS):
        score = curl_score(*state.slopes, *state.variances, problem.data.mask)
        scale = curl_scale(score)
        limit = curl_limit(score) * (max(1.0, scale) if np.isfinite(scale) else 1.0)
        found = curl_suspects(score, limit, problem.bridged) & problem.data.mask
        removable = lone(found, problem.data) & ~problem.bridged
        problem = replace(problem, suspects=problem.suspects | found)
        if not removable.any():
            break
        wrong = problem.bridged | removable
        problem = replace(problem, data=bridged(problem.data, wrong), bridged=wrong)
        state = _solve(problem, state.w, options)
    return problem, state, scale


def _at_its_noise(
    problem: Problem, state: State, scale: float, options: Options
) -> tuple[Problem, State, float]:
    """The same with sigma as large as the curl's scale says, and the scale that is left; not where rounding
    makes the curl.
    """
    if not scale > _NOISIER or problem.data.whole_cells(problem.bridged):
        return problem, state, scale
    problem = replace(problem, data=problem.data.noisier(scale))
    return problem, _solve(problem, state.w, options), 1.0


def _first(
    correspondence: Correspondence,
    scene: Scene,
    anchor: Anchors,
    mask: Mask | None,
    options: Options,
    start: HeightMap | None,
) -> tuple[Problem, State]:
    """The problem and its solution. Pixels that cannot be solved are left out first; where the mirror turns
    out to be elsewhere than at rest, once more. If Newton's method does not converge, so are the pixels
    beside the pattern whose edges it misses: in a scene that is slightly wrong they lie beyond the pattern.
    """
    singular = np.zeros(correspondence.u.shape, dtype=np.bool_)
    for _ in range(_ATTEMPTS):
        problem = prepare(correspondence, scene, anchor, mask, singular, not options.newton)
        first = _warm(problem, start) if start is not None else None
        state = _solve(problem, problem.data.rest() if first is None else first, options)
        hollow = problem.data.singular(state.w, not options.newton)
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


def _solve(problem: Problem, first: Floats, options: Options) -> State:
    return solve(problem.data, problem.samples, problem.labels, first, options)


def _around_discontinuities(problem: Problem, state: State, options: Options, noise: float) -> State:
    """The solution with doubtful edges held in doubt, if there are any. noise: the curl's scale."""
    for _ in range(_REWEIGHTED):
        doubt = doubted(problem, state, noise)
        if doubt is None:
            break
        state = solve(problem.data, problem.samples, problem.labels, state.w, options, doubt)
    return state


def doubted(problem: Problem, state: State, noise: float) -> Doubt | None:
    """What is in doubt of a solution's edges, those of interpolated pixels included."""
    announced = not np.isfinite(noise) or problem.data.whole_cells(problem.bridged)
    # a residual that most edges have is no discontinuity
    scale = 1.0 if announced else max(min(1.0, _BETTER * noise), state.misfit)
    mask, blamed = problem.data.mask, problem.suspects & ~problem.bridged
    doubt = edge_doubt(*state.slopes, *state.variances, mask, scale, blamed)
    if problem.bridged.any():
        gaps = across_gaps(*state.slopes, state.variances, mask, problem.bridged)
        doubt = gaps if doubt is None else Doubt(np.maximum(doubt.x, gaps.x), np.maximum(doubt.y, gaps.y))
        doubt = widened(doubt, problem.bridged) if touched(doubt).any() else None
    return doubt


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
