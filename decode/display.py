"""What a display does to a fringe: it is a grid of cells, read through the footprint of a pixel and a blur.

A pixel that averages w cells of the map (a box), after a cell (a box of one) and a Gaussian blur of b cells, turns a
fringe of P cells into itself and sidebands of frequency 1/P + m, m = +-1, +-2, ... It reads u + e(u) instead of u,

    e = P / 2 pi arg(1 + sum over m of A_m exp(2 pi i m u)),
    A_m = (-1)^m / (1 + m P) sinc((1/P + m) w) / sinc(w / P) T^(m^2 + 2 m / P),    T = exp(-2 (pi b)^2),

and several periods share in the coordinate by their information N_j / P_j^2 (contrast_j)^2. The blur is what the
map tells itself: second differences of neighbours hold those of e, and the blur whose e leaves least of them is taken
if it leaves significantly less than none does. Then E[u | reading] replaces the reading, and what is unsure (Var[u |
reading], and the range of blurs that explain the map as well) joins the variance. Where the map does not tell, nothing
is taken off and all that may be there joins the variance.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .noise import Sample
from .plan import AxisPlan, Fringe

__all__ = ["Pixelation", "cell_error", "measured_pixelation", "no_pixelation", "table_rounding"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Places of a cell, widths of a footprint (cells) and blurs (cells rms) that are tabled.
PLACES = 64
_WIDEST = 2.5
WIDTHS = np.linspace(0.0, _WIDEST, 51)
_BLURS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7)
#: Harmonics of the cells; finer places on which readings are inverted.
_TERMS, _FINE = 4, 128
#: Change of chi2 that is significant (three deviations).
_SIGNIFICANT = 9.0
#: Squared deviations beyond which a second difference says nothing of cells.
_OUTLYING = 400.0
#: Footprint over period beyond which a fringe is not seen.
_BLIND = 0.9
#: Share of sigma that may be left out.
_SLIGHT = 0.1
#: Pixels of the sample that are compared at most.
_MOST = 4096


@dataclass(frozen=True, slots=True)
class Pixelation:
    """What is added to a reading, and its variance, by footprint (51,) and place in the cell (64,), cells.

    blur: rms, cells; NaN where the map does not tell it. reach: rms extent of what a pixel sees beyond its centre.
    """

    shift: F32
    variance: F32
    blur: float

    @property
    def reach(self) -> float:
        """Deviation of a cell and its blur, cells; of a usual blur where none is known."""
        blur = 0.5 if np.isnan(self.blur) else self.blur
        return float(np.sqrt(1 / 12 + blur**2))


def no_pixelation(blur: float = float("nan")) -> Pixelation:
    """Nothing that matters: of ideal fringes, or of a blur that leaves too little of the cells."""
    nothing = np.zeros((0, PLACES), np.float32)
    return Pixelation(nothing, nothing, blur)


def shares_of(axis: AxisPlan) -> tuple[tuple[float, float], ...]:
    """Periods of an axis and their information, shares of the finest's: N / P^2; coarse ones do not matter."""
    fringes = (*axis.fringes, *axis.singles)
    if not fringes:
        return ()
    weights = [len(fringe.index) / fringe.period**2 for fringe in fringes]
    pairs = zip((f.period for f in fringes), (w / max(weights) for w in weights), strict=True)
    return tuple((period, share) for period, share in pairs if share > 0.01)


def cell_error(shares: tuple[tuple[float, float], ...], width: Any, blur: float, place: F64) -> F64:
    """e (W, K) in cells at places (K,) (cells) for footprints (W,)."""
    m = np.concatenate([np.arange(1, _TERMS + 1), -np.arange(1, _TERMS + 1)])
    waves = np.exp(2j * np.pi * m[:, None] * place)
    width = np.atleast_1d(np.asarray(width, np.float64))[:, None]
    left = max(np.exp(-2 * (np.pi * blur) ** 2), 1e-12)
    error, weight = np.zeros((2, len(width), len(place)))
    for period, share in shares:
        seen = np.sinc(np.minimum(width, _BLIND * period) / period)
        bands = left ** (m * m + 2 * m / period) * np.sinc((1 / period + m) * width) / seen
        light = 1 + (bands * (-1.0) ** m / (1 + m * period)) @ waves
        own = share * (left ** (period**-2.0) * seen) ** 2 * np.abs(light) ** 2
        error += own * period / (2 * np.pi) * np.angle(light)
        weight += own
    return np.asarray(error / weight)


@lru_cache(maxsize=64)
def _inverted(shares: tuple[tuple[float, float], ...], blur: float, sigma: float) -> tuple[F32, F32]:
    """E[u] - reading and Var[u] beyond noise (W, PLACES), cells, of readings with that noise."""
    at = np.arange(_FINE) / _FINE
    reading = at + cell_error(shares, WIDTHS, blur, at)
    place = (np.arange(PLACES) / PLACES)[:, None]
    away = place - reading[:, None, :]
    weight = np.exp(-0.5 * ((away - np.rint(away)) / max(sigma, 1.5 / _FINE)) ** 2) + 1e-30
    weight /= weight.sum(axis=2, keepdims=True)
    truth = at - place
    truth -= np.rint(truth)
    shift = (weight * truth).sum(axis=2)
    variance = (weight * truth**2).sum(axis=2) - shift**2 - max(sigma, 1.5 / _FINE) ** 2
    return shift.astype(np.float32), np.maximum(variance, 0).astype(np.float32)


def measured_pixelation(axis: AxisPlan, blur: float | None, lit: Sample, coord: F32, variance: F32) -> Pixelation:
    """From the decoded map (H, W) of an axis and its variance at the sampled pixels that see the pattern.

    blur: rms, cells, if it is known.
    """
    shares = shares_of(axis)
    if not shares:
        return no_pixelation()
    seen = _neighbours(lit, coord, variance)
    sigma = 0.05 if seen is None else float(np.sqrt(np.median(seen.noise) / 6))
    usual = float(2.0 ** np.clip(np.rint(2 * np.log2(max(sigma, 1e-6))) / 2, -8, -1))
    if blur is not None:
        return _table(shares, blur, (blur, blur), usual)
    if seen is None:
        return _table(shares, float("nan"), (0.0, 0.0), usual)
    return _table(shares, *_fitted_blur(shares, usual, seen), usual)


def _table(
    shares: tuple[tuple[float, float], ...], blur: float, allowed: tuple[float, float], sigma: float
) -> Pixelation:
    """The correction for a blur (NaN: none), what blurs between the allowed ones would change in the variance."""
    place = np.arange(PLACES) / PLACES
    shift, variance = np.zeros((2, len(WIDTHS), PLACES), np.float32)
    own = np.zeros((len(WIDTHS), PLACES))
    if not np.isnan(blur):
        shift, variance = _inverted(shares, blur, sigma)
        own = cell_error(shares, WIDTHS, blur, place)
    unsure = [cell_error(shares, WIDTHS, end, place) - own for end in allowed]
    extra = np.max([(part**2).mean(axis=1) for part in unsure], axis=0)
    if (shift**2 + variance + extra[:, None]).max() < (_SLIGHT * sigma) ** 2:
        return no_pixelation(blur)
    return Pixelation(shift, (variance + extra[:, None]).astype(np.float32), blur)


@dataclass(frozen=True, slots=True)
class _Three:
    """Readings (3, K) of neighbours in a row, their footprint (K,) and the variance of their second difference."""

    place: F32
    width: F32
    noise: F32


def _neighbours(lit: Sample, coord: F32, variance: F32) -> _Three | None:
    """Of neighbours along the direction in which the coordinate changes most."""
    row, col = lit.places[:: max(1, len(lit.places) // _MOST)].T
    inside = (col > 0) & (col < coord.shape[1] - 1) & (row > 0) & (row < coord.shape[0] - 1)
    row, col = row[inside], col[inside]
    along, down = (
        np.stack([coord[row + d * y, col + d * x] for d in (-1, 0, 1)]) for y, x in ((0, 1), (1, 0))
    )
    steps = [0.5 * np.abs(three[2] - three[0]) for three in (along, down)]
    with np.errstate(invalid="ignore"):
        take = steps[0] >= steps[1]
        three = np.where(take, along, down)
        y, x = np.where(take, 0, 1), np.where(take, 1, 0)
        noise = variance[row - y, col - x] + 4 * variance[row, col] + variance[row + y, col + x]
        bend, width = three[0] - 2 * three[1] + three[2], np.hypot(*steps)
        keep = (noise < 1) & (width < _WIDEST) & (np.abs(bend) < 1)
    if np.count_nonzero(keep) < 200:
        return None
    return _Three(three[:, keep], width[keep], noise[keep])


def _fitted_blur(
    shares: tuple[tuple[float, float], ...], sigma: float, seen: _Three
) -> tuple[float, tuple[float, float]]:
    """The blur whose correction leaves least of the second differences (NaN: none leaves significantly less), and
    the ends of those that do as well. The curvature of the map itself counts as noise."""
    k = np.minimum(np.rint(seen.width / WIDTHS[1]).astype(int), len(WIDTHS) - 1)
    i = np.rint((seen.place - np.floor(seen.place)) * PLACES).astype(int) % PLACES
    chi2 = []
    for blur in (*_BLURS, None):
        three = seen.place if blur is None else seen.place + _inverted(shares, blur, sigma)[0][k, i]
        bend = three[0] - 2 * three[1] + three[2]
        chi2.append(np.minimum(bend**2 / seen.noise, _OUTLYING))
    left = np.sum(chi2, axis=1)
    left /= max(1.0, float(left.min()) / len(k))
    best = int(np.argmin(left[:-1]))
    near = np.flatnonzero(left[:-1] <= left.min() + _SIGNIFICANT)
    allowed = (_BLURS[near[0]], _BLURS[near[-1]]) if len(near) else (_BLURS[-1], _BLURS[-1])
    told = left[-1] - left[best] > _SIGNIFICANT
    return (_BLURS[best] if told else float("nan")), allowed


def table_rounding(fringe: Fringe, tables: NDArray[np.uint8]) -> float:
    """Variance (turns^2) of the phase of a cell by the rounding of its grey values; tables (N, extent)."""
    inverse = np.linalg.pinv(fringe.design())
    place = np.arange(tables.shape[1])
    c, s = inverse[1:] @ tables[list(fringe.index)].astype(np.float64)
    turns = np.arctan2(s, c) / (2 * np.pi) - place / fringe.period
    return float(np.var(turns - np.rint(turns)))
