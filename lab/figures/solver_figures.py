"""The reconstructor's time, over pairs of cosine transforms, and its error over sigma."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import scipy.fft

from optolever.arrays import Floats
from optolever.reconstruct import HeightMap, exact_correspondence, reconstruct
from optolever.samples.metrics import sigma_ratio
from optolever.scene import dent_from_text, load, resize, trace
from optolever.timing import timed

from .figures import Figure

NOISE = 0.01  # px
#: Pixels, and pairs of cosine transforms at most: exact, typed, against rest.
TIMES = {(480, 640): (90.0, 95.0, 140.0), (1024, 1024): (55.0, 58.0, 100.0)}


def run_solver_times() -> list[Figure]:
    """Processor time of a height over a pair of cosine transforms, minima; error over sigma beside it."""
    figures = list[Figure]()
    for (rows, cols), limits in TIMES.items():
        scene, rng, captures = resize(load("prism48"), rows, cols), np.random.default_rng(0), []
        truth, flat = (
            trace(scene, dent_from_text(name, scene)) for name in ("gaussian:peak=0.3,sigma=8", "flat")
        )
        for one in (truth, flat):
            u, v = (part + NOISE * rng.standard_normal(part.shape) for part in (one.u, one.v))
            captures.append(replace(exact_correspondence(one, NOISE), u=u, v=v))
        seen, rest = captures
        unit = min(timed(lambda: _transforms(truth.u)).processor for _ in range(9))  # noqa: B023
        known = replace(scene, accuracy=None, covariance=None)
        cases: dict[str, Callable[[], HeightMap]] = {
            "exact": partial(reconstruct, seen, known),
            "typed": partial(reconstruct, seen, scene),
            "against rest": partial(reconstruct, seen, scene, rest=rest),
        }
        for (name, call), limit in zip(cases.items(), limits, strict=True):
            runs = [timed(call) for _ in range(5)]  # the first compiles; others may share the machine
            seconds = min(run.processor for run in runs)
            height = runs[0].value
            ratio = sigma_ratio(height.z, truth.z, height.total_sigma, height.good)
            note = f"{seconds:.2f} s" + ("" if name == "typed" else f"; error over total sigma {ratio:.2f}")
            figures.append(Figure(f"{cols} x {rows}, {name}", seconds / unit, "pairs", high=limit, note=note))
    return figures


def _transforms(values: Floats) -> Floats:
    modes = scipy.fft.dctn(values, norm="ortho")
    there: Floats = scipy.fft.idctn(modes, norm="ortho")
    return there
