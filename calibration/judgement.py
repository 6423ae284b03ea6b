"""Contribution of each capture, in order: usable share, tilt, and effect on the predicted sigma of a height.

Information adds: the normal matrix of some captures is the sum of their J_k^T J_k and the priors'. Its
inverse, propagated by the heights' derivatives by the scene's parameters, predicts the variance of a height
by these captures, to first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optolever.arrays import Floats
from optolever.blocks import blas_on_one
from optolever.decode import Flag
from optolever.errors import InputError
from optolever.scene import Scene

from .adjust import Adjustment, covariance_of
from .calibrate import Calibration, calibrate
from .observability import MOST_CHI, lacking
from .observation import Observation, checked
from .targets import Flat, Rest

__all__ = ["Judgement", "SoFar", "calibrate_so_far", "judged", "reason_to_repeat"]


_DECODED = 0.5  # of the pixels that see the pattern: below, a capture is to be repeated
_GAIN = 0.95  # of the last sigma of a depth: above, a capture adds next to nothing
_UNSEEN = int(Flag.DARK | Flag.LOW_CONTRAST | Flag.OFF_PATTERN | Flag.INVALID)


@dataclass(frozen=True, slots=True)
class Judgement:
    """Figures of a capture.

    chi: rms residual in sigma; seen: share of the image in which the mirror reflects the pattern; decoded:
    share usable in the adjustment (good, in the mask); tilt: relative to z = 0, degrees, None unless the
    target is a flat or a plate. Heights and depths: standard deviations by the rig alone (mm) of a height
    (median over the mirror) and of the depth of a dent relative to the mirror at rest; so_far: by the
    captures up to this one; without: by all others (None for the capture that defines z = 0).
    """

    name: str
    chi: float
    seen: float
    decoded: float
    tilt: float | None
    height_so_far: float
    depth_so_far: float
    height_without: float | None
    depth_without: float | None

    def to_dict(self) -> dict[str, Any]:
        """As plain types."""
        lengths = {f"{key}_mm": getattr(self, key) for key in self.__slots__[5:]}
        shares = {"chi": self.chi, "seen": self.seen, "decoded": self.decoded}
        return shares | {"tilt_deg": self.tilt} | lengths


@blas_on_one()
def judged(found: Calibration) -> list[Judgement]:
    """Every capture of a calibration, the frame's first, the others in the given order."""
    solved = found.adjustment
    names = [sample.name for sample in solved.problem.samples]
    sigmas = {}
    for k, name in enumerate(names):
        others = [each for each in names if each != name]
        for key, some in (("so_far", names[: k + 1]), ("without", others)):
            sigmas[name, key] = found.effects.sigmas(_covariance(solved, some))
    seen = {o.name: float(np.mean((o.correspondence.flags & _UNSEEN) == 0)) for o in found.observations}
    return [
        Judgement(
            name,
            solved.chis[name],
            seen[name],
            found.decoded[name],
            found.tilts.get(name),
            *sigmas[name, "so_far"],
            *((None, None) if name == solved.problem.frame else sigmas[name, "without"]),
        )
        for name in names
    ]


@dataclass(frozen=True, slots=True, eq=False)
class SoFar:
    """A calibration by the captures so far (None: none says where z = 0 is), a sentence on missing captures
    ("": none is), and the judgement of the last capture."""

    found: Calibration | None = None
    few: str = "no capture is left; at least one of Flat or Rest is needed"
    last: Judgement | None = None

    def required(self) -> Calibration:
        """InputError without a calibration."""
        if self.found is None:
            raise InputError(f"calibration: {self.few}")
        return self.found


def calibrate_so_far(scene: Scene, observations: Sequence[Observation], priors: Mapping[str, float]) -> SoFar:
    """`calibrate` of captures while others are still to come. No calibration without a Flat or a Rest, nor of
    so few Flats that any rig would fit them. InputError names a wrong capture."""
    few, kinds = lacking(observations), {type(one.target) for one in observations}
    cure = "" if few is None else f"{few.name}: {few.cure}"
    if Rest in kinds or (Flat in kinds and few is None):
        found = calibrate(scene, observations, priors)
        return SoFar(found, cure, next(one for one in judged(found) if one.name == observations[-1].name))
    if Flat in kinds:
        checked(observations, (scene.camera.rows, scene.camera.cols))
    return SoFar(None, cure)


def reason_to_repeat(decoded: float, last: Judgement | None, before: Judgement | None, complete: bool) -> str:
    """Reason to repeat the last capture ("": none), from its judgement and the one before; decoded: share of
    the pixels that see the pattern; complete: whether no capture is missing."""
    if decoded < _DECODED:
        return f"{100 * decoded:.0f} % of the pixels that see the pattern are decoded: expose, focus"
    if last is None:
        return ""
    if last.chi > MOST_CHI:
        return (
            f"chi {last.chi:.3g} is above {MOST_CHI}: another target, a mirror that moved, or a wrong number"
        )
    if complete and before is not None and last.depth_so_far > _GAIN * before.depth_so_far:
        return "it adds next to nothing: another pose, another place"
    return ""


def _covariance(solved: Adjustment, captures: Sequence[str]) -> Floats:
    """Covariance of the unknowns by these captures, linearised at the minimum of all, with its chi."""
    problem, kept = solved.problem, np.ones(len(solved.jacobian), dtype=np.bool_)
    rows = np.concatenate([np.full(2 * len(each.row), each.name in captures) for each in problem.samples])
    kept[: len(rows)] = rows
    return covariance_of(solved.jacobian[kept], problem.scale, solved.chi)
