"""How much of the cells is left by blur, read off decoded coordinates: their stairs gather them at cells.

The mean of cos(2 pi (u + e(u))) over pixels that sample the cells evenly is T sinc(w) for small stairs e of
an endless period (see cells for T and w); for others it is tabled.
"""

import math
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .run_kernels import LINES, RUN, gather_runs, most_runs

__all__ = ["Gathered", "contradicted", "gathered", "largest_left", "solve_stairs"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Runs that tell something, at least.
_FEWEST = 8
#: sinc(w) from which on a run of pixels tells the height of the stairs.
_TOLD = 0.15
#: What is tabled: steps of T, step and end of w (beyond, nothing is told), harmonics, places in a cell.
_LEVELS, _STEP, _WIDEST, _TERMS, _PLACES = 40, 0.02, 2.0, 16, 64
#: Footprint over period from which on a fringe is none.
_BLIND = 0.7


class Gathered(NamedTuple):
    """Of runs of pixels (K,): how much they gather at whole cells, gradients w (cells a pixel), sinc(w)."""

    seen: F64
    gradient: F64
    model: F64


def gathered(coord: Map, sigma: Map, flags: Map, down: bool) -> Gathered:
    """Of runs from all over the maps (H, W), along rows or (down) columns."""
    rows, cols = coord.shape
    told = np.empty((3, most_runs(cols, rows) if down else most_runs(rows, cols)))
    room = np.empty((LINES, RUN), np.float32)
    flat = coord.reshape(-1), sigma.reshape(-1), flags.reshape(-1)
    count = gather_runs(*flat, cols, down, _parabolas(), room, told)
    return Gathered(*told[:, :count])


def contradicted(attenuation: float, runs: Gathered, shares: F64) -> bool:
    """Whether coordinates surely gather at whole cells by less than half of what T makes them.

    That is so for ideal cosines that no cells showed, whose contrast looks like that of a sharp display.
    """
    if len(runs.seen) < _FEWEST:
        return False
    model = _table(shares)[round(attenuation * _LEVELS), _columns(runs.gradient)]
    if not model.any():
        return False
    share, doubt = _attenuation(runs.seen, model)
    return share + 4 * doubt < 0.5


def largest_left(runs: Gathered) -> float:
    """T that two standard errors of what runs of pixels tell leave possible; 1 where there are too few."""
    if len(runs.seen) < _FEWEST:
        return 1.0
    attenuation, doubt = _attenuation(runs.seen, runs.model)
    return min(max(attenuation + 2 * doubt, 0.0), 1.0)


def _attenuation(seen: F64, model: F64) -> tuple[float, float]:
    """T of low stairs and its standard error."""
    weight = max(float(model @ model), 1e-12)
    attenuation = float(seen @ model) / weight
    rest = (seen - attenuation * model) * model
    return attenuation, math.sqrt(float(rest @ rest)) / weight


def solve_stairs(runs: Gathered, shares: F64) -> tuple[float, float]:
    """(T, fill): what blur leaves of the cells' fundamental, and the footprint over the gradient, both 0..1.

    T is 0 where the frames cannot tell (1:1 sampling); fill is below 1 only if the stairs are higher than a
    footprint that fills the gradient allows.
    """
    if len(runs.seen) < _FEWEST:
        return 0.0, 1.0
    # near 1:1 sampling stairs hardly show, and what little is seen would be blown up to any T
    told = np.abs(runs.model) > _TOLD
    seen, gradient, model = runs.seen[told], runs.gradient[told], runs.model[told]
    if float(model @ model) < 1.0:
        return 0.0, 1.0
    attenuation, doubt = _attenuation(seen, model)
    if attenuation < 4 * doubt:
        return 0.0, 1.0
    table, column = _table(shares), _columns(gradient)
    misses = ((seen - table[:, column]) ** 2).sum(axis=1)
    best = int(np.argmin(misses))
    if best < _LEVELS:
        return (best + _between(misses[best - 1 : best + 2])) / _LEVELS, 1.0
    if np.sum(seen) <= 1.05 * np.sum(table[-1, column]):
        return 1.0, 1.0
    fills = np.linspace(0, 1, 41)
    apart = [abs(float(np.sum(seen - table[-1, (column * fill).astype(int)]))) for fill in fills]
    return 1.0, float(fills[int(np.argmin(apart))])


def _between(three: F64) -> float:
    """Where the parabola through three values at -1, 0 and 1 is least; 0 of fewer values."""
    if len(three) < 3 or not three[0] + three[2] > 2 * three[1]:
        return 0.0
    return float(0.5 * (three[0] - three[2]) / (three[0] + three[2] - 2 * three[1]))


@cache
def _parabolas() -> NDArray[np.float32]:
    """Orthonormal basis of the parabolas over a run (3, RUN)."""
    place = np.linspace(-1, 1, RUN)
    basis = np.linalg.qr(np.stack([np.ones(RUN), place, place**2], axis=1))[0]
    return np.ascontiguousarray(basis.T, np.float32)


@lru_cache(maxsize=64)
def _gathering(shares: tuple[tuple[float, float], ...]) -> F64:
    """Mean of cos(2 pi (u + e(u))) over a cell for T = 0, 1/40, ..., 1 (rows) and w = 0, 0.02, ..., 2."""
    place = (np.arange(_PLACES) + 0.5) / _PLACES
    m = np.concatenate([np.arange(1, _TERMS + 1), -np.arange(1, _TERMS + 1)])
    waves = np.exp(2j * np.pi * m[:, None] * place)
    left = np.maximum(np.linspace(0, 1, _LEVELS + 1), 1e-9)[:, None]
    width = np.arange(0, _WIDEST + _STEP / 2, _STEP)
    error, weight = np.zeros((2, len(left), len(width), _PLACES))
    for period, share in shares:
        seen = np.sinc(np.minimum(width, _BLIND * period) / period)
        bands = (left ** (m * m + 2 * m / period))[:, None] * np.sinc((1 / period + m) * width[:, None])
        bands *= (-1.0) ** m / (1 + m * period) / seen[:, None]
        light = 1 + bands @ waves
        own = share * ((left**period**-2) * seen)[..., None] ** 2 * np.abs(light) ** 2
        error += own * period / (2 * np.pi) * np.angle(light)
        weight += own
    mean: F64 = np.cos(2 * np.pi * (place + error / weight)).mean(axis=2)
    return mean


def _columns(gradient: F64) -> NDArray[np.int64]:
    """Of the table, for footprints."""
    return np.minimum(np.rint(gradient / _STEP), round(_WIDEST / _STEP)).astype(np.int64)


def _table(shares: F64) -> F64:
    return _gathering(tuple((float(period), float(share)) for period, share in shares))
