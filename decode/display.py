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
PLACES = 128
WIDTHS = np.linspace(0.0, 2.5, 51)
_BLURS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8])
#: Harmonics of the cells; finer places on which readings are inverted; harmonics of e that are compared.
_TERMS, _FINE, _COMPARED = 4, 256, 3
#: Change of chi2 that is significant (three deviations).
_SIGNIFICANT = 9.0
#: Footprint over period beyond which a fringe is not seen.
_BLIND = 0.9
#: Share of sigma that may be left out.
_SLIGHT = 0.1
#: Pixels of the sample that are compared at most.
_MOST = 4096


@dataclass(frozen=True, slots=True)
class Pixelation:
    """What is added to a reading, and its variance, by footprint (51,) and place in the cell (128,), cells.

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


@lru_cache(maxsize=16)
def _harmonics(shares: tuple[tuple[float, float], ...]) -> F64:
    """Of e: coefficients of sin(2 pi h u), h = 1, 2, 3, by blur and footprint (B, 3, W)."""
    place = (np.arange(PLACES) + 0.5) / PLACES
    sines = np.stack([np.sin(2 * np.pi * h * place) for h in range(1, _COMPARED + 1)])
    errors = np.stack([cell_error(shares, WIDTHS, float(blur), place) for blur in _BLURS])
    return np.asarray(np.einsum("bwk,hk->bhw", errors, sines) * 2 / PLACES)


@lru_cache(maxsize=32)
def _inverted(shares: tuple[tuple[float, float], ...], blur: float, sigma: float) -> tuple[F32, F32]:
    """E[u] - reading and Var[u] beyond noise, of readings in the places of a cell, by footprint."""
    at = np.arange(_FINE) / _FINE
    reading = at + cell_error(shares, WIDTHS, blur, at)
    place = np.arange(PLACES) / PLACES
    away = place[:, None] - reading[:, None, :]  # (W, places, fine)
    away -= np.rint(away)
    spread = max(sigma, 1.5 / _FINE)
    weight = np.exp(-0.5 * (away / spread) ** 2) + 1e-30
    weight /= weight.sum(axis=2, keepdims=True)
    truth = at - place[:, None]
    truth = truth - np.rint(truth)
    shift = (weight * truth).sum(axis=2)
    variance = (weight * (truth - shift[..., None]) ** 2).sum(axis=2) - spread**2
    return shift.astype(np.float32), np.maximum(variance, 0).astype(np.float32)


def measured_pixelation(axis: AxisPlan, blur: float | None, lit: Sample, coord: F32, variance: F32) -> Pixelation:
    """From the decoded map (H, W) of an axis and its variance at the sampled pixels that see the pattern."""
    shares = shares_of(axis)
    if not shares:
        return no_pixelation()
    sigma = 0.0
    if blur is None:
        seen = _second_differences(lit, coord, variance)
        if seen is None:
            return _table(shares, float("nan"), (0.0, float(_BLURS[-1])), 0.05)
        place, width, bend, noise = seen
        sigma = float(np.sqrt(np.median(noise) / 6))
        best, low, high = _fitted_blur(_harmonics(shares), place, width, bend, noise)
        return _table(shares, best, (low, high), sigma)
    return _table(shares, blur, (blur, blur), 0.05)


def _table(
    shares: tuple[tuple[float, float], ...], blur: float, allowed: tuple[float, float], sigma: float
) -> Pixelation:
    """The correction for a blur (NaN: none), what blurs between the allowed ones would change in the variance."""
    place = np.arange(PLACES) / PLACES
    usual = round(float(np.clip(sigma, 0.005, 0.5)) * 100) / 100
    shift, variance = np.zeros((2, len(WIDTHS), PLACES), np.float32)
    own = np.zeros((len(WIDTHS), PLACES))
    if not np.isnan(blur):
        shift, variance = _inverted(shares, round(blur, 2), usual)
        own = cell_error(shares, WIDTHS, blur, place)
    unsure = [cell_error(shares, WIDTHS, end, place) - own for end in allowed]
    extra = np.max([(part**2).mean(axis=1) for part in unsure], axis=0)
    if (shift**2 + variance + extra[:, None]).max() < (_SLIGHT * sigma) ** 2:
        return no_pixelation(blur)
    return Pixelation(shift, (variance + extra[:, None]).astype(np.float32), blur)


def _second_differences(lit: Sample, coord: F32, variance: F32) -> tuple[F64, F64, F64, F64] | None:
    """Places (3, K) of three neighbours in a row, footprint, second difference and its variance (K,)."""
    row, col = lit.places[:: max(1, len(lit.places) // _MOST)].T
    inside = (col > 0) & (col < coord.shape[1] - 1)
    row, col = row[inside], col[inside]
    three = np.stack([coord[row, col + d] for d in (-1, 0, 1)]).astype(np.float64)
    noise = sum(f * variance[row, col + d].astype(np.float64) for f, d in ((1, -1), (4, 0), (1, 1)))
    bend, step = three[0] - 2 * three[1] + three[2], 0.5 * np.abs(three[2] - three[0])
    down = np.minimum(row + 1, len(coord) - 1)
    across = np.abs(coord[down, col] - coord[down - 1, col]).astype(np.float64)
    keep = np.isfinite(bend) & np.isfinite(across) & (noise < 1) & (step < 4) & (across < 4)
    keep &= np.abs(bend) < 0.5
    if np.count_nonzero(keep) < 200:
        return None
    width = np.hypot(step, across)
    return three[:, keep], width[keep], bend[keep], np.asarray(noise)[keep]


def _fitted_blur(
    harmonics: F64, place: F64, width: F64, bend: F64, noise: F64
) -> tuple[float, float, float]:
    """The blur whose e explains second differences best (NaN: none significantly), and the ends of those that
    explain them as well. The curvature of the map itself counts as noise."""
    column = np.minimum(np.rint(width / WIDTHS[1]).astype(int), len(WIDTHS) - 1)
    waves = [np.sin(2 * np.pi * h * place) for h in range(1, _COMPARED + 1)]
    bends = np.stack([wave[0] - 2 * wave[1] + wave[2] for wave in waves])
    left = np.array([(bend - (own[:, column] * bends).sum(axis=0)) for own in harmonics] + [bend])
    square = np.minimum(left**2 / noise, 25.0)  # what is further off says nothing
    scale = max(1.0, float(square.mean(axis=1).min()))
    chi2 = square.sum(axis=1) / scale
    best = int(np.argmin(chi2[:-1]))
    near = np.flatnonzero(chi2[:-1] <= chi2.min() + _SIGNIFICANT)
    low, high = (float(_BLURS[near[0]]), float(_BLURS[near[-1]])) if len(near) else (0.8, 0.8)
    told = chi2[-1] - chi2[best] > _SIGNIFICANT
    return (float(_BLURS[best]) if told else float("nan")), low, high


def table_rounding(fringe: Fringe, tables: NDArray[np.uint8]) -> float:
    """Variance (turns^2) of the phase of a cell by the rounding of its grey values; tables (N, extent)."""
    inverse = np.linalg.pinv(fringe.design())
    place = np.arange(tables.shape[1])
    c, s = inverse[1:] @ tables[list(fringe.index)].astype(np.float64)
    turns = np.arctan2(s, c) / (2 * np.pi) - place / fringe.period
    return float(np.var(turns - np.rint(turns)))
