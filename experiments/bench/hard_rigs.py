"""Drawn hard cases of the decoder: rigs that nobody has thought of, seen by rays through pixels' areas."""

from functools import partial

import numpy as np

from optolever.decode import decode
from optolever.patterns import sequence_from_text
from optolever.projector import area_frames, trace_area
from optolever.scene import Sensor

from ..drawn import between
from .area_truth import area_errors
from .hard_case import Case, Found
from .rigs import KINDS, Rig, draw_rig, drawn_sensor

__all__ = ["RIG_PIXELS", "RIG_SHARE", "decoded_rig", "rig_case", "rig_of"]

RIG_SHARE, RIG_PIXELS = 1e-3, 3
"""Silent errors that one rig may have: this share of its unflagged pixels, or so many pixels."""

_SIZES = (100, 191)  # rows and columns of a camera: from, below
_SEED = 1977


def rig_case(number: int) -> Case:
    """The drawn case of a number, always the same."""
    kind, size, code, sensor = _drawn_case(number)
    return Case(
        "decode",
        f"random {number}",
        f"{code} on {kind}",
        size,
        partial(decoded_rig, number),
        round(sensor.noise, 2),
        "uint8" if sensor.bits == 8 else "uint16",
        share=RIG_SHARE,
        pixels=RIG_PIXELS,
    )


def rig_of(number: int) -> tuple[Rig, str, Sensor]:
    """The rig of a number, its sequence's text and its camera's sensor."""
    kind, size, code, sensor = _drawn_case(number)
    return draw_rig(np.random.default_rng([_SEED, number, 1]), kind, size), code, sensor


def decoded_rig(number: int) -> Found:
    """Render, decode, compare with where every pixel looked."""
    rig, code, sensor = rig_of(number)
    shown = sequence_from_text(code, rig.scene.pattern.rows, rig.scene.pattern.cols)
    area = trace_area(rig.scene, rig.surface)
    frames = area_frames(area, shown, sensor, rig.lighting, seed=number)
    return area_errors(decode(frames, shown), area, shown)


def _drawn_case(number: int) -> tuple[str, tuple[int, int], str, Sensor]:
    """Kind of rig, camera's size, sequence, sensor."""
    rng = np.random.default_rng([_SEED, number, 0])
    rows, cols = rng.integers(*_SIZES, 2)
    return str(rng.choice(KINDS)), (int(rows), int(cols)), _code(rng), drawn_sensor(rng)


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
