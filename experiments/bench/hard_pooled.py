"""Figures over all draws of a family of hard cases: shares of draws, of faults, of pixels."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .hard_case import LIMIT, REFUSED, Result

__all__ = ["Pooled", "pooled"]

GOOD_EDGES = 0.95  # share of pixels away from edges that are to be good
FLAGGED = 0.05  # median over rigs of the flagged share of the pixels that see the pattern


@dataclass(frozen=True, slots=True)
class Pooled:
    """A figure over `count` draws, faults or pixels, and its limit, if any: lower (at_least) or upper."""

    name: str
    value: float
    count: int
    limit: float | None = None
    at_least: bool = False

    @property
    def met(self) -> bool:
        """True within the limit, or of nothing."""
        if self.limit is None or math.isnan(self.value):
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "met": self.met}


def pooled(results: Iterable[Result]) -> list[Pooled]:
    """The figures of drawn rigs, scenes with edges, curved mirrors and wrong scenes; none without any."""
    listed = list(results)
    rigs = [one for one in listed if one.case.part == "decode" and one.case.name.startswith("random ")]
    edges = [one for one in listed if one.case.part == "edges"]
    curved = [one for one in listed if one.case.part == "curved"]
    of_curved = [
        figure
        for code in dict.fromkeys(one.case.subject for one in curved)
        for figure in _of_code(code, curved)
    ]
    scenes = _of_scenes([one for one in listed if one.case.part == "scene"])
    return (_of_rigs(rigs) if rigs else []) + (_of_edges(edges) if edges else []) + of_curved + scenes


def _of_scenes(draws: list[Result]) -> list[Pooled]:
    """Of right and wrong scenes: how many are noticed, median error over the depth, by what case they are."""
    figures = []
    for name in dict.fromkeys(one.case.name.partition(":")[0] for one in draws):
        own = [one for one in draws if one.case.name.partition(":")[0] == name]
        told = [one.frames.findings != () for one in own if one.frames is not None]
        errors = [one.error for one in own if not math.isnan(one.error)]
        if told:
            figures.append(_share(f"{name}, noticed", sum(told), len(told)))
        if errors:
            figures.append(Pooled(f"{name}, error, median", float(np.median(errors)), len(errors)))
    return figures


def _of_code(code: str, results: list[Result]) -> list[Pooled]:
    """Silent errors and scores of one code on all mirrors that bend inside of a pixel."""
    own = [one for one in results if one.case.subject == code]
    told = [(one.unflagged, one.normalised) for one in own if not math.isnan(one.normalised)]
    count = sum(pixels for pixels, _ in told)
    square = sum(pixels * score**2 for pixels, score in told) / max(count, 1)
    return [
        _silent(f"silent errors of {code} on curved mirrors", own, LIMIT),
        Pooled(f"rms(error / sigma) of {code} there (worse of u, v; true: 1.28)", math.sqrt(square), count),
    ]


def _of_rigs(rigs: list[Result]) -> list[Pooled]:
    """A rig that is refused is flagged altogether."""
    flagged = [1.0 if math.isnan(one.flagged) else one.flagged for one in rigs]
    normalised = [one.normalised for one in rigs if not math.isnan(one.normalised)]
    return [
        _share("rigs failed", sum(one.fault for one in rigs), len(rigs), 0.0),
        _share("rigs refused", sum(one.verdict == REFUSED for one in rigs), len(rigs)),
        _silent("silent errors on rigs, of unflagged pixels", rigs, LIMIT),
        Pooled("flagged share of a rig, median", float(np.median(flagged)), len(rigs), FLAGGED),
        Pooled(
            "rms(error / sigma) of a rig, median (worse of u, v; true: 1.28)",
            float(np.median(normalised)) if normalised else math.nan,
            len(normalised),
        ),
    ]


def _of_edges(draws: list[Result]) -> list[Pooled]:
    judged = [(one, one.frames) for one in draws if one.frames is not None]
    clean = [(one, frames) for one, frames in judged if not frames.fault]
    asked = [(one, frames) for one, frames in judged if frames.counts]
    right, wrong = [one for one, _ in clean], [one for one, _ in asked]
    good, pixels = sum(one.unflagged for one in right), sum(one.pixels for one in right)
    accused = sum(frames.accused > 0 for _, frames in clean)
    named = sum(frames.named for _, frames in asked)
    findings = sum(frames.findings != () for _, frames in clean)
    return [
        _share("right frames accused, of draws", accused, len(clean), 0.0),
        _share("wrong frames named, of faults that count", named, len(asked), 0.95, True),
        _share("good pixels away from edges", good, pixels, GOOD_EDGES, True),
        _silent("silent errors there, of unflagged pixels", right, LIMIT),
        _share("draws with a finding, of right ones", findings, len(clean)),
        _silent("silent errors under faults that count", wrong),
        _share("draws refused or failed", len(draws) - len(judged), len(draws), 0.0),
    ]


def _silent(name: str, results: list[Result], limit: float | None = None) -> Pooled:
    return _share(
        name, sum(one.silent_count for one in results), sum(one.unflagged for one in results), limit
    )


def _share(name: str, some: float, count: int, limit: float | None = None, at_least: bool = False) -> Pooled:
    return Pooled(name, some / count if count else math.nan, count, limit, at_least)
