"""Adaptive sensing against the best fixed sequence: the same goal on several dents, frames counted.

Both sides are judged alike: share of the pixels that see the pattern in full whose height is within the goal,
against the truth, mean over the same seeds.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.experiments.design import Candidate, Lever, candidates
from optolever.experiments.design.candidates import LEAST_STEPS
from optolever.experiments.design.view import stride_for
from optolever.notices import Notice
from optolever.patterns import Frame, Sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap
from optolever.records import Progress, silent
from optolever.scene import Scene, Surface, dent_from_text

from .adaptive import SIDE, Goal, Show, Start, Step, adapt, expected_share, starting

#: Predicted share under the goal's, up to which a fixed sequence is worth simulating; of one number of
#: frames so many at most.
DOUBTFUL, SIMULATED = 0.01, 10


@dataclass(frozen=True, slots=True)
class AdaptiveRow:
    """One dent: frames that adaptive sensing took (mean over the seeds), share actually within the goal, that
    of the fixed sequence; met: what the adaptive measurement said of itself; why not; steps of the first
    seed; seconds; notices of the last height maps."""

    dent: str
    frames: float
    within: float
    met: bool
    why: str
    steps: list[Step]
    seconds: float
    fixed_within: float = math.nan
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True)
class FixedSearch:
    """best: fewest frames that meet the goal on every dent, None if none does; shares: actually within the
    goal on each; offered: sequences that were looked at, simulated: on one dent at least."""

    best: Candidate | None
    shares: list[float]
    offered: int
    simulated: int


@dataclass(frozen=True)
class AdaptiveStudy:
    """rows per dent; fixed: the best fixed sequence, None if it was not looked for."""

    rows: list[AdaptiveRow]
    fixed: FixedSearch | None
    settings: dict[str, Any]
    seconds: dict[str, float]

    @property
    def fewer(self) -> int:
        """Dents on which adaptive sensing met the goal with fewer frames than the fixed sequence."""
        best = None if self.fixed is None else self.fixed.best
        least = math.inf if best is None else len(best.sequence)
        return sum(
            row.met and row.within >= self.settings["share"] and row.frames < least for row in self.rows
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        plain = asdict(self) | {"fewer": self.fewer}
        if self.fixed is not None:
            best = self.fixed.best
            told = (None, None) if best is None else (best.text, len(best.sequence))
            looked = {"offered": self.fixed.offered, "simulated": self.fixed.simulated}
            plain["fixed"] = dict(zip(("text", "frames"), told, strict=True)) | looked
        return plain


def study_dents(scene: Scene) -> tuple[str, ...]:
    """Six dents of different width, depth and shape that suit the scene's mirror."""
    side = min(scene.mirror.length, scene.mirror.width)
    x, y = 0.6 * scene.mirror.length, 0.4 * scene.mirror.width
    return (
        f"gaussian:peak={0.0008 * side:.4g},sigma={0.13 * side:.4g}",
        f"gaussian:peak={0.0056 * side:.4g},sigma={0.096 * side:.4g}",
        f"gaussian:peak={0.0024 * side:.4g},sigma={0.05 * side:.4g},x={x:.4g},y={y:.4g}",
        f"ridge:peak={0.0016 * side:.4g},sigma={0.064 * side:.4g},angle_deg=30",
        f"raised-cosine:peak={0.0016 * side:.4g}",
        f"rounded-needle:peak={0.0016 * side:.4g}",
    )


def run_adaptive(
    scene: Scene,
    dents: tuple[str, ...],
    goal: Goal,
    *,
    noise: float = 1.0,
    seeds: int = 2,
    compare: bool = True,
    renderer: str = "auto",
    progress: Progress = silent,
    told: Callable[[AdaptiveRow], None] = lambda row: None,
) -> AdaptiveStudy:
    """Measure every dent adaptively; compare: find the best fixed sequence too (minutes).

    told: gets every dent's row when it is measured.
    """
    start = time.perf_counter()
    progress("rest", 0, len(dents))
    first = starting(scene, noise, goal)
    rows, levers = [], []
    for index, dent in enumerate(dents):
        progress(f"adaptive: {dent}", index, len(dents))
        levers.append(Lever(scene, dent_from_text(dent, scene), stride=stride_for(scene, SIDE)))
        rows.append(_measured(dent, levers[-1], first, goal, seeds, renderer))
        told(rows[-1])
    adapted = time.perf_counter()
    fixed = best_fixed(levers, noise, goal, seeds, renderer, progress) if compare else None
    done = time.perf_counter()
    if fixed is not None:
        rows = [replace(row, fixed_within=share) for row, share in zip(rows, fixed.shares, strict=True)]
    settings = {
        "scene": scene.name,
        "size": [scene.camera.rows, scene.camera.cols],
        "goal": goal.height,
        "share": goal.share,
        "noise": noise,
        "seeds": seeds,
    }
    return AdaptiveStudy(rows, fixed, settings, {"adaptive": adapted - start, "fixed": done - adapted})


def _measured(dent: str, lever: Lever, first: Start, goal: Goal, seeds: int, renderer: str) -> AdaptiveRow:
    start = time.perf_counter()
    sources = [virtual(lever.scene, lever.surface, first.noise, seed, renderer) for seed in range(seeds)]
    runs = [adapt(source, first, goal) for source in sources]
    return AdaptiveRow(
        dent,
        float(np.mean([len(run.sequence) for run in runs])),
        float(np.mean([actual_share(lever, run.height, goal) for run in runs])),
        all(run.met for run in runs),
        next((run.why for run in runs if run.why), ""),
        runs[0].steps,
        time.perf_counter() - start,
        notices=tuple(dict.fromkeys(notice for run in runs for notice in run.height.notices)),
    )


def best_fixed(
    levers: list[Lever], noise: float, goal: Goal, seeds: int, renderer: str, progress: Progress = silent
) -> FixedSearch:
    """The fixed sequence of fewest frames whose mean share over the seeds meets the goal on every dent.

    Predicted first, then simulated from the most promising on. A miss of this search is the search's, not
    proven impossible.
    """
    pattern, need = levers[0].scene.pattern, goal.share - DOUBTFUL
    order = list(levers)  # the hardest first
    offered = simulated = 0
    for count in range(4 * LEAST_STEPS, goal.frames + 1):
        progress(f"fixed sequences of {count} frames", count, goal.frames)
        now = [one for one in candidates(pattern.rows, pattern.cols, count) if len(one.sequence) == count]
        least = {one.text: _least(order, one.sequence, noise, goal, need) for one in now}
        best = [one for one in now if least[one.text] >= need]
        offered += len(now)
        for candidate in sorted(best, key=lambda one: -least[one.text])[:SIMULATED]:
            simulated += 1
            shares: list[float] = []
            for lever in levers:
                shares.append(_fixed_share(lever, candidate.sequence, noise, goal, seeds, renderer))
                if shares[-1] < goal.share:
                    break
            else:
                return FixedSearch(candidate, shares, offered, simulated)
    return FixedSearch(None, [math.nan] * len(levers), offered, simulated)


def _least(order: list[Lever], sequence: Sequence, noise: float, goal: Goal, need: float) -> float:
    """Least predicted share; where it is under `need`, of those up to there, which then comes first."""
    least = 1.0
    for lever in tuple(order):
        least = min(least, expected_share(lever.view, lever.unit_sigma, sequence, noise, goal))
        if least < need:
            order.remove(lever)
            order.insert(0, lever)
            break
    return least


def _fixed_share(
    lever: Lever, sequence: Sequence, noise: float, goal: Goal, seeds: int, renderer: str
) -> float:
    """Share actually within the goal of a fixed sequence, mean over the seeds; 0 where it gives no height."""
    shares = np.zeros(seeds)
    for seed in range(seeds):
        with suppress(InputError):
            shares[seed] = actual_share(lever, lever.measured(sequence, noise, seed, renderer), goal)
    return float(np.mean(shares))


def actual_share(lever: Lever, height: HeightMap, goal: Goal) -> float:
    """Share of the pixels that see the pattern in full with a height within the goal."""
    view = lever.full
    error = np.where(height.good, np.abs(height.z - view.truth.z), np.inf)
    return float((error <= goal.height)[view.usable].mean())


def virtual(scene: Scene, surface: Surface, noise: float, seed: int, renderer: str) -> Show:
    """The virtual sensor as a source of frames on demand; every frame that is shown has noise of its own."""
    shown = 0

    def show(frames: tuple[Frame, ...]) -> NDArray[Any]:
        nonlocal shown
        sequence = Sequence(frames, scene.pattern.rows, scene.pattern.cols)
        own = int(np.random.SeedSequence([seed, shown]).generate_state(1)[0])
        shown += len(frames)
        return capture(scene, surface, sequence, noise=noise, seed=own, renderer=renderer).frames

    return show
