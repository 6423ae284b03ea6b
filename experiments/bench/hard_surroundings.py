"""Hard cases of the decoder: a mirror that fills a part of the image, in surroundings.

Every case decodes the same mirror twice: alone, filling the image, and cut out with something around it. In
the pixels that the mirror fills, light and noise are the same to the last bit, so that whatever is worse
comes from the surroundings.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, check, decode
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import AreaTrace, area_light, expose, trace_area
from optolever.scene import Scene, Sensor, dent_from_text, load, resize

from ..faults import Fault
from .found import Found, FrameVerdict, found_area
from .hard_case import Case
from .surroundings import AROUND, FORMS, mirror_mask, surrounded

__all__ = ["FILLS", "NOISES", "SEQUENCES", "Surroundings", "covering", "surroundings_cases"]

Frames = NDArray[Any]
Mask = NDArray[np.bool_]
Values = tuple[tuple[Any, ...], ...]

SEQUENCES = ("gray+phase", "phase", "phase:steps=3", "micro-phase", "gray")
NOISES = (0.3, 1.0, 2.5)
FILLS = (0.6, 0.3, 0.1, 0.03)
SCENES = ("prism48", "paper-simulation", "monitor-mirror")
QUICK = 12
"""So many of the list, from its start, for a quick look: each holds as many new pairs of values as it can."""

FAULT_SIZE = 128
"""Rows and columns, at most, of an image in whose frames every single fault is tried."""
FAULT_CASES = tuple(
    zip(SEQUENCES, (0.1, 0.3, 0.6, 0.03, 0.1), ("dark", "room", "lamp", "dark", "reflection"), strict=True)
)
_SENSOR = Sensor(offset=20.0, exposure=200.0 / 255.0)  # amplitude 100
_CHANGED = 0.01  # of the lit pixels: a fault that changes fewer of them by 3 times the noise need not be told


@dataclass(frozen=True, slots=True)
class Surroundings:
    """sequence; noise (8-bit levels); fill: share of the image that the mirror takes; form, around: see
    surroundings.FORMS, AROUND; scene: of the mirror.
    """

    sequence: str
    noise: float
    fill: float
    form: str
    around: str
    scene: str

    @property
    def name(self) -> str:
        """For the list of cases."""
        return f"surroundings {self.around}, {self.form} mirror {100 * self.fill:g} %"


def surroundings_cases(size: tuple[int, int], quick: bool = False, every: bool = False) -> Iterator[Case]:
    """A list that holds every combination of sequence, fill and surroundings, and every pair of two values
    (quick: a dozen of it; every: the full product); then faults of frames.
    """
    values = (SEQUENCES, NOISES, FILLS, tuple(FORMS), tuple(AROUND), SCENES)
    if every:
        chosen = [Surroundings(*each) for each in product(*values)]
    else:
        groups = (*combinations(range(len(values)), 2), (0, 2, 4))
        chosen = [Surroundings(*each) for each in covering(values, groups, 0)]
    for each in chosen[: QUICK if quick else None]:
        make = partial(_decoded, each, size)
        yield Case("decode", each.name, f"{each.sequence} on {each.scene}", size, make, each.noise, "uint8")
    for sequence, fill, around in FAULT_CASES[: 2 if quick else None]:
        each = Surroundings(sequence, 1.0, fill, "round", around, "prism48")
        name = each.name.replace("surroundings", "surroundings and frame faults:")
        small = min(size[0], FAULT_SIZE), min(size[1], FAULT_SIZE)
        yield Case("decode", name, sequence, small, partial(_frame_faults, each, small), each.noise, "uint8")


def covering(values: Values, groups: Iterable[tuple[int, ...]], seed: int) -> list[tuple[Any, ...]]:
    """Tuples of one value each that hold, for every group of positions, each combination of their values at
    least once: greedily, of 60 drawn ones the one that holds most combinations that are missing.
    """
    rng, groups = np.random.default_rng([27, seed]), tuple(groups)
    missing = {(group, each) for group in groups for each in product(*(values[at] for at in group))}
    chosen = []
    while missing:
        drawn = [tuple(each[rng.integers(len(each))] for each in values) for _ in range(60)]
        held = [{(group, tuple(one[at] for at in group)) for group in groups} & missing for one in drawn]
        best = max(range(len(drawn)), key=lambda at: len(held[at]))
        if held[best]:
            chosen.append(drawn[best])
            missing -= held[best]
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class _Alone:
    """A mirror that fills the image: its light (N, H, W) and what was decoded of it."""

    area: AreaTrace
    shown: Sequence
    light: NDArray[np.float32]
    found: Correspondence


@lru_cache(maxsize=4)
def _area(name: str, size: tuple[int, int]) -> tuple[Scene, AreaTrace]:
    scene = resize(load(name), *size)
    return scene, trace_area(scene, dent_from_text("gaussian", scene))


@lru_cache(maxsize=32)
def _alone(name: str, text: str, noise: float, size: tuple[int, int]) -> _Alone:
    scene, area = _area(name, size)
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    light = area_light(area, shown)
    return _Alone(area, shown, light, decode(_taken(light, shown, noise), shown))


def _taken(light: NDArray[np.float32], shown: Sequence, noise: float) -> Frames:
    return expose(light, shown, replace(_SENSOR, noise=noise), seed=5)


def _mask(case: Surroundings, size: tuple[int, int]) -> Mask:
    rng = np.random.default_rng([31, *size, round(1000 * case.fill), list(FORMS).index(case.form)])
    return mirror_mask(case.form, case.fill, size, rng)


def _decoded(case: Surroundings, size: tuple[int, int]) -> Found:
    """Errors in the mirror's pixels, and those of the same pixels where it fills the image."""
    alone, mask = _alone(case.scene, case.sequence, case.noise, size), _mask(case, size)
    light = surrounded(alone.light, mask, case.around, np.random.default_rng(8))
    try:
        found = decode(_taken(light, alone.shown, case.noise), alone.shown)
    except InputError as error:
        raise RuntimeError(f"refused, though not alone: {error}") from error
    reference = _within(found_area(alone.found, alone.area, alone.shown), mask, beside=False)
    here = _within(found_area(found, alone.area, alone.shown), mask, beside=case.around != "reflection")
    return replace(here, reference=reference)


def _within(found: Found, mask: Mask, beside: bool) -> Found:
    """What was found in the mirror's pixels; beside: nothing else may be unflagged either."""
    outside = ~mask if beside else np.zeros_like(mask)
    flags = np.where(mask | outside, found.flags, int(Flag.INVALID))
    return replace(
        found, expected=found.expected & mask, beside=np.where(mask, found.beside, outside), flags=flags
    )


def _frame_faults(case: Surroundings, size: tuple[int, int]) -> tuple[FrameVerdict, ...]:
    """Swaps of neighbouring frames and lost frames: those that are detected where the mirror fills the image,
    and change at least 1 % of the mirror's pixels by 3 times the noise, are to be detected here.
    Not so a bit swapped with its inverse where the mirror sees one block of it alone: that is the picture of
    another mirror.
    """
    alone, mask = _alone(case.scene, case.sequence, case.noise, size), _mask(case, size)
    light = surrounded(alone.light, mask, case.around, np.random.default_rng(8))
    full, here = (_taken(each, alone.shown, case.noise) for each in (alone.light, light))
    lit = alone.light[:, mask & alone.area.visible] * np.float32(255.0 * _SENSOR.exposure)
    seen = {"u": alone.area.centre.u[mask], "v": alone.area.centre.v[mask]}
    verdicts = []
    for fault in _faults(len(full)):
        if _mirrors(fault, alone.shown, seen):
            continue
        moves = bool((np.abs(fault.spoil(lit) - lit) > 3.0 * case.noise).any(axis=0).mean() >= _CHANGED)
        hidden = not (moves and _is_detected(fault.spoil(full), alone.shown, mask))
        named = not hidden and _is_detected(fault.spoil(here), alone.shown, mask)
        verdicts.append(FrameVerdict(str(fault), moves, hidden, named))
    return tuple(verdicts)


def _faults(count: int) -> Iterator[Fault]:
    """Neighbours swapped, one frame lost."""
    for index in range(count - 1):
        yield Fault("swapped", index, index + 1)
        yield Fault("lost", index, index)


def _mirrors(fault: Fault, shown: Sequence, seen: dict[str, NDArray[Any]]) -> bool:
    """Whether a bit is swapped with its inverse, and what is seen (px) lies in one of its blocks, which that
    turns round."""
    if not fault.inverts(shown):
        return False
    first = shown.frames[fault.frame]
    assert first.axis is not None
    assert first.bit is not None
    blocks = np.floor(seen[first.axis] / ((first.cell_px or 1.0) * 2.0 ** (first.bit + 1)))
    return bool(np.ptp(blocks[np.isfinite(blocks)]) == 0)


def _is_detected(frames: Frames, shown: Sequence, mask: Mask) -> bool:
    """A finding, frames refused, or most of the mirror's pixels flagged for it."""
    try:
        found = decode(frames, shown)
        if check(frames, shown, found).findings:
            return True
    except InputError:
        return True
    return bool(((found.flags[mask] & int(Flag.WRONG_FRAME)) != 0).mean() > 0.5)
