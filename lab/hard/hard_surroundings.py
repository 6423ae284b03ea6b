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

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, check, decode
from optolever.errors import InputError
from optolever.experiments.arrays import Mask
from optolever.experiments.ideal import Fault
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import AreaTrace, area_light, expose, trace_area
from optolever.scene import Scene, Sensor, dent_from_text, load, resize

from .found import Found, FrameVerdict, found_area
from .hard_case import Case

Light = NDArray[np.float32]

_GHOST = 0.04  # of a second reflection of the pattern
_SHIFT = (0.21, -0.34)  # by which it is shifted, shares of the image
_LAMP = 2.0  # light of the lamp in its middle, of a fully lit pixel
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


def surrounded(light: Light, mask: Mask, around: str, rng: np.random.Generator) -> Light:
    """Light (N, H, W) of an image whose mirror fills `mask`; around it is what AROUND[around] makes."""
    return np.where(mask, light, AROUND[around](light, mask, rng)).astype(np.float32)


def _round(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """A disk; what the image would cut off of it is added elsewhere."""
    radius = np.sqrt(fill * shape[0] * shape[1] / np.pi)
    rows, cols = shape
    row = _between(rng, radius, rows - 1 - radius)
    col = _between(rng, radius, cols - 1 - radius)
    y, x = np.mgrid[:rows, :cols]
    distance = np.hypot(y - row, x - col)
    return np.asarray(distance <= np.quantile(distance, fill))


def _oblong(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """A rectangle three times as wide as high, or as wide as 0.95 of the image."""
    width = min(0.95, np.sqrt(3.0 * fill))
    return _rectangles([(width, fill / width)], shape, rng)


def _islands(fill: float, shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """Two rectangles side by side, 3 to 2."""
    width = min(0.9, np.sqrt(2.0 * fill))
    return _rectangles([(0.6 * width, fill / width), (0.4 * width, fill / width)], shape, rng)


def _rectangles(sizes: list[tuple[float, float]], shape: tuple[int, int], rng: np.random.Generator) -> Mask:
    """Rectangles (width, height; shares of the image) from left to right with gaps between them."""
    rows, cols = shape
    mask = np.zeros(shape, np.bool_)
    free = 1.0 - sum(width for width, _ in sizes)
    gap = max(free / (len(sizes) + 1), 0.02) * (len(sizes) > 1)
    at = float(rng.uniform(0.0, max(free - gap * (len(sizes) - 1), 0.0)))
    for width, height in sizes:
        top = float(rng.uniform(0.0, 1.0 - height))
        mask[
            round(top * rows) : round((top + height) * rows), round(at * cols) : round((at + width) * cols)
        ] = 1
        at += width + gap
    return mask


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high)) if high > low else 0.5 * (low + high)


def _dark(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """Nothing."""
    return np.zeros_like(light)


def _room(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """A lit room, constant in time: things large and small with edges, up to a fully lit pixel's light."""
    shape = mask.shape
    room = np.zeros(shape)
    for scale, share in ((24.0, 0.6), (3.0, 0.4)):
        smooth = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), scale)
        room += share * (0.5 + 0.25 * smooth / smooth.std())
    room[cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 12.0) > 0.01] *= 0.3
    return np.broadcast_to(np.clip(room, 0.0, 1.0).astype(np.float32), light.shape)


def _reflection(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """The pattern once more, dim and shifted, as from the surface of a cover glass."""
    shift = round(_SHIFT[0] * mask.shape[0]), round(_SHIFT[1] * mask.shape[1])
    return np.asarray(_GHOST * np.roll(light, shift, axis=(1, 2)), np.float32)


def _lamp(light: Light, mask: Mask, rng: np.random.Generator) -> Light:
    """A lamp as far as possible from the mirror that saturates in its middle, and its glow."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    row, col = np.unravel_index(int(away.argmax()), mask.shape)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    distance = np.hypot(y - row, x - col) / (0.08 * np.sqrt(mask.size))
    lamp = _LAMP * np.exp(-np.minimum(distance, 50.0))
    return np.broadcast_to(lamp.astype(np.float32), light.shape)


#: Pixels (H, W) that a mirror takes: the share `fill` of the image, somewhere in it.
FORMS = {"round": _round, "oblong": _oblong, "islands": _islands}
#: What is in the image beside them.
AROUND = {"dark": _dark, "room": _room, "reflection": _reflection, "lamp": _lamp}


@dataclass(frozen=True, slots=True)
class Surroundings:
    """sequence; noise (8-bit levels); fill: share of the image that the mirror takes; form, around: see
    FORMS, AROUND; scene: of the mirror.
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


def covering(
    values: tuple[tuple[Any, ...], ...], groups: Iterable[tuple[int, ...]], seed: int
) -> list[tuple[Any, ...]]:
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
    scene = resize(load(name, exact=True), *size)
    return scene, trace_area(scene, dent_from_text("gaussian", scene))


@lru_cache(maxsize=32)
def _alone(name: str, text: str, noise: float, size: tuple[int, int]) -> _Alone:
    scene, area = _area(name, size)
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    light = area_light(area, shown)
    return _Alone(area, shown, light, decode(_taken(light, shown, noise), shown))


def _taken(light: NDArray[np.float32], shown: Sequence, noise: float) -> NDArray[Any]:
    return expose(light, shown, replace(_SENSOR, noise=noise), seed=5)


def _mask(case: Surroundings, size: tuple[int, int]) -> Mask:
    rng = np.random.default_rng([31, *size, round(1000 * case.fill), list(FORMS).index(case.form)])
    return FORMS[case.form](case.fill, size, rng)


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


def _is_detected(frames: NDArray[Any], shown: Sequence, mask: Mask) -> bool:
    """A finding, frames refused, or most of the mirror's pixels flagged for it."""
    try:
        found = decode(frames, shown)
        if check(frames, shown).findings:
            return True
    except InputError:
        return True
    return bool(((found.flags[mask] & int(Flag.WRONG_FRAME)) != 0).mean() > 0.5)
