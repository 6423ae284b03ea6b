"""Is the first choice of run_design the right one? Against simulating every candidate, on scenes of all
kinds.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.scene import dent_from_text

from .candidates import candidates
from .judged import Case
from .ranking import DesignRow, merit, run_design, simulate
from .sensitivity import Lever

__all__ = ["ChoiceRow", "run_choices"]

Progress = Callable[[str, int, int], None]
FINALISTS = 6  # simulated with more draws of noise
#: Standard errors of simulated rms errors, of every candidate and of the finalists: where draws scatter, more
#: of them are simulated, at most so many.
CHANCE, CHANCE_LAST, MOST = 0.05, 0.025, 60
#: The same of finalists whose merit is so near to the best one's.
CLOSE, CHANCE_CLOSE, MOST_CLOSE = 0.12, 0.0125, 160
#: Predictions are right within so much; those off by more than the second are judged by as many draws as the
#: finalists.
LIMIT, DOUBTED = 0.15, 0.05


@dataclass(frozen=True, slots=True)
class ChoiceRow:
    """One case: the choice, its simulated error (mm) and share, the best of all simulated and the same of it;
    excess: how much worse the choice's merit is (0: the best); candidates that nothing rules out, the share
    of them predicted within 15 %, of the others predicted over simulated error, the worst first; seconds that
    it took."""

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
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def run_choices(
    cases: Sequence[Case],
    *,
    pixels: int = 72,
    seeds: int = 3,
    more: int = 10,
    renderer: str = "auto",
    progress: Progress = lambda text, done, total: None,
) -> Iterator[ChoiceRow]:
    """Choose for every case, simulate every candidate with `seeds` draws at least, the best ones with `more`;
    see CHANCE."""
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
    lever = Lever(scene, dent_from_text(case.dent, scene), stride=1)
    seeds, more = _draws(lever, CHANCE, seeds), _draws(lever, CHANCE_LAST, more)
    offered = {c.text: c for c in candidates(scene.pattern.rows, scene.pattern.cols, case.frames)}

    def shown(text: str, first: int, draws: int) -> tuple[float, float]:
        return simulate(lever, offered[text], case.noise, range(first, first + draws), renderer)

    found: dict[str, tuple[float, float]] = {}
    for text in offered:
        progress("all candidates", len(found), len(offered))
        with suppress(InputError):  # it cannot be decoded
            found[text] = shown(text, 100, seeds)
    measured = {text for text, error in found.items() if error[0] > 0}
    told = {row.text: row.predicted for row in design.rows if _stands(row) and row.text in measured}
    doubted = {text for text, error in told.items() if abs(error / found[text][0] - 1) > DOUBTED}
    chosen = design.chosen.text
    first = sorted(found, key=lambda text: merit(*found[text]))[:FINALISTS]
    final: dict[str, tuple[float, float]] = {}
    for text in sorted({*first, chosen} | doubted):
        progress("the best again, and what was not predicted", len(final), FINALISTS + len(doubted))
        with suppress(InputError):  # a draw that leaves no anchor
            final[text] = shown(text, 200, more)
    final.setdefault(chosen, found.get(chosen, (math.nan, 0.0)))
    least = min(merit(*error) for error in final.values())
    close = {text for text in final if merit(*final[text]) < (1 + CLOSE) * least} | {chosen}
    if len(close) > 1:  # the least of several is as a rule one that draws were kind to
        last = _draws(lever, CHANCE_CLOSE, more, MOST_CLOSE)
        for done, text in enumerate(sorted(close)):
            progress("the close ones again", done, len(close))
            with suppress(InputError):
                final[text] = shown(text, 200, last)
    best = min(close, key=lambda text: merit(*final[text]))
    ratios = {text: error / final.get(text, found[text])[0] for text, error in told.items()}
    outside = _outside(ratios)
    return ChoiceRow(
        case.name, chosen, *final[chosen], best, *final[best],
        merit(*final[chosen]) / merit(*final[best]) - 1, len(ratios), 1 - len(outside) / max(1, len(ratios)),
        outside, time.perf_counter() - start,
    )  # fmt: skip


def _outside(ratios: dict[str, float]) -> dict[str, float]:
    """Those that are off by more than the limit, or no number, the worst first."""
    off = {text: abs(math.log(ratio)) if ratio > 0 else math.inf for text, ratio in ratios.items()}
    return {
        text: ratios[text]
        for text in sorted(off, key=lambda text: -off[text])
        if not abs(ratios[text] - 1) <= LIMIT
    }


def _draws(lever: Lever, uncertain: float, least: int, most: int = MOST) -> int:
    """Draws whose rms height error is told within a standard error."""
    return int(np.clip(math.ceil((lever.scatter / uncertain) ** 2), least, max(least, most)))


def _stands(row: DesignRow) -> bool:
    return not row.why and row.predicted > 0
