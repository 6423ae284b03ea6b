"""reconstruct(): Correspondence + Scene -> HeightMap."""

from dataclasses import dataclass, replace

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
from .holes import bridged, noise_gain
from .measured import Measured
from .newton import Options, State, coarse_start, solve
from .outliers import outliers
from .paper import SeriesName
from .paper_scene import reconstruct_paper
from .problem import Problem, prepare, require_correspondence
from .propagation import Measurement, calibration_modes
from .result import Spread, anchors_apart, height_map, judged
from .reweighting import reweighted
from .rounding import rounding_variance

__all__ = ["doubted", "method_names", "reconstruct", "solved_height", "with_modes"]

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
_BETTER = 3.0  # times: data less better than that by its curl may hide what neighbours share
_NOISIER = 1.2  # times the announced noise, by the curl: sigma grows to what it is
_ROUNDS = 6  # of leaving out lone pixels with a curl


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
        problem, state, height = solved_height(correspondence, scene, anchor, mask, method, start)
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
    _, problem, state, _ = _first(correspondence, scene, measured.anchor, measured.mask, options, start)
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
) -> tuple[Problem, State, HeightMap]:
    """`reconstruct` by one of the dense methods, with what was solved and how it ended."""
    options = _METHODS[method]
    whole, problem, state, removed = _first(correspondence, scene, anchor, mask, options, start)
    problem, state, wrong = _without_curl(whole.data, problem, state, removed, options)
    problem, state, noise = _at_its_noise(problem, state, wrong.scale, options)
    blamed = wrong.suspects & ~wrong.removed
    if method == "robust":
        state = reweighted(problem, state, options)
    elif method == "march":
        state = replace(state, doubt=doubted(problem, state, noise, wrong.removed, blamed))
    else:
        state = _around_discontinuities(problem, state, options, noise, wrong.removed, blamed)
    bridging = noise_gain(problem.data.mask, problem.bridged | wrong.removed)
    rounding = rounding_variance(problem, state)
    chi2, freedom = circulation_chi2(problem.data, state, bridging)
    shared = chi2 if rounding is None and chi2 > chi2_limit(freedom) else 1.0
    spread = Spread(shared, bridging, rounding)
    height = height_map(
        problem, state, correspondence.flags, wrong.suspects, wrong.scale, method, None, spread
    )
    if rounding is not None:  # errors of discrete codes are shared by neighbours
        chi2 /= height.diagnostics.correlation
    return problem, state, judged(height, scene.mirror, chi2, freedom, correspondence.notices)


@dataclass(frozen=True, slots=True)
class _Wrong:
    """suspects (rows, cols): pixels with a curl or without agreement with their neighbours; removed: those of
    them that were replaced; scale: the curl's of the others, see `curl_scale`.
    """

    suspects: Mask
    removed: Mask
    scale: float


def _without_curl(
    measured: Measured, problem: Problem, state: State, removed: Mask, options: Options
) -> tuple[Problem, State, _Wrong]:
    """The solution without lone pixels whose slopes have a curl. measured: the data with them; removed:
    pixels that are left out already.
    """
    suspects = removed.copy()
    for _ in range(_ROUNDS):
        score, scale = _curl(problem, state)
        limit = curl_limit(score) * (max(1.0, scale) if np.isfinite(scale) else 1.0)
        found = curl_suspects(score, limit, removed) & measured.mask
        suspects |= found
        removable = lone(found, problem.data) & ~removed
        if not removable.any():
            break
        removed = removed | removable
        problem = replace(problem, data=bridged(measured, removed))
        state = _solve(problem, state.w, options)
    return problem, state, _Wrong(suspects, removed, scale)


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
) -> tuple[Problem, Problem, State, Mask]:
    """The problem, the same without outliers, its solution, and what was removed. Pixels that cannot be
    solved are left out first; where the mirror turns out to be elsewhere than at rest, once more.
    """
    singular = np.zeros(correspondence.u.shape, dtype=np.bool_)
    for _ in range(_ATTEMPTS):
        whole = prepare(correspondence, scene, anchor, mask, singular, not options.newton)
        removed = outliers(whole.data, ~whole.bridged)
        problem = replace(whole, data=bridged(whole.data, removed))
        first = _warm(problem, start) if start is not None else None
        if first is None:
            first = coarse_start(problem.data, problem.samples, problem.labels, options)
        state = _solve(problem, first, options)
        hollow = problem.data.singular(state.w, not options.newton)
        problem = replace(problem, singular=problem.singular | hollow)
        if not hollow.any():
            break
        singular |= problem.to_image(hollow, False)
    return whole, problem, state, removed


def _solve(problem: Problem, first: Floats, options: Options) -> State:
    return solve(problem.data, problem.samples, problem.labels, first, options)


def _around_discontinuities(
    problem: Problem, state: State, options: Options, noise: float, removed: Mask, blamed: Mask
) -> State:
    """The solution with doubtful edges held in doubt, if there are any. noise: the curl's scale; removed:
    lone wrong pixels; blamed: others with a curl.
    """
    for _ in range(_REWEIGHTED):
        doubt = doubted(problem, state, noise, removed, blamed)
        if doubt is None:
            break
        state = solve(problem.data, problem.samples, problem.labels, state.w, options, doubt)
    return state


def doubted(
    problem: Problem,
    state: State,
    noise: float,
    removed: Mask,
    blamed: Mask | None = None,
) -> Doubt | None:
    """What is in doubt of a solution's edges, those of interpolated pixels included."""
    p, q = problem.data.slopes(state.w)[:2]
    announced = not np.isfinite(noise) or problem.data.whole_cells(problem.bridged)
    scale = 1.0 if announced else min(1.0, _BETTER * noise)
    doubt = edge_doubt(p, q, *state.variances, problem.data.mask, scale, blamed)
    guessed = removed | problem.bridged
    if guessed.any():
        gaps = across_gaps(p, q, state.variances, problem.data.mask, guessed)
        doubt = gaps if doubt is None else doubt.at_least(gaps)
        doubt = widened(doubt, guessed) if touched(doubt).any() else None
    return doubt


def _curl(problem: Problem, state: State) -> tuple[Floats, float]:
    """Curl of the slopes over its standard deviation, and its robust scale."""
    p, q = problem.data.slopes(state.w)[:2]
    score = curl_score(p, q, *state.variances, problem.data.mask)
    return score, curl_scale(score)


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
