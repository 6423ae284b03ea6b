"""Least-squares solvers for edge increments, one signature: what `integrate` chooses from."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Mask
from ..judgement.reweighting import cauchy, scaled_median
from ..solver.alternatives import DirectEdges, marched
from ..solver.poisson import Accuracy, MaskedEdges, SeparableEdges

__all__ = ["SOLVERS", "Field", "defect"]

_ACCURACY = Accuracy(relative=1e-12)
_NEGLIGIBLE = 0.1  # energy of a solve's error: a bound of every height's error in standard deviations
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
    return math.sqrt(sum(float(np.einsum("ij,ij->", r, r)) for r in (rx, ry)) / max(count, 1))


def _rectangle(f: Field) -> _Solution:
    result = SeparableEdges(f.wx, f.wy).solve(f.gx, f.gy, _ACCURACY)
    return result.x, result.iterations, None


def _cg(f: Field) -> _Solution:
    result = MaskedEdges(f.wx, f.wy, f.mask).solve(f.gx, f.gy, _ACCURACY)
    return result.x, result.iterations, None


def _direct(f: Field) -> _Solution:
    return DirectEdges(f.wx, f.wy, f.mask).solve(f.gx, f.gy, _ACCURACY).x, 1, None


def _robust(f: Field) -> _Solution:
    """Cauchy weights on the edge defects, see `reweighting`."""
    floor = _ROUNDING * scaled_median((f.gx, f.gy), (f.wx, f.wy))
    z, iterations, factorise = np.zeros(f.mask.shape), 0, False
    left, scale = (f.wx, f.wy), 0.0

    def step(doubts: tuple[Floats, Floats] | None) -> tuple[Floats, Floats]:
        nonlocal z, iterations, factorise, left, scale
        if doubts is not None:
            left = f.wx / (1.0 + f.wx * doubts[0] ** 2), f.wy / (1.0 + f.wy * doubts[1] ** 2)
        accuracy = Accuracy(energy=_NEGLIGIBLE * scale, relative=1e-10)
        if not factorise:
            result = MaskedEdges(*left, f.mask).solve(f.gx, f.gy, accuracy, z, _PATIENCE)
            factorise = result.iterations == _PATIENCE and int(f.mask.sum()) <= _FACTORISED
            z, iterations = result.x, iterations + result.iterations
        if factorise:
            z, iterations = DirectEdges(*left, f.mask).solve(f.gx, f.gy, accuracy).x, iterations + 1
        residuals = _residuals(f, z)
        scale = scaled_median(residuals, (f.wx, f.wy))
        return residuals

    cauchy(step, (f.wx, f.wy), floor)
    return z, iterations, left


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
