"""Errors that a height map shares with other maps of the same references: a rest capture, an anchor.

Part of `sigma`, as each map alone has them; a difference of two maps counts them once, see
`HeightMap.difference`.
"""

import hashlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence

from .arrays import Floats, Mask
from .heightmap import HeightMap
from .problem import Problem
from .result import height_sigma
from .solver.anchors import Anchors
from .solver.newton import State
from .uncertainty.sources import ANCHORS

__all__ = ["with_references"]


def with_references(
    height: HeightMap,
    problem: Problem,
    state: State,
    noise: dict[str, Floats],
    corrected: Correspondence,
    anchor: Anchors,
    rest: Correspondence | None,
) -> HeightMap:
    """The height with its `references` and their part of sigma, `shared`; noise: see `sources`; corrected:
    the correspondence less the rest capture's deviation, the variances of both added."""
    known = noise.get(ANCHORS, np.zeros(state.w.shape))
    settled = height_sigma(problem, state, known)
    parts: list[tuple[str, Floats]] = []
    if np.nanmax(settled, initial=0.0) > 0:
        parts.append((f"anchor {anchor!r}", np.fmin(settled, height.sigma)))
    if rest is not None:
        both = corrected.good & rest.good
        share = _variance(rest, both) / _variance(corrected, both) if both.any() else 0.0
        others = np.sqrt(np.maximum(height.sigma**2 - np.nan_to_num(settled) ** 2, 0.0))
        parts.append((f"rest {_digest(rest)}", np.sqrt(share) * others))
    if not parts:
        return height
    names, sigmas = tuple(name for name, _ in parts), np.stack([part for _, part in parts])
    return replace(height, references=names, shared=sigmas)


def _variance(correspondence: Correspondence, known: Mask) -> float:
    """Of u and v together, median of the known pixels, pattern px^2."""
    sigmas = (correspondence.sigma_u, correspondence.sigma_v)
    return sum(float(np.median(sigma[known])) ** 2 for sigma in sigmas)


def _digest(correspondence: Correspondence) -> str:
    parts: tuple[NDArray[np.floating], ...] = (correspondence.u, correspondence.v)
    return hashlib.blake2b(
        b"".join(np.ascontiguousarray(part).tobytes() for part in parts), digest_size=8
    ).hexdigest()
