"""How much of the cells is left by blur, read off decoded coordinates: their stairs gather them at cells.

The mean of cos(2 pi (u + e(u))) over pixels that sample the cells evenly is T sinc(w) for small stairs e of
an endless period (see cells for T and w); for others it is tabled.
"""

from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .run_kernels import LINES, RUN, gather_runs

__all__ = ["contradicted", "gathered", "largest_left", "solve_stairs"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Runs of pixels that are looked at, about, in groups side by side (down columns, a line of the cache holds
#: pixels of several); what spreads these evenly.
_RUNS, _BESIDE, _GOLDEN = 512, 8, 0.6180339887498949
#: Runs that tell something, at least.
_FEWEST = 8
#: sinc(w) from which on a run of pixels tells the height of the stairs.
_TOLD = 0.15
#: What is tabled: steps of T, step and end of w (beyond, nothing is told), harmonics, places in a cell.
_LEVELS, _STEP, _WIDEST, _TERMS, _PLACES = 40, 0.02, 2.0, 16, 64
#: Footprint over period from which on a fringe is none.
_BLIND = 0.7


def gathered(coord: Map, sigma: Map, flags: Map, down: bool) -> tuple[F64, F64]:
    """By how much runs of pixels from all over the maps (H, W), along rows or (down) columns, gather at whole
    cells (K,), and their gradients (K,)."""
    rows, cols = coord.shape
    lines, length, apart, step = (cols, rows, 1, cols) if down else (rows, cols, cols, 1)
    across = length // RUN
    if across == 0:
        return np.zeros(0), np.zeros(0)
    chosen, run = _chosen(lines, across)
    starts = chosen * apart + run * (RUN * step)
    told, room = np.empty((2, len(starts))), np.empty((LINES, RUN), np.float32)
    flat = coord.reshape(-1), sigma.reshape(-1), flags.reshape(-1)
    count = gather_runs(starts, step, *flat, _parabolas(), room, told)
    return told[0, :count], told[1, :count]


def _chosen(lines: int, across: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Line and place along it of the runs, `across` of which a line holds: all, or groups from all over."""
    if lines * across <= _RUNS:
        line, run = np.divmod(np.arange(lines * across), across)
        return line, run
    beside = min(_BESIDE, lines)
    group = np.arange(across * max(1, _RUNS // (across * beside)))
    first = (group * _GOLDEN % 1.0 * (lines - beside + 1)).astype(np.int64)
    return (first[:, None] + np.arange(beside)).ravel(), np.repeat(group % across, beside)


def contradicted(attenuation: float, seen: F64, gradient: F64, shares: F64) -> bool:
    """Whether coordinates surely gather at whole cells by less than half of what T makes them.

    That is so for ideal cosines that no cells showed, whose contrast looks like that of a sharp display.
    """
    if len(seen) < _FEWEST:
        return False
    model = _table(shares)[round(attenuation * _LEVELS), _columns(gradient)]
    if not model.any():
        return False
    share, doubt = _attenuation(seen, model)
    return share + 4 * doubt < 0.5


def largest_left(seen: F64, gradient: F64) -> float:
    """T that two standard errors of what runs of pixels tell leave possible; 1 where there are too few."""
    if len(seen) < _FEWEST:
        return 1.0
    attenuation, doubt = _attenuation(seen, np.sinc(gradient))
    return float(np.clip(attenuation + 2 * doubt, 0.0, 1.0))


def _attenuation(seen: F64, model: F64) -> tuple[float, float]:
    """T of low stairs and its standard error."""
    weight = max(float(np.sum(model**2)), 1e-12)
    attenuation = float(np.sum(seen * model)) / weight
    return attenuation, float(np.sqrt(np.sum((seen - attenuation * model) ** 2 * model**2))) / weight


def solve_stairs(seen: F64, gradient: F64, shares: F64) -> tuple[float, float]:
    """(T, fill): what blur leaves of the cells' fundamental, and the footprint over the gradient, both 0..1.

    T is 0 where the frames cannot tell (1:1 sampling); fill is below 1 only if the stairs are higher than a
    footprint that fills the gradient allows.
    """
    if len(seen) < _FEWEST:
        return 0.0, 1.0
    model = np.sinc(gradient)
    # near 1:1 sampling stairs hardly show, and what little is seen would be blown up to any T
    told = np.abs(model) > _TOLD
    seen, gradient, model = seen[told], gradient[told], model[told]
    if float(np.sum(model**2)) < 1.0:
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
