"""The reconstructor's figures: exactness and time, growth and memory, plain integration, cliffs, a stream.

Heights from exact correspondences, relative to the peak depth. Times are those of a second call, wall clock;
processor time beside them, for machines that are shared.
"""

import time
import tracemalloc
from collections.abc import Callable, Iterator
from functools import lru_cache, partial

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import sequence_from_text
from optolever.projector import capture
from optolever.reconstruct import HeightMap, HeightStream, PixelAnchor, integrate, reconstruct
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace

from .cliffs import cauchy_loop, cliff
from .demo import Progress, silent
from .figures import Figure
from .metrics import rms
from .solver_bound import bound_figures
from .timing import timed

__all__ = ["run_solver_figures"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIDE = 1024
LARGE = 2048
STATED = 0.01  # px: sigma of exact correspondences
PRISM, RIG = "paper-simulation", "monitor-mirror"
INTEGRATED = 512
CLIFFS, ROUGH = (512, 612), (1e-2, 1e-4)  # pixels; noise of the slopes, per pixel
STREAM, FRAMES = (480, 640), "phase"
PEAKS = (1.0, 1.01, 1.02, 1.03)
STREAMED = 24  # frames


def run_solver_figures(*, seeds: int = 30, progress: Progress = silent) -> list[Figure]:
    """Measure everything; seeds: runs of the means over noise."""
    parts: dict[str, Callable[[], Iterator[Figure]]] = {
        "whole prism": _whole,
        "masks": _masked,
        "other mirrors": _others,
        "growth and memory": _growth,
        "integration": _integration,
        "cliffs": _cliffs,
        "noise": lambda: bound_figures(seeds),
        "stream": _stream,
    }
    figures: list[Figure] = []
    for done, (name, part) in enumerate(parts.items()):
        progress(name, done, len(parts))
        figures += part()
    progress("", len(parts), len(parts))
    return figures


def _whole() -> Iterator[Figure]:
    scene, truth = _mirror(PRISM, "raised-cosine", SIDE)
    yield from _solved("prism, raised cosine", scene, truth, 1e-9, 1.0)
    error = _error(_height(scene, truth, None, known=False), truth)
    yield Figure("prism, raised cosine, edge at rest", error, "of the depth", high=1e-6)


def _masked() -> Iterator[Figure]:
    scene, truth = _mirror(PRISM, "raised-cosine", SIDE)
    for name, mask in (("disk", _disk(SIDE)), ("blob", _blob(SIDE))):
        yield from _solved(f"prism behind a {name}", scene, truth, 1e-8, 2.5, mask)


def _others() -> Iterator[Figure]:
    yield from _solved("pinhole", *_mirror(RIG, "", SIDE), 1e-8, 2.5)
    yield from _solved("folded map", *_mirror(PRISM, "gaussian:peak=2,sigma=9", SIDE), 1e-8)
    yield from _solved("needle", *_mirror(PRISM, "needle", SIDE), 5e-6)


def _solved(
    name: str,
    scene: Scene,
    truth: Trace,
    limit: float,
    seconds: float | None = None,
    mask: Mask | None = None,
) -> Iterator[Figure]:
    _height(scene, truth, mask)  # what is compiled or loaded once is not counted
    height, wall, processor = timed(lambda: _height(scene, truth, mask))
    rows, cols = truth.u.shape
    yield Figure(f"{name}, {rows} x {cols}, known point", _error(height, truth), "of the depth", high=limit)
    solved = height.diagnostics
    note = f"{processor:.2f} s of processor time, {len(solved.steps)} steps, {solved.iterations} iterations"
    yield Figure(f"{name}, time", wall, "s", high=seconds, note=note)


def _growth() -> Iterator[Figure]:
    """Processor time against N log N, and memory."""
    scene, truth = _mirror(PRISM, "raised-cosine", SIDE)
    _height(scene, truth, None)
    small = min(timed(lambda: _height(scene, truth, None))[2] for _ in range(2))
    for name, mask in (("whole", None), ("behind a blob", _blob(SIDE))):
        seen = _seen(truth, mask)
        anchor = _known(truth)
        tracemalloc.start()
        reconstruct(seen, scene, anchor=anchor)
        peak = tracemalloc.get_traced_memory()[1] / truth.u.nbytes
        tracemalloc.stop()
        yield Figure(f"memory above the inputs, {name}", peak, "float64 images", high=40)
    scene, truth = _mirror(PRISM, "raised-cosine", LARGE)
    yield from _solved("prism, 4 Mpx", scene, truth, 1e-9, 6.0)
    large = min(timed(lambda: _height(scene, truth, None))[2] for _ in range(2))
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
    whole, alone = [], []
    for _ in range(15):  # by turns, so that both meet the same load
        whole.append(timed(lambda: integrate(gx, gy, spacing=step))[2])
        alone.append(timed(lambda: _transforms(gx))[2])
    ratio = float(np.median(whole) / np.median(alone))
    yield Figure(f"{name}, time over its two transforms", ratio, high=2.0)


def _cliffs() -> Iterator[Figure]:
    """Robust integration over a cliff against a plain loop of reweighted sparse solves."""
    for noise in ROUGH:
        z, gx, gy, mask = cliff(*CLIFFS, noise)
        integrate(gx, gy, "robust", mask=mask)  # what is compiled once is not counted
        turns = [
            (
                timed(partial(integrate, gx, gy, "robust", mask=mask)),
                timed(partial(cauchy_loop, gx, gy, mask)),
            )
            for _ in range(2)  # by turns, so that both meet the same load
        ]
        own, loop = (min(turn[k][2] for turn in turns) for k in (0, 1))
        errors = [(found - z)[mask] for found in (turns[0][0][0].z, turns[0][1][0])]
        whole, middle = ([size(error - np.median(error)) for error in errors] for size in (rms, _middle))
        name = f"robust over a cliff, {CLIFFS[0]} x {CLIFFS[1]}, noise {noise:g}"
        note = f"processor time: {own:.1f} s, loop {loop:.1f} s"
        yield Figure(f"{name}, time over a plain loop's", own / loop, high=1.0, note=note)
        note = f"rms {whole[0]:.3g}, loop {whole[1]:.3g}; median {middle[0]:.3g}, loop {middle[1]:.3g}"
        yield Figure(f"{name}, rms error over a plain loop's", whole[0] / whole[1], high=1.02, note=note)


def _middle(error: Array) -> float:
    return float(np.median(np.abs(error)))


def _transforms(values: Array) -> Array:
    modes = scipy.fft.dctn(values, norm="ortho", workers=-1)
    there: Array = scipy.fft.idctn(modes, norm="ortho", workers=-1)
    return there


def _stream() -> Iterator[Figure]:
    """A dent that grows frame by frame: decoding and heights from the last frame's, timed together."""
    scene = resize(load(PRISM), *STREAM)
    shown = sequence_from_text(FRAMES, scene.pattern.rows, scene.pattern.cols)
    stacks = [
        capture(scene, dent_from_text(f"raised-cosine:peak={peak}", scene), shown, noise=1.0, seed=k).frames
        for k, peak in enumerate(PEAKS)
    ]
    stream = HeightStream(scene)
    for frames in stacks:  # what is compiled or loaded once is not counted
        stream.update(decode(frames, shown))
    turn = [stacks[k % len(stacks)] for k in [*range(4), 2, 1] * (STREAMED // 6)]
    start, processor = time.perf_counter(), time.process_time()
    heights: list[HeightMap] = []
    for frames in turn:
        height = stream.update(decode(frames, shown))
        if len(heights) < len(stacks):  # to hold them all is to fetch new memory for each
            heights.append(height)
    wall, processor = time.perf_counter() - start, time.process_time() - processor
    worst = 0.0
    for frames, height in zip(turn, heights, strict=False):
        full = reconstruct(decode(frames, shown), scene)
        both = full.good & height.good
        worst = max(worst, rms((height.z - full.z)[both] / full.sigma[both]))
    note = f"{1000 * processor / len(turn):.0f} ms of processor time each"
    yield Figure("stream, 640 x 480, decode and height", len(turn) / wall, "heights/s", low=30, note=note)
    yield Figure("stream, off the converged height, rms", worst, "sigma", high=0.1)


def _height(scene: Scene, truth: Trace, mask: Mask | None, known: bool = True) -> HeightMap:
    return reconstruct(_seen(truth, mask), scene, anchor=_known(truth) if known else None)


def _known(truth: Trace) -> PixelAnchor:
    row, col = (size // 2 for size in truth.u.shape)
    return PixelAnchor(float(row), float(col), float(truth.z[row, col]))


def _seen(truth: Trace, mask: Mask | None) -> Correspondence:
    sigma = np.full(truth.u.shape, STATED)
    seen = truth.visible if mask is None else truth.visible & mask
    return Correspondence(truth.u, truth.v, sigma, sigma, np.where(seen, 0, 128).astype(np.uint16))


def _error(height: HeightMap, truth: Trace) -> float:
    stands = height.good & truth.visible
    return rms((height.z - truth.z)[stands]) / float(np.nanmax(np.abs(truth.z)))


def _disk(side: int) -> Mask:
    y, x = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    return np.asarray(np.hypot(x, y) < 0.45)


def _blob(side: int) -> Mask:
    """A shape with bays, off any symmetry of the grid."""
    y, x = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    angle = np.arctan2(y, x)
    return np.asarray(np.hypot(x, y) < 0.35 + 0.08 * np.sin(3 * angle + 0.4) + 0.04 * np.cos(7 * angle))


@lru_cache(maxsize=2)
def _mirror(name: str, shape: str, side: int) -> tuple[Scene, Trace]:
    scene = resize(load(name), side, side)
    return scene, trace(scene, dent_from_text(shape or scene.dent or "flat", scene))
