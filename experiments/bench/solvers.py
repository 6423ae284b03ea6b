"""Solvers of the table: every method of `reconstruct`, one plain integration, and integrators from PyPI
(mbipy, pyGrad2Surf), which are run, never copied.
"""

import importlib
import importlib.util
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, method_names, reconstruct
from optolever.scene import Scene

from .decoupled import Floats, decoupled, frankot_chellappa

__all__ = ["Solver", "installed", "missing_peers", "peer_integrators", "solver", "solver_names"]


@dataclass(frozen=True, slots=True)
class Solver:
    """A way from correspondence to height. kind: own | paper | peer; module: what must be installed."""

    name: str
    kind: str
    run: Callable[[Correspondence, Scene], HeightMap]
    module: str | None = None


def _mbipy(name: str, per_row: Floats, per_col: Floats) -> Floats:
    integrators: Any = importlib.import_module("mbipy.normal_integration")
    return np.asarray(getattr(integrators, name)(per_row, per_col), dtype=np.float64)


def _by_column(name: str, gx: Floats, gy: Floats) -> Floats:
    return _mbipy(name, gy, gx)


def _g2s(gx: Floats, gy: Floats) -> Floats:
    """Global least squares of Harker and O'Leary (arXiv:1308.4292), derivatives over five points; it
    overwrites what it is given.
    """
    module: Any = importlib.import_module("pyGrad2Surf.g2s")
    x, y = (np.arange(count, dtype=np.float64) for count in gx.shape[::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(module.g2s(x, y, gx.copy(), gy.copy(), N=5), dtype=np.float64)


_PLAIN = {"decoupled": Solver("decoupled", "own", partial(decoupled, integrate=frankot_chellappa))}
_PEERS = {
    f"mbipy-{short}": Solver(
        f"mbipy-{short}", "peer", partial(decoupled, integrate=partial(_mbipy, name)), "mbipy"
    )
    for short, name in (("frankot", "frankot"), ("dct", "dct_poisson"), ("southwell", "southwell"))
}


def installed(module: str | None) -> bool:
    """True if the module can be imported, or if there is none to import."""
    return module is None or importlib.util.find_spec(module) is not None


def missing_peers() -> tuple[str, ...]:
    """Packages of peers that are not installed."""
    return tuple(name for name in ("mbipy", "pyGrad2Surf") if not installed(name))


def peer_integrators() -> Iterator[tuple[str, Callable[[Floats, Floats], Floats]]]:
    """Names, and calls of (dz/dcol, dz/drow) per pixel that give z up to a constant; what is installed."""
    if installed("mbipy"):
        for name in ("frankot", "dct_poisson", "southwell", "li"):
            yield f"mbipy {name}", partial(_by_column, name)
    if installed("pyGrad2Surf"):
        yield "pyGrad2Surf g2s", _g2s


def solver_names() -> tuple[str, ...]:
    """Names that `solver` knows."""
    return (*method_names(), *_PLAIN, *_PEERS)


def solver(name: str) -> Solver:
    """The solver of this name; InputError if there is none."""
    if name in method_names():
        kind = "paper" if name.startswith("paper") else "own"
        return Solver(name, kind, partial(reconstruct, method=name))
    try:
        return {**_PLAIN, **_PEERS}[name]
    except KeyError as error:
        raise InputError(f"solver {name!r}: unknown, must be one of {', '.join(solver_names())}") from error
