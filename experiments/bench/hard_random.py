"""Random hard cases: rigs, mirrors, displays, cameras and codes that nobody has thought of."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from ..drawn import between, drawn_dent, together
from .hard_case import Case
from .hard_reconstruct import HIDDEN, Problem, reconstructed
from .hard_rigs import rig_case

__all__ = ["random_cases"]

SCENES = ("paper-simulation", "paper-prototype", "prism48", "monitor-mirror")


def random_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases, alternately of the decoder and of the solver; a number's case is always the same."""
    for number in range(first, first + count):
        yield rig_case(number) if number % 2 == 0 else _solving(number)


def _solving(number: int) -> Case:
    rng = np.random.default_rng([2006, number])
    scene, size = str(rng.choice(SCENES)), _size(rng)
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


def _size(rng: np.random.Generator) -> tuple[int, int]:
    rows, cols = rng.integers(48, 193, 2)
    return int(rows), int(cols)
