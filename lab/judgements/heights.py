"""Judgements of `reconstruct`: rigs that are as described, and faults of every kind, traced by `scene.trace`.

A rig is prism48, exact for even seeds, typed and drawn from its priors for odd ones; beside it the rigs of
`typed_runs`. A right map has less than 1 % of its heights beyond five total sigma; a fault counts where more
are.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.reconstruct import reconstruct
from optolever.scene import Scene, Surface, TelecentricCamera, load, resize, rig_covariance

from ..calibration.typed import KINDS as TYPED
from ..calibration.typed import moved, typed_runs
from ..figures import pressed
from ..figures.contacts import captured, changed
from .record import Row

__all__ = ["rows"]

Rng = np.random.Generator

_PART, _ANY = "heights", "any"
_SIZE, _NOISE = (120, 160), 0.01  # px
_BEYOND = 0.01  # share of the heights
#: Tests whose words are true of right heights, too: which pixels have none, how the anchor's error grows.
_TRUE = ("rest pixels", "total sigma", "wedge")


@dataclass(frozen=True)
class _Case:
    """A capture: the typed scene, press and rest, and the true height (NaN: unknown)."""

    typed: Scene
    press: Correspondence
    rest: Correspondence | None
    z: Floats


@dataclass(frozen=True)
class _Rigs:
    """The typed scene and the true rig."""

    typed: Scene
    true: Scene

    def case(
        self,
        surface: Surface,
        rng: Rng,
        now: Scene | None = None,
        before: Surface | None = None,
        alone: bool = False,
    ) -> _Case:
        """Of a press; now: the rig when it is captured; before: the mirror at rest."""
        now = self.true if now is None else now
        press, z = _captured(now, surface, rng)
        rest, flat = _captured(self.true, _ball(0.0) if before is None else before, rng)
        return _Case(self.typed, press, None if alone else rest, z - flat)


def rows(seeds: int, kinds: Collection[str] | None = None) -> list[Row]:
    """Of every test on every kind of right captures, and of every kind of fault; kinds: None is all."""
    found = []
    for kind, make in RIGHT.items():
        if kinds is None or kind in kinds:
            found += _right(kind, [_judged(make, kind, seed) for seed in range(seeds)])
    for kind in TYPED if kinds is None else [kind for kind in TYPED if kind in kinds]:
        runs = [
            _Judged(run.limits, set(run.named), run.refused or run.beyond > _BEYOND)
            for run in typed_runs((kind,), range(seeds))
        ]
        found += _right(f"typed, {kind}", runs)
    for kind, (make, tests) in WRONG.items():
        if kinds is None or kind in kinds:
            maps = [_judged(make, kind, seed) for seed in range(seeds)]
            off = [one for one in maps if one.wrong]
            missed = sum(not one.named & set(tests) for one in off)
            found.append(Row(_PART, ", ".join(tests), kind, math.nan, 0, 0, len(off), missed))
    return found


def _right(kind: str, maps: "list[_Judged]") -> list[Row]:
    """Rows of captures that are right, and one of the others."""
    right, off, found = [one for one in maps if not one.wrong], [one for one in maps if one.wrong], []
    for test in dict.fromkeys(test for one in right for test in one.limits if test not in _TRUE):
        limits = [one.limits[test] for one in right if test in one.limits]
        alarms = sum(test in one.named for one in right)
        found.append(Row(_PART, test, kind, min(limits), len(limits), alarms, 0, 0))
    silent = sum(not one.named for one in off)
    return [*found, Row(_PART, _ANY, kind, math.nan, 0, 0, len(off), silent)]


class _Judged(NamedTuple):
    """limits: of the tests of a map; named: the ones that fail; wrong: more than 1 % of the heights are
    beyond five total sigma, or none is good."""

    limits: dict[str, float]
    named: set[str]
    wrong: bool


def _judged(make: "_Make", kind: str, seed: int) -> _Judged:
    rng = np.random.default_rng([91, seed, sum(map(ord, kind))])
    case = make(_rigs(1 if kind in _OF_TYPED else seed, rng), rng)
    try:
        height = reconstruct(case.press, case.typed, rest=case.rest)
    except InputError:  # one line says why
        return _Judged({}, {"refused"}, True)
    good = height.good & np.isfinite(case.z)
    beyond = np.abs(height.z - case.z)[good] > 5 * height.total_sigma[good]
    wrong = not good.any() or float(beyond.mean()) > _BEYOND
    limits = {test.test: test.limit for test in height.tests}
    return _Judged(limits, {test.test for test in height.tests if test.fails}, wrong)


def _rigs(seed: int, rng: Rng) -> _Rigs:
    scene = resize(load("prism48", exact=seed % 2 == 0), *_SIZE)
    covariance = rig_covariance(scene)
    if covariance is None:
        return _Rigs(scene, scene)
    return _Rigs(scene, changed(scene, rng.standard_normal(len(covariance.root)) @ covariance.root))


def _captured(scene: Scene, surface: Surface, rng: Rng) -> tuple[Correspondence, Floats]:
    places, seen = captured(scene, surface, _NOISE, rng)
    return places, np.where(seen.visible, seen.z, np.nan)


def _ball(depth: float, x: float = 30.0, y: float = 22.0, radius: float = 4.0, sunk: float = 0.0) -> Surface:
    """A ball's contact, mm; sunk: of the whole mirror."""
    even = pressed.Dent(lambda r: np.full_like(r, sunk), sunk, radius, math.nan)
    return pressed.surface_of([(pressed.ball(radius, depth), x, y), (even, x, y)])


def _drawn_ball(rng: Rng) -> Surface:
    return _ball(rng.uniform(0.03, 0.12), rng.uniform(24, 36), rng.uniform(16, 28), rng.uniform(3, 5))


def _drawn_punch(rng: Rng) -> Surface:
    depth, x, y, radius = rng.uniform((0.02, 24, 16, 3), (0.06, 36, 28, 5)).tolist()
    return pressed.surface_of([(pressed.flat_punch(radius, depth), x, y)])


def _shifted(scene: Scene, pixels: float) -> Scene:
    """The camera moved along the columns of its image."""
    camera = scene.camera
    assert isinstance(camera, TelecentricCamera)
    return replace(
        scene, camera=replace(camera, origin=camera.origin + pixels * camera.pitch[0] * camera.u_axis)
    )


def _two_moments(rigs: _Rigs, rng: Rng) -> _Case:
    """The camera moved by half a pixel between the frames of u and of v."""
    surface = _drawn_ball(rng)
    case, later = rigs.case(surface, rng), _captured(_shifted(rigs.true, 0.5), surface, rng)[0]
    return replace(case, press=replace(case.press, v=later.v))


def _exchanged(rigs: _Rigs, rng: Rng) -> _Case:
    case = rigs.case(_drawn_ball(rng), rng)
    assert case.rest is not None
    return replace(case, press=case.rest, rest=case.press)


def _reversed(rigs: _Rigs, rng: Rng) -> _Case:
    """u runs the other way, in both captures."""
    case = rigs.case(_drawn_ball(rng), rng)
    assert case.rest is not None
    last = rigs.typed.pattern.cols - 1
    press, rest = (replace(one, u=last - one.u) for one in (case.press, case.rest))
    return replace(case, press=press, rest=rest)


def _coarser(rigs: _Rigs, rng: Rng, alone: bool) -> _Case:
    """The typed pitch of the pattern is half the true one."""
    case, pattern = rigs.case(_drawn_ball(rng), rng, alone=alone), rigs.typed.pattern
    return replace(case, typed=replace(rigs.typed, pattern=replace(pattern, pitch=0.5 * pattern.pitch)))


_Make = Callable[[_Rigs, Rng], _Case]
#: Right only of a typed rig: the motion is one that its accuracy knows.
_OF_TYPED = ("ball, moved by the prior", "untouched, moved by the prior")
#: Kind of right captures -> makes one.
RIGHT: dict[str, _Make] = {
    "untouched": lambda rigs, rng: rigs.case(_ball(0.0), rng),
    "ball": lambda rigs, rng: rigs.case(_drawn_ball(rng), rng),
    "punch": lambda rigs, rng: rigs.case(_drawn_punch(rng), rng),
    "ball, alone": lambda rigs, rng: rigs.case(_drawn_ball(rng), rng, alone=True),
    "ball, moved by the prior": lambda rigs, rng: rigs.case(
        _drawn_ball(rng), rng, moved(rigs.true, 1.0, rng)
    ),
    "untouched, moved by the prior": lambda rigs, rng: rigs.case(_ball(0.0), rng, moved(rigs.true, 1.0, rng)),
}


def _camera(pixels: float) -> _Make:
    return lambda rigs, rng: rigs.case(_drawn_ball(rng), rng, _shifted(rigs.true, pixels))


def _sinks(micrometres: float) -> _Make:
    return lambda rigs, rng: rigs.case(_ball(0.05, sunk=1e-3 * micrometres), rng)


_MOVED = ("moved", "motion", "untouched")
_SCENE = ("plausible", "rest rig", "circulation", "refused")
#: Kind of fault -> makes a capture of it, and the tests that may name it.
WRONG: dict[str, tuple[_Make, tuple[str, ...]]] = {
    **{f"camera moved by {px:g} px": (_camera(px), _MOVED) for px in (0.05, 0.2, 1.0)},
    **{f"block sank by {um} µm": (_sinks(um), _MOVED) for um in (5, 20, 50)},
    "press and rest exchanged": (_exchanged, ("below rest",)),
    "contact at rest": (
        lambda rigs, rng: rigs.case(_ball(0.05), rng, before=_ball(0.04, 40.0)),
        ("below rest",),
    ),
    "u and v of two moments": (_two_moments, ("circulation", "plausible")),
    "u reversed": (_reversed, _SCENE),
    "pitch half as large": (lambda rigs, rng: _coarser(rigs, rng, False), _SCENE),
    "pitch half as large, alone": (lambda rigs, rng: _coarser(rigs, rng, True), _SCENE),
}
