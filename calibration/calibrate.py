"""calibrate(): captures of simple targets -> a scene with covariance, and notices."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from typing import Any

import numpy as np

from optolever import schema
from optolever.arrays import Floats
from optolever.blocks import blas_on_one
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.scene import Covariance, RestForm, Scene, parameter_changes, parameter_values

from .adjust import Adjustment, Problem, adjust, among, step_of
from .error_budget import error_sources
from .initial_pose import open_air_start
from .observability import MOST_CHI, Direction, beyond_priors, directions, notices
from .observation import Observation, Sample, against_rest, checked, frame_of, sampled
from .predicted import Effects, effects
from .priors import GAUGE, is_pose, resolved
from .targets import Ball, Flat, Plate, Rest

__all__ = ["Calibration", "calibrate", "left_out"]


_STARTS = 24  # one start in 4 to one in 12 led to a second minimum: one such minimum in 8 is missed
_COSTLIER = 25.0  # five sigma: the difference D of two sums of squares is known to 2 sqrt(D)
_START_PIXELS = 200  # pixels of a capture in the search for starts
_START_EVALUATIONS = 100  # of 144 starts of 18 rigs, converged ones took 56 at most; others wander
_ALIKE = 0.1  # difference of two sums of squares below which two minima are one
_ROUNDING = 1e-9  # rounding error of derivatives by differences
_BLOCKS = 6  # blocks of the image along rows and columns: a static field varies over such lengths
_REWEIGHTED = 6  # iterations of the weighting at most
_NO_BALL = 5.0  # chi of a ball's capture and sigmas of its radius, above which the target is no ball


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """scene: adjusted, with its covariance; adjustment: the solution of the bundle adjustment; start: the
    scene at the start; guessed: that scene was the given one (else `open_air_start` found it); directions:
    weakest first; by (q, p): derivatives of the covariance's parameters by the unknowns."""

    scene: Scene
    adjustment: Adjustment
    observations: tuple[Observation, ...]
    start: Scene
    guessed: bool
    directions: tuple[Direction, ...]
    by: Floats

    @cached_property
    def effects(self) -> Effects:
        """Derivatives of heights and of a depth by the unknowns."""
        return effects(self.scene, self.by)

    @cached_property
    def notices(self) -> tuple[Notice, ...]:
        """Warnings, and a list of errors that enter the heights one to one."""
        return notices(self.adjustment, self.directions, self.effects, self.observations)

    @property
    def implausible(self) -> list[Notice]:
        """Parameters that ended more than 5 prior sigma from their typed values, farthest first. Any of them
        is a sign of a wrong scene."""
        return beyond_priors(self.adjustment)

    def __repr__(self) -> str:
        solved = self.adjustment
        start = "a preset" if self.guessed else "no guess"
        lines = [
            f"Calibration of {self.scene.name}: {len(solved.values)} parameters, {len(solved.chis)} captures"
        ]
        lines.append(f"  chi {solved.chi:.4g}, from {start}, {solved.evaluations} evaluations")
        return "\n".join([*lines, f"  {len(self.implausible)} numbers beyond 5 prior sigma"])

    @property
    def parameters(self) -> list[dict[str, Any]]:
        """Per unknown: name, value, sigma, prior mean and sigma."""
        problem = self.adjustment.problem
        sigmas = np.sqrt(np.diag(self.adjustment.covariance))
        return [
            {
                "name": name,
                "value": float(value),
                "sigma": float(sigma),
                "prior": float(problem.means.get(name, 0.0)),
                "prior_sigma": float(problem.sigmas[name]),
            }
            for name, value, sigma in zip(problem.names, self.adjustment.values, sigmas, strict=True)
        ]

    @property
    def residuals(self) -> dict[str, tuple[Floats, Floats, Floats, Floats]]:
        """Per capture: row, col (n,) of its sample, and predicted less measured u and v (n,), in sigma."""
        problem = self.adjustment.problem
        named = zip(problem.samples, problem.data(self.adjustment.values), strict=False)
        return {s.name: (s.row, s.col, rows[: len(s.row)], rows[len(s.row) :]) for s, rows in named}

    @property
    def decoded(self) -> dict[str, float]:
        """Per capture: share of the image that is decoded (and in its mask)."""
        return {each.name: float(each.usable.mean()) for each in self.observations}

    @property
    def tilts(self) -> dict[str, float]:
        """Per flat or plate: its tilt relative to the plane z = 0, degrees."""
        values = self.adjustment.problem.named(self.adjustment.values)
        posed = [each.name for each in self.observations if isinstance(each.target, Flat | Plate)]
        slopes = {n: [values.get(f"{n}.{key}", 0.0) for key in ("tilt_x", "tilt_y")] for n in posed}
        return {name: math.degrees(math.atan(math.hypot(*slope))) for name, slope in slopes.items()}

    def to_dict(self) -> dict[str, Any]:
        """As plain types."""
        return {
            "chi": self.adjustment.chi,
            "captures": self.adjustment.chis,
            "decoded": self.decoded,
            "tilts_deg": self.tilts,
            "evaluations": self.adjustment.evaluations,
            "start": "preset" if self.guessed else "without a guess",
            "parameters": self.parameters,
            "directions": [
                {"singular": each.singular, "parts": dict(each.parts)} for each in self.directions
            ],
            "notices": [str(notice) for notice in self.notices],
        }


@schema.checked(scene=Scene, observations=[Observation])
@blas_on_one()
def calibrate(
    scene: Scene,
    observations: Sequence[Observation],
    priors: Mapping[str, float] | None = None,
    *,
    guess: bool = False,
) -> Calibration:
    """The scene that explains the captures, with its covariance.

    priors: name -> standard deviation (inf: free, 0: fixed) in place of `default_priors`; their means are the
    scene's values. guess: start from the given scene even where
    captures in open air yield a start. InputError names the wrong capture or prior.
    """
    scene = replace(scene, covariance=None, rest_form=None)
    observations = checked(observations, (scene.camera.rows, scene.camera.cols))
    frame = frame_of(observations)
    samples = sorted(map(sampled, observations), key=lambda sample: sample.name != frame)
    samples = against_rest(samples, next(each for each in observations if each.name == frame))
    sigmas = resolved(scene, priors)
    means = {name: value for name, value in parameter_values(scene).items() if name in sigmas}
    told = any(is_pose(name) and math.isfinite(sigma) and sigma > 0 for name, sigma in (priors or {}).items())
    found = None if guess or told else _without_guess(scene, samples, sigmas)
    for sample in samples:
        sigmas |= sample.target.unknowns(sample.name, sample.name == frame)
    problem = Problem(scene, samples, sigmas, means, frame)
    if found is not None:
        base, first = found
        problem = replace(problem, scene=base)
        result = adjust(problem, _roughly(problem, first))
    if found is None or result.chi > _NO_BALL:  # a bad start: the given scene may be better
        other = _least(replace(problem, scene=scene), means)
        if found is None or other.chi < result.chi:
            found, result = None, other
    result = _rest_by_misfit(result)
    _require_balls(result)
    return _judged(result, observations, found is None)


def left_out(calibration: Calibration, name: str) -> float:
    """Leave-one-out chi of a capture: the root of the increase that it causes in the minimal sum of squares,
    per degree of freedom. The uncertainty of the rig by the other captures is thus included. NaN for the
    capture that defines the frame."""
    whole = calibration.adjustment.problem
    others = [sample for sample in whole.samples if sample.name != name]
    if name == whole.frame or not others:
        return math.nan
    own = {key for key in whole.sigmas if key.startswith(f"{name}.")}
    sigmas = {key: value for key, value in whole.sigmas.items() if key not in own}
    first = whole.named(calibration.adjustment.values)
    without = adjust(replace(whole, samples=others, sigmas=sigmas), first)
    (sample,) = (sample for sample in whole.samples if sample.name == name)
    added = calibration.adjustment.cost - without.cost
    return math.sqrt(max(0.0, added) / (2 * len(sample.row) - len(own)))


def _without_guess(
    scene: Scene, samples: Sequence[Sample], sigmas: Mapping[str, float]
) -> tuple[Scene, dict[str, float]] | None:
    """A start from flats in open air: scene and first values of the unknowns."""
    views = [s.thinned(_START_PIXELS) for s in samples if isinstance(s.target, Flat)]
    if len(views) != len(samples) or scene.medium is not None:
        return None
    found = open_air_start(scene, views)
    if found is None:
        return None
    base, poses = found
    values = {name: value for name, value in parameter_values(base).items() if name in sigmas}
    return base, values | dict(poses)


def _least(problem: Problem, mean: dict[str, float]) -> Adjustment:
    """The lowest minimum of all captures, from every minimum of the rest capture alone. For flats there is
    one start, the priors' mean: their poses are free."""
    (frame,) = (sample for sample in problem.samples if sample.name == problem.frame)
    starts = _rest_minima(_thinned(problem), mean) if isinstance(frame.target, Rest) else [mean]

    def joined(first: dict[str, float]) -> Adjustment:
        return adjust(problem, _roughly(problem, _first_poses(problem, first)))

    found = _minima(joined, starts)
    return among(min(found, key=lambda each: each.cost), found)


def _minima(
    solve: Callable[[dict[str, float]], Adjustment], starts: Sequence[dict[str, float]]
) -> list[Adjustment]:
    """The minima from these starts without duplicates. A start that leads to no scene is dropped; InputError
    of the first one if all do."""
    found: list[Adjustment] = []
    failed: list[InputError] = []
    for first in starts:
        try:
            each = solve(first)
        except InputError as error:
            failed.append(error)
            continue
        if all(abs(each.cost - other.cost) > _ALIKE for other in found):
            found.append(each)
    if not found:
        raise failed[0]
    return found


def _rest_by_misfit(found: Adjustment) -> Adjustment:
    """The adjustment with the rest capture weighted by its misfit, if other captures are compared with it: a
    static field (schlieren, glass) cancels in the comparisons, and the rig must not fit it."""
    problem = found.problem
    if not any(sample.reference for sample in problem.samples):
        return found
    for _ in range(_REWEIGHTED):
        (sample,) = (each for each in problem.samples if each.name == problem.frame)
        rows = dict(zip((s.name for s in problem.samples), problem.data(found.values), strict=False))
        factor = _misfit(sample, sample.inflation * rows[sample.name])
        if factor < MOST_CHI * sample.inflation:
            break
        wider = [s.inflated(factor) if s is sample else s for s in problem.samples]
        problem = replace(problem, samples=wider)
        found = adjust(problem, found.problem.named(found.values))
    return found


def _misfit(sample: Sample, rows: Floats) -> float:
    """Inflation factor of a sample's sigma by its residuals (2 n,) in sigma of the noise: their rms, or the
    rms of block means times the root of the pixels per block, whichever is larger; 1 up to a chi of MOST_CHI.
    """
    places = [np.floor(_BLOCKS * (p - p.min()) / (np.ptp(p) + 1)) for p in (sample.row, sample.col)]
    block = (_BLOCKS * places[0] + places[1]).astype(np.intp)
    counts = np.bincount(block)
    sums = [np.bincount(block, part) for part in np.split(rows, 2)]
    used = counts > 0
    common = np.mean([(each[used] ** 2 / counts[used]).mean() for each in sums])
    square = float(np.mean(rows**2))
    return math.sqrt(max(square, float(common))) if square > MOST_CHI**2 else 1.0


def _rest_minima(problem: Problem, mean: dict[str, float]) -> list[dict[str, float]]:
    """Minima of the rest capture alone, from the priors' mean and from random draws of the priors, without
    duplicates; draws that do not converge, and minima whose cost exceeds the lowest by more than five sigma
    of noise, are dropped."""
    (frame,) = (sample for sample in problem.samples if sample.name == problem.frame)
    drawn = sorted(set(parameter_values(problem.scene)) & set(problem.sigmas))
    own = {*drawn, *frame.target.unknowns(problem.frame, True)}
    alone = replace(
        problem, samples=[frame], sigmas={key: problem.sigmas[key] for key in problem.sigmas if key in own}
    )
    rng = np.random.default_rng(0)
    starts = [mean]
    for _ in range(_STARTS - 1 if drawn else 0):
        scatter = dict(zip(drawn, rng.standard_normal(len(drawn)), strict=True))
        starts.append(mean | {key: mean.get(key, 0.0) + problem.sigmas[key] * scatter[key] for key in drawn})
    found = _minima(lambda first: adjust(alone, first, True, _START_EVALUATIONS), starts)
    found = [found[0], *(each for each in found[1:] if each.evaluations < _START_EVALUATIONS)]
    least = min(each.cost for each in found)
    return [mean | each.problem.named(each.values) for each in found if each.cost < least + _COSTLIER]


def _thinned(problem: Problem) -> Problem:
    return replace(problem, samples=[sample.thinned(_START_PIXELS) for sample in problem.samples])


def _roughly(problem: Problem, first: Mapping[str, float]) -> dict[str, float]:
    """The minimum of the thinned captures."""
    found = adjust(_thinned(problem), first, rough=True)
    return found.problem.named(found.values)


def _first_poses(problem: Problem, values: dict[str, float]) -> dict[str, float]:
    """Start values with those of the balls: below the centroid of its pixels; depth d by the contact radius,
    a^2 = R d."""
    camera, mirror = problem.scene_at(problem.vector(values)).camera, problem.scene.mirror
    found = dict(values)
    for sample in problem.samples:
        if isinstance(sample.target, Ball):
            o, d = camera.rays_at(sample.row, sample.col)
            foot = (o - (o[:, 2] / d[:, 2])[:, None] * d)[:, :2]
            x, y = foot.mean(axis=0) - 0.5 * np.array([mirror.length, mirror.width])
            depth = (0.5 * np.ptp(foot[:, 1])) ** 2 / sample.target.radius
            own = {"x": x, "y": y, "depth": depth}
            found |= {f"{sample.name}.{key}": float(value) for key, value in own.items()}
    return found


def _require_balls(result: Adjustment) -> None:
    for sample in result.problem.samples:
        if not isinstance(sample.target, Ball):
            continue
        chi, name = result.chis[sample.name], f"{sample.name}.radius"
        off = abs(result.problem.named(result.values)[name]) / sample.target.sigma
        if max(chi, off) > _NO_BALL and chi > 2 * result.chis[result.problem.frame]:
            raise InputError(
                f"capture {sample.name!r}: chi {chi:.3g}, radius off by {off:.3g} sigma, limit {_NO_BALL:g}: "
                f"no ball of radius {sample.target.radius:g} mm, or a mask that holds more than the contact"
            )


def _judged(result: Adjustment, observations: Sequence[Observation], guessed: bool) -> Calibration:
    base = result.problem.scene
    names = [name for name in result.problem.names if name in parameter_values(base)]
    found = directions(result, names)
    scene = result.problem.scene_at(result.values)
    numbers, by = _carried(result, scene, names)
    form = _rest_form(result)
    if form is not None:
        own = np.array([[key == f"rest.{name}" for key in result.problem.names] for name in form.values])
        numbers, by = (*numbers, *(f"rest.{name}" for name in form.values)), np.vstack([by, own])
    sources, parts = error_sources(result)
    matrix, parts = (by @ part @ by.T for part in (result.covariance, parts))
    day = date.today().isoformat()
    covariance = Covariance(numbers, matrix, result.chi, GAUGE, sources, parts, day)
    return Calibration(
        replace(scene, covariance=covariance, rest_form=form),
        result,
        tuple(observations),
        base,
        guessed,
        tuple(found),
        by,
    )


def _rest_form(result: Adjustment) -> RestForm | None:
    """The form of the mirror at rest, None without a rest capture."""
    values = result.problem.named(result.values)
    found = [value for name, value in values.items() if name.startswith("rest.L")]
    return RestForm(np.array(found)) if found else None


def _carried(result: Adjustment, scene: Scene, names: Sequence[str]) -> tuple[tuple[str, ...], Floats]:
    """Names (q,) of the adjusted scene's parameters, and their derivatives (q, p) by the unknowns.

    The unknowns are changes of the start scene's poses, along the axes of its parts. The adjustment rotates
    these axes. Without the derivatives, a parameter known to 30 um mixes with one known to 0.4 um.
    """
    known, problem = parameter_values(scene), result.problem
    by = np.zeros((len(known), len(result.values)))
    for name in names:
        k, step = problem.names.index(name), 1e3 * step_of(name)
        move = step * (np.arange(len(result.values)) == k)
        ends = (problem.scene_at(result.values + sign * move) for sign in (1, -1))
        ahead, behind = (np.array(list(parameter_changes(scene, end).values())) for end in ends)
        by[:, k] = (ahead - behind) / (2 * step)
    some = np.abs(by).max(axis=1, initial=0.0) > _ROUNDING
    return tuple(name for name, moves in zip(known, some, strict=True) if moves), by[some]
