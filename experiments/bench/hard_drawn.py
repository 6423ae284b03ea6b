"""Drawn hard cases: rigs seen by rays through pixels' areas, places and heights; mirrors to solve."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import ndimage

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import AreaTrace, Lighting, area_frames, trace_area
from optolever.reconstruct import reconstruct
from optolever.scene import Scene, Sensor, Surface, Trace

from ..drawn import between, drawn_dent, together
from .found import Found, found_area, found_height
from .hard_case import Case
from .hard_reconstruct import HIDDEN, Problem, reconstructed
from .rigs import KINDS, Rig, draw_rig, drawn_sensor

__all__ = [
    "AREA_PIXELS",
    "AREA_SHARE",
    "decoded_area",
    "drawn_size",
    "height_cases",
    "random_cases",
    "rig_case",
    "rig_of",
    "seen_area",
]

AREA_SHARE, AREA_PIXELS = 1e-3, 3
"""Silent errors that one drawn scene may have: this share of its unflagged pixels, or so many pixels."""

_SCENES = ("paper-simulation", "paper-prototype", "prism48", "monitor-mirror")
_SIZES, _SOLVED = (100, 191), (48, 193)  # rows and columns of a camera: from, below
_SEED, _SEED_SOLVED = 1977, 2006


def random_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases, alternately of the decoder and of the solver; a number's case is always the same."""
    for number in range(first, first + count):
        yield rig_case(number) if number % 2 == 0 else _solving(number)


def drawn_size(rng: np.random.Generator, sizes: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of a camera, each from the first to below the second."""
    rows, cols = rng.integers(*sizes, 2)
    return int(rows), int(cols)


def decoded_area(
    scene: Scene, surface: Surface, code: str, sensor: Sensor, seed: int, lighting: Lighting | None = None
) -> Found:
    """Render, decode, compare with where every pixel looked."""
    return found_area(*seen_area(scene, surface, code, sensor, seed, lighting))


def seen_area(
    scene: Scene, surface: Surface, code: str, sensor: Sensor, seed: int, lighting: Lighting | None = None
) -> tuple[Correspondence, AreaTrace, Sequence]:
    """Frames of pixels' areas, decoded; where every pixel looked; what was shown."""
    shown = sequence_from_text(code, scene.pattern.rows, scene.pattern.cols)
    area = trace_area(scene, surface)
    return decode(area_frames(area, shown, sensor, lighting, seed=seed), shown), area, shown


def rig_case(number: int) -> Case:
    """The drawn case of a number, always the same."""
    kind, size, code, sensor = _drawn_case(number)
    return Case(
        "decode",
        f"random {number}",
        f"{code} on {kind}",
        size,
        partial(_decoded_rig, number),
        round(sensor.noise, 2),
        "uint8" if sensor.bits == 8 else "uint16",
        share=AREA_SHARE,
        pixels=AREA_PIXELS,
    )


def rig_of(number: int) -> tuple[Rig, str, Sensor]:
    """The rig of a number, its sequence's text and its camera's sensor."""
    kind, size, code, sensor = _drawn_case(number)
    return draw_rig(np.random.default_rng([_SEED, number, 1]), kind, size), code, sensor


def _decoded_rig(number: int) -> Found:
    rig, code, sensor = rig_of(number)
    return decoded_area(rig.scene, rig.surface, code, sensor, number, rig.lighting)


def _drawn_case(number: int) -> tuple[str, tuple[int, int], str, Sensor]:
    """Kind of rig, camera's size, sequence, sensor."""
    rng = np.random.default_rng([_SEED, number, 0])
    size = drawn_size(rng, _SIZES)
    return str(rng.choice(KINDS)), size, _code(rng), drawn_sensor(rng)


def _code(rng: np.random.Generator) -> str:
    """gray+phase in two of five, the README's codes in two, one with parameters of its own else."""
    common = ("gray+phase", "phase", "phase:steps=3,periods=8.73782/8.05745/8", "micro-phase", "gray")
    if rng.random() < 0.8:
        return str(rng.choice(common, p=(0.5, 0.14, 0.14, 0.12, 0.1)))
    bits = ("gray", "binary", "xor-gray", "long-run-gray")
    steps = int(rng.integers(3, 9))
    period = between(rng, 8, 40)
    ratio = rng.uniform(1.02, 1.2, 2)
    periods = "/".join(f"{number:.3f}" for number in (period, period * ratio[0], period * ratio.prod()))
    inverses = str(bool(rng.random() < 0.5)).lower()
    return str(
        rng.choice(
            [
                f"{rng.choice(bits)}:inverses={inverses}",
                f"gray+phase:steps={steps},period={2 * round(period / 4)}",
                f"phase:steps={steps}",
                f"phase:steps={steps},periods={periods}",
                f"stripe:step={between(rng, 4, 16):.2f}",
            ]
        )
    )


def _solving(number: int) -> Case:
    rng = np.random.default_rng([_SEED_SOLVED, number])
    scene, size = str(rng.choice(_SCENES)), drawn_size(rng, _SOLVED)
    dents = [drawn_dent(rng) for _ in range(rng.integers(1, 5))]
    problem = Problem(
        f"random {number}",
        partial(together, dents),
        scene,
        HIDDEN[rng.integers(len(HIDDEN))] if rng.random() < 0.5 else None,
        between(rng, 1e-3, 0.05) if rng.random() < 0.25 else 0.0,
    )
    noise = between(rng, 0.003, 1.0) if rng.random() < 0.8 else 0.0
    dtype = str(rng.choice(["float64", "float32"]))
    hidden = "" if problem.hide is None else f", {problem.hide.__name__.strip('_')}"
    wrong = f", {100 * problem.outliers:.1f} % wrong" if problem.outliers else ""
    return Case(
        "reconstruct",
        problem.name,
        f"{scene}, {len(dents)} dents{hidden}{wrong}",
        size,
        partial(reconstructed, problem, size, noise, dtype),
        round(noise, 3),
        dtype,
    )


def height_cases(draws: int, first: int = 0) -> Iterator[Case]:
    """`draws` rigs from frames to height, in which errors that neighbours have in common add up; a number's
    rig, its frames and their noise are those of `rig_case`."""
    for number in range(first, first + draws):
        decoded = rig_case(number)
        yield replace(decoded, part="height", name=f"rig {number}", make=partial(_solved_rig, number))


def _solved_rig(number: int) -> Found:
    rig, code, sensor = rig_of(number)
    seen, area, _ = seen_area(rig.scene, rig.surface, code, sensor, number, rig.lighting)
    height = reconstruct(seen, rig.scene, anchor=_known_point(seen, area.centre))
    return replace(found_height(height, area.centre, 1.0), unit="mm")


def _known_point(seen: Correspondence, truth: Trace) -> tuple[float, float, float]:
    """The true place (mm) on the mirror of the good pixel that is farthest from any that is not."""
    inside = ndimage.distance_transform_cdt(np.pad(seen.good & truth.visible, 1))[1:-1, 1:-1]
    if not inside.any():
        raise InputError("no pixel is good")
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    return float(truth.x[at]), float(truth.y[at]), float(truth.z[at])
