"""Mistakes in the description of a rig that make a good capture an impossible one, each tried in turn."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import Scene

from .rig import Measurement, RigJudgement

__all__ = ["likely_mistake"]

_BETTER = 0.1  # of the circulation's chi2: what the right description leaves at most
_RATIOS = {"ten times larger": 10.0, "ten times smaller": 0.1, "twice as large": 2.0, "half as large": 0.5}


class _Mistake(NamedTuple):
    words: str
    measured: Measurement
    scene: Scene


def likely_mistake(
    judge: Callable[[Measurement, Scene], RigJudgement], measured: Measurement, scene: Scene, chi2: float
) -> str | None:
    """The mistake without which the capture fits its scene, in words; None where none does.

    judge: solves a measurement on a coarse grid and judges it; chi2: of the capture as it was described.
    """
    found: list[tuple[float, str]] = []
    for mistake in _mistakes(measured, scene):
        try:
            judged = judge(mistake.measured, mistake.scene)
        except InputError:  # no such mirror
            continue
        if judged.likely and judged.raw < _BETTER * chi2:
            found.append((judged.raw, mistake.words))
    return min(found)[1] if found else None


def _mistakes(measured: Measurement, scene: Scene) -> Iterator[_Mistake]:
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

        yield _Mistake(words, _each(measured, turned), scene)
    for words, ratio in _RATIOS.items():
        scaled = replace(scene, pattern=replace(scene.pattern, pitch=ratio * pitch))
        yield _Mistake(f"pattern.pitch_mm is {words}", measured, scaled)

        def resized(c: Correspondence, by: float = ratio) -> Correspondence:
            return replace(c, u=by * c.u, v=by * c.v, sigma_u=by * c.sigma_u, sigma_v=by * c.sigma_v)

        yield _Mistake(
            f"the sequence has cells {words} than the scene's pattern", _each(measured, resized), scene
        )


def _each(measured: Measurement, change: Callable[[Correspondence], Correspondence]) -> Measurement:
    rest = None if measured.rest is None else change(measured.rest)
    return replace(measured, correspondence=change(measured.correspondence), rest=rest)
