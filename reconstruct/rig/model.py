"""Modes of a height map by the errors of its rig, and whether these explain slopes that contradict each
other.

A rig has m independent errors a of unit variance: the rows of a root of its covariance, a sag of the mirror
at rest, the thickness of a cover glass, motion between two captures. `RigModel.solved(a)` is the solution
that the solver would find if the rig had these errors, by chord steps; M_j = dz/da_j is the solution for a
change of the slopes, of all modes at once. Modes are smooth: the model lies on a coarse grid of pixels, each
the mean over its surroundings. Anchors are looked for once: another rig sees the plane there, by the
solution's normal, at another distance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import RestForm, Scene, adjusted, parameter_values, rig_covariance, strided

from ..geometry import flat_mirror, pattern_plane, rest_height, traced_rays
from ..heightmap import HeightFlag, HeightMap, Modes, coarse_step, filled
from ..judgement.circulation import circulations
from ..measured import Measured
from ..problem import Problem, first_solution
from ..solver.anchors import Anchors, PixelAnchor
from ..solver.newton import State, chord_step, linear_changes
from ..solver.poisson import Accuracy
from .calibration import gauge_displacement, glass_shift, rest_corrected
from .since_rest import motion_shifts

__all__ = [
    "LIKELY", "LINEAR", "Measurement", "RigJudgement", "RigModel", "RigModes", "judged_rig",
    "rig_model", "rig_modes",
]  # fmt: skip

_UNSETTLED = np.uint16(HeightFlag.NOT_CONVERGED | HeightFlag.SINGULAR)
_STEP = 1e-5  # of a standard deviation: against rest, changes cancel to a thousandth
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
_SAG = ("rest.L20", "rest.L11", "rest.L02")


class Measurement(NamedTuple):
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

    def common_u(self, centroid: float) -> float:
        """Standard deviation of an error of all u, at least that of a cell's centroid; of captures against
        rest, which see the same cells, only what one of them has alone."""
        own = self.correspondence.common_u
        if self.rest is None:
            return max(own, centroid)
        return 0.0 if own == self.rest.common_u else max(own, self.rest.common_u)

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
    errors: of the rig, rms in standard deviations; likely: whether its covariance allows them; raw: chi2
    before, on the coarse grid."""

    chi2: float
    freedom: int
    errors: float
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
    """A measurement with other errors of the rig, how it was solved, and its scene on the coarse grid."""

    data: Measured
    state: State
    scene: Scene


class _Held(NamedTuple):
    """Places of the anchors in the image, (M,) each, the known points there (mm) and the planes' normals
    (M, 3), and whether these are of the mirror at rest (M,)."""

    row: Floats
    col: Floats
    points: Floats
    normals: Floats
    rest: Mask


@dataclass(frozen=True, slots=True)
class RigModel:
    """A solved measurement as a function of the errors of its rig, on every step-th pixel.

    scene: of that grid; numbers: its own, by name; root (r0, p): rows of the covariance's root, of those in
    `names`; shifts (k, 2, rows, cols): changes of u and v in the image; all of one standard deviation, the
    errors in this order. rest_mirror (2, rows, cols): u and v of the flat mirror where a rest capture is
    compared with it. sources (s,): of the errors, in words; shares (s, m, m): the part of each source in
    their covariance, which is 1.
    motions: how many of the last errors are of motion.
    """

    problem: Problem
    state: State
    scene: Scene
    step: int
    held: _Held
    rest_mirror: Floats | None
    numbers: dict[str, float]
    names: tuple[str, ...]
    root: Floats
    shifts: Floats
    sources: tuple[str, ...]
    shares: Floats
    motions: int

    @property
    def count(self) -> int:
        """How many errors there are."""
        return len(self.root) + len(self.shifts)

    def changed(self, errors: Floats) -> list[RigSolution]:
        """The measurements with these errors (n, m), unsolved: the model's state with the anchors moved."""
        problem, data, numbers = self.problem, self.problem.data, len(self.root)
        changes, shifts = errors[:, :numbers] @ self.root, np.tensordot(errors[:, numbers:], self.shifts, 1)
        values = [{k: self.numbers[k] + x for k, x in zip(self.names, one, strict=True)} for one in changes]
        scenes = [adjusted(self.scene, one, self.numbers) for one in values]
        camera = self.scene.camera
        rays = [problem.rays if one.camera is camera else traced_rays(one.camera) for one in scenes]
        if self.rest_mirror is not None:  # the rest capture is compared with what a rig predicts of it
            flat = [flat_mirror(*pair) for pair in zip(scenes, rays, strict=True)]
            shifts = shifts + np.nan_to_num(np.stack(flat) - self.rest_mirror)
        windows = [
            data.rays if scene.camera is camera else problem.rays_on_grid(one)
            for scene, one in zip(scenes, rays, strict=True)
        ]
        own = self.scene.pattern
        planes = [data.plane if one.pattern is own else pattern_plane(one) for one in scenes]
        known = data.unknown(np.stack(self._distances(scenes)))
        found = []
        for scene, window, plane, (u, v), at in zip(
            scenes, windows, planes, problem.to_grid(shifts), known, strict=True
        ):
            moved = replace(
                data, rays=window, plane=plane, shape=scene.pattern.shape, u=data.u + u, v=data.v + v
            )
            state = replace(self.state, rows=self.state.rows._replace(known=at))
            found.append(RigSolution(moved, state, scene))
        return found

    def solved(self, errors: Floats, start: State) -> RigSolution:
        """The measurement with these errors (m,), and its solution by chord steps from a state."""
        ((data, own, scene),) = self.changed(errors[None])
        state = replace(start, rows=own.rows)
        for _ in range(_CHORDS):
            state = chord_step(data, self.problem.labels, state, _ACCURACY, self.state.share)
        return RigSolution(data, state, scene)

    def _distances(self, scenes: list[Scene]) -> list[Floats]:
        """Of the anchors along the rays of every scene, (M,) mm."""
        row, col, points, normals, rest = self.held
        camera, own, (x, y) = self.scene.camera, self.scene.rest_form, points[:, :2].T
        still = camera.rays_at(row, col)
        rays = [still if one.camera is camera else one.camera.rays_at(row, col) for one in scenes]
        before = rest_height(x, y, self.scene)
        rises = [0.0 * x if one.rest_form is own else rest_height(x, y, one) - before for one in scenes]
        known = [points + np.multiply.outer(rest * rise, [0.0, 0.0, 1.0]) for rise in rises]
        return [
            np.asarray(((at - start) * normals).sum(axis=1) / (ahead * normals).sum(axis=1))
            for at, (start, ahead) in zip(known, rays, strict=True)
        ]

    def solutions(self) -> list[RigSolution]:
        """The solution without errors, and those with one error each, by derivatives."""
        data, w = self.problem.data, self.state.w
        own, *others = self.changed(_STEP * np.eye(self.count + 1, self.count, -1))
        p, q = data.slopes(w)[:2]
        moved = [one.data.slopes(w)[:2] for one in others]
        slopes = np.stack([one[0] for one in moved]) - p, np.stack([one[1] for one in moved]) - q
        known = np.stack([one.state.rows.known for one in others]) - own.state.rows.known
        changes = linear_changes(data, self.problem.labels, self.state, slopes, known, _CHORDS)
        return [own] + [
            one._replace(state=replace(one.state, w=w + by)) for one, by in zip(others, changes, strict=True)
        ]

    def points(self, solutions: Sequence[RigSolution]) -> Floats:
        """Mirror points (n, 3, rows, cols) in mm, z less the form at rest of a map against rest; NaN where
        unsolved."""
        w = np.stack([state.w for _, state, _ in solutions])
        t = np.where(self.problem.labels > 0, self.problem.data.distance(w), np.nan)
        found = np.stack([one.rays.inner_directions for one, _, _ in solutions]) * t[:, None]
        found += np.stack([one.rays.inner_origins for one, _, _ in solutions])
        if self.rest_mirror is not None:
            for (x, y, z), (_, _, scene) in zip(found, solutions, strict=True):
                if scene.rest_form is not self.scene.rest_form:  # which is plane
                    z -= rest_height(x, y, scene)
        return self.problem.to_image(found, np.nan)

    def circulations(self, solution: RigSolution) -> "_Circulations":
        """Of a solution, over the noise of the one without errors."""
        p, q, _, _ = solution.data.slopes(solution.state.w)
        variance = self.state.variances[0] + self.state.variances[1]
        found = [each for each in circulations(solution.data.mask, (p, q), variance) if each[1].size]
        shares = np.array([1 / (2 * block) ** 2 / len(found) for block, _ in found])
        sizes = np.array([score.size for _, score in found], np.intp)
        scores = np.concatenate([np.zeros(0), *(score for _, score in found)])
        return _Circulations(np.sqrt(np.repeat(shares, sizes)) * scores, shares * sizes, sizes)


class _Circulations(NamedTuple):
    """scores (n,): circulations over their sigma of blocks of all sizes, each times the root of its share of
    independent ones; how many are independent, and how many there are, of every size."""

    scores: Floats
    independent: Floats
    sizes: NDArray[np.intp]

    def worst(self, scores: Floats) -> float:
        """The largest mean square of one size."""
        sums = np.bincount(np.repeat(np.arange(self.sizes.size), self.sizes), scores**2)
        return float(np.max(sums / self.independent))


def rig_model(
    measured: Measurement, scene: Scene, height: HeightMap | None = None, unsettled: Mask | None = None
) -> RigModel | None:
    """The model on a coarse grid, of the pixels that a height map settled; None where there are no errors.

    unsettled (H, W): pixels that the last steps still moved, if within their sigma: right before the pattern
    no linear change holds there. Where the coarse grid has no solution (small images, ragged masks), all
    pixels are taken.
    """
    if height is not None:
        settled = np.isfinite(height.z) & ((height.flags & _UNSETTLED) == 0)
        settled &= True if unsettled is None else ~unsettled
        if settled.any():
            measured = measured._replace(mask=settled if measured.mask is None else settled & measured.mask)
    step = coarse_step(measured.correspondence.u.shape)
    try:
        return _model(measured, scene, step)
    except InputError:
        if step == 1:
            raise
        return _model(measured, scene, 1)


def _model(measured: Measurement, scene: Scene, step: int) -> RigModel | None:
    coarse, typed = measured.coarse(step), scene.accuracy if scene.covariance is None else None
    scene, at_rest = strided(scene, step), measured.rest is not None
    problem, state = first_solution(coarse.corrected(scene), scene, coarse.anchor, coarse.mask)
    known = rig_covariance(scene)
    root = np.zeros((0, 0)) if known is None else known.root
    names = () if known is None else known.names
    sources = () if known is None else known.sources or ("numbers of the rig",)
    shares = np.eye(len(root))[None] if known is None or known.shares is None else known.shares
    others: list[tuple[str, int]] = []
    shifts = np.zeros((0, 2, *problem.valid.shape))
    centroid = measured.common_u(0.0 if typed is None else typed.centroid)
    if typed is not None:
        if typed.sag > 0 and (at_rest or problem.samples.rest.any()):
            form = RestForm(np.zeros(len(_SAG))) if scene.rest_form is None else scene.rest_form
            scene, names = replace(scene, rest_form=form), (*names, *_SAG)
            sag = typed.sag / np.sqrt(len(_SAG)) * np.eye(len(_SAG))
            root, others = scipy.linalg.block_diag(root, sag), [(SAG, len(_SAG))]
        glass = typed.glass * glass_shift(scene, problem, state.w, at_rest)
        shifts, others = glass[None], [*others, (GLASS, 1)]
    if centroid > 0:
        stripes = np.broadcast_to([[[[centroid]], [[0.0]]]], (1, *shifts.shape[1:]))
        shifts, others = np.concatenate([shifts, stripes]), [*others, (CENTROID, 1)]
    flat = flat_mirror(scene) if at_rest else None
    if flat is not None:
        moved = motion_shifts(coarse.correspondence, scene, flat, step)
        shifts, others = np.concatenate([shifts, moved]), [*others, (MOTION, len(moved))]
    extra = np.repeat(np.arange(len(others)), [size for _, size in others])
    shares = np.pad(shares[: len(sources)], ((0, 0), (0, extra.size), (0, extra.size)))
    alone = [
        np.diag(np.append(np.zeros(shares.shape[1] - extra.size), extra == k)) for k in range(len(others))
    ]
    model = RigModel(
        problem,
        state,
        scene,
        step,
        _held(problem, state, scene),
        flat,
        parameter_values(scene),
        names,
        root,
        shifts,
        (*sources, *(name for name, _ in others)),
        np.concatenate([shares, np.reshape(alone, (-1, *shares.shape[1:]))]),
        motions=others[-1][1] if at_rest else 0,
    )
    return model if model.count else None


def _held(problem: Problem, state: State, scene: Scene) -> _Held:
    """The anchors of a solution; scene: of its grid."""
    samples, kept = problem.samples, state.rows.sample
    down, along = samples.row, samples.col
    row, col = down[kept] + problem.rows.start, along[kept] + problem.cols.start
    distance, normal = samples.distance[kept], samples.normal[kept]
    origins, directions = scene.camera.rays_at(row, col)
    ahead, ray = (
        part.reshape(3, -1)[:, state.rows.pixel].T
        for part in (problem.data.to_pattern(state.w), problem.data.rays.inner_directions)
    )
    bisector = ahead / np.linalg.norm(ahead, axis=1)[:, None] - ray
    normals = np.where(np.isnan(normal), bisector, normal)
    return _Held(row, col, origins + distance[:, None] * directions, normals, samples.rest[kept])


def rig_modes(model: RigModel, solutions: Sequence[RigSolution]) -> RigModes:
    """The modes of a height map."""
    own, *others = model.points(solutions)
    moved = (np.stack(others) - own) / _STEP
    return RigModes(
        filled(moved[:, 2]),
        model.step,
        np.concatenate([_affine(own, moved[:, :2]), gauge_displacement(model.scene)]),
        model.sources,
        model.shares,
        model.motions,
    )


def judged_rig(model: RigModel, solutions: Sequence[RigSolution], raw: float, freedom: int) -> RigJudgement:
    """Whether errors of the rig explain that the slopes contradict each other.

    Minimises trust |c(a)|^2 + |a|^2 over the errors a, c the circulations of the coarse grid; trust < 1 where
    the errors are so large that derivatives describe them to a tenth. raw, freedom: chi2 of all pixels (see
    `circulation_chi2`); it shrinks as the coarse grid's. Circulations no larger than those by the rig's
    errors of one standard deviation are likely, whatever made them: the height stays within its total sigma.
    """
    blocks, solution = model.circulations(solutions[0]), solutions[0]
    first = blocks.scores
    if not first.any():
        return RigJudgement(raw, freedom, 0.0, True, raw)
    slopes = np.stack([(model.circulations(each).scores - first) / _STEP for each in solutions[1:]], axis=1)
    before = blocks.worst(first)
    allowed = before <= blocks.worst(np.sqrt(np.square(slopes).sum(axis=1)))
    trust = 1.0 if before < LINEAR else _TENTH / before
    errors, scores, reach = np.zeros(model.count), first, 1.0
    for _ in range(_FITS):
        normal = trust * slopes.T @ slopes + np.eye(model.count)
        moved = errors - reach * np.linalg.solve(normal, trust * slopes.T @ scores + errors)
        try:
            tried = model.solved(moved, solution.state)
            found = model.circulations(tried).scores
        except InputError:  # no rig has these numbers
            reach *= _SHORTER
            continue
        if trust * found @ found + moved @ moved < trust * scores @ scores + errors @ errors:
            errors, scores, solution = moved, found, tried
        else:
            reach *= _SHORTER
    left = blocks.worst(scores)
    square = float(errors @ errors) / model.count
    likely, size = square <= LIKELY, math.sqrt(square)
    if trust < 1.0:
        return RigJudgement(
            trust * left, freedom, size, allowed or (likely and trust * left <= LIKELY), before
        )
    return RigJudgement(raw * left / before, freedom, size, allowed or likely, before)


def _affine(points: Floats, moved: Floats) -> Floats:
    """(m, 2, 3): the fields moved (m, 2, rows, cols) as affine functions of x and y."""
    known = np.isfinite(points).all(axis=0) & np.isfinite(moved).all(axis=(0, 1))
    terms = np.stack([np.ones(np.count_nonzero(known)), points[0][known], points[1][known]], axis=1)
    fields = moved[:, :, known].reshape(-1, len(terms)).T
    found: Floats = (np.linalg.pinv(terms) @ fields).T.reshape(-1, 2, 3)
    return found


def _coarse(c: Correspondence, step: int) -> Correspondence:
    """Every step-th row and column, u and v as means over squares of about step pixels that are all good."""
    if step == 1:
        return c
    side = 2 * (step // 2) + 1
    whole = cv2.erode(c.good.astype(np.uint8), np.ones((side, side), np.uint8))[::step, ::step] > 0

    def mean(values: NDArray[np.floating]) -> Floats:
        known = np.where(c.good, values, 0.0).astype(np.float64)
        means = cv2.blur(known, (side, side), borderType=cv2.BORDER_REFLECT)[::step, ::step]
        return np.where(whole, means, values[::step, ::step])

    sigma_u, sigma_v = (
        np.where(whole, s / side, s) for s in (c.sigma_u[::step, ::step], c.sigma_v[::step, ::step])
    )
    flags = c.flags[::step, ::step].copy()
    return Correspondence(mean(c.u), mean(c.v), sigma_u, sigma_v, flags, common_u=c.common_u)


def _anchors(anchor: Anchors, step: int) -> Anchors:
    if isinstance(anchor, PixelAnchor):
        return replace(anchor, row=anchor.row / step, col=anchor.col / step)
    if isinstance(anchor, Sequence) and not isinstance(anchor, str):
        return [_anchors(part, step) for part in anchor]  # type: ignore[arg-type, misc]
    return anchor
