"""Observability: which combinations of parameters the captures determine, and which the priors alone.

Singular values in prior units, the effect of a weak combination on the heights, notices of a calibration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from optolever.arrays import Floats
from optolever.notices import Notice

from .adjust import Adjustment
from .observation import Observation
from .predicted import Effects
from .priors import GAUGE, plausible
from .targets import Ball, Flat, Plate, Rest

__all__ = ["BEYOND", "MOST_CHI", "Direction", "beyond_priors", "directions", "lacking", "notices"]


BEYOND = 5.0  # prior sigma from the typed value: above, the adjustment is refused
_FAR = 3.0  # prior sigma from the typed value: above, the parameter is named
_WEAK = 3.0  # singular value in prior units: below, the prior contributes noticeably
_SHARE = 0.25  # of the variance of a height or a depth: below, a weak direction needs no notice
_TILT = math.radians(2.0)  # between mirrors: below, they are nearly one pose
MOST_CHI = 1.2  # of a capture: above, the model does not hold (docs/howto/calibrate.md)
_CONTACT = 300  # pixels
_MISFIT = (
    "sigma grows by as much; most likely the target is another one than you named, or it moved: calibrate "
    "--without NAME leaves it out"
)
_STATIC = (
    "most likely a cover glass, uneven air or a bent display; heights against a rest capture are free of it: "
    "reconstruct --rest"
)
_RARE = 1e-4  # false-alarm probability of the test of the priors
_PART = 0.3  # share of a direction's length above which a parameter is named


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """A combination of parameters. singular: prior sigma over the sigma by the captures alone; parts: the
    parameters with the largest shares; error (p,): one posterior sigma, in the unknowns' units."""

    singular: float
    parts: tuple[tuple[str, float], ...]
    error: Floats

    @property
    def names(self) -> str:
        """The parameters."""
        names = [name for name, _ in self.parts]
        return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} separately"


def directions(found: Adjustment, names: Sequence[str]) -> list[Direction]:
    """Singular directions of these parameters, weakest first; others are eliminated (projected out)."""
    problem = found.problem
    order = problem.names
    rows = (found.jacobian * problem.scale)[: -len(order)]
    chosen = [order.index(name) for name in names]
    rest = [k for k in range(len(order)) if k not in chosen]
    own, others = rows[:, chosen], np.vstack([rows[:, rest], np.eye(len(rest))])
    own = np.vstack([own, np.zeros((len(rest), len(chosen)))])
    triangle = np.asarray(np.linalg.qr(np.hstack([others, own]), mode="r"))
    own = triangle[len(rest) :, len(rest) :]
    _, singular, right = np.linalg.svd(own, full_matrices=False)
    result = []
    for size, vector in zip(singular[::-1], right[::-1], strict=True):
        big = np.argsort(-np.abs(vector))
        parts = tuple((names[k], float(vector[k])) for k in big if abs(vector[k]) >= _PART)
        error = np.zeros(len(order))
        error[chosen] = problem.scale[chosen] * vector * max(1.0, found.chi) / math.hypot(1.0, size)
        result.append(Direction(float(size), parts or ((names[big[0]], float(vector[big[0]])),), error))
    return result


def beyond_priors(found: Adjustment, limit: float = BEYOND) -> list[Notice]:
    """Parameters that ended more than `limit` prior sigma from the prior's mean, farthest first."""
    problem = found.problem
    means = problem.prior
    away = np.abs(found.values - means) / problem.scale
    lens = [f"camera.{key}" for key in ("k1", "cx", "cy") if f"camera.{key}" in problem.held]
    free = f"most likely the lens is distorted: calibrate --prior {lens[0]}=0.2; else " if lens else ""
    cure = f"{free}the typed value is wrong, or a capture mislabelled: calibrate --prior NUMBER=SIGMA"
    return [
        Notice(
            f"{problem.names[k]} is {found.values[k]:.4g} by the captures, typed {means[k]:.4g} +- "
            f"{problem.scale[k]:.3g}; distance in prior sigma",
            float(away[k]),
            limit,
            cure,
        )
        for k in np.argsort(-away)
        if away[k] > limit
    ]


def notices(
    found: Adjustment, weak: Sequence[Direction], effects: Effects, observations: Sequence[Observation]
) -> tuple[Notice, ...]:
    """Warnings, and a list of errors that enter the heights one to one."""
    warned = [*beyond_priors(found, _FAR), *_weak(found, weak, effects, observations)]
    warned += [*_poses(found, observations), *_priors(found)]
    chis = {"all captures": found.chi} | found.chis
    compared = any(sample.reference for sample in found.problem.samples)
    warned += [
        Notice(
            f"The rig does not fit {name}; residuals over noise",
            chi,
            MOST_CHI,
            _STATIC if compared and name == found.problem.frame else _MISFIT,
        )
        for name, chi in chis.items()
        if chi > MOST_CHI
    ]
    counts = {o.name: int(np.count_nonzero(o.usable)) for o in observations if isinstance(o.target, Ball)}
    warned += [
        Notice(
            f"{name}: the contact has {count} pixels, fewer than {_CONTACT}",
            count,
            math.nan,
            "take a larger ball, or press deeper",
        )
        for name, count in counts.items()
        if count < _CONTACT
    ]
    flats = sorted({each.target.flatness for each in observations if isinstance(each.target, Flat)})
    um = ", ".join(f"{1e3 * f:g}" for f in flats)
    through = [f"an error of the reference's flatness adds to the heights ({um} µm)"] if flats else []
    through += ["an error of the ball's radius scales all heights"] if counts else []
    if through:
        name = f"No capture reveals it: {', and '.join(through)}"
        warned.append(Notice(name, math.nan, math.nan, ""))
    return (*warned, Notice(GAUGE, math.nan, math.nan, ""))


def _weak(
    found: Adjustment, weak: Sequence[Direction], effects: Effects, observations: Sequence[Observation]
) -> list[Notice]:
    """Directions that the priors determine, if they cause a quarter of a height's or a depth's variance."""
    whole = effects.sigmas(found.covariance)
    kinds = {type(each.target) for each in observations}
    if Ball in kinds:
        cure = "add a ball at another place, or measure one of these numbers (calibrate --prior)"
    elif Rest in kinds:
        cure = "press a ball of known radius, or measure one of these numbers (calibrate --prior)"
    else:
        cure = "add a pose, tilted by 3 to 8 degrees about another axis"
    notices = []
    for each in (one for one in weak if one.singular < _WEAK):
        height, depth = effects.sigmas(np.outer(each.error, each.error))
        if max(height / whole[0], depth / whole[1]) > math.sqrt(_SHARE):
            name = (
                f"The captures do not determine {each.names}, only your typed values do; by that, sigma of a "
                f"height is {1e3 * height:.2g} µm, of a depth {100 * depth / effects.peak:.2g} %"
            )
            notices.append(Notice(name, each.singular, math.nan, cure))
    return notices


def lacking(observations: Sequence[Observation]) -> Notice | None:
    """Notice of missing captures, None if there are enough."""
    kinds = [type(each.target) for each in observations]
    posed = sum(kind in (Flat, Plate) for kind in kinds)
    name = f"{posed} poses without a ball do not determine the rig"
    cure = f"{3 - posed} more, tilted by 3 to 8 degrees"
    if not {Flat, Rest} & {*kinds}:
        name, cure = "no capture of a flat or of the mirror at rest", "take one: it defines z = 0"
    elif Ball in kinds or posed > 2:
        return None
    elif not posed:
        name = "rest without a ball: only the priors determine the scale of the depth"
        cure = "press a ball of known radius"
    return Notice(name, posed or math.nan, math.nan, cure)


def _poses(found: Adjustment, observations: Sequence[Observation]) -> list[Notice]:
    """Notices of too few or of nearly parallel poses; none if a ball was captured."""
    if any(isinstance(each.target, Ball) for each in observations):
        return []
    values, few = found.problem.named(found.values), lacking(observations)
    warned = [] if few is None else [few]
    posed = [each for each in observations if isinstance(each.target, Flat | Plate)]
    tilts = np.array([[values.get(f"{p.name}.{key}", 0.0) for key in ("tilt_x", "tilt_y")] for p in posed])
    if len(posed) < 2:
        return warned
    apart = float(np.linalg.norm(tilts[:, None] - tilts[None], axis=-1).max())
    if apart < _TILT:
        name = (
            f"The poses are parallel within {math.degrees(apart):.2g} degrees: they hardly determine the rig"
        )
        cure = "tilt them by 3 to 8 degrees, about different axes"
        warned.append(Notice(name, math.nan, math.nan, cure))
    return warned


def _priors(found: Adjustment) -> list[Notice]:
    """chi2 test of the scene's parameters against their priors: the squared distances in prior sigma. Degrees
    of freedom: sum of 1 - (sigma / prior sigma)^2, the parameters that the captures determine."""
    problem, wide = found.problem, plausible(found.problem.scene)
    typed = [k for k, name in enumerate(problem.names) if problem.sigmas[name] < wide.get(name, 0.0)]
    away = np.abs(problem.residuals(found.values)[-len(problem.names) :])
    square = float((away[typed] ** 2).sum())
    freedom = float((1 - np.diag(found.linear) / problem.scale**2)[typed].sum())
    limit = float(chdtri(freedom, _RARE)) if freedom > 1 else math.inf
    if not square > limit:
        return []
    size, most = (math.sqrt(each / freedom) for each in (square, limit))
    worst = max(typed, key=lambda k: float(away[k]))
    name = (
        f"Typed numbers are further off than assumed; the worst is {problem.names[worst]} ({away[worst]:.2g} "
        "sigma); rms of all in prior sigma"
    )
    cure = f"measure it again, or widen its prior: calibrate --prior {problem.names[worst]}=SIGMA"
    return [Notice(name, size, most, cure)]
