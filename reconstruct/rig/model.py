"""Modes of a height map by the errors of its rig, and whether these explain slopes that contradict each
other.

A rig has m independent errors a of unit variance: the rows of a root of its covariance, the thickness of a
cover glass, a sag of the mirror at rest, motion between two captures. `RigModel.at(a)` is the measurement
that the solver would work on if the rig had these errors; chord steps from the solution give the height, so
that M_j = (z(h e_j) - z(0))/h needs no solve from scratch. h is small, since a rig that is off by one
sigma of a wide prior may have no solution.
Modes are smooth: the model lies on a coarse grid of the camera's pixels, each the mean over its surroundings,
and modes are interpolated linearly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.ndimage
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import Covariance, Scene, adjusted, parameter_values, rig_covariance, strided

from ..arrays import Floats, Mask
from ..geometry import pattern_plane, traced_rays
from ..heightmap import HeightFlag, HeightMap
from ..judgement.circulation import circulation_chi2, circulations
from ..measured import Measured
from ..outputs.coarse_modes import Modes, coarse_step, filled
from ..problem import Problem
from ..solver.anchors import (
    AnchorRows,
    Anchors,
    DistanceAnchor,
    EdgeAnchor,
    PixelAnchor,
    Samples,
    anchor_rows,
    anchor_samples,
)
from ..solver.newton import State, chord_step
from ..solver.poisson import Accuracy
from .calibration import Form, Pair3, flat_mirror, no_form, rest_corrected
from .motion import motion_shifts
from .rig_effects import gauge_displacement, glass_shift, sag_forms

__all__ = [
    "LIKELY",
    "LINEAR",
    "Measurement",
    "RigJudgement",
    "RigModel",
    "RigModes",
    "judged_rig",
    "raw_chi2",
    "rig_model",
    "rig_modes",
    "rig_solutions",
]

First = Callable[["Measurement", Scene, HeightMap | None], tuple[Problem, State]]

_UNSETTLED = np.uint16(HeightFlag.NOT_CONVERGED | HeightFlag.SINGULAR)
_STEP = 0.05  # of a standard deviation
_CHORDS = 3  # steps; each leaves about 1 % of the last one, the error of the integrating factor
#: chi2 up to which derivatives by the rig's errors serve; beyond it they describe errors to a tenth.
LINEAR = 1e4
#: Mean square of the rig's errors in standard deviations up to which a scene is believed: three sigma of all.
LIKELY = 9.0
_TENTH = 100.0  # chi2 by the tenth of an error whose chi2 is 1e4
_FITS = 5  # Gauss-Newton steps
_SHORTER = 0.3  # of a step that makes it worse
_ACCURACY = Accuracy(1e-4, 1e-7)  # energy: of an edge's standard deviation; less is rounding
GLASS, CENTROID = "cover glass", "colour stripes of the display"
SAG, MOTION = "sag of the mirror at rest", "motion between rest and press"


@dataclass(frozen=True, slots=True)
class Measurement:
    """The arguments of `reconstruct`."""

    correspondence: Correspondence
    anchor: Anchors
    mask: Mask | None
    rest: Correspondence | None

    def corrected(self, scene: Scene) -> Correspondence:
        """The correspondence less the rest capture's deviation from the scene."""
        if self.rest is None:
            return self.correspondence
        return rest_corrected(self.correspondence, self.rest, scene)

    def coarse(self, step: int) -> "Measurement":
        """Every step-th row and column of it, correspondences as means over the pixels between."""
        return Measurement(
            _coarse(self.correspondence, step),
            _anchors(self.anchor, step),
            None if self.mask is None else np.asarray(self.mask)[::step, ::step],
            None if self.rest is None else _coarse(self.rest, step),
        )


class RigJudgement(NamedTuple):
    """chi2 of the slopes' circulation after the errors of the rig are taken off, and its degrees of freedom;
    likely: whether the covariance of the rig allows such errors; raw: chi2 before, on the coarse grid."""

    chi2: float
    freedom: int
    likely: bool
    raw: float

    @property
    def exact(self) -> bool:
        """Whether the errors are small enough for chi2 to be that of noise alone."""
        return self.raw < LINEAR


class RigModes(NamedTuple):
    """Changes by independent errors of unit variance, see `HeightMap`."""

    modes: Modes
    modes_step: int
    displacement: Floats
    sources: tuple[str, ...]
    shares: Floats
    own: int


class RigSolution(NamedTuple):
    """A measurement with other errors of the rig, how it was solved, and the form of the mirror at rest."""

    data: Measured
    state: State
    form: Form


@dataclass(frozen=True, slots=True)
class RigModel:
    """A solved measurement as a function of the errors of its rig, on every step-th pixel.

    root (r0, p): rows of the covariance's root, of the scene's numbers `names`; forms: shapes of the mirror
    at rest; shifts (k, 2, rows, cols): changes of u and v in the image; all of one standard deviation, the
    errors in this order. rest_mirror (2, rows, cols): u and v of the flat mirror where a rest capture is
    compared with it. sources (s,): of the errors, in words; shares (s, m, m): the part of each source in
    their covariance, which is 1. motions: how many of the last errors are of motion.
    """

    problem: Problem
    state: State
    scene: Scene
    step: int
    anchor: Anchors
    rest_mirror: Floats | None
    names: tuple[str, ...]
    root: Floats
    forms: tuple[Form, ...]
    shifts: Floats
    sources: tuple[str, ...]
    shares: Floats
    motions: int

    @property
    def count(self) -> int:
        """How many errors there are."""
        return len(self.root) + len(self.forms) + len(self.shifts)

    def at(self, errors: Floats) -> tuple[Measured, AnchorRows, Form]:
        """The measurement, the anchors and the form of the mirror at rest with these errors (m,)."""
        numbers, forms, shifts = np.split(errors, np.cumsum([len(self.root), len(self.forms)]))
        change = numbers @ self.root
        scene, form, moved = (
            self._scene(change),
            _sum(self.forms, forms),
            np.tensordot(shifts, self.shifts, 1),
        )
        problem, at_rest = self.problem, self.rest_mirror is not None
        pattern = [name.startswith("pattern.") for name in self.names]
        same = not np.any(change[np.logical_not(pattern)])  # the camera: anchors stay where they are
        rays = problem.rays if same else traced_rays(scene.camera)
        if self.rest_mirror is not None and (change.any() or forms.any()):
            # the rest capture is compared with what this rig predicts of it
            moved = moved + np.nan_to_num(flat_mirror(scene, form, rays) - self.rest_mirror)
        data = replace(
            problem.data,
            plane=pattern_plane(scene),
            shape=scene.pattern.shape,
            u=problem.data.u + problem.to_grid(moved[0]),
            v=problem.data.v + problem.to_grid(moved[1]),
        )
        if same and (at_rest or not forms.any()):
            return data, self.state.rows, form
        window = rays.cropped(problem.rows, problem.cols)
        data = replace(data, rays=window.transposed() if problem.turned else window)
        samples = anchor_samples(self.anchor, scene, rays, problem.valid)
        if not at_rest and forms.any():  # the edge is where the mirror at rest is
            origins, directions = (part.T for part in scene.camera.rays_at(samples.row, samples.col))
            x, y, _ = origins + samples.distance * directions
            samples = replace(samples, distance=samples.distance + form(x, y)[0] / directions[2])
        samples = samples.window(problem.rows.start, problem.cols.start)
        samples = _nearest(problem.samples, samples.transposed() if problem.turned else samples)
        return data, anchor_rows(samples, data, problem.labels), form

    def solved(self, errors: Floats, start: State | None = None) -> "RigSolution":
        """The measurement with these errors, and its solution by chord steps."""
        data, rows, form = self.at(errors)
        state = replace(self.state if start is None else start, rows=rows)
        for _ in range(_CHORDS):
            state = chord_step(data, self.problem.labels, state, _ACCURACY, self.state.share)
        return RigSolution(data, state, form)

    def points(self, solution: "RigSolution") -> Floats:
        """Mirror points (3, rows, cols) in mm, z less the form at rest; NaN where unsolved."""
        data, state, form = solution
        t = np.where(self.problem.labels > 0, data.distance(state.w), np.nan)
        points = data.rays.inner_origins + t * data.rays.inner_directions
        if self.rest_mirror is not None:
            points[2] -= form(points[0], points[1])[0]
        return np.stack([self.problem.to_image(part, np.nan) for part in points])

    def _scene(self, change: Floats) -> Scene:
        own = parameter_values(self.scene)
        values = {name: own[name] + float(moved) for name, moved in zip(self.names, change, strict=True)}
        return strided(adjusted(self.scene, values) if change.any() else self.scene, self.step)


def rig_model(
    first: First,
    measured: Measurement,
    scene: Scene,
    height: HeightMap | None,
) -> RigModel | None:
    """The model on a coarse grid, from a height map if it is solved; None where there are no errors.

    first: solves a measurement (its problem and its state).
    Where the coarse grid has no solution (small images, ragged masks), all pixels are taken.
    """
    step = coarse_step(measured.correspondence.u.shape)
    if height is not None:
        settled = np.isfinite(height.z) & ((height.flags & _UNSETTLED) == 0)
        if settled.any():
            measured = replace(measured, mask=settled if measured.mask is None else settled & measured.mask)
    for each in dict.fromkeys((step, 1)):
        try:
            return _model(first, measured, scene, each, height)
        except InputError:
            if each == 1:
                raise
    raise AssertionError


def _model(
    first: First,
    measured: Measurement,
    scene: Scene,
    step: int,
    height: HeightMap | None,
) -> RigModel | None:
    coarse, small = measured.coarse(step), strided(scene, step)
    start = None
    if height is not None:
        x, y, z, sigma = (part[::step, ::step] for part in (height.x, height.y, height.z, height.sigma))
        start = HeightMap(x, y, z, sigma, height.flags[::step, ::step])
    problem, state = first(coarse, small, start)
    typed = scene.accuracy if scene.covariance is None else None
    at_rest = measured.rest is not None
    shifts: list[tuple[str, Floats]] = []
    forms: tuple[Form, ...] = ()
    if typed is not None:
        shifts = [
            (GLASS, typed.glass * glass_shift(small, problem, state.w, at_rest)[None]),
            (CENTROID, np.broadcast_to([[[[typed.centroid]], [[0.0]]]], (1, 2, *problem.valid.shape))),
        ]
        if at_rest or _at_edge(measured.anchor):
            forms = sag_forms(small, typed.sag)
    if at_rest:
        shifts.append((MOTION, motion_shifts(coarse.correspondence, scene, step)))
    known = rig_covariance(scene)
    model = RigModel(
        problem,
        state,
        scene,
        step,
        coarse.anchor,
        flat_mirror(small) if at_rest else None,
        () if known is None else known.names,
        np.zeros((0, 0)) if known is None else known.root,
        forms,
        np.concatenate([np.zeros((0, 2, *problem.valid.shape)), *(fields for _, fields in shifts)]),
        *_sources(known, forms, shifts),
        motions=len(shifts[-1][1]) if shifts and shifts[-1][0] == MOTION else 0,
    )
    return model if model.count else None


def rig_solutions(model: RigModel) -> list[RigSolution]:
    """The solution without errors, and those with one error each."""
    return [model.solved(errors) for errors in (np.zeros(model.count), *_STEP * np.eye(model.count))]


def raw_chi2(model: RigModel) -> float:
    """chi2 of the slopes' circulation on the coarse grid, errors of the rig not taken off: `raw` of its
    `judged_rig`."""
    own = _scores(model, model.solved(np.zeros(model.count)))
    return own.worst(own.scores) if own.scores.size else 0.0


def rig_modes(model: RigModel, solutions: Sequence[RigSolution]) -> RigModes:
    """The modes of its height map."""
    own, *others = (model.points(each) for each in solutions)
    moved = (np.stack(others) - own) / _STEP
    return RigModes(
        filled(moved[:, 2]),
        model.step,
        np.concatenate([_affine(own, moved[:, :2]), gauge_displacement(model.scene)]),
        model.sources,
        model.shares,
        model.motions,
    )


def judged_rig(
    model: RigModel, solutions: Sequence[RigSolution], problem: Problem, state: State, gain: Floats
) -> RigJudgement:
    """Whether errors of the rig explain that the slopes contradict each other.

    Minimises trust sum_b w_b s_b(a)^2 + |a|^2 over the errors a, s the circulations of the coarse grid over
    their sigma, w their share of independent ones; trust < 1 where the errors are so large that derivatives
    describe them to a tenth. problem, state, gain: of all pixels, whose chi2 (see `circulation_chi2`) is the
    one before; it shrinks as the coarse grid's. Circulations no larger than those by the rig's errors of one
    standard deviation are likely, whatever made them: the height then stays within its total sigma.
    """
    raw, freedom = circulation_chi2(problem.data, state, gain)
    own = _scores(model, solutions[0])
    if not own.scores.size or not own.scores.any():
        return RigJudgement(raw, freedom, True, raw)
    slopes = np.stack([(_scores(model, each).scores - own.scores) / _STEP for each in solutions[1:]], axis=1)
    squares, prior = (slopes.T * own.weights) @ slopes, np.eye(model.count)
    before = own.worst(own.scores)
    typed = own.worst(np.sqrt(np.square(slopes).sum(axis=1)))
    trust = 1.0 if before < LINEAR else _TENTH / before
    errors, scores, solution, reach = np.zeros(model.count), own.scores, solutions[0], 1.0
    for _ in range(_FITS):
        gradient = trust * slopes.T @ (own.weights * scores) + errors
        step = scipy.linalg.solve(trust * squares + prior, gradient, assume_a="pos")
        try:
            tried = model.solved(errors - reach * step, solution.state)
        except InputError:  # no rig has these numbers
            reach *= _SHORTER
            continue
        found, was = _scores(model, tried).scores, trust * own.weights @ scores**2 + errors @ errors
        moved = errors - reach * step
        if trust * own.weights @ found**2 + moved @ moved < was:
            errors, scores, solution = moved, found, tried
        else:
            reach *= _SHORTER
    after = own.worst(scores)
    allowed = before <= typed  # of this size, whatever made them
    likely = allowed or float(errors @ errors) <= LIKELY * model.count
    if trust < 1.0:
        return RigJudgement(trust * after, freedom, allowed or (likely and trust * after <= LIKELY), before)
    return RigJudgement(raw * after / before, freedom, likely, before)


class _Circulations(NamedTuple):
    """scores (n,): circulations over their sigma of blocks of all sizes; weights (n,): the share of each that
    is independent; block (n,): number of its size."""

    scores: Floats
    weights: Floats
    block: NDArray[np.intp]

    def worst(self, scores: Floats) -> float:
        """The largest mean square of one size."""
        return float(np.max(np.bincount(self.block, scores**2) / np.bincount(self.block)))


def _scores(model: RigModel, solution: RigSolution) -> _Circulations:
    p, q, _, _ = solution.data.slopes(solution.state.w)
    variance = model.state.variances[0] + model.state.variances[1]
    found = [each for each in circulations(solution.data.mask, (p, q), variance) if each[1].size]
    if not found:
        return _Circulations(np.zeros(0), np.zeros(0), np.zeros(0, np.intp))
    weights = [np.full(scores.size, 1 / (2 * block) ** 2 / len(found)) for block, scores in found]
    sizes = np.repeat(np.arange(len(found)), [scores.size for _, scores in found])
    return _Circulations(np.concatenate([scores for _, scores in found]), np.concatenate(weights), sizes)


def _sources(
    known: Covariance | None, forms: tuple[Form, ...], shifts: Sequence[tuple[str, Floats]]
) -> tuple[tuple[str, ...], Floats]:
    """What is behind the errors, in words (s,), and the share of each (s, m, m)."""
    blocks: list[tuple[str, NDArray[Any]]] = []
    if known is not None:
        shares = np.eye(len(known.root))[None] if known.shares is None else known.shares
        blocks += zip(known.sources or ("numbers of the rig",), shares, strict=True)
    numbers = 0 if known is None else len(known.root)
    sizes = [(SAG, len(forms)), *((name, len(fields)) for name, fields in shifts)]
    total = numbers + sum(size for _, size in sizes)
    padded: list[tuple[str, NDArray[Any]]] = [
        (name, np.pad(share, (0, total - numbers))) for name, share in blocks
    ]
    start = numbers
    for name, size in sizes:
        if size:
            padded.append((name, np.diag(np.repeat([0.0, 1.0, 0.0], (start, size, total - start - size)))))
        start += size
    shares = np.array([share for _, share in padded]).reshape(-1, total, total)
    return tuple(name for name, _ in padded), shares


def _nearest(reference: Samples, samples: Samples) -> Samples:
    """Of every sample of the reference the nearest one: as many, where the edge has moved along the image."""
    if samples.row.size == reference.row.size:
        return samples
    away = np.hypot(reference.row[:, None] - samples.row, reference.col[:, None] - samples.col)
    at = np.argmin(away, axis=1)
    return Samples(samples.row[at], samples.col[at], samples.distance[at], samples.sigma[at])


def _sum(forms: Sequence[Form], factors: Floats) -> Form:
    if not factors.any():
        return no_form

    def form(x: Floats, y: Floats) -> Pair3:
        total = no_form(x, y)
        for each, factor in zip(forms, factors, strict=True):
            total = tuple(a + factor * b for a, b in zip(total, each(x, y), strict=True))
        return total

    return form


def _affine(points: Floats, moved: Floats) -> Floats:
    """(m, 2, 3): the fields moved (m, 2, rows, cols) as affine functions of x and y."""
    known = np.isfinite(points).all(axis=0) & np.isfinite(moved).all(axis=(0, 1))
    terms = np.stack([np.ones(np.count_nonzero(known)), points[0][known], points[1][known]], axis=1)
    fields = moved[:, :, known].reshape(-1, len(terms)).T
    found: Floats = np.linalg.lstsq(terms, fields, rcond=None)[0].T.reshape(-1, 2, 3)
    return found


def _coarse(c: Correspondence, step: int) -> Correspondence:
    """Every step-th row and column, u and v as means over squares of about step pixels that are all good."""
    if step == 1:
        return c
    side = 2 * (step // 2) + 1
    whole = scipy.ndimage.minimum_filter(c.good, side)

    def mean(values: NDArray[Any]) -> NDArray[Any]:
        means = scipy.ndimage.uniform_filter(np.where(c.good, values, 0.0), side)
        return np.ascontiguousarray(np.where(whole, means, values)[::step, ::step])

    sigma_u, sigma_v = (np.where(whole, s / side, s)[::step, ::step].copy() for s in (c.sigma_u, c.sigma_v))
    return Correspondence(mean(c.u), mean(c.v), sigma_u, sigma_v, c.flags[::step, ::step].copy())


def _anchors(anchor: Anchors, step: int) -> Anchors:
    if isinstance(anchor, PixelAnchor | DistanceAnchor):
        return replace(anchor, row=anchor.row / step, col=anchor.col / step)
    if isinstance(anchor, Sequence) and not isinstance(anchor, str):
        return [_anchors(part, step) for part in anchor]  # type: ignore[arg-type, misc]
    return anchor


def _at_edge(anchor: Anchors) -> bool:
    """Whether the anchor is the mirror's edge or its middle at rest, which a sag moves."""
    named = isinstance(anchor, str) and anchor in ("edge", "middle")
    return anchor is None or named or isinstance(anchor, EdgeAnchor)
