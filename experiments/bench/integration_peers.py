"""Integrators of gradient fields that install from PyPI, mbipy and pyGrad2Surf: run, never copied."""

import importlib
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .solvers import installed, mbipy

__all__ = ["missing_peers", "peer_integrators"]

Floats = NDArray[np.float64]
Integrator = Callable[[Floats, Floats], Floats]

_MBIPY = ("frankot", "dct_poisson", "southwell", "li")


def peer_integrators() -> Iterator[tuple[str, Integrator]]:
    """Names, and calls of (dz/dcol, dz/drow) per pixel that give z up to a constant; what is installed."""
    if installed("mbipy"):
        for name in _MBIPY:
            yield f"mbipy {name}", partial(_by_column, name)
    if installed("pyGrad2Surf"):
        yield "pyGrad2Surf g2s", _g2s


def missing_peers() -> tuple[str, ...]:
    """Packages of peers that are not installed."""
    return tuple(name for name in ("mbipy", "pyGrad2Surf") if not installed(name))


def _by_column(name: str, gx: Floats, gy: Floats) -> Floats:
    return mbipy(name, gy, gx)


def _g2s(gx: Floats, gy: Floats) -> Floats:
    """Global least squares of Harker and O'Leary (arXiv:1308.4292), derivatives over five points; it
    overwrites what it is given.
    """
    module: Any = importlib.import_module("pyGrad2Surf.g2s")
    x, y = (np.arange(count, dtype=np.float64) for count in gx.shape[::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(module.g2s(x, y, gx.copy(), gy.copy(), N=5), dtype=np.float64)
