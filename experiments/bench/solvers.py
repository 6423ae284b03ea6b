"""Solvers of the table: every method of `reconstruct`, one plain integration, and integrators from PyPI."""

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, method_names, reconstruct
from optolever.scene import Scene

from .decoupled import Floats, decoupled, frankot_chellappa

__all__ = ["Solver", "installed", "mbipy", "solver", "solver_names"]


@dataclass(frozen=True, slots=True)
class Solver:
    """A way from correspondence to height. kind: own | paper | peer; module: what must be installed."""

    name: str
    kind: str
    run: Callable[[Correspondence, Scene], HeightMap]
    module: str | None = None


def mbipy(name: str, per_row: Floats, per_col: Floats) -> Floats:
    """Integrator `name` of mbipy (MIT)."""
    integrators: Any = importlib.import_module("mbipy.normal_integration")
    return np.asarray(getattr(integrators, name)(per_row, per_col), dtype=np.float64)


_PLAIN = {"decoupled": Solver("decoupled", "own", partial(decoupled, integrate=frankot_chellappa))}
_PEERS = {
    f"mbipy-{short}": Solver(
        f"mbipy-{short}", "peer", partial(decoupled, integrate=partial(mbipy, name)), "mbipy"
    )
    for short, name in (("frankot", "frankot"), ("dct", "dct_poisson"), ("southwell", "southwell"))
}


def installed(module: str | None) -> bool:
    """True if the module can be imported, or if there is none to import."""
    return module is None or importlib.util.find_spec(module) is not None


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
