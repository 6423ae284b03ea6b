"""Solvers of the table: every method of `reconstruct`; conventional deflectometry (slopes computed at depth
zero, as if the mirror were at rest, and one integration); integrators from PyPI (mbipy, pyGrad2Surf), which
are run, never copied.
"""

import importlib
import importlib.util
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.fft

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, method_names, reconstruct, slope_map
from optolever.scene import Scene

from ..arrays import Floats
from ..paper import PAPER_METHODS, reconstruct_paper
from ..place import on_rest

Integrator = Callable[[Floats, Floats], Floats]


def decoupled(seen: Correspondence, scene: Scene, integrate: Integrator) -> HeightMap:
    """Height by one integration of the slopes at rest; no sigma (inf), flags of the correspondence.

    integrate: (height per row, height per column), (H, W) each -> height up to a constant. Flagged pixels
    have no slope. The constant is set so that the pixels along the edge x = L0 are at rest on average.
    """
    points, _ = on_rest(scene)
    x, y, none = points[..., 0], points[..., 1], np.zeros(points.shape[:2])
    slopes = slope_map(HeightMap(x, y, none, none, seen.flags), seen, scene)
    known = seen.good & np.isfinite(slopes.slope_x) & np.isfinite(slopes.slope_y)
    rises = (
        slopes.slope_x * np.gradient(x, axis=k) + slopes.slope_y * np.gradient(y, axis=k) for k in (0, 1)
    )
    steps = [np.where(known, rise, 0.0) for rise in rises]
    z = np.asarray(integrate(steps[0], steps[1]), dtype=np.float64)
    pixel = max(np.abs(np.gradient(x, axis=axis)).max() for axis in (0, 1))
    edge = x > x.max() - 0.75 * pixel
    z = z - z[edge].mean()
    flags = np.where(known | (seen.flags != 0), seen.flags, int(Flag.INVALID)).astype(np.uint16)
    return HeightMap(x, y, np.where(known, z, np.nan), np.full(z.shape, np.inf), flags)


def frankot_chellappa(per_row: Floats, per_col: Floats) -> Floats:
    """The periodic field whose gradient fits the given one in least squares.

    Frankot and Chellappa 1988, eq. 21 (doi:10.1109/34.3909).
    """
    rows, cols = per_row.shape
    along_rows = 2j * np.pi * scipy.fft.fftfreq(rows)[:, None]
    along_cols = 2j * np.pi * scipy.fft.rfftfreq(cols)[None, :]
    energy = np.abs(along_rows) ** 2 + np.abs(along_cols) ** 2
    energy[0, 0] = 1.0
    modes = -(along_rows * scipy.fft.rfft2(per_row) + along_cols * scipy.fft.rfft2(per_col)) / energy
    modes[0, 0] = 0.0
    return np.asarray(scipy.fft.irfft2(modes, s=(rows, cols)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Solver:
    """A solver of correspondence to height. kind: own | paper | peer; module: required package."""

    kind: str
    run: Callable[[Correspondence, Scene], HeightMap]
    module: str | None = None


def _mbipy(name: str, per_row: Floats, per_col: Floats) -> Floats:
    integrators: Any = importlib.import_module("mbipy.normal_integration")
    return np.asarray(getattr(integrators, name)(per_row, per_col), dtype=np.float64)


def _by_column(name: str, gx: Floats, gy: Floats) -> Floats:
    return _mbipy(name, gy, gx)


def _g2s(gx: Floats, gy: Floats) -> Floats:
    """Global least squares of Harker and O'Leary (arXiv:1308.4292), derivatives over five points; on copies:
    the package overwrites its arguments.
    """
    module: Any = importlib.import_module("pyGrad2Surf.g2s")
    x, y = (np.arange(count, dtype=np.float64) for count in gx.shape[::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(module.g2s(x, y, gx.copy(), gy.copy(), N=5), dtype=np.float64)


_OTHERS = {
    name: Solver("paper", partial(reconstruct_paper, series=series)) for name, series in PAPER_METHODS.items()
}
_OTHERS |= {"decoupled": Solver("own", partial(decoupled, integrate=frankot_chellappa))} | {
    f"mbipy-{short}": Solver("peer", partial(decoupled, integrate=partial(_mbipy, name)), "mbipy")
    for short, name in (("frankot", "frankot"), ("dct", "dct_poisson"), ("southwell", "southwell"))
}


def installed(module: str | None) -> bool:
    """True if the module can be imported, or if there is none to import."""
    return module is None or importlib.util.find_spec(module) is not None


def missing_peers() -> tuple[str, ...]:
    """Packages of peers that are not installed."""
    return tuple(name for name in ("mbipy", "pyGrad2Surf") if not installed(name))


def peer_integrators() -> Iterator[tuple[str, Callable[[Floats, Floats], Floats]]]:
    """Names and functions of the installed integrators: dz/dcol, dz/drow per pixel -> z up to a constant."""
    if installed("mbipy"):
        for name in ("frankot", "dct_poisson", "southwell", "li"):
            yield f"mbipy {name}", partial(_by_column, name)
    if installed("pyGrad2Surf"):
        yield "pyGrad2Surf g2s", _g2s


def solver_names() -> tuple[str, ...]:
    """Names of all solvers."""
    return (*method_names(), *_OTHERS)


def solver(name: str) -> Solver:
    """The solver of this name; InputError if there is none."""
    if name in method_names():
        return Solver("own", partial(reconstruct, method=name))
    try:
        return _OTHERS[name]
    except KeyError as error:
        raise InputError(f"solver {name!r}: unknown, must be one of {', '.join(solver_names())}") from error
