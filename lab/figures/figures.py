"""Figures beside the limits that each is to keep: exactness, renderers, the demo, noise, speed; and
reflection by brute force, which checks `scene.trace`.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import decode
from optolever.experiments import run_demo
from optolever.experiments.arrays import Floats
from optolever.experiments.metrics import rms
from optolever.experiments.timing import timed
from optolever.patterns import Sequence, sequence
from optolever.projector import NoContextError, PatternRenderer, capture, chosen_renderer, context_info
from optolever.records import Progress, silent
from optolever.scene import Scene, Surface, dent_from_text, load, resize, trace

STEPS = 4096  # samples along a ray, between which a crossing is looked for
HALVINGS = 80  # more than float64 has bits
RAYS = 500
SEEDS = 30
SMALL = (192, 192)
COMPARED = (384, 384)  # camera of the comparison of renderers
FULL = (1080, 1920)  # of the speeds
TRACED = ("raised-cosine", "gaussian", "ball", "needle", "ridge")


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


Parts = Mapping[str, Callable[[], Iterable[Figure]]]


def measured_parts(parts: Parts, progress: Progress) -> list[Figure]:
    """The figures of all parts, measured one after the other."""
    figures: list[Figure] = []
    for done, (name, part) in enumerate(parts.items()):
        progress(name, done, len(parts))
        figures += part()
    progress("", len(parts), len(parts))
    return figures


def run_figures(
    *, seeds: int = SEEDS, size: tuple[int, int] | None = None, progress: Progress = silent
) -> list[Figure]:
    """Measure everything; size (rows, cols) resamples the demo, seeds: runs of the mean over seeds."""
    parts: Parts = {
        "trace": _tracing,
        "renderers": _renderers,
        "renderer speed": _speed,
        "demo": lambda: _demo(size),
        "seeds": lambda: _many_seeds(seeds),
    }
    return measured_parts(parts, progress)


def _tracing() -> Iterator[Figure]:
    for name in ("paper-simulation", "monitor-mirror"):
        scene = resize(load(name, exact=True), 256, 256)
        rng = np.random.default_rng(0)
        row, col = rng.integers(0, 256, (2, RAYS))
        worst = 0.0
        for dent in TRACED:
            surface = dent_from_text(dent, scene)
            exact = trace(scene, surface)
            u, v = brute_force(scene, surface, row.astype(np.float64), col.astype(np.float64))
            seen = exact.visible[row, col]
            error = np.hypot(exact.u[row, col] - u, exact.v[row, col] - v)[seen]
            worst = max(worst, float(error.max()))
        yield Figure(f"trace against brute force, {name}, largest", worst, "px", high=1e-9)


def _renderers() -> Iterator[Figure]:
    """OpenGL against NumPy, without noise: frames, and what is decoded from unrounded bits."""
    try:
        context_info()
    except NoContextError:
        return
    for name in ("paper-simulation", "monitor-mirror"):
        scene = resize(load(name, exact=True), *COMPARED)
        surface = dent_from_text("gaussian", scene)
        shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
        frames = [
            capture(scene, surface, shown, renderer=renderer, bits=16).frames for renderer in ("gl", "numpy")
        ]
        levels = (frames[0].astype(np.float64) - frames[1]) / 257
        yield Figure(f"GLSL against float64, {name}, frames rms", rms(levels), "levels", high=0.5)
        apart = _decoded_apart(frames, shown)
        yield Figure(f"GLSL against float64, {name}, decoded rms", apart, "px", high=2e-3)


def _decoded_apart(frames: list[NDArray[Any]], shown: Sequence) -> float:
    first, second = (decode(stack, shown) for stack in frames)
    both = first.good & second.good
    return rms(np.hypot(first.u - second.u, first.v - second.v)[both].astype(np.float64))


def _speed() -> Iterator[Figure]:
    """Frames drawn for a second; captured once with noise, after a small capture that compiles."""
    name = "{1} x {0}".format(*FULL)
    if chosen_renderer("auto") == "gl":
        shown = sequence("gray+phase", *FULL)
        with PatternRenderer(shown) as patterns:
            patterns.draw(0)
            patterns.finish()
            count, start = 0, time.perf_counter()
            while (passed := time.perf_counter() - start) < 1:
                patterns.draw(count % len(shown))
                patterns.finish()
                count += 1
        yield Figure(f"drawn at {name}", count / passed, "frames/s", note=str(context_info()))
    scene = load("paper-simulation", exact=True)
    for size in ((64, 64), FULL):
        sized = resize(scene, *size)
        shown = sequence("gray+phase", sized.pattern.rows, sized.pattern.cols)
        taken = timed(partial(capture, sized, dent_from_text("raised-cosine", sized), shown, noise=1.0))
    yield Figure(f"captured at {name}", len(shown) / taken.seconds, "frames/s")


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


def brute_force(scene: Scene, surface: Surface, row: Floats, col: Floats) -> tuple[Floats, Floats]:
    """Pattern coordinates (u, v) of camera pixels (row, col), (n,); NaN where the ray misses the mirror.

    A ray is marched to the mirror and bisected, its mirror image is solved against the pattern's plane. Slow,
    and shares no step with `scene.trace`, which it checks.

    Neither shadows nor the pattern's extent are looked at: compare where `trace` says visible.
    """
    origin, direction = scene.camera.rays_at(row, col)
    points = origin + _distance(surface, origin, direction)[:, None] * direction
    slope_x, slope_y = surface.gradient(points[:, 0], points[:, 1])
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    householder = np.eye(3) - 2 * normal[:, :, None] * normal[:, None, :]
    leaving = np.einsum("nij,nj->ni", householder, direction)
    pattern = scene.pattern
    axes = np.broadcast_to([pattern.pitch * pattern.u_axis, pattern.pitch * pattern.v_axis], (len(row), 2, 3))
    system = np.concatenate([axes, -leaving[:, None, :]], axis=1).transpose(0, 2, 1)
    solved = np.full((len(row), 3), np.nan)
    known = np.isfinite(points).all(axis=1)
    solved[known] = np.linalg.solve(system[known], (points - pattern.origin)[known][..., None])[..., 0]
    return solved[:, 0], solved[:, 1]


def _distance(surface: Surface, origin: Floats, direction: Floats) -> Floats:
    """Where the ray first goes below the mirror; NaN if it does not on its way to z = -1 mm."""
    reach = (-1.0 - origin[:, 2]) / direction[:, 2]
    share = np.linspace(0.0, 1.0, STEPS)
    below = np.stack([_above(surface, origin, direction, reach * part) < 0 for part in share], axis=1)
    first = np.argmax(below, axis=1)
    high = np.where(below.any(axis=1) & (first > 0), reach * share[first], np.nan)
    low = reach * share[np.maximum(first - 1, 0)]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        inside = _above(surface, origin, direction, middle) < 0
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    return np.asarray(0.5 * (low + high))


def _above(surface: Surface, origin: Floats, direction: Floats, distance: Floats) -> Floats:
    """Height of the ray's point over the mirror, mm."""
    point = origin + distance[:, None] * direction
    return np.asarray(point[:, 2] - surface.height(point[:, 0], point[:, 1]))
