"""Least-squares solvers for edge increments, one signature: what `integrate` chooses from."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .alternatives import DirectEdges, marched
from .linear import MaskedEdges, SeparableEdges
from .poisson import Accuracy

__all__ = ["SOLVERS", "Field", "defect"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ACCURACY = Accuracy(relative=1e-12)
_CAUCHY = 2.385  # deviations at which a defect's weight is one half: 95 % efficiency under Gaussian noise
_ROBUST_STEPS = 30
_ROBUST_CHANGE = 1e-3  # of the defects' scale: where reweighting stops
_NEGLIGIBLE = 0.1  # energy of a solve's error: what no height is off by, in its own standard deviations
_PATIENCE = 50  # conjugate gradients that cost a factorisation; steeper weights still make it many more
_FACTORISED = 1 << 20  # pixels: 1 GB of factors
_ROUNDING = 1e-4  # of the increments: defects below it are quadrature and rounding, no outliers


@dataclass(frozen=True, slots=True)
class Field:
    """Edge increments gx, gy with their weights, on a mask."""

    gx: Floats
    gy: Floats
    wx: Floats
    wy: Floats
    mask: Mask


_Solution = tuple[Floats, int, tuple[Floats, Floats] | None]


def _residuals(f: Field, z: Floats) -> tuple[Floats, Floats]:
    rx, ry = f.gx.copy(), f.gy.copy()
    if f.mask.all():
        rx[:, :-1] -= np.diff(z, axis=1)
        ry[:-1] -= np.diff(z, axis=0)
        return rx, ry
    rx[:, :-1] = np.where(f.wx[:, :-1] > 0, f.gx[:, :-1] - np.diff(z, axis=1), 0.0)
    ry[:-1] = np.where(f.wy[:-1] > 0, f.gy[:-1] - np.diff(z, axis=0), 0.0)
    return rx, ry


def defect(f: Field, z: Floats) -> float:
    """rms difference between the increments and the differences of z."""
    rx, ry = _residuals(f, z if f.mask.all() else np.nan_to_num(z))
    count = int(np.count_nonzero(f.wx)) + int(np.count_nonzero(f.wy))
    return math.sqrt(float(np.vdot(rx, rx) + np.vdot(ry, ry)) / max(count, 1))


def _rectangle(f: Field) -> _Solution:
    result = SeparableEdges(f.wx, f.wy).solve(f.gx, f.gy, _ACCURACY)
    return result.x, result.iterations, None


def _cg(f: Field) -> _Solution:
    result = MaskedEdges(f.wx, f.wy, f.mask).solve(f.gx, f.gy, _ACCURACY)
    return result.x, result.iterations, None


def _direct(f: Field) -> _Solution:
    return DirectEdges(f.wx, f.wy, f.mask).solve(f.gx, f.gy, _ACCURACY).x, 1, None


def _robust(f: Field) -> _Solution:
    """Iteratively reweighted least squares with Cauchy weights 1 / (1 + (r / (2.385 s))^2) on the edge
    defects.

    s: scaled median absolute defect over the edges' own standard deviations. doi:10.1080/03610927708827533
    """
    floor = _ROUNDING * _scale(f, f.gx, f.gy)
    wx, wy, s, iterations = f.wx, f.wy, 0.0, 0
    z = np.zeros(f.mask.shape)
    factorise = False
    for _ in range(_ROBUST_STEPS):
        accuracy = Accuracy(energy=_NEGLIGIBLE * s, relative=1e-10)
        if not factorise:
            result = MaskedEdges(wx, wy, f.mask).solve(f.gx, f.gy, accuracy, z, _PATIENCE)
            factorise = result.iterations == _PATIENCE and int(f.mask.sum()) <= _FACTORISED
            z, iterations = result.x, iterations + result.iterations
        if factorise:
            z, iterations = DirectEdges(wx, wy, f.mask).solve(f.gx, f.gy, accuracy).x, iterations + 1
        rx, ry = _residuals(f, z)
        before, s = s, max(_scale(f, rx, ry), floor)
        if s == floor or abs(before - s) <= _ROBUST_CHANGE * s:
            break
        wx, wy = (w / (1.0 + w * (r / (_CAUCHY * s)) ** 2) for w, r in ((f.wx, rx), (f.wy, ry)))
    return z, iterations, (wx, wy)


def _scale(f: Field, rx: Floats, ry: Floats) -> float:
    """Scaled median of absolute edge values over the edges' own standard deviations."""
    pairs = ((rx, f.wx), (ry, f.wy))
    scaled = np.concatenate([np.abs(r[w > 0]) * np.sqrt(w[w > 0]) for r, w in pairs])
    return 1.4826 * float(np.median(scaled)) if scaled.size else 0.0


def _march(f: Field) -> _Solution:
    """Down the first column, then along every row."""
    return marched(f.gx, f.gy), 1, None


SOLVERS: dict[str, Callable[[Field], _Solution]] = {
    "weighted": _rectangle,
    "cg": _cg,
    "direct": _direct,
    "robust": _robust,
    "march": _march,
}
