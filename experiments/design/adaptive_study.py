"""Adaptive sensing against the best fixed sequence: the same goal on several dents, frames counted.

Both sides are judged alike: share of the pixels that see the pattern in full whose height is within the goal,
against the truth, mean over the same seeds.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Frame, Sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap
from optolever.records import Progress, silent
from optolever.scene import Scene, Surface, dent_from_text

from .adaptive import SIDE, Adapted, Start, Step, adapt, starting
from .candidates import Candidate
from .goal import Goal, offers
from .sensitivity import Lever
from .view import stride_for

__all__ = [
    "AdaptiveRow",
    "AdaptiveStudy",
    "FixedSearch",
    "Place",
    "VirtualOnDemand",
    "best_fixed",
    "run_adaptive",
    "study_dents",
]

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
        fixed = None
        if self.fixed is not None:
            best = self.fixed.best
            fixed = {
                "text": None if best is None else best.text,
                "frames": None if best is None else len(best.sequence),
                "offered": self.fixed.offered,
                "simulated": self.fixed.simulated,
            }
        return {
            "rows": [asdict(row) for row in self.rows],
            "fixed": fixed,
            "fewer": self.fewer,
            "settings": self.settings,
            "seconds": self.seconds,
        }


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
    rows, places = [], []
    for index, dent in enumerate(dents):
        progress(f"adaptive: {dent}", index, len(dents))
        places.append(Place(first, dent, goal, renderer))
        rows.append(_measured(places[-1], seeds))
        told(rows[-1])
    adapted = time.perf_counter()
    fixed = best_fixed(places, goal, seeds, progress) if compare else None
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


def _measured(place: "Place", seeds: int) -> AdaptiveRow:
    start = time.perf_counter()
    runs = [place.adaptive(seed) for seed in range(seeds)]
    return AdaptiveRow(
        place.dent,
        float(np.mean([len(run.sequence) for run, _ in runs])),
        float(np.mean([within for _, within in runs])),
        all(run.met for run, _ in runs),
        next((run.why for run, _ in runs if run.why), ""),
        runs[0][0].steps,
        time.perf_counter() - start,
        notices=tuple(dict.fromkeys(notice for run, _ in runs for notice in run.height.notices)),
    )


def best_fixed(places: "list[Place]", goal: Goal, seeds: int, progress: Progress = silent) -> FixedSearch:
    """The fixed sequence of fewest frames whose mean share over the seeds meets the goal on every place.

    Predicted first, then simulated from the most promising on. A miss of this search is the search's, not
    proven impossible.
    """
    offered = simulated = 0
    levers, noise = [place.lever for place in places], places[0].start.noise
    for offer in offers(levers, noise, goal, goal.share - DOUBTFUL):
        offered += offer.looked_at
        for _, candidate in offer.best[:SIMULATED]:
            progress(f"fixed sequences of {offer.frames} frames", offer.frames, goal.frames)
            simulated += 1
            shares = _verified(places, candidate.sequence, goal.share, seeds)
            if shares is not None:
                return FixedSearch(candidate, shares, offered, simulated)
        progress(f"fixed sequences of {offer.frames + 1} frames", offer.frames, goal.frames)
    return FixedSearch(None, [math.nan] * len(places), offered, simulated)


def _verified(places: "list[Place]", sequence: Sequence, share: float, seeds: int) -> list[float] | None:
    """Actual shares on every place, None as soon as one is missed."""
    shares = []
    for place in places:
        shares.append(float(np.mean([place.fixed(sequence, seed) for seed in range(seeds)])))
        if shares[-1] < share:
            return None
    return shares


class VirtualOnDemand:
    """The virtual sensor as a source of frames on demand; every frame that is shown has noise of its own."""

    def __init__(
        self, scene: Scene, surface: Surface, *, noise: float, seed: int = 0, renderer: str = "auto"
    ) -> None:
        self._scene, self._surface = scene, surface
        self._noise, self._seed, self._renderer = noise, seed, renderer
        self.shown = 0

    def show(self, frames: tuple[Frame, ...]) -> NDArray[Any]:
        """Images (n, H, W) of the frames, in their order."""
        pattern = self._scene.pattern
        sequence = Sequence(frames, pattern.rows, pattern.cols)
        seed = int(np.random.SeedSequence([self._seed, self.shown]).generate_state(1)[0])
        self.shown += len(frames)
        seen = capture(
            self._scene, self._surface, sequence, noise=self._noise, seed=seed, renderer=self._renderer
        )
        return seen.frames


class Place:
    """A scene with one dent, for prediction, adaptive and fixed measurement; errors against its truth."""

    def __init__(self, start: Start, text: str, goal: Goal, renderer: str) -> None:
        self.start, self.dent, self._goal, self._renderer = start, text, goal, renderer
        self.surface = dent_from_text(text, start.scene)
        self.lever = Lever(start.scene, self.surface, stride=stride_for(start.scene, SIDE))

    def adaptive(self, seed: int) -> tuple[Adapted, float]:
        """(what adaptive sensing did, share of the pixels that see the pattern actually within the goal)."""
        source = VirtualOnDemand(
            self.start.scene, self.surface, noise=self.start.noise, seed=seed, renderer=self._renderer
        )
        done = adapt(source, self.start, self._goal)
        return done, self.within(done.height)

    def fixed(self, sequence: Sequence, seed: int) -> float:
        """Share actually within the goal of a fixed sequence."""
        try:
            return self.within(self.lever.measured(sequence, self.start.noise, seed, self._renderer))
        except InputError:
            return 0.0

    def within(self, height: HeightMap) -> float:
        """Share of the pixels that see the pattern in full with a height within the goal."""
        view = self.lever.full
        error = np.where(height.good, np.abs(height.z - view.truth.z), np.inf)
        return float((error <= self._goal.height)[view.usable].mean())
