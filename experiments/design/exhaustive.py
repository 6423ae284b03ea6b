"""Is the first choice of run_design the right one? Against simulating every candidate, on scenes of all
kinds.
"""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from optolever.errors import InputError
from optolever.records import Progress, silent
from optolever.scene import dent_from_text

from .judged import Case
from .ranking import merit, run_design, simulate
from .sensitivity import Lever

__all__ = ["ChoiceRow", "run_choices"]

#: Simulated again are those whose merit is over the least one's by up to so much.
CLOSE = 1.12
#: Predictions are right within so much.
LIMIT = 0.15


@dataclass(frozen=True, slots=True)
class ChoiceRow:
    """One case: the choice, its simulated error (mm) and share, the best of all simulated and the same of it;
    excess: how much worse the choice's merit is (0: the best); candidates that nothing rules out, the share
    of them predicted within 15 %, of the others predicted over simulated error, the worst first; median of
    |predicted / simulated - 1|; seconds that it took."""

    case: str
    chosen: str
    chosen_error: float
    chosen_share: float
    best: str
    best_error: float
    best_share: float
    excess: float
    candidates: int
    within_15: float
    outside: dict[str, float]
    median_error: float
    seconds: float


def run_choices(
    cases: Sequence[Case],
    *,
    pixels: int = 72,
    seeds: int = 12,
    more: int = 40,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Iterator[ChoiceRow]:
    """Choose for every case, simulate every candidate with `seeds` draws, the best ones with `more`."""
    for index, case in enumerate(cases):

        def step(text: str, done: int, total: int, index: int = index) -> None:
            progress(f"case {index + 1} of {len(cases)}: {text}", done, total)

        yield _judge(case, pixels, seeds, more, renderer, step)


def _judge(case: Case, pixels: int, seeds: int, more: int, renderer: str, progress: Progress) -> ChoiceRow:
    start = time.perf_counter()
    scene = case.scene(pixels)
    design = run_design(
        scene, case.dent, frames=case.frames, noise=case.noise, renderer=renderer, progress=progress
    )
    if design.chosen is None:
        raise InputError(f"case {case.name}: nothing meets the limits")
    chosen = design.chosen.text
    lever = Lever(scene, dent_from_text(case.dent, scene), stride=1)
    found = {chosen: (math.nan, 0.0)}

    def simulated(texts: set[str], draws: range) -> None:
        for done, text in enumerate(sorted(texts)):
            progress(f"simulate with {len(draws)} draws", done, len(texts))
            with suppress(InputError):  # it cannot be decoded, or a draw leaves no anchor
                found[text] = simulate(lever, design.candidates[text], case.noise, draws, renderer)

    simulated(set(design.candidates), range(100, 100 + seeds))
    least = min(merit(*error) for error in found.values())
    close = {text for text, error in found.items() if merit(*error) < CLOSE * least} | {chosen}
    simulated(close, range(200, 200 + more))
    best = min(close, key=lambda text: merit(*found[text]))
    ratios = {
        row.text: row.predicted / found[row.text][0]
        for row in design.rows
        if not row.why and row.text in found and found[row.text][0] > 0
    }
    off = {text: abs(ratio - 1) for text, ratio in ratios.items()}
    outside = {text: ratios[text] for text in sorted(off, key=lambda text: -off[text]) if off[text] > LIMIT}
    return ChoiceRow(
        case.name, chosen, *found[chosen], best, *found[best],
        merit(*found[chosen]) / merit(*found[best]) - 1, len(ratios), 1 - len(outside) / max(1, len(ratios)),
        outside, float(np.median(list(off.values()))), time.perf_counter() - start,
    )  # fmt: skip
