"""Judgements of `decode`: right captures of every kind of light, and wrong ones of every kind of fault.

A fault counts where it does harm: more than 2 % of the pixels that would be good are wrong by more than five
sigma and half a pixel. It is missed where more than 2 % of the good ones are, and no notice names it.
"""

import math
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Decoder, Flag, decode, estimate_profile
from optolever.projector import Capture

from ..figures.house import ROOT
from .captures import CODES, LIGHTS, Drawn, draw
from .faults import faults
from .record import Row

__all__ = ["rows"]

_PART, _HARM, _FEWEST = "decode", 0.02, 20
#: Notices that judge no picture.
_WEAK = ("sigma is", "the mirror moved")
_REAL, _WINDOW = ROOT.parent / "shared" / "real" / "refused", 80


def rows(seeds: int, codes: Collection[str] = CODES) -> list[Row]:
    """Of every test on every kind of right captures; of every kind of fault, without and with a profile."""
    found = []
    for kind, light in LIGHTS.items():
        drawn = (draw(code, light, seed) for seed in range(seeds) for code in codes)
        found += _right(kind, (decode(one.frames, one.sequence) for one in drawn))
    for folder in sorted(_REAL.glob("*")):
        found += _right(folder.name, _windows(folder, 5 * seeds))
    counts = dict[str, list[int]]()
    for seed in range(seeds):
        for code in codes:
            for kind, missed in _wrong(draw(code, LIGHTS["clean"], seed), seed):
                counts.setdefault(kind, [0, 0])[0] += 1
                counts[kind][1] += missed
    return found + [Row(_PART, "any", kind, math.nan, 0, 0, *count) for kind, count in counts.items()]


def _right(kind: str, captures: Iterator[Correspondence]) -> list[Row]:
    figures = dict[str, tuple[float, list[bool]]]()
    for found in captures:
        for one in found.tests:
            figures.setdefault(one.test, (one.limit, []))[1].append(one.fails)
    return [
        Row(_PART, test, kind, limit, len(fails), sum(fails), 0, 0)
        for test, (limit, fails) in figures.items()
    ]


def _windows(folder: Path, count: int) -> Iterator[Correspondence]:
    """Parts of a right capture."""
    shot, rng = Capture.load(folder), np.random.default_rng(81)
    _, rows, cols = shot.frames.shape
    for _ in range(count):
        y, x = rng.integers(0, max(rows - _WINDOW, 0) + 1), rng.integers(0, max(cols - _WINDOW, 0) + 1)
        yield decode(shot.frames[:, y : y + _WINDOW, x : x + _WINDOW], shot.sequence)


def _wrong(right: Drawn, seed: int) -> Iterator[tuple[str, bool]]:
    """Kind of a fault that does harm, whether it is missed; of frames by a right capture's profile, too."""
    profile = estimate_profile(right.frames, right.sequence)
    for kind, frames, shown, knowable in faults(right.frames, right.sequence, np.random.default_rng(seed)):
        ways = {kind: Decoder(shown)} if knowable else {}
        if ways and shown == right.sequence:
            ways[f"{kind}, by a profile"] = Decoder(shown, profile)
        for name, decoder in ways.items():
            found = decoder.decode(frames)
            before = np.asarray(found.flags & ~np.uint16(Flag.WRONG_FRAME), np.uint16)
            if _share(right, found, before) > _HARM:
                said = any(not str(one).startswith(_WEAK) for one in found.notices)
                yield name, not said and _share(right, found, found.flags) > _HARM


def _share(right: Drawn, found: Correspondence, flags: NDArray[np.uint16]) -> float:
    """Wrong share of the lit pixels without a flag."""
    use, off = (flags == 0) & right.lit, np.zeros(right.lit.shape, np.bool_)
    for place, sigma, truth in zip(
        (found.u, found.v), (found.sigma_u, found.sigma_v), right.truth, strict=True
    ):
        coded = np.isfinite(sigma)
        off |= coded & ~(np.abs(place - truth) <= 5 * np.where(coded, sigma, 0) + 0.5)
    return float(off[use].mean()) if np.count_nonzero(use) > _FEWEST else 0.0
