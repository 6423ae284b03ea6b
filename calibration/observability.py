"""What the captures tell and what only the priors do: singular values in prior units, and warnings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from optolever.notices import Notice

from .adjust import Adjustment
from .observation import Observation
from .priors import GAUGE, MEANING, plausible
from .targets import Ball, Flat, Plate, Rest

__all__ = ["Direction", "directions", "lacking", "notices"]

Floats = NDArray[np.float64]

_WEAK = 3.0  # singular value in prior units: below, the prior says as much as the captures
_TILT = math.radians(2.0)  # between mirrors: below, they are nearly one pose
_CHI = 1.2
_CONTACT = 300  # pixels
_RARE = 1e-4  # probability that right priors are said to be contradicted
_PART = 0.3  # share of a direction's length from which a number is named


@dataclass(frozen=True, slots=True)
class Direction:
    """A combination of numbers: how much sharper the captures know it than the priors (singular value), and
    the numbers behind it with their shares."""

    singular: float
    parts: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        """In words."""
        names = [MEANING.get(name, (name, ""))[0] for name, _ in self.parts]
        cures = dict.fromkeys(MEANING.get(name, ("", ""))[1] for name, _ in self.parts)
        cure = "; ".join(each for each in cures if each)
        what = names[0] if len(names) == 1 else f"a combination of {', '.join(names)}"
        return f"{what} is known from your prior alone{': ' + cure if cure else ''}"


def directions(found: Adjustment, names: Sequence[str]) -> list[Direction]:
    """Of these numbers, weakest first: the others are eliminated (columns projected out)."""
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
        result.append(Direction(float(size), parts or ((names[big[0]], float(vector[big[0]])),)))
    return result


def notices(
    found: Adjustment, weak: Sequence[Direction], observations: Sequence[Observation]
) -> tuple[Notice, ...]:
    """Warnings by name, and what passes through one to one."""
    told = [
        Notice(str(each), each.singular, _WEAK, "singular value in prior units")
        for each in weak
        if each.singular < _WEAK
    ]
    told += [*_poses(found, observations), *_priors(found)]
    chis = {"all captures": found.chi} | found.chis
    told += [
        Notice(f"chi of {name}", chi, _CHI, "the model does not explain it: leave it out, or free more")
        for name, chi in chis.items()
        if chi > _CHI
    ]
    counts = {o.name: int(np.count_nonzero(o.usable)) for o in observations if isinstance(o.target, Ball)}
    told += [
        Notice(
            f"{count} contact pixels of {name}, fewer than {_CONTACT}",
            count,
            math.nan,
            "take a larger ball, or press deeper",
        )
        for name, count in counts.items()
        if count < _CONTACT
    ]
    flats = sorted({each.target.flatness for each in observations if isinstance(each.target, Flat)})
    through = (
        [f"the flatness of the reference ({', '.join(f'{1e3 * f:g}' for f in flats)} um)"] if flats else []
    )
    through += ["the radius of the ball"] if counts else []
    if through:
        verb = "pass" if len(through) > 1 else "passes"
        name = f"{' and '.join(through)} {verb} into the heights one to one"
        told.append(Notice(name, math.nan, math.nan, ""))
    return (*told, Notice(GAUGE, math.nan, math.nan, ""))


def lacking(observations: Sequence[Observation]) -> Notice | None:
    """What these captures are too few of."""
    kinds = [type(each.target) for each in observations]
    posed = sum(kind in (Flat, Plate) for kind in kinds)
    name, cure = f"K = {posed} poses without a ball", f"the null space is not empty: {3 - posed} more, tilted"
    if not {Flat, Rest} & {*kinds}:
        name, cure = "no capture of a flat or of the mirror at rest", "take one: it says where z = 0 is"
    elif Ball in kinds or posed > 2:
        return None
    elif not posed:
        name = "rest without a ball"
        cure = "the scale of the depth is known from your priors alone: press a ball"
    return Notice(name, posed or math.nan, math.nan, cure)


def _poses(found: Adjustment, observations: Sequence[Observation]) -> list[Notice]:
    """Too few, parallel or nearly parallel mirrors, where no ball makes up for them."""
    if any(isinstance(each.target, Ball) for each in observations):
        return []
    values, few = found.problem.named(found.values), lacking(observations)
    told = [] if few is None else [few]
    posed = [each for each in observations if isinstance(each.target, Flat | Plate)]
    tilts = np.array([[values.get(f"{p.name}.{key}", 0.0) for key in ("tilt_x", "tilt_y")] for p in posed])
    if len(posed) < 2:
        return told
    apart = float(np.linalg.norm(tilts[:, None] - tilts[None], axis=-1).max())
    if apart < _TILT:
        name = "parallel poses" if apart < 0.1 * _TILT else "tilts below 2 degrees"
        cure = f"mirrors differ by {math.degrees(apart):.2g} degrees: tilt them by 3 to 8"
        told.append(Notice(name, math.nan, math.nan, cure))
    return told


def _priors(found: Adjustment) -> list[Notice]:
    """Numbers of the scene against their priors: over these, their squares sum to a chi2 of as many degrees
    of freedom as the captures tell, the sum of 1 - (sigma / prior sigma)^2."""
    problem, wide = found.problem, plausible(found.problem.scene)
    told = [k for k, name in enumerate(problem.names) if problem.sigmas[name] < wide.get(name, 0.0)]
    square = float((problem.residuals(found.values)[-len(problem.names) :][told] ** 2).sum())
    freedom = float((1 - np.diag(found.linear) / problem.scale**2)[told].sum())
    limit = chi2.isf(_RARE, freedom) if freedom > 1 else math.inf
    if not square > limit:
        return []
    size, most = (math.sqrt(each / freedom) for each in (square, limit))
    cure = "give wider ones, or a capture is not what it is said to be"
    return [Notice("chi of the scene's numbers by their priors", size, most, cure)]
