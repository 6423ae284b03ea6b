"""Draws of two effects at once, or of one structural fault, decoded and judged; a number's draw is always the
same."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from optolever.decode import Correspondence, check, decode
from optolever.errors import InputError
from optolever.experiments.bench.measures import SIGMAS
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import AreaTrace, trace_area
from optolever.reconstruct import reconstruct
from optolever.scene import Scene, Trace

from ..hard.found import least_limit
from ..hard.rigs import KINDS as RIGS
from ..hard.rigs import Rig, draw_rig
from .effects import FAULTS, LIGHT, Frames, drawn_camera, drawn_effect, finer, light_of_effects, read
from .structural import KINDS, drawn_structural

__all__ = ["Drawn", "Judged", "drawn_pair", "drawn_structure", "judged"]

Mask = NDArray[np.bool_]
SIZE = 150, 180
CODES = ("gray+phase", "phase", "gray", "phase:steps=3,periods=8.73782/8.05745/8", "gray+phase:inverses=true")
SHARES = (0.4, 0.25, 0.15, 0.1, 0.1)
_SEED, _SEED_STRUCTURAL = 6100, 6101
_LIT = 0.15  # share of the image that sees the pattern, at least
_RAYS = 4  # along each side of a pixel
#: Of the lit pixels, how many a fault must change by how many deviations of the noise to be measurable.
_CHANGED, _DEVIATIONS = 0.01, 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A capture with its truth.

    frames (N, H, W), described by `sequence`; truth: of the pixels' centres; lit: all of whose rays meet the
    pattern; wrong: numbers of the frames that are not those described; causes: words one of which a true
    cause holds (empty: frames are named by number); heights: whether they are asked for.
    """

    number: int
    code: str
    what: str
    scene: Scene
    sequence: Sequence
    frames: Frames
    truth: Trace
    lit: Mask
    wrong: frozenset[int]
    causes: tuple[str, ...] = ()
    heights: bool = True


@dataclass(frozen=True, slots=True)
class Judged:
    """What a draw gave.

    good: share of the lit pixels; places, heights: share of the good ones that are off by more than 5 sigma
    (NaN: none is good, or heights were not asked for); named: 'right' (the frames and no others; the true
    cause), 'partly' (some of the frames, or more), 'false' (others), '' (nothing); left_out: whether the
    wrong frames are decoded without, or put back; told: notices.
    """

    number: int
    code: str
    what: str
    good: float
    places: float
    heights: float
    named: str
    left_out: bool
    told: tuple[str, ...]

    @property
    def silent(self) -> float:
        """Share of heights, or of places where there are none, silently beyond 5 sigma."""
        return float(np.nan_to_num(self.heights if np.isfinite(self.heights) else self.places))

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def drawn_pair(number: int) -> Drawn:
    """Two effects of LIGHT and FAULTS on a drawn rig. Faults that change nothing are drawn again."""
    rng = np.random.default_rng([_SEED, number])
    rig, area = _drawn_rig(rng, number)
    code = str(rng.choice(CODES, p=SHARES))
    names = [str(name) for name in rng.choice([*LIGHT, *FAULTS], 2, replace=False)]
    if "coarse" in names:
        rig = finer(rig, float(np.exp(rng.uniform(*np.log(LIGHT["coarse"])))), area)
        area = trace_area(rig.scene, rig.surface, _RAYS)
    shown = sequence_from_text(code, rig.scene.pattern.rows, rig.scene.pattern.cols)
    camera, seed = drawn_camera(rng), int(rng.integers(1 << 30))
    while True:
        effects = tuple(drawn_effect(rng, name, shown) for name in names)
        seed += 2  # a window may be where nothing is seen
        light = light_of_effects(area, rig, shown, effects, np.random.default_rng(seed))
        frames = read(light, camera, effects, np.random.default_rng(seed + 1))
        rest = tuple(one for one in effects if one.name not in FAULTS)
        if len(rest) == 2:
            break
        whole = read(light, camera, rest, np.random.default_rng(seed + 1))
        if _differ(frames, whole, area.visible, camera.noise):
            break
    faults = [one for one in effects if one.name in FAULTS]
    wrong = frozenset(i for one in faults for i in (one.frames[:1] if one.name == "torn" else one.frames))
    what = ", ".join(map(str, effects))
    return Drawn(number, code, what, rig.scene, shown, frames, area.centre, area.visible, wrong)


def drawn_structure(number: int) -> Drawn:
    """A structural fault on a drawn rig."""
    rng = np.random.default_rng([_SEED_STRUCTURAL, number])
    rig, area = _drawn_rig(rng, number)
    kind = list(KINDS)[number % len(KINDS)]
    codes, causes = KINDS[kind]
    code = str(rng.choice(codes))
    described = sequence_from_text(code, rig.scene.pattern.rows, rig.scene.pattern.cols)
    camera, seed = drawn_camera(rng), int(rng.integers(1 << 30))
    plain = light_of_effects(area, rig, described, (), np.random.default_rng(seed))
    whole = read(plain, camera, (), np.random.default_rng(seed + 1))
    while True:
        seed += 2
        fault = drawn_structural(rng, number, len(described))
        effects = (drawn_effect(rng, "window", described),) if kind == "window" else ()
        light = light_of_effects(area, rig, fault.shown(described), (), np.random.default_rng(seed))
        frames = fault.spoil(read(light, camera, effects, np.random.default_rng(seed + 1)), described)
        if _differ(frames, whole, area.visible, camera.noise):
            break
    what = f"{kind} {fault.frame} {fault.other}" + "".join(f", {one}" for one in effects)
    of_rig = rig.scene, described, frames, area.centre, area.visible
    return Drawn(number, code, what, *of_rig, frozenset(), causes, False)


def _drawn_rig(rng: np.random.Generator, number: int) -> tuple[Rig, AreaTrace]:
    while True:
        rig = draw_rig(rng, RIGS[number % len(RIGS)], SIZE)
        if rig.lit >= _LIT:
            return rig, trace_area(rig.scene, rig.surface, _RAYS)


def _differ(frames: Frames, whole: Frames, lit: Mask, noise: float) -> bool:
    """Whether a fault changes anything measurable."""
    apart = np.abs(frames.astype(np.int16) - whole).max(axis=0)[lit]
    return bool(np.mean(apart > _DEVIATIONS * noise + 2) > _CHANGED)


def judged(draw: Drawn) -> Judged:
    """Decode a draw and compare with the truth."""
    found, lit = decode(draw.frames, draw.sequence), draw.lit
    told = tuple(str(one) for one in found.notices)
    named, left = _named_cause(draw, told) if draw.causes else _named_frames(draw)
    good, shared, truth = found.good & lit, found.shared_noise, draw.truth
    shifts = (0.0, 0.0) if shared is None else (shared.shift_u, shared.shift_v)
    wrong = np.zeros(lit.shape, np.bool_)
    axes = (found.u, found.sigma_u, truth.u, shifts[0]), (found.v, found.sigma_v, truth.v, shifts[1])
    for place, sigma, true, shift in axes:
        limit = np.maximum(SIGMAS * np.hypot(sigma, shift), least_limit(draw.sequence))
        wrong |= ~(np.abs(place - true) <= limit)
    places = float(wrong[good].mean()) if good.any() else float("nan")
    heights = _heights_beyond(draw, found) if draw.heights and good.any() else float("nan")
    share = float(found.good[lit].mean())
    return Judged(draw.number, draw.code, draw.what, share, places, heights, named, left, told)


def _named_frames(draw: Drawn) -> tuple[str, bool]:
    """How the wrong frames are named, and whether they are left out."""
    findings = [one for one in check(draw.frames, draw.sequence).findings if one.frames]
    if not findings:
        return "", False
    told = {i for one in findings for i in one.frames}
    named = "right" if told == draw.wrong else "partly" if told & draw.wrong else "false"
    return named, any(one.put_back or draw.wrong <= set(one.leave_out) for one in findings)


def _named_cause(draw: Drawn, told: tuple[str, ...]) -> tuple[str, bool]:
    """Notices that name a frame or say what was shown instead."""
    causes = [one for one in told if any(word in one for word in ("frame ", "frames ", "shown", "described"))]
    causes = [one for one in causes if not one.startswith(_NO_CAUSES)]
    if not causes:
        return "", False
    return ("right" if any(word in one for one in causes for word in draw.causes) else "false"), False


#: Notices that name no frame and no cause.
_NO_CAUSES = (
    "frames contradict each other",
    "neighbours differ",
    "codes contradict",
    "some frames, or parts",
    "frames do not fit",
)


def _heights_beyond(draw: Drawn, found: Correspondence) -> float:
    """Share of the good heights that are off by more than 5 sigma, anchored at a true point."""
    truth = draw.truth
    inside = distance_transform_cdt(np.pad(found.good & truth.visible, 1))[1:-1, 1:-1]
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    anchor = float(truth.x[at]), float(truth.y[at]), float(truth.z[at])
    try:
        height = reconstruct(found, draw.scene, anchor=anchor)
    except InputError:
        return float("nan")
    good = (height.flags == 0) & truth.visible
    beyond = np.abs(height.z - truth.z) > SIGMAS * height.sigma
    return float(beyond[good].mean()) if good.any() else float("nan")
