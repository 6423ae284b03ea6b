"""Figures beside the limits that each is to keep: of the demo, with and without blur, and over seeds."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from optolever.records import Progress, silent
from optolever.samples import run_demo
from optolever.scene import load

SEEDS = 30
SMALL = (192, 192)


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured number, its unit, and the range that it is to lie in (None: no limit on that side)."""

    name: str
    value: float
    unit: str = ""
    low: float | None = None
    high: float | None = None
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the value lies within its limits."""
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)

    def limits(self) -> str:
        """In words."""
        known = {"at least": self.low, "at most": self.high}
        return ", ".join(f"{word} {limit:g}" for word, limit in known.items() if limit is not None)


def run_figures(
    *, seeds: int = SEEDS, size: tuple[int, int] | None = None, progress: Progress = silent
) -> list[Figure]:
    """Measure everything; size (rows, cols) resamples the demo, seeds: runs of the mean over seeds."""
    figures: list[Figure] = []
    for done, (name, part) in enumerate({"demo": _demo(size), "seeds": _many_seeds(seeds)}.items()):
        progress(name, done, 2)
        figures += part
    progress("", 2, 2)
    return figures


def _demo(size: tuple[int, int] | None) -> Iterator[Figure]:
    scene = load("paper-simulation", exact=True)
    result = run_demo(scene, size=size)
    numbers = result.metrics
    yield Figure("demo, height", numbers["height_rms_rel"], "of the depth", high=5e-5)
    yield Figure("demo, unflagged", 100 * numbers["unflagged_share"], "%", low=95)
    for name in ("u", "v"):
        yield Figure(f"demo, rms(error / sigma) of {name}", numbers[f"sigma_ratio_{name}"], low=0.9, high=1.1)
    yield Figure("demo, rms(error / sigma) of height", numbers["sigma_ratio_height"], low=0.75, high=1.35)
    yield Figure("demo, without its report", result.seconds["total"], "s", high=60)
    sharp = replace(scene, pattern=replace(scene.pattern, blur_px=0.0))
    numbers = run_demo(sharp, size=size).metrics
    yield Figure("demo without blur, height", numbers["height_rms_rel"], "of the depth", high=2e-4)


def _many_seeds(seeds: int) -> Iterator[Figure]:
    runs = [run_demo(size=SMALL, seed=seed).metrics["sigma_ratio_height"] for seed in range(seeds)]
    name = f"192 x 192, rms(error / sigma) of height, mean over {seeds} seeds"
    yield Figure(name, float(np.mean(runs)), low=0.95, high=1.05)
