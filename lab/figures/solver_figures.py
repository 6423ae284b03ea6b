"""The reconstructor's figures: exactness and time, growth and memory, plain integration.

Heights from exact correspondences, relative to the peak depth. Times are those of a second call, wall clock;
processor time beside them, for machines that are shared.
"""

import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy.fft

from optolever.experiments.arrays import Floats, Mask
from optolever.experiments.metrics import relative_error, rms, sigma_ratio
from optolever.experiments.timing import Measured, timed
from optolever.reconstruct import HeightMap, integrate, reconstruct
from optolever.records import Progress, silent
from optolever.scene import load, resize

from .figures import Figure, Parts, measured_parts
from .place import EXACT_SIGMA, Place, exact, middle_anchor
from .solver_bound import bound_figures

SIDE = 1024
LARGE = 2048
PRISM, RIG = "paper-simulation", "monitor-mirror"
INTEGRATED = 512
#: Pixels, and pairs of cosine transforms at most: exact, typed, against rest.
TIMES = {(480, 640): (90.0, 95.0, 140.0), (1024, 1024): (55.0, 58.0, 100.0)}


def run_solver_figures(*, seeds: int = 30, progress: Progress = silent) -> list[Figure]:
    """Measure everything; seeds: runs of the means over noise."""
    parts: Parts = {
        "times": run_solver_times,
        "mirrors": _mirrors,
        "growth and memory": _growth,
        "integration": _integration,
        "noise": lambda: bound_figures(seeds),
    }
    return measured_parts(parts, progress)


def run_solver_times() -> list[Figure]:
    """Processor time of a height over a pair of cosine transforms, minima; error over sigma beside it."""
    figures = list[Figure]()
    for (rows, cols), limits in TIMES.items():
        place = Place.of(resize(load("prism48"), rows, cols))
        flat = Place.of(place.scene, "flat")
        rng = np.random.default_rng(0)
        seen, rest = (exact(one.truth, noise=EXACT_SIGMA, rng=rng) for one in (place, flat))
        unit = min(timed(lambda: _transforms(place.truth.u)).processor for _ in range(9))  # noqa: B023
        known = replace(place.scene, accuracy=None, covariance=None)
        cases: dict[str, Callable[[], HeightMap]] = {
            "exact": partial(reconstruct, seen, known),
            "typed": partial(reconstruct, seen, place.scene),
            "against rest": partial(reconstruct, seen, place.scene, rest=rest),
        }
        for (name, call), limit in zip(cases.items(), limits, strict=True):
            runs = [timed(call) for _ in range(2)]  # the first compiles
            seconds = min(run.processor for run in runs)
            height = runs[0].value
            ratio = sigma_ratio(height.z, place.truth.z, height.total_sigma, height.good)
            note = f"{seconds:.2f} s; error over total sigma {ratio:.2f}"
            figures.append(Figure(f"{cols} x {rows}, {name}", seconds / unit, "pairs", high=limit, note=note))
    return figures


def _mirrors() -> Iterator[Figure]:
    place = _mirror(PRISM, "raised-cosine", SIDE)
    yield from _solved("prism, raised cosine", place, 1e-9, 1.0)
    error = relative_error(reconstruct(exact(place.truth), place.scene), place.truth)
    yield Figure("prism, raised cosine, edge at rest", error, "of the depth", high=1e-6)
    for name, mask in (("disk", _disk(SIDE)), ("blob", _blob(SIDE))):
        yield from _solved(f"prism behind a {name}", place, 1e-8, 2.5, mask)
    yield from _solved("pinhole", _mirror(RIG, "", SIDE), 1e-8, 2.5)
    yield from _solved("folded map", _mirror(PRISM, "gaussian:peak=2,sigma=9", SIDE), 1e-8)
    yield from _solved("needle", _mirror(PRISM, "needle", SIDE), 5e-6)


def _solved(
    name: str, place: Place, limit: float, seconds: float | None = None, mask: Mask | None = None
) -> Iterator[Figure]:
    _height(place, mask)  # what is compiled or loaded once is not counted
    run = timed(lambda: _height(place, mask))
    rows, cols = place.truth.u.shape
    error = relative_error(run.value, place.truth)
    yield Figure(f"{name}, {rows} x {cols}, known point", error, "of the depth", high=limit)
    solved = run.value.diagnostics
    note = (
        f"{run.processor:.2f} s of processor time, {len(solved.steps)} steps, {solved.iterations} iterations"
    )
    yield Figure(f"{name}, time", run.seconds, "s", high=seconds, note=note)


def _growth() -> Iterator[Figure]:
    """Processor time against N log N, and memory."""
    place = _mirror(PRISM, "raised-cosine", SIDE)
    _height(place)
    small = min(timed(lambda: _height(place)).processor for _ in range(2))
    for name, mask in (("whole", None), ("behind a blob", _blob(SIDE))):
        seen, anchor = exact(place.truth, mask), middle_anchor(place.truth)
        tracemalloc.start()
        reconstruct(seen, place.scene, anchor=anchor)
        peak = tracemalloc.get_traced_memory()[1] / place.truth.u.nbytes
        tracemalloc.stop()
        yield Figure(f"memory above the inputs, {name}", peak, "float64 images", high=40)
    place = _mirror(PRISM, "raised-cosine", LARGE)
    yield from _solved("prism, 4 Mpx", place, 1e-9, 6.0)
    large = min(timed(lambda: _height(place)).processor for _ in range(2))
    expected = (LARGE / SIDE) ** 2 * np.log(LARGE) / np.log(SIDE)
    yield Figure("growth over that of N log N", large / small / float(expected), high=1.1)


def _integration() -> Iterator[Figure]:
    y, x = (np.mgrid[:INTEGRATED, :INTEGRATED] + 0.5) / INTEGRATED - 0.5
    truth = np.exp(-(x**2 + y**2) / (2 * 0.15**2))
    gx, gy = -x / 0.15**2 * truth, -y / 0.15**2 * truth
    step = 1 / INTEGRATED
    found = integrate(gx, gy, spacing=step).z
    truth = truth - truth.mean()
    name = f"plain integration, Gaussian, {INTEGRATED} x {INTEGRATED}"
    yield Figure(name, rms(found - truth) / rms(truth), "of the field", high=3e-9)
    turns = _in_turn(partial(integrate, gx, gy, spacing=step), partial(_transforms, gx), count=15)
    whole, alone = (np.median([turn[k].processor for turn in turns]) for k in (0, 1))
    ratio = float(whole / alone)
    yield Figure(f"{name}, time over its two transforms", ratio, high=2.0)


def _in_turn(*calls: Callable[[], Any], count: int) -> list[tuple[Measured, ...]]:
    """Time each of the calls `count` times, interleaved, so that all meet the same load."""
    return [tuple(timed(call) for call in calls) for _ in range(count)]


def _transforms(values: Floats) -> Floats:
    modes = scipy.fft.dctn(values, norm="ortho")
    there: Floats = scipy.fft.idctn(modes, norm="ortho")
    return there


def _height(place: Place, mask: Mask | None = None) -> HeightMap:
    return reconstruct(exact(place.truth, mask), place.scene, anchor=middle_anchor(place.truth))


def _disk(side: int) -> Mask:
    y, x = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    return np.asarray(np.hypot(x, y) < 0.45)


def _blob(side: int) -> Mask:
    """A shape with bays, off any symmetry of the grid."""
    y, x = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    angle = np.arctan2(y, x)
    return np.asarray(np.hypot(x, y) < 0.35 + 0.08 * np.sin(3 * angle + 0.4) + 0.04 * np.cos(7 * angle))


@lru_cache(maxsize=2)
def _mirror(name: str, shape: str, side: int) -> Place:
    return Place.of(name, shape, (side, side))
