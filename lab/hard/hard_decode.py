"""Hard cases of the decoder: what displays, cameras, mirrors and drivers do to the frames."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Displacement, decode, difference
from optolever.experiments.bench.measures import far_from_visible
from optolever.experiments.design import varied
from optolever.experiments.ideal import Fault
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, VirtualSensor
from optolever.scene import (
    Display,
    Scene,
    Sensor,
    Surface,
    Trace,
    dent_from_text,
    load,
    moving_dent,
    resize,
    trace,
)

from .found import Found, found_places, least_limit
from .hard_case import Case

Frames = NDArray[Any]
Spoil = Callable[[Frames, np.random.Generator], Frames]

SCENE = "paper-simulation"
SEQUENCES = (
    "gray+phase",
    "phase",
    "phase:steps=4,periods=20/22/25",
    "micro-phase",
    "gray",
    "xor-gray",
    "long-run-gray",
    "stripe:step=8",
)
ONE_PERIOD = "phase:steps=3,counts=0.9"
NOMINAL = Sensor(offset=16.0, exposure=0.85)


@dataclass(frozen=True, slots=True)
class Condition:
    """What is wrong with a capture.

    sensor, display, blur (cells), noise (levels), bits: of the virtual sensor; cells: pattern cells per
    camera pixel, over the usual; dent; rates: of a moving dent's parameters (per second); rest: what counts
    is the difference to the undented mirror, decoded alike; spoil: what happens to the frames afterwards;
    limits: sequences from which nobody could tell, and why.
    """

    name: str
    sensor: Sensor = NOMINAL
    display: Display | None = None
    blur: float | None = None
    noise: float = 1.0
    bits: int | None = None
    cells: float = 1.0
    dent: str = "gaussian"
    rates: Mapping[str, float] = field(default_factory=dict)
    rest: bool = False
    spoil: Spoil | None = None
    limits: Mapping[str, str] = field(default_factory=dict)


def _fault(kind: str, at: float = 0.5) -> Spoil:
    """A fault of a frame and the one before; at: share of the sequence."""

    def spoil(frames: Frames, rng: np.random.Generator) -> Frames:
        index = round(at * (len(frames) - 1))
        return Fault(kind, index, index - 1, 0.5).spoil(frames)

    return spoil


def _hot_pixels(frames: Frames, rng: np.random.Generator) -> Frames:
    """One pixel in 500 stands at a level of its own."""
    hot = rng.random(frames.shape[1:]) < 0.002
    frames[:, hot] = rng.integers(0, 256, int(hot.sum()))
    return frames


def _flashes(frames: Frames, rng: np.random.Generator) -> Frames:
    """One pixel in 200 is hit once, in one of its frames."""
    rows, cols = np.nonzero(rng.random(frames.shape[1:]) < 0.005)
    frames[rng.integers(0, len(frames), rows.size), rows, cols] = 255
    return frames


_N3 = {ONE_PERIOD: "three steps of one period: three numbers for three unknowns, nothing is left to check"}

CONDITIONS = (
    Condition("plain"),
    Condition("low contrast", sensor=Sensor(offset=100.0, exposure=0.05)),
    Condition("lower contrast", sensor=Sensor(offset=100.0, exposure=0.02)),
    Condition("saturation at 255 of 300", sensor=Sensor(offset=16.0, exposure=284 / 255)),
    Condition("gamma 2.2", display=Display(gamma=2.2)),
    Condition("defocus", blur=3.0),
    Condition("sharp display", blur=0.0),
    Condition("sharp display, low noise", blur=0.15, noise=0.3),
    Condition("one-pixel stripes at the camera's limit", cells=2.0),
    Condition("steep", dent="rounded-needle:peak=6"),
    Condition("folded", dent="gaussian:peak=2,sigma=9"),
    Condition("cusp", dent="needle"),
    Condition("motion", rates={"x": 5.0}),
    Condition("slow motion", rates={"x": 0.5}),
    Condition("frame dropped", spoil=_fault("lost", 0.4), limits=_N3),
    Condition("frame dropped early", spoil=_fault("lost", 0.1), limits=_N3),
    Condition("frame twice", spoil=_fault("twice"), limits=_N3),
    Condition("frame twice, late", spoil=_fault("twice", 0.9), limits=_N3),
    Condition("frames swapped", spoil=_fault("swapped"), limits=_N3),
    Condition("frame torn", spoil=_fault("torn"), limits=_N3),
    Condition("flicker 5 % of 100 Hz", sensor=replace(NOMINAL, flicker=0.05, frame_s=1 / 60)),
    Condition("hot pixels", spoil=_hot_pixels, limits=_N3),
    Condition("flashes", spoil=_flashes, limits=_N3),
    Condition("12 bit in 16", bits=12),
    Condition("16 bit", bits=16),
    Condition("deformed minus rest", rest=True),
    Condition("deformed minus rest, 12 bit in 16", rest=True, bits=12),
)


def decode_cases(size: tuple[int, int], quick: bool = False) -> Iterator[Case]:
    """Every condition with every sequence, at a camera of size (rows, cols)."""
    sequences = ("gray+phase", "phase") if quick else SEQUENCES
    for condition in CONDITIONS:
        for text in (*sequences, *condition.limits):
            yield Case(
                "decode",
                condition.name,
                text,
                size,
                partial(_decoded, condition, text, size),
                condition.noise,
                "uint16" if condition.bits else "uint8",
                condition.limits.get(text, ""),
            )


def _decoded(condition: Condition, text: str, size: tuple[int, int]) -> Found:
    """Capture, spoil, decode, compare with where every pixel truly looked."""
    scene = _scene(condition, size)
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    surface = _surface(condition, scene)
    with VirtualSensor(scene, surface, shown, noise=condition.noise, seed=1, bits=condition.bits) as sensor:
        taken: Capture = sensor.capture()
        times = sensor.time(0), sensor.time(len(shown) // 2), sensor.time(len(shown) - 1)
    frames = taken.frames
    if condition.spoil is not None:
        frames = condition.spoil(frames.copy(), np.random.default_rng(7))
    deformed = decode(frames, shown)
    seen: Correspondence | Displacement = deformed
    if isinstance(surface, Surface):
        truths = [trace(scene, surface)]
    else:
        truths = [trace(scene, surface(time)) for time in times]
    if condition.rest:
        rest = dent_from_text("flat", scene)
        with VirtualSensor(scene, rest, shown, noise=condition.noise, seed=2, bits=condition.bits) as sensor:
            seen = difference(deformed, decode(sensor.capture().frames, shown))
        truths = [_displacement(truth, trace(scene, rest)) for truth in truths]
    return compared(seen, truths, shown, 2.0 if condition.rest else 1.0)


def _displacement(deformed: Trace, rest: Trace) -> Trace:
    """The deformed trace with u, v less those of the rest, where both are seen."""
    return replace(
        deformed, u=deformed.u - rest.u, v=deformed.v - rest.v, visible=deformed.visible & rest.visible
    )


def compared(
    seen: Correspondence | Displacement, truths: list[Trace], shown: Sequence, captures: float = 1.0
) -> Found:
    """Errors against the truth; of a moving mirror, against all that was true while the frames were taken.

    captures: how many were decoded for it, each of which may be wrong by as much.
    """
    visible = np.logical_and.reduce([truth.visible for truth in truths])
    somewhere = np.logical_or.reduce([truth.visible for truth in truths])
    stacks = (np.stack([getattr(truth, name) for truth in truths]) for name in "uv")
    between = ((stack.min(axis=0), stack.max(axis=0)) for stack in stacks)
    return found_places(seen, between, visible, far_from_visible(somewhere), captures * least_limit(shown))


def _scene(condition: Condition, size: tuple[int, int]) -> Scene:
    scene = resize(load(SCENE, exact=True), *size)
    blur = scene.pattern.blur_px if condition.blur is None else condition.blur
    finer = varied(scene, "pattern", condition.cells).pattern
    pattern = replace(finer, blur_px=blur)
    return replace(scene, pattern=pattern, sensor=condition.sensor, display=condition.display)


def _surface(condition: Condition, scene: Scene) -> Surface | Callable[[float], Surface]:
    if condition.rates:
        return moving_dent(condition.dent, scene, dict(condition.rates))
    return dent_from_text(condition.dent, scene)
