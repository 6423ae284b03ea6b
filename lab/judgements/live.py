"""Judgements of `live`: streams of eleven kinds and faults of frames, by the independent renderer."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from optolever.live import Live, Reading
from optolever.scene import load, resize

from ..live.streams import FAULTS, KINDS, StreamRig, stream_rig
from ..live.world import GAUSS, photons
from .record import Row

__all__ = ["rows"]

Frame = NDArray[np.uint8]
Rng = np.random.Generator

_PART, _SIZE = "live", (240, 320)
_DENT = ((GAUSS, 28.0, 22.0, 6.0, 0.1),)
#: Test -> how its notice begins, or words of the reason.
TESTS = {
    "moved": "moved as a whole",
    "rolled": "rolled",
    "load": "does not sink as under a load",
    "saturated": "Saturated pixels",
    "lost": "Cells without a height",
    "too few cells": "too few cells",
    "edge": "edge of the mirror",
    "dust": "Dust",
    "converged": "converge",
    "circulation": "slopes contradict",
    "steep": "too steep",
    "blur": "; loss of contrast",
    "more light": "More light",
    "less light": "Less light",
}
#: Fault of a frame -> the tests that may name it.
NAMED_BY: dict[str, tuple[str, ...]] = {
    "black": ("too few cells", "less light"),
    "white": ("too few cells", "saturated"),
    "torn": ("circulation", "too few cells"),
    "covered": ("lost", "too few cells"),
    "bumped": ("moved",),
    "rolled": ("moved", "too few cells", "circulation"),
    "saturated": ("saturated", "more light", "too few cells"),
    "light": ("less light",),
}
#: Kind of streams with nothing wrong -> tests that may speak, as of a dent whose flank shows no fringe.
_STEEP = ("lost", "steep", "converged", "circulation")
RIGHT: dict[str, tuple[str, ...]] = {
    "smooth press": (),
    "two slide": (),
    "ball 3 mm, half-space": (),
    "ball 4 mm rolls": (),
    "ball 5 mm, half-space": _STEEP,
    "deep 2 mm": _STEEP,
    "deep 3 mm": _STEEP,
    "lamp": ("more light",),
}


def _lighter(frame: Frame) -> Frame:
    """The lamp of a room is on."""
    return np.clip(frame.astype(np.int64) + 25, 0, 255).astype(np.uint8)


def _dusty(frame: Frame) -> Frame:
    """16 pixels without a fringe, off the dents."""
    found = frame.copy()
    found[40:56, 40:56] = np.uint8(frame.mean())
    return found


#: Changes of a frame that touch no height beside them -> tests that name them.
BESIDE: dict[str, tuple[Callable[[Frame], Frame], tuple[str, ...]]] = {
    "room light": (_lighter, ("more light", "blur")),
    "dust of 16 px": (_dusty, ("dust",)),
}


def rows(seeds: int) -> list[Row]:
    """Of every test on frames of right streams, and of every fault of a frame."""
    rig = stream_rig(resize(load("prism48"), *_SIZE))
    found = []
    for kind, allowed in RIGHT.items():
        named = [_named(_frame(rig, kind, seed)) - set(allowed) for seed in range(seeds)]
        found += _alarms(kind, named)
    for name, (change, tests) in BESIDE.items():
        named = [_named(_frame(rig, "smooth press", seed, change)) for seed in range(seeds)]
        found += _alarms(name, [one - set(tests) for one in named])
        missed = sum(not one & set(tests) for one in named)
        found.append(Row(_PART, ", ".join(tests), name, math.nan, 0, 0, len(named), missed))
    for name, fault in FAULTS.items():
        named = [_named(_faulty(rig, fault, seed)) for seed in range(seeds)]
        missed = sum(not one & set(NAMED_BY[name]) for one in named)
        found.append(Row(_PART, ", ".join(NAMED_BY[name]), name, math.nan, 0, 0, len(named), missed))
    return found


def _alarms(kind: str, named: list[set[str]]) -> list[Row]:
    """Rows of every test on frames with nothing wrong."""
    return [
        Row(_PART, test, kind, math.nan, len(named), sum(test in one for one in named), 0, 0)
        for test in TESTS
    ]


def _named(reading: Reading) -> set[str]:
    said = [reading.reason, *(notice.name for notice in reading.notices)]
    return {test for test, words in TESTS.items() if any(words in one for one in said)}


def _frame(
    rig: StreamRig, kind: str, seed: int, change: Callable[[Frame], Frame] = lambda frame: frame
) -> Reading:
    """Of a press at half of a stream."""
    rng = np.random.default_rng([91, seed])
    moment = KINDS[kind](rng.uniform(26, 34), rng.uniform(18, 27), rng.uniform(0.3, 1.0), 0.5)
    return Live(rig.prepared).update(change(photons(rig.shown(moment)[0], rng)))


def _faulty(rig: StreamRig, fault: Callable[[Frame, Frame], Frame], seed: int) -> Reading:
    """Of a fault after a good frame."""
    rng, live = np.random.default_rng([92, seed]), Live(rig.prepared)
    before, now = (photons(rig.light(dents), rng) for dents in ((), _DENT))
    live.update(before, 0.0)
    return live.update(fault(now, before), 1 / 60)
