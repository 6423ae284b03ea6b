"""Impossible captures: whether a rig of the scene's accuracy can have taken one, and which mistake explains
it."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from optolever.arrays import Floats, some_rows
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Judged
from optolever.scene import TYPED, Scene, adjusted, parameter_values, strided, typed_covariance

from ..geometry import flat_mirror, ray_field, traced_rays
from ..judgement.circulation import circulation_chi2
from ..judgement.holes import noise_gain
from .model import LIKELY, Measurement, RigJudgement, judged_rig, rig_model

__all__ = ["explain", "mistakes", "of_another_rig"]

_NAMES = 3  # mistakes
_BETTER = 0.1  # of the misfit: the limit for the right description
_LINES = 24  # rows of the grid on which a rest capture is compared with the flat mirror
_NOISE = 1.0  # px: sag, glass and curvature of a rest capture
_TENTH = 0.1  # of the deviation: derivatives describe large errors to a tenth
_REWEIGHTED = 8  # times
_STEP = 0.05  # of a standard deviation
_RATIOS = {"ten times larger": 10.0, "ten times smaller": 0.1, "twice as large": 2.0, "half as large": 0.5}
#: Whether u and v are exchanged, then u, v reversed.
_TURNS = {
    "u runs the other way along the display, or the picture is mirrored": (False, True, False),
    "v runs the other way along the display, or the picture is mirrored": (False, False, True),
    "the display is turned by 180 degrees, or the picture is": (False, True, True),
    "u and v are exchanged": (True, False, False),
    "the display is turned by 90 degrees (u and v exchanged, u reversed)": (True, True, False),
    "the display is turned by 270 degrees (u and v exchanged, v reversed)": (True, False, True),
    "u and v are exchanged and both reversed": (True, True, True),
}

#: Whether rows, columns of the picture are reversed.
_FLIPS = {
    "the pictures of press and rest are mirrored to each other, left to right": (
        slice(None),
        slice(None, None, -1),
    ),
    "the pictures of press and rest are mirrored to each other, top to bottom": (
        slice(None, None, -1),
        slice(None),
    ),
    "the pictures of press and rest are turned by 180 degrees to each other": 2 * (slice(None, None, -1),),
}

_Change = Callable[[Correspondence], Correspondence]


def explain(
    correspondence: Correspondence, scene: Scene, rest: Correspondence | None = None
) -> tuple[str, ...]:
    """Up to three mistakes in the scene or the pictures without which the capture fits, in words, the
    likeliest first; none where none does, or the capture fits as it stands."""
    return mistakes(Measurement(correspondence, None, None, rest), scene)[:_NAMES]


def mistakes(measured: Measurement, scene: Scene, described: RigJudgement | None = None) -> tuple[str, ...]:
    """Of a measurement, see `explain`: by its rest capture, if there is one; described: its judgement as it
    was described, if it is known."""
    scene = replace(scene, accuracy=TYPED) if scene.exact else scene
    if measured.rest is None:
        return _mistakes_alone(measured, scene, described)
    turned = _turned_against(measured.correspondence, measured.rest)
    return ((turned,) if turned else ()) + _mistakes_at_rest(measured.rest, scene)


def _mistakes_alone(measured: Measurement, scene: Scene, described: RigJudgement | None) -> tuple[str, ...]:
    """Only mistakes without which the places lie nearer to the flat mirror's, the nearest first, each
    solved on a coarse grid."""
    if described is None and (described := _judged(measured, scene)) is None:
        return ()
    press, found = measured.correspondence, []
    changed = {words: (change(press), other) for words, (change, other) in _mistakes(scene).items()}
    away = {words: _rest_misfit(*one) for words, one in changed.items()}
    for words in sorted(away, key=away.__getitem__):
        if not away[words] < _rest_misfit(press, scene):
            break
        seen, other = changed[words]
        judged = _judged(measured._replace(correspondence=seen), other, described.raw)
        if judged and judged.likely and (judged.exact or judged.chi2 < 0.5 * described.chi2):
            found.append(words)
    return tuple(found)


def _judged(measured: Measurement, scene: Scene, raw: float = math.inf) -> RigJudgement | None:
    """The judgement of a capture on a coarse grid; None where no mirror explains it, or not much better than
    with a chi2 of `raw`."""
    try:
        model = rig_model(measured, scene)
        if model is None:
            return None
        gain = noise_gain(model.problem.data.mask, model.problem.bridged)
        chi2, freedom = circulation_chi2(model.problem.data, model.state, gain)
        return judged_rig(model, model.solutions(), chi2, freedom) if chi2 < _BETTER * raw else None
    except InputError:  # no such mirror
        return None


def _mistakes_at_rest(rest: Correspondence, scene: Scene) -> tuple[str, ...]:
    """Without which the rest capture is one of a flat mirror, the best first."""
    misfit = _rest_misfit(rest, scene)
    if misfit <= LIKELY:
        return ()
    found = {words: _rest_misfit(change(rest), other) for words, (change, other) in _mistakes(scene).items()}
    limit = min(LIKELY, _BETTER * misfit)
    return tuple(words for words in sorted(found, key=found.__getitem__) if found[words] < limit)


def _turned_against(press: Correspondence, rest: Correspondence) -> str | None:
    """The turn of the pictures without which press and rest lie ten times nearer to each other, in words."""

    few = some_rows(rest.u)

    def apart(flip: tuple[slice, slice]) -> float:
        both = press.good[few] & rest.good[flip][few]
        away = np.hypot(press.u[few] - rest.u[flip][few], press.v[few] - rest.v[flip][few])[both]
        return float(np.median(away)) if away.size else np.inf

    found = {words: apart(flip) for words, flip in _FLIPS.items()}
    best = min(found, key=found.__getitem__)
    return best if found[best] < _BETTER * apart((slice(None), slice(None))) else None


def of_another_rig(measured: Measurement, scene: Scene) -> Judged | None:
    """Whether a flat mirror in this rig shows no pattern, or the capture at rest (of a prism the press
    itself) shows it elsewhere than the accuracy of the rig's numbers allows."""
    seen = measured.correspondence if measured.rest is None else measured.rest
    if seen.u.shape != (scene.camera.rows, scene.camera.cols):
        return None
    few = strided(scene, max(1, min(seen.u.shape) // _LINES))
    if not np.isfinite(flat_mirror(few)).any():
        words = "By the scene's numbers no pixel sees the pattern in a flat mirror"
        return Judged("rest rig", math.nan, math.nan, words, "correct them (optolever design --range)")
    if measured.rest is None and (scene.accuracy is None or scene.open_air):
        return None
    errors, _, names = _rest_errors(seen, scene, robust=measured.rest is None)
    if not errors.size:
        return None
    most = names[int(np.abs(errors).argmax())]
    words = f"A flat mirror is seen elsewhere than by the scene's numbers, {most} the most; rms in sigma"
    cure = f"correct mirror, pattern and camera of the scene ({most} may stand for another), or calibrate"
    return Judged("rest rig", float(np.sqrt(np.mean(errors**2))), LIKELY**0.5, words, cure)


def _rest_misfit(rest: Correspondence, scene: Scene) -> float:
    """Mean square of the errors, in standard deviations, that the rig needs so that a flat mirror explains
    the rest capture, and of what they leave; 0 where nothing is comparable."""
    errors, left, _ = _rest_errors(rest, scene)
    return float(np.mean(errors**2)) + left if errors.size else 0.0


def _rest_errors(
    rest: Correspondence, scene: Scene, robust: bool = False
) -> tuple[Floats, float, tuple[str, ...]]:
    """Errors of the rig's numbers, in standard deviations, by which a flat mirror explains the rest capture,
    the mean square of what they leave, and their names; none where nothing is comparable.

    robust: places that a dent moves count less.
    Minimises |a|^2 + sum (y - J a)^2 / s^2 over the errors a, y the deviation from the flat mirror in px, s
    at least a pixel and a tenth of y.
    """
    step = max(1, min(rest.u.shape) // _LINES)
    scene = strided(scene, step)
    known, own, rays = typed_covariance(scene), parameter_values(scene), ray_field(scene.camera)
    flat = flat_mirror(scene, rays)
    places = np.stack([rest.u[::step, ::step], rest.v[::step, ::step]])
    some = rest.good[::step, ::step] & np.isfinite(flat).all(axis=0) & np.isfinite(places).all(axis=0)
    if known is None or not some.any():
        return np.zeros(0), 0.0, ()
    deviation, camera = (places - flat)[:, some].ravel(), scene.camera
    values = [
        {name: own[name] + _STEP * by for name, by in zip(known.names, row, strict=True)}
        for row in known.root
    ]
    scenes = [adjusted(scene, one, own) for one in values]
    moved = [flat_mirror(one, rays if one.camera is camera else traced_rays(one.camera)) for one in scenes]
    fields = np.nan_to_num((np.stack(moved, axis=-1) - flat[..., None])[:, some] / _STEP)
    fields = fields.reshape(len(deviation), -1)
    size = max(_NOISE, _TENTH * float(np.sqrt(np.mean(deviation**2))))
    weight = np.ones(len(deviation))
    for _ in range(_REWEIGHTED if robust else 1):
        normal = (fields.T * weight) @ fields / size**2 + np.eye(fields.shape[1])
        errors = np.linalg.solve(normal, (fields.T * weight) @ deviation / size**2)
        left = deviation - fields @ errors
        weight = 1 / (1 + np.square(left / max(_NOISE, 1.4826 * float(np.median(np.abs(left))))))
    return np.asarray(errors), float(np.mean(left**2)) / size**2, known.names


def _mistakes(scene: Scene) -> dict[str, tuple[_Change, Scene]]:
    """In words, how to change the capture, and the scene, if that is the mistake."""
    pattern = scene.pattern
    found: dict[str, tuple[_Change, Scene]] = {
        words: (partial(_turned, scene=scene, turn=turn), scene) for words, turn in _TURNS.items()
    }
    for words, ratio in _RATIOS.items():
        scaled = replace(scene, pattern=replace(pattern, pitch=ratio * pattern.pitch))
        found[f"pattern.pitch_mm is {words}"] = (lambda c: c), scaled
        resized = partial(_resized, by=ratio)
        found[f"the sequence has cells {words} than the scene's pattern"] = resized, scene
    return found


def _turned(c: Correspondence, scene: Scene, turn: tuple[bool, bool, bool]) -> Correspondence:
    swapped, along_u, along_v = turn
    if swapped:
        c = replace(c, u=c.v, v=c.u, sigma_u=c.sigma_v, sigma_v=c.sigma_u)
    u = scene.pattern.cols - 1 - c.u if along_u else c.u
    return replace(c, u=u, v=scene.pattern.rows - 1 - c.v if along_v else c.v)


def _resized(c: Correspondence, by: float) -> Correspondence:
    return replace(c, u=by * c.u, v=by * c.v, sigma_u=by * c.sigma_u, sigma_v=by * c.sigma_v)
