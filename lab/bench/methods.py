"""Speed against error of every method in one run: plain integration of fields, and heights of mirrors."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft

from optolever.errors import InputError
from optolever.experiments.arrays import Floats, Mask
from optolever.experiments.bench.measures import measures
from optolever.experiments.bench.solvers import installed, peer_integrators, solver, solver_names
from optolever.experiments.metrics import rms
from optolever.experiments.place import Place, middle_anchor
from optolever.experiments.timing import Measured, fastest
from optolever.files import load_arrays
from optolever.reconstruct import integrate, integrator_names, reconstruct
from optolever.records import Progress, silent

from .problems import PROBLEMS, spoiled

Numbers = dict[str, Any]
Measure = Callable[[], Numbers]

AGAIN = 20.0  # s: what takes less is run a second time, without what the first run compiles


@dataclass(frozen=True, slots=True)
class MethodRow:
    """One method on one case. seconds: wall, cpu: processor time; error: rms over the peak (fields: over the
    rms of the field) of what is not flagged; sigma_ratio: rms(error / sigma); flagged: share of the pixels
    that could be seen; silent: share of the unflagged off by more than 5 sigma; NaN where a method knows no
    sigma; why: no number.
    """

    part: str
    case: str
    method: str
    seconds: float = math.nan
    cpu: float = math.nan
    error: float = math.nan
    sigma_ratio: float = math.nan
    flagged: float = math.nan
    silent: float = math.nan
    why: str = ""


#: Problems by name, noise (px), and whether a known point is the anchor.
MIRRORS = (
    ("smooth", 0.0, False),
    ("smooth", 0.0, True),
    ("cusp", 0.0, False),
    ("holes", 0.0, False),
    ("smooth", 0.05, False),
    ("outliers 1 %", 0.05, False),
    ("pinhole", 0.0, True),
)
FIELDS = ("gaussian", "needle", "hole", "noise", "outliers 1 %")


def run_methods(
    size: tuple[int, int],
    cases: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    progress: Progress = silent,
    files: tuple[Path, ...] = (),
) -> list[MethodRow]:
    """Every method on every case; `cases` and `methods` keep those that hold one of the words given.

    files: more fields to integrate, see `load_field`. InputError if nothing is left.
    """
    work = [
        (part, case, name, measure)
        for part, case, name, measure in (*_fields(size, files), *_mirrors(size))
        if (not cases or any(word in f"{part}, {case}" for word in cases))
        and (not methods or name in methods)
    ]
    if not work:
        raise InputError(f"methods: none left of cases {list(cases)}, methods {list(methods)}")
    rows = []
    for done, (part, case, name, measure) in enumerate(work):
        progress(f"{case}: {name}", done, len(work))
        try:
            rows.append(MethodRow(part, case, name, **measure()))
        except InputError as error:
            rows.append(MethodRow(part, case, name, why=str(error)))
    progress("", len(work), len(work))
    return rows


def load_field(path: Path) -> tuple[Floats, Floats, Floats, Mask]:
    """A published test field, .npz: z, its slopes gx (per column) and gy (per row), (H, W) each, and mask (H,
    W) if not every pixel counts. InputError if they do not belong together.
    """
    arrays = load_arrays(path, ("z", "gx", "gy"))
    z, gx, gy = (np.asarray(arrays[name], dtype=np.float64) for name in ("z", "gx", "gy"))
    mask = np.asarray(arrays.get("mask", np.ones(z.shape)), dtype=np.bool_)
    for name, array in (("gx", gx), ("gy", gy), ("mask", mask)):
        if z.ndim != 2 or array.shape != z.shape:
            raise InputError(f"{path}: {name} has shape {array.shape}, must be 2-D like z {z.shape}")
    mask &= np.isfinite(gx) & np.isfinite(gy) & np.isfinite(z)
    if not mask.any():
        raise InputError(f"{path}: mask leaves no pixel with z, gx and gy")
    return z, gx, gy, mask


def _fields(size: tuple[int, int], files: tuple[Path, ...]) -> Iterator[tuple[str, str, str, Measure]]:
    """Plain integration."""
    fields = [(case, _field(case, size)) for case in FIELDS]
    for case, (z, gx, gy, mask) in [*fields, *((path.stem, load_field(path)) for path in files)]:
        if case == "gaussian":
            yield "integrate", case, "two DCTs alone", partial(_transforms, z)
        for name in integrator_names():
            yield "integrate", case, name, partial(_integrated, partial(_own, name, gx, gy, mask), z, mask)
        if mask.all():
            for name, peer in peer_integrators():
                yield "integrate", case, name, partial(_integrated, partial(peer, gx, gy), z, mask)


def _field(case: str, size: tuple[int, int]) -> tuple[Floats, Floats, Floats, Mask]:
    """Height, its slopes per pixel as given to the methods, the pixels to use."""
    rows, cols = size
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x, y = x - 0.5 * (cols - 1), y - 0.5 * (rows - 1)
    width = 0.15 * min(size)
    if case == "needle":
        r = np.maximum(np.hypot(x, y), 1e-9)
        z = np.exp(-r / (0.06 * min(size)))
        gx, gy = (-z * part / r / (0.06 * min(size)) for part in (x, y))
    else:
        z = np.exp(-(x * x + y * y) / (2 * width**2))
        gx, gy = -x / width**2 * z, -y / width**2 * z
    mask = np.hypot(x - 0.2 * cols, y) > 0.1 * min(size) if case == "hole" else np.ones(size, dtype=np.bool_)
    rng = np.random.default_rng(2)
    if case in ("noise", "outliers 1 %"):
        gx, gy = (g + 0.01 / width * rng.standard_normal(size) for g in (gx, gy))
    if case == "outliers 1 %":
        wrong = rng.random(size) < 0.01
        gx[wrong] += 10.0 / width * rng.standard_normal(int(wrong.sum()))
    return z, gx, gy, mask


def _own(name: str, gx: Floats, gy: Floats, mask: Mask) -> Floats:
    return integrate(gx, gy, name, mask=None if mask.all() else mask).z


def _transforms(z: Floats) -> Numbers:
    return _times(fastest(lambda: scipy.fft.idctn(scipy.fft.dctn(z, workers=2), workers=2), 2, AGAIN))


def _times(run: Measured) -> Numbers:
    return {"seconds": run.seconds, "cpu": run.processor}


def _integrated(call: Callable[[], Floats], z: Floats, mask: Mask) -> Numbers:
    run = fastest(call, 2, AGAIN)
    error = (run.value - z)[mask]
    return _times(run) | {"error": rms(error - np.mean(error)) / rms(z[mask])}


def _mirrors(size: tuple[int, int]) -> Iterator[tuple[str, str, str, Measure]]:
    """Heights from correspondences."""
    for problem, noise, point in MIRRORS:
        case = problem + (f", noise {noise:g} px" if noise else "") + (", known point" if point else "")
        for name in solver_names():
            known_point = solver(name).kind == "own" and name != "decoupled"
            if installed(solver(name).module) and (known_point or not point):
                yield "reconstruct", case, name, partial(_height, problem, noise, point, size, name)


def _height(which: str, noise: float, point: bool, size: tuple[int, int], method: str) -> Numbers:
    problem = next(problem for problem in PROBLEMS if problem.name == which)
    place = Place.of(problem.scene, problem.dent, size)
    seen = spoiled(problem, place, noise, "float64")
    call = partial(solver(method).run, seen, place.scene)
    if point:
        call = partial(reconstruct, seen, place.scene, method=method, anchor=middle_anchor(place.truth))
    run = fastest(call, 2, AGAIN)
    height = run.value
    numbers = measures(place.truth, seen, height)
    known = bool(np.isfinite(height.sigma[height.good]).any())
    return _times(run) | {
        "error": numbers["height_rms_rel"],
        "sigma_ratio": numbers["sigma_ratio_height"],
        "flagged": numbers["flagged_share"],
        "silent": numbers["silent_share"] if known else math.nan,
    }
