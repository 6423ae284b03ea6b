"""Scenes with depth edges, shadows, gloss and holes: right frames are not accused, wrong ones are named."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, Integrity, check, decode
from optolever.experiments.arrays import Mask
from optolever.experiments.ideal import Fault
from optolever.patterns import Sequence, sequence_from_text

from .drawn import between
from .found import Found, FrameVerdict, found_places
from .hard_case import Case
from .layered import MARGIN, SAMPLES, Gloss, Layer, Outline, Samples, World, inside, light, sampled
from .plain import plain_places, seams

Frames = NDArray[np.uint8]
Floats = NDArray[np.float32]

#: The finest stripes of a binary code are half as wide as those of a Gray code: cells of two pixels.
EDGE_CODES = (
    "gray",
    "gray:inverses=false",
    "gray:references=false",
    "binary:cell=2",
    "phase",
    "gray+phase",
)
PATTERN = (256, 512)
AWAY = 3.0  # px from edges of depth, shadow, gloss, holes and ink, from which pixels are judged
LIT = 20.0  # levels of projector light of a lit pixel
MOVED = 0.2  # px by which a fault must move the place of a pixel: beyond what noise does to a fringe
COUNTS = 0.01  # share of the lit pixels that a fault must move to be counted
UNLIKE = 0.25  # share of the light by which a level must differ from any that the wrong place could have
SEAMS, SEAM = 8, 3.0  # neighbours on one surface, and px by which they are torn apart, that tell of a fault
TOGETHER = 4  # frames that one finding may name at most: one period of fringes, or two bits with inverses
SUSPECTS = 6  # frames that all such findings may name together: who accuses all names nobody
VARIANTS = ("raw", "jpeg", "binned", "cropped")
FAULTS = ("swapped", "twice", "torn")  # that are drawn
MAPS = ("u", "v", "judged", "lit", "changed", "unlike")  # of Taken


@dataclass(frozen=True, slots=True)
class Draw:
    """One drawn capture. quality: of JPEG; window: of a cropped image, shares (top, left, height, width);
    noise: rms levels; seed: of the noise."""

    world: World
    code: str
    variant: str
    quality: int
    window: tuple[float, float, float, float]
    noise: float
    seed: int
    fault: Fault | None = None


@dataclass(frozen=True, slots=True)
class Taken:
    """Frames (N, H, W), true u and v (H, W).

    judged: lit pixels away from what is in the way; lit: pixels with enough projector light; changed: pixels
    whose place the fault moves; unlike: those in which the wrong place does not explain the levels; torn: how
    many neighbours on one surface the fault tears apart.
    """

    frames: Frames
    sequence: Sequence
    u: Floats
    v: Floats
    judged: Mask
    lit: Mask
    changed: Mask
    unlike: Mask
    torn: int = 0

    @property
    def moved(self) -> float:
        """Share of the lit pixels whose place the fault moves."""
        return float(self.changed[self.lit].mean()) if self.lit.any() else 0.0

    @property
    def perfect(self) -> bool:
        """True if the spoilt frames are perfect ones of another scene: nothing tells of the fault."""
        return self.torn < SEAMS and float(self.unlike[self.lit].mean()) <= COUNTS


def edge_cases(count: int, first: int, size: tuple[int, int]) -> Iterator[Case]:
    """`count` draws without a fault, `count` with one; a number's draw is always the same."""
    for faulty in (False, True):
        for number in range(first, first + count):
            draw = drawn(number, faulty, size)
            told = f"fault {number}: {draw.fault}" if draw.fault else f"clean {number}"
            variant = f"jpeg={draw.quality}" if draw.variant == "jpeg" else draw.variant
            yield Case(
                *("edges", f"{told}, {variant}", draw.code, size),
                partial(judged_draw, draw),
                round(draw.noise, 2),
                "uint8",
            )


def drawn(number: int, faulty: bool, size: tuple[int, int]) -> Draw:
    """The draw of a number, camera (rows, cols). Codes and variants take turns."""
    rng = np.random.default_rng([27, number, int(faulty)])
    code = EDGE_CODES[number % len(EDGE_CODES)]
    draw = Draw(
        world=drawn_world(rng, size),
        code=code,
        variant=VARIANTS[(number // len(EDGE_CODES) + number) % len(VARIANTS)],
        quality=int(rng.integers(75, 96)),
        window=_window(rng),
        noise=between(rng, 0.5, 1.5),
        seed=int(rng.integers(1 << 30)),
    )
    if not faulty:
        return draw
    return replace(draw, fault=drawn_fault(rng, sequence_from_text(code, *PATTERN)))


def drawn_fault(rng: np.random.Generator, sequence: Sequence) -> Fault:
    """A fault that is no swap of a bit with its own inverse."""
    count = len(sequence)
    while True:
        kind = str(rng.choice(FAULTS))
        frame = int(rng.integers(1, count))
        other = frame - 1 if rng.random() < 0.6 else int(rng.integers(count))
        if frame == other or Fault(kind, frame, other).inverts(sequence):
            continue
        return Fault(kind, frame, other, float(rng.uniform(0.25, 0.75)), bool(rng.random() < 0.5))


def drawn_world(rng: np.random.Generator, size: tuple[int, int]) -> World:
    """A wall and two to five objects before it, shadows, a gloss streak, holes, ink."""
    rows, cols = size
    scale = float(rng.uniform(0.35, 0.65))
    disparity = between(rng, 80, 200)
    side = float(rng.choice([0.0, math.pi]) + rng.uniform(-0.4, 0.4))
    # tilts and bends change the disparity by at most a quarter of the scale from pixel to pixel
    slope, reach = 0.25 * scale / disparity, 0.5 * math.hypot(rows, cols)
    count = int(rng.integers(2, 6))
    layers = [Layer(None, 1.0, _direction(rng, 0.5 * slope), _bend(rng, slope / reach), _albedo(rng))]
    for _ in range(count):
        outline = _outline(rng, size, (0.1, 0.3))
        jump = between(rng, 15, min(180.0, 0.9 * disparity))
        bend = _bend(rng, 2 * slope / reach)
        layers.append(Layer(outline, 1 + jump / disparity, _direction(rng, slope), bend, _albedo(rng)))
    nearest = max(layer.depth for layer in layers)
    mean = 0.5 * disparity * (1 + nearest)
    return World(
        size=size,
        pattern=PATTERN,
        layers=tuple(layers),
        scale=scale,
        origin=(
            0.5 * (PATTERN[1] - 1) + mean * math.cos(side),
            0.5 * (PATTERN[0] - 1) + mean * math.sin(side),
        ),
        disparity=disparity,
        baseline=side,
        holes=tuple(_outline(rng, size, (0.02, 0.05)) for _ in range(rng.integers(1, 4))),
        prints=tuple(_outline(rng, size, (0.03, 0.1)) for _ in range(rng.integers(0, 3))),
        gloss=(_gloss(rng, size),),
        gain=float(rng.uniform(150, 210)),
        ambient=float(rng.uniform(0, 25)),
        black=float(rng.uniform(2, 15)),
        spread=float(rng.uniform(0.6, 1.0)),
        seed=int(rng.integers(1 << 30)),
    )


def _direction(rng: np.random.Generator, size: float) -> tuple[float, float]:
    angle, length = rng.uniform(0, 2 * math.pi), size * rng.uniform(0, 1)
    return float(length * math.cos(angle)), float(length * math.sin(angle))


def _bend(rng: np.random.Generator, most: float) -> float:
    return float(rng.uniform(-most, most)) if rng.random() < 0.5 else 0.0


def _albedo(rng: np.random.Generator) -> tuple[float, float]:
    low = between(rng, 0.2, 0.7)
    return low, float(rng.uniform(max(low, 0.5), 1.0))


def _outline(rng: np.random.Generator, size: tuple[int, int], reach: tuple[float, float]) -> Outline:
    """An ellipse, a parallelogram or a hexagon somewhere in the image; reach: of its half width."""
    rows, cols = size
    elliptic = bool(rng.random() < 0.4)
    pairs = 2 if elliptic else int(rng.integers(2, 4))
    start = rng.uniform(0, math.pi)
    skew = np.zeros(pairs) if elliptic else rng.uniform(-0.2, 0.2, pairs)
    angles = start + np.pi / pairs * np.arange(pairs) + skew
    sides = tuple((float(math.cos(a)), float(math.sin(a)), float(cols * rng.uniform(*reach))) for a in angles)
    x, y = (float(n * rng.uniform(-0.42, 0.42)) for n in (cols, rows))
    return Outline(x, y, sides, elliptic)


def _gloss(rng: np.random.Generator, size: tuple[int, int]) -> Gloss:
    x, y = (float(n * rng.uniform(-0.4, 0.4)) for n in size[::-1])
    width, peak = between(rng, 1.5, 5), between(rng, 100, 600)
    return Gloss(x, y, float(rng.uniform(0, math.pi)), width, peak, bool(rng.random() < 0.5))


def _window(rng: np.random.Generator) -> tuple[float, float, float, float]:
    height, width = rng.uniform(0.55, 0.85, 2)
    return float(rng.uniform(0, 1 - height)), float(rng.uniform(0, 1 - width)), float(height), float(width)


def taken(draw: Draw) -> Taken:
    """Frames as they come from the camera, and the truth about them."""
    world, sequence = draw.world, sequence_from_text(draw.code, *draw.world.pattern)
    fine, centre = sampled(world), sampled(world, 1)
    frames = light(world, fine, sequence)
    if draw.fault is not None and draw.fault.shown:
        frames = draw.fault.spoil(frames)
    rng = np.random.default_rng(draw.seed)
    noise = draw.noise * rng.standard_normal(frames.shape, np.float32)
    read = np.clip(np.rint(frames + noise), 0, 255).astype(np.uint8)
    if draw.fault is not None and not draw.fault.shown:
        read = draw.fault.spoil(read)
    rows, cols = world.size
    trouble = inside(fine.trouble, SAMPLES).reshape(rows, SAMPLES, cols, SAMPLES)
    free = np.asarray(~trouble.any((1, 3)))
    lit = inside(np.asarray(centre.lit & (centre.projected >= LIT)))
    torn, changed, unlike = 0, np.zeros_like(lit), np.zeros_like(lit)
    if draw.fault is not None:
        torn, changed, unlike = _consequences(draw, draw.fault, centre, sequence, free & lit)
    return _varied(
        draw, Taken(read, sequence, inside(centre.u), inside(centre.v), free, lit, changed, unlike, torn)
    )


def _consequences(
    draw: Draw, fault: Fault, centre: Samples, sequence: Sequence, judged: Mask
) -> tuple[int, Mask, Mask]:
    """What a fault does to ideal levels (Taken's torn, changed), and whether they are those of another scene
    (unlike)."""
    ideal = light(draw.world, centre, sequence)
    spoilt = fault.spoil(ideal)
    right, wrong = plain_places(ideal, sequence), plain_places(spoilt, sequence)
    u, v = (np.pad(place, MARGIN, mode="edge").astype(np.float32) for place in wrong)
    explained = light(draw.world, replace(centre, u=u, v=v), sequence)
    unlike = np.abs(explained - spoilt).max(axis=0) > UNLIKE * np.maximum(inside(centre.projected), LIT)
    within = np.zeros(judged.shape, np.bool_)
    part = _window_of(draw, within.shape) if draw.variant == "cropped" else (slice(None), slice(None))
    within[part] = judged[part]
    changed = np.hypot(right[0] - wrong[0], right[1] - wrong[1]) > MOVED
    return seams(right, wrong, within, SEAM), changed, unlike


def _varied(draw: Draw, whole: Taken) -> Taken:
    """As JPEG, binned 2 x 2, or cropped; judged where nothing in the way is near."""
    frames, maps = whole.frames, {name: getattr(whole, name) for name in MAPS}
    if draw.variant == "jpeg":
        quality = [cv2.IMWRITE_JPEG_QUALITY, draw.quality]
        packed = [cv2.imencode(".jpg", frame, quality)[1] for frame in frames]
        frames = np.stack([np.asarray(cv2.imdecode(one, cv2.IMREAD_GRAYSCALE), np.uint8) for one in packed])
    elif draw.variant == "binned":
        frames = np.rint(np.stack([_halved(frame) for frame in frames])).astype(np.uint8)
        halves = {name: _halved(one) for name, one in maps.items()}
        maps = {name: one if name in "uv" else np.asarray(one == 1) for name, one in halves.items()}
    free = maps["judged"].astype(np.uint8)
    apart = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    maps["judged"] = maps["lit"] & (apart >= AWAY)
    if draw.variant == "cropped":
        part = _window_of(draw, free.shape)
        frames, maps = np.ascontiguousarray(frames[:, *part]), {name: one[part] for name, one in maps.items()}
    return replace(whole, frames=frames, **maps)


def _window_of(draw: Draw, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a cropped image."""
    top, left, height, width = draw.window
    return (
        slice(round(top * shape[0]), round((top + height) * shape[0])),
        slice(round(left * shape[1]), round((left + width) * shape[1])),
    )


def _halved(image: NDArray[Any]) -> Floats:
    rows, cols = image.shape
    halved: Floats = image.astype(np.float32).reshape(rows // 2, 2, cols // 2, 2).mean((1, 3))
    return halved


def judged_draw(draw: Draw) -> Found:
    """Decode and check a draw; what is right and what is said about its frames."""
    shot = taken(draw)
    seen = decode(shot.frames, shot.sequence)
    found = against_truth(seen, shot.u, shot.v, shot.judged)
    report = check(shot.frames, shot.sequence)
    verdict = FrameVerdict(
        fault="" if draw.fault is None else str(draw.fault),
        moves=shot.moved > COUNTS,
        hidden=draw.fault is not None and shot.perfect,
        named=draw.fault is not None and names(report, draw.fault),
        accused=int(np.count_nonzero(seen.flags == Flag.WRONG_FRAME)),
        findings=tuple(finding.sentence for finding in report.findings[:3]),
    )
    return replace(found, frames=verdict)


def names(report: Integrity, fault: Fault) -> bool:
    """Whether findings about few frames, and few of them in all, hold one of the fault's."""
    wrong = {fault.frame, fault.other} if fault.kind == "swapped" else {fault.frame}
    few = [finding.frames for finding in report.findings if len(finding.frames) <= TOGETHER]
    suspects = {frame for frames in few for frame in frames}
    return bool(wrong & suspects) and len(suspects) <= SUSPECTS


def against_truth(seen: Correspondence, u: Floats, v: Floats, judged: Mask) -> Found:
    """Errors of the judged pixels; the others count as flagged."""
    found = found_places(seen, ((u, u), (v, v)), judged, np.zeros(judged.shape, np.bool_))
    return replace(found, flags=np.where(judged, seen.flags, seen.flags | np.uint16(Flag.INVALID)))
