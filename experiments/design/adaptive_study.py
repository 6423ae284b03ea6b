"""Adaptive sensing against the best fixed sequence: the same goal on several dents, frames counted."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.special import erf

from optolever.decode import decode
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, dent_from_text

from .adaptive import Goal, Step, adapt
from .candidates import SPAN, Candidate, candidates
from .on_demand import VirtualOnDemand
from .prediction import predict
from .sensitivity import Lever
from .view import Floats

__all__ = ["AdaptiveRow", "AdaptiveStudy", "best_fixed", "run_adaptive", "study_dents"]

Progress = Callable[[str, int, int], None]
VERIFIED = 4  # candidates of a budget that are simulated
DOUBTFUL = 0.01  # predicted share under the goal's, up to which a candidate is worth simulating
SIDE = 100


@dataclass(frozen=True, slots=True)
class AdaptiveRow:
    """One dent: frames that adaptive sensing took (mean over the seeds), share actually within the goal, that
    of the fixed sequence; met: what the adaptive measurement said of itself; steps of the first seed."""

    dent: str
    frames: float
    within: float
    fixed_within: float
    met: bool
    why: str
    steps: list[Step]


@dataclass(frozen=True)
class AdaptiveStudy:
    """rows per dent; fixed: the best fixed sequence and its frames, None if none meets the goal
    everywhere.
    """

    rows: list[AdaptiveRow]
    fixed: Candidate | None
    settings: dict[str, Any]
    seconds: dict[str, float]

    @property
    def fewer(self) -> int:
        """Dents on which adaptive sensing met the goal with fewer frames than the fixed sequence."""
        least = math.inf if self.fixed is None else len(self.fixed.sequence)
        return sum(
            row.met and row.within >= self.settings["share"] and row.frames < least for row in self.rows
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        fixed = None
        if self.fixed is not None:
            fixed = {"text": self.fixed.text, "frames": len(self.fixed.sequence)}
        return {
            "rows": [asdict(row) for row in self.rows],
            "fixed": fixed,
            "fewer": self.fewer,
            "settings": self.settings,
            "seconds": self.seconds,
        }


def silent(text: str, done: int, total: int) -> None:
    """Progress that nobody watches."""


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
) -> AdaptiveStudy:
    """Measure every dent adaptively; compare: find the best fixed sequence too (minutes)."""
    places = [_Place(scene, text, goal, noise, renderer) for text in dents]
    start = time.perf_counter()
    measured = []
    for index, place in enumerate(places):
        progress(f"adaptive: {place.dent}", index, len(places))
        measured.append([place.adaptive(seed) for seed in range(seeds)])
    adapted = time.perf_counter()
    fixed, shares = best_fixed(places, goal, seeds, progress) if compare else (None, [math.nan] * len(places))
    done = time.perf_counter()
    rows = [
        AdaptiveRow(
            place.dent,
            float(np.mean([len(run.sequence) for run, _ in runs])),
            float(np.mean([within for _, within in runs])),
            share,
            all(run.met for run, _ in runs),
            next((run.why for run, _ in runs if run.why), ""),
            runs[0][0].steps,
        )
        for place, runs, share in zip(places, measured, shares, strict=True)
    ]
    settings = {
        "scene": scene.name,
        "size": [scene.camera.rows, scene.camera.cols],
        "goal": goal.height,
        "share": goal.share,
        "noise": noise,
        "seeds": seeds,
    }
    return AdaptiveStudy(rows, fixed, settings, {"adaptive": adapted - start, "fixed": done - adapted})


def best_fixed(
    places: "list[_Place]", goal: Goal, seeds: int, progress: Progress = silent
) -> tuple[Candidate | None, list[float]]:
    """The fixed sequence of fewest frames that meets the goal on all places, and its actual share on each.

    Budget by budget, from the smallest that any code needs: candidates by their predicted share on the worst
    place, the most promising simulated. A miss of this search is the search's, not proven impossible.
    """
    pattern = places[0].scene.pattern
    for frames in range(8, goal.frames + 1):
        progress("fixed sequences", frames, goal.frames)
        offered = [
            *candidates(pattern.rows, pattern.cols, frames),
            *_uneven(pattern.rows, pattern.cols, frames),
        ]
        exact = [candidate for candidate in offered if len(candidate.sequence) == frames]
        ranked = sorted(
            ((_worst(places, c, goal.share - DOUBTFUL), c) for c in exact), key=lambda pair: -pair[0]
        )
        for worst, candidate in ranked[:VERIFIED]:
            if worst < goal.share - DOUBTFUL:
                break
            shares = []
            for place in places:
                shares.append(
                    float(np.mean([place.fixed(candidate.sequence, seed) for seed in range(seeds)]))
                )
                if shares[-1] < goal.share:
                    break
            if len(shares) == len(places) and min(shares) >= goal.share:
                return candidate, shares
    return None, [math.nan] * len(places)


def _worst(places: "list[_Place]", candidate: Candidate, least: float) -> float:
    """Least predicted share over the places; stops where it is under `least`."""
    worst = 1.0
    for place in places:
        worst = min(worst, place.predicted(candidate.sequence))
        if worst < least:
            break
    return worst


def _uneven(rows: int, cols: int, frames: int) -> Iterator[Candidate]:
    """Two-period ladders with steps of their own for every axis and period."""
    for split in product(range(3, 9), repeat=3):
        last = frames - sum(split)
        if not 3 <= last <= 12:
            continue
        counts = {"u": (split[0], split[1]), "v": (split[2], last)}
        for fine in (6.0, 8.0, 12.0):
            shown = [
                Frame("phase", axis, period_px=period, shift=2 * math.pi * k / count)
                for axis, extent in (("u", cols), ("v", rows))
                for period, count in zip((SPAN * extent, fine), counts[axis], strict=True)
                for k in range(count)
            ]
            text = f"ladder to {fine:g} px, steps u {split[0]}/{split[1]}, v {split[2]}/{last}"
            yield Candidate(text, Sequence(tuple(shown), rows, cols, text))


class _Place:
    """A scene with one dent, for prediction, adaptive and fixed measurement; errors against its truth."""

    def __init__(self, scene: Scene, text: str, goal: Goal, noise: float, renderer: str) -> None:
        self.scene, self.dent, self._goal = scene, text, goal
        self._noise, self._renderer = noise, renderer
        self.surface = dent_from_text(text, scene)
        stride = max(1, min(scene.camera.rows, scene.camera.cols) // SIDE)
        self.lever = Lever(scene, self.surface, stride=stride)
        self._reference: tuple[float, Floats] | None = None

    def adaptive(self, seed: int) -> tuple[Any, float]:
        """(what adaptive sensing did, share of the pixels that see the pattern actually within the goal)."""
        source = VirtualOnDemand(
            self.scene, self.surface, noise=self._noise, seed=seed, renderer=self._renderer
        )
        done = adapt(source, self.scene, self._goal, noise=self._noise)
        return done, self.within(done.height)

    def fixed(self, sequence: Sequence, seed: int) -> float:
        """Share actually within the goal of a fixed sequence."""
        seen = capture(
            self.scene, self.surface, sequence, noise=self._noise, seed=seed, renderer=self._renderer
        )
        try:
            return self.within(reconstruct(decode(seen.frames, sequence), self.scene))
        except InputError:
            return 0.0

    def within(self, height: HeightMap) -> float:
        """Share of the pixels that see the pattern with a height within the goal."""
        truth = self.lever.full.truth
        error = np.where(height.good, np.abs(height.z - truth.z), np.inf)
        return float((error <= self._goal.height)[truth.visible].mean())

    def predicted(self, sequence: Sequence) -> float:
        """The same predicted."""
        try:
            there = predict(self.lever.view, sequence, self._noise)
        except InputError:
            return 0.0
        size = self.lever.quick(there)
        if self._reference is None:
            solved = self.lever.solve(self.lever.view, (there.u.stated, there.v.stated), there.solved)
            self._reference = size, solved.sigma * self.lever.to_full
        unit, sigma = self._reference
        passed = (1 - there.u.refused) * (1 - there.v.refused)
        with np.errstate(divide="ignore", invalid="ignore"):
            each = passed * erf(self._goal.height * unit / (size * math.sqrt(2) * sigma))
        return float(np.nan_to_num(each)[self.lever.view.visible].mean())
