"""Random hard cases: mirrors, displays, cameras and codes that nobody has thought of."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene, Surface, dent

from ..drawn import FORMS, between, dent_params
from .hard_case import Case
from .hard_decode import NOMINAL, Condition, decoded, flashes, hot_pixels
from .hard_reconstruct import HIDDEN, Problem, reconstructed

__all__ = ["random_cases"]

Floats = NDArray[np.float64]

SCENES = ("paper-simulation", "paper-prototype", "prism48", "monitor-mirror")
STRANGE = 0.1  # how often each thing happens that usually does not


def random_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases, alternately of the decoder and of the solver; a number's case is always the same."""
    for number in range(first, first + count):
        rng = np.random.default_rng([2006, number])
        yield _decoding(number, rng) if number % 2 == 0 else _solving(number, rng)


def _decoding(number: int, rng: np.random.Generator) -> Case:
    scene, size, code = str(rng.choice(SCENES)), _size(rng), _code(rng)
    strange = rng.random(5) < STRANGE
    condition = Condition(
        f"random {number}",
        sensor=replace(
            NOMINAL,
            offset=float(rng.uniform(0, 60)),
            exposure=between(rng, 0.05, 1.1),
            gamma=float(rng.uniform(1, 2.4)) if strange[0] else 1.0,
            flicker=float(rng.uniform(0, 0.1)) if strange[1] else 0.0,
            gain_e=between(rng, 5, 500) if rng.random() < 0.5 else 0.0,
        ),
        scene=scene,
        blur=float(rng.uniform(0, 3)),
        noise=between(rng, 0.3, 5),
        bits=int(rng.choice([10, 12, 16])) if rng.random() < 0.25 else None,
        cells=between(rng, 0.5, 2),
        rest=bool(strange[2]),
        spoil=hot_pixels if strange[3] else flashes if strange[4] else None,
    )
    return Case(
        "decode",
        condition.name,
        f"{code} on {scene}",
        size,
        partial(decoded, condition, code, size, _dent(rng)),
        round(condition.noise, 2),
        "uint16" if condition.bits else "uint8",
    )


def _solving(number: int, rng: np.random.Generator) -> Case:
    scene, size = str(rng.choice(SCENES)), _size(rng)
    dents = [_dent(rng) for _ in range(rng.integers(1, 5))]
    problem = Problem(
        f"random {number}",
        partial(_together, dents),
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


def _size(rng: np.random.Generator) -> tuple[int, int]:
    rows, cols = rng.integers(48, 193, 2)
    return int(rows), int(cols)


def _dent(rng: np.random.Generator) -> Callable[[Scene], Surface]:
    """A dent of any form, a twentieth to twice as deep as the usual one, somewhere on the mirror."""
    form = str(rng.choice(list(FORMS)))
    return partial(
        _placed,
        form,
        between(rng, 0.05, 2),
        between(rng, 0.2, 2),
        (float(rng.uniform(0.1, 0.85)), float(rng.uniform(0.1, 0.9))),
        float(rng.uniform(-90, 90)),
    )


def _placed(
    form: str, depth: float, width: float, place: tuple[float, float], angle: float, scene: Scene
) -> Surface:
    mirror, params = scene.mirror, dent_params(form, scene, depth, width)
    if FORMS[form]:
        params |= {"x": place[0] * mirror.length, "y": place[1] * mirror.width}
    if form == "ridge":
        params["angle_deg"] = angle
    return dent(form, scene, **params)


def _together(dents: list[Callable[[Scene], Surface]], scene: Scene) -> Surface:
    """All of them pressed at once: heights and slopes add up."""
    surfaces = [made(scene) for made in dents]

    def height(x: Floats, y: Floats) -> Floats:
        return np.asarray(sum(surface.height(x, y) for surface in surfaces))

    def gradient(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        slopes = [surface.gradient(x, y) for surface in surfaces]
        return np.asarray(sum(p for p, _ in slopes)), np.asarray(sum(q for _, q in slopes))

    return Surface(height, gradient)


def _code(rng: np.random.Generator) -> str:
    """A code with parameters of its own."""
    bits = ("gray", "binary", "xor-gray", "long-run-gray")
    steps = int(rng.integers(4, 9))
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
                "micro-phase",
                f"stripe:step={between(rng, 4, 16):.2f}",
            ]
        )
    )
