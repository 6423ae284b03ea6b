"""Impossible captures: whether a rig of the scene's accuracy can have taken one, and which mistake explains
it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import Scene, adjusted, parameter_values, strided, typed_covariance

from ..arrays import Floats
from .calibration import flat_mirror
from .model import LIKELY, Measurement, RigJudgement

__all__ = ["likely_mistake", "likely_mistake_at_rest", "rest_misfit"]

_BETTER = 0.1  # of the misfit: the limit for the right description
_LINES = 24  # rows of the grid on which a rest capture is compared with the flat mirror
_NOISE = 1.0  # px: sag, glass and curvature of a rest capture
_TENTH = 0.1  # of the deviation: derivatives describe large errors to a tenth
_STEP = 0.05  # of a standard deviation
_RATIOS = {"ten times larger": 10.0, "ten times smaller": 0.1, "twice as large": 2.0, "half as large": 0.5}


class _Mistake(NamedTuple):
    words: str
    change: Callable[[Correspondence], Correspondence]
    scene: Scene


def likely_mistake(
    judge: Callable[[Measurement, Scene, float], RigJudgement | None],
    measured: Measurement,
    scene: Scene,
    described: RigJudgement,
) -> str | None:
    """The mistake without which the capture fits its scene, in words; None where none does.

    Only mistakes without which the places lie nearer to those of the flat mirror, the nearest first.
    judge: solves a measurement on a coarse grid and judges its slopes, None where their raw chi2 is not below
    a limit; described: the judgement of the capture as it was described.
    """
    limit, press = _BETTER * described.raw, measured.correspondence
    away = [(rest_misfit(each.change(press), each.scene), each) for each in _mistakes(scene)]
    near = [(off, each) for off, each in away if off < rest_misfit(press, scene)]
    for _, (words, change, other) in sorted(near, key=lambda pair: pair[0]):
        rest = None if measured.rest is None else change(measured.rest)
        changed = replace(measured, correspondence=change(press), rest=rest)
        try:
            judged = judge(changed, other, limit)
        except InputError:  # no such mirror
            continue
        if judged is None:
            continue
        better = judged.raw < limit and (judged.exact or judged.chi2 < 0.5 * described.chi2)
        if judged.likely and better:
            return words
    return None


def likely_mistake_at_rest(rest: Correspondence, scene: Scene) -> str | None:
    """The mistake without which the rest capture is one of a flat mirror, in words; None where none is, or
    the scene is likely as it stands."""
    misfit = rest_misfit(rest, scene)
    if misfit <= LIKELY:
        return None
    found = [(rest_misfit(change(rest), other), words) for words, change, other in _mistakes(scene)]
    some = [each for each in found if each[0] < min(LIKELY, _BETTER * misfit)]
    return min(some)[1] if some else None


def rest_misfit(rest: Correspondence, scene: Scene) -> float:
    """Mean square of the errors, in standard deviations, that the rig needs so that a flat mirror explains
    the rest capture, and of what they leave; 0 where nothing is comparable.

    Minimises |a|^2 + sum (y - J a)^2 / s^2 over the errors a, y the deviation from the flat mirror in px, s
    at least a pixel and a tenth of y.
    """
    known = typed_covariance(scene)
    step = max(1, min(rest.u.shape) // _LINES)
    flat = flat_mirror(strided(scene, step))
    places = np.stack([rest.u[::step, ::step], rest.v[::step, ::step]])
    some = rest.good[::step, ::step] & np.isfinite(flat).all(axis=0) & np.isfinite(places).all(axis=0)
    if known is None or not some.any():
        return 0.0
    deviation = (places - flat)[:, some].ravel()
    own = parameter_values(scene)

    def moved(row: Floats) -> Floats:
        values = {name: own[name] + _STEP * by for name, by in zip(known.names, row, strict=True)}
        change: Floats = (flat_mirror(strided(adjusted(scene, values), step)) - flat)[:, some].ravel() / _STEP
        return np.nan_to_num(change)

    fields = np.stack([moved(row) for row in known.root], axis=1)
    size = max(_NOISE, _TENTH * float(np.sqrt(np.mean(deviation**2))))
    normal = fields.T @ fields / size**2 + np.eye(fields.shape[1])
    errors = np.linalg.solve(normal, fields.T @ deviation / size**2)
    left = deviation - fields @ errors
    return float(np.mean(errors**2) + np.mean(left**2) / size**2)


def _mistakes(scene: Scene) -> Iterator[_Mistake]:
    cols, rows, pitch = scene.pattern.cols, scene.pattern.rows, scene.pattern.pitch
    turns = {
        "u runs the other way along the display": (False, True, False),
        "v runs the other way along the display": (False, False, True),
        "the display is turned by 180 degrees": (False, True, True),
        "u and v are exchanged": (True, False, False),
        "the display is turned by 90 degrees (u and v exchanged, u reversed)": (True, True, False),
        "the display is turned by 270 degrees (u and v exchanged, v reversed)": (True, False, True),
        "u and v are exchanged and both reversed": (True, True, True),
    }
    for words, (swapped, along_u, along_v) in turns.items():

        def turned(
            c: Correspondence, swap: bool = swapped, u: bool = along_u, v: bool = along_v
        ) -> Correspondence:
            if swap:
                c = replace(c, u=c.v, v=c.u, sigma_u=c.sigma_v, sigma_v=c.sigma_u)
            return replace(c, u=cols - 1 - c.u if u else c.u, v=rows - 1 - c.v if v else c.v)

        yield _Mistake(words, turned, scene)
    for words, ratio in _RATIOS.items():
        scaled = replace(scene, pattern=replace(scene.pattern, pitch=ratio * pitch))
        yield _Mistake(f"pattern.pitch_mm is {words}", lambda c: c, scaled)

        def resized(c: Correspondence, by: float = ratio) -> Correspondence:
            return replace(c, u=by * c.u, v=by * c.v, sigma_u=by * c.sigma_u, sigma_v=by * c.sigma_v)

        yield _Mistake(f"the sequence has cells {words} than the scene's pattern", resized, scene)
