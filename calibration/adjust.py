"""The bundle adjustment: all captures, all unknowns, one least-squares problem.

Residuals (model - (u, v))/sigma on every capture's sample, and one row (value - mean)/sigma for every prior;
dense, by `scipy.optimize.least_squares`. Covariance C = max(1, chi)^2 (J^T J)^-1, plus the scatter of
other plausible minima (`among`). Rays are reflected at a target of known form: first intersection with
z = h(x, y) by Newton's method, no edges; checked against `scene.trace`, which brackets it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.scene import Scene, adjusted, parameter_values, shifted

from .observation import Sample
from .targets import Shape

__all__ = ["Adjustment", "Problem", "adjust", "among", "covariance_of", "step_of"]

_STEPS = 12
_SETTLED = 1e-11  # mm
_LOST = 1e4  # residual of a pixel whose ray misses the pattern
_LARGEST = 1e8  # residual
# Steps of forward differences: the root of the rounding error. Larger steps err by the curvature, which
# exceeds the slope along a weak direction. Covariances by these are right to 2e-4, by central ones to 1e-7.
_TINY = {"k1": 1e-7, "k2": 1e-6, "k3": 1e-5, "p1": 1e-8, "p2": 1e-8, "index": 1e-8, "pitch": 1e-10}
_TINY |= {"pitch_u": 1e-10, "pitch_v": 1e-10, "f": 1e-4, "cx": 1e-5, "cy": 1e-5, "rx": 1e-8, "ry": 1e-8}
_TINY |= {"rz": 1e-8, "tilt_x": 1e-8, "tilt_y": 1e-8}
_SMALL = 1e-6  # mm: of a length
_CENTRAL = 100.0  # steps of a central difference


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: unknowns (p,) with prior means and sigmas."""

    scene: Scene
    samples: Sequence[Sample]
    sigmas: Mapping[str, float]
    means: Mapping[str, float]
    frame: str = ""

    @property
    def count(self) -> int:
        """Number of residuals."""
        return sum(2 * len(sample.row) for sample in self.samples) + len(self.sigmas)

    @property
    def names(self) -> list[str]:
        """Names of the unknowns."""
        return list(self.sigmas)

    @cached_property
    def known(self) -> dict[str, float]:
        """Values of the scene's parameters."""
        return parameter_values(self.scene)

    @property
    def held(self) -> list[str]:
        """Parameters of the scene that are fixed."""
        return [name for name in self.known if name not in self.sigmas]

    @property
    def scale(self) -> Floats:
        """Prior standard deviations of the unknowns, (p,)."""
        return np.array(list(self.sigmas.values()))

    @property
    def prior(self) -> Floats:
        """Prior means of the unknowns, (p,)."""
        return np.array([self.means.get(name, 0.0) for name in self.names])

    def named(self, vector: Floats) -> dict[str, float]:
        """Values of the unknowns, by name."""
        return dict(zip(self.names, vector.tolist(), strict=True))

    def vector(self, values: Mapping[str, float]) -> Floats:
        """Values (p,) of the unknowns; a missing one has its prior's mean."""
        return np.array([values.get(name, mean) for name, mean in zip(self.names, self.prior, strict=True)])

    def scene_at(self, vector: Floats) -> Scene:
        """The scene with these parameter values."""
        return adjusted(self.scene, self._of_scene(self.named(vector)), self.known)

    def _of_scene(self, values: Mapping[str, float]) -> dict[str, float]:
        return {name: value for name, value in values.items() if name in self.known}

    def data(self, vector: Floats) -> list[Floats]:
        """Residuals (2 n,) of every sample."""
        values, scene = self.named(vector), self.scene_at(vector)
        rays = [self._reflected(s, values, rays_of(scene, s.row, s.col)) for s in self.samples]
        return [_rows(s, scene, each)[0] for s, each in zip(self.samples, rays, strict=True)]

    def residuals(self, vector: Floats) -> Floats:
        """All rows: samples, priors."""
        return np.concatenate([*self.data(vector), (vector - self.prior) / self.scale])

    def _own(self, s: Sample) -> set[str]:
        """Unknowns of the targets (not of the scene) that affect a sample's rows."""
        names = {*s.target.unknowns(s.name, s.name == self.frame)}
        return names if s.reference is None else names | {*s.reference.unknowns(self.frame, True)}

    @np.errstate(all="ignore")
    def _reflected(self, s: Sample, values: Mapping[str, float], rays: Floats) -> list[Floats]:
        """The sample's rays after its mirror, and after its reference, if it has one."""
        shapes = [s.target.shape(s.name, values, self.scene.mirror)]
        if s.reference is not None:
            shapes.append(s.reference.shape(self.frame, values, self.scene.mirror))
        return [reflected(rays, shape) for shape in shapes]

    def jacobian(self, vector: Floats) -> Floats:
        """Central differences."""
        return 0.5 * (self.forward(vector, _CENTRAL) + self.forward(vector, -_CENTRAL))

    def forward(self, vector: Floats, steps: float = 1.0) -> Floats:
        """Jacobian by one-sided differences of `steps` steps; a target's unknowns affect only its capture."""
        starts = np.cumsum([0, *(2 * len(sample.row) for sample in self.samples)])
        rows = np.zeros((self.count, len(vector)))
        scene, values, data = self.scene_at(vector), self.named(vector), self.count - len(vector)
        moves = [steps * step_of(name) + at - at for name, at in zip(self.names, vector, strict=True)]
        moved = [values | {name: values[name] + by} for name, by in zip(self.names, moves, strict=True)]
        scenes = {
            k: shifted(self.scene, self._of_scene(moved[k]), self.known)
            for k, name in enumerate(self.names)
            if name in self.known
        }
        turned = [k for k in scenes if not self.names[k].startswith("pattern.")]
        rows[data + np.arange(len(vector)), np.arange(len(vector))] = 1 / self.scale
        for i, s in enumerate(self.samples):
            n, own, part = s.row.size, self._own(s), rows[starts[i] : starts[i + 1]]
            rays = [rays_of(each, s.row, s.col) for each in (scene, *(scenes[k] for k in turned))]
            out = self._reflected(s, values, np.concatenate(rays, axis=2))
            here, *there = _rows(s, scene, out)
            part[:, turned] = np.transpose(there) - here[:, None]
            for k, name in enumerate(self.names):
                if name in own:
                    part[:, k] = _rows(s, scene, self._reflected(s, moved[k], rays[0]))[0] - here
                elif k in scenes and k not in turned:
                    part[:, k] = _rows(s, scenes[k], [one[..., :n] for one in out])[0] - here
        rows[:data] /= moves
        return rows


@dataclass(frozen=True, eq=False)
class Adjustment:
    """values (p,) at the minimum, jacobian there (data rows first, then one row per prior), chi of the data
    per degree of freedom, chis of every sample by its noise, evaluations; cost: sum of squares, priors
    included; apart (n, p): offsets to other minima, each times the root of its share of the posterior."""

    problem: Problem
    values: Floats
    jacobian: Floats
    chi: float
    chis: dict[str, float]
    evaluations: int
    cost: float
    apart: Floats

    @property
    def linear(self) -> Floats:
        """(p, p): max(1, chi)^2 (J^T J)^-1, by singular values of the scaled Jacobian."""
        return covariance_of(self.jacobian, self.problem.scale, self.chi)

    @property
    def covariance(self) -> Floats:
        """(p, p): `linear` plus the scatter of other minima."""
        return self.linear + self.apart.T @ self.apart


@np.errstate(all="ignore")
def _rows(s: Sample, scene: Scene, out: Sequence[Floats]) -> Floats:
    """Residuals (m, 2 n) of m times a sample's rays after its mirror, less those after its reference."""
    u, v, _ = scene.pattern.landing(*out[0])
    for rays in out[1:]:
        u0, v0, _ = scene.pattern.landing(*rays)
        u, v = u - u0, v - v0
    u, v = (part.reshape(-1, s.row.size) for part in (u, v))
    rows = np.hstack([(u - s.u) / s.sigma_u, (v - s.v) / s.sigma_v])
    rows = np.nan_to_num(rows, copy=False, nan=_LOST, posinf=_LOST, neginf=-_LOST)
    return np.clip(rows, -_LARGEST, _LARGEST)


def covariance_of(jacobian: Floats, scale: Floats, chi: float) -> Floats:
    """max(1, chi)^2 (J^T J)^-1 of unknowns with prior sigmas `scale` (p,)."""
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian * scale, mode="r"))
    inverse = (right.T / singular**2) @ right
    found: Floats = max(1.0, chi) ** 2 * inverse * np.outer(scale, scale)
    return 0.5 * (found + found.T)


def adjust(problem: Problem, start: Mapping[str, float], rough: bool = False, most: int = 200) -> Adjustment:
    """The minimum from a start (missing names: the prior's mean) in at most `most` evaluations. rough: stop
    where a step lowers the sum of squares by less than 1e-6 of it, with one-sided Jacobians at half the
    cost."""
    first = problem.vector(start)

    def residuals(vector: Floats) -> Floats:
        try:
            return problem.residuals(vector)
        except InputError:  # no scene has these parameters: reject the step
            return np.full(problem.count, _LARGEST)

    try:
        found = scipy.optimize.least_squares(
            residuals,
            first,
            problem.forward if rough else problem.jacobian,
            x_scale="jac",
            method="lm",  # QR; the singular values that trf takes of every step cost ten times that
            ftol=1e-6 if rough else 1e-10,
            xtol=1e-12,
            gtol=1e-12,
            max_nfev=most,
        )
    except InputError as error:
        raise InputError(
            f"the captures lead to a scene that cannot be ({error}); is every one the target that it is said "
            "to be?"
        ) from error
    data = problem.data(found.x)
    count = sum(rows.size for rows in data)
    chi = float(np.sqrt(sum((rows**2).sum() for rows in data) / max(1, count - len(first))))
    named = zip(problem.samples, data, strict=False)
    chis = {sample.name: sample.inflation * float(np.sqrt(np.mean(rows**2))) for sample, rows in named}
    return Adjustment(
        problem,
        found.x,
        found.jac,
        chi,
        chis,
        evaluations=int(found.nfev),
        cost=2 * float(found.cost),
        apart=np.zeros((0, len(first))),
    )


def among(found: Adjustment, minima: Sequence[Adjustment]) -> Adjustment:
    """The minimum with the scatter of all plausible minima. By Laplace's approximation the posterior weight
    of each is exp(-cost/2) / sqrt(det J^T J)."""
    scale = found.problem.scale
    spans = [np.linalg.slogdet(np.linalg.qr(each.jacobian * scale, mode="r"))[1] for each in minima]
    logs = np.array([-0.5 * each.cost / max(1.0, found.chi) ** 2 for each in minima]) - np.array(spans)
    share = np.exp(logs - logs.max())
    away = np.array([each.values - found.values for each in minima])
    rows = np.sqrt(share / share.sum())[:, None] * away
    return replace(found, apart=rows)


def step_of(name: str) -> float:
    """Step of finite differences by a parameter."""
    return _TINY.get(name.rpartition(".")[2], _SMALL)


def rays_of(scene: Scene, row: Floats, col: Floats) -> Floats:
    """Origins and directions (2, 3, n) of the rays of a scene's pixels."""
    return np.stack([part.T for part in scene.camera.rays_at(row, col)])


def reflected(rays: Floats, shape: Shape) -> Floats:
    """Points on the mirror, mm, and directions (2, 3, n) from there to the pattern."""
    o, d = rays
    t = -o[2] / d[2]
    for _ in range(_STEPS):
        x, y, z = o + t * d
        h, hx, hy = shape(x, y)
        fall = d[2] - hx * d[0] - hy * d[1]
        step = (z - h) / fall
        t = t - step
        if not (np.abs(step) >= _SETTLED).any():
            break
    twice = 2 * fall / (1 + hx * hx + hy * hy)
    return np.stack([o + t * d, [d[0] + twice * hx, d[1] + twice * hy, d[2] - twice]])
