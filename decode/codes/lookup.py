"""Look-up: a pixel's samples against known levels, whatever they are.

Free grey values, fringes of a single shift each (micro phase shifting: M. Gupta, S. K. Nayar, CVPR 2012,
doi:10.1109/CVPR.2012.6247753), swept stripes, binary codes within their cells: the levels of each place of
the surface through a pixel (cell, footprint, blur) are known, with a codeword for each eighth of a pattern
pixel. Samples are v = o + a t(u): normalised correlation finds the place, least squares between adjacent
codewords refines it, and the Fisher information of the fit gives its variance, or that of the flattest
codewords of the cell (the treads of a sharp display). The probability of another place follows from the angle
to the most similar codeword elsewhere, or from the highest correlations of all. If the frames have no
constraints for the camera's noise, the residuals give it.

Start of the search: the neighbour's place (any levels), the brightest frame (stripes), the decoded cell
(codes).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from optolever.patterns import Sequence

from ..estimate import Estimate
from ..frames import Light
from ..plan import AxisPlan, Plan
from ..profile.noise import Noise, Sample, fitted_noise
from .lookup_kernels import SEARCH, SWEEP, WITHIN, match_rows
from .lookup_light import Camera
from .lookup_tables import USUAL, Optics, Table, table_of

__all__ = ["Table", "lookup_rows", "prepare"]

F64 = NDArray[np.float64]
#: Pixels of the sample on which the spread is measured.
_PIXELS = 2048
#: Trial spreads, pattern pixels rms: from a pixel of a third of a cell to defocus, or to half a stripe.
_SHARPEST, _WIDEST, _TRIED = 0.12, 2.4, 8
#: Tables are kept for spreads in steps of 1 %, so that a series of captures shares them.
_STEP = 1.01
#: Squared residuals that noise reaches once in so many pixels.
_RARE = 1e-5
#: Relative step of a spread's derivatives; probability of another place below which a pixel enters the fit of
#: a spread.
_NUDGE, _SAFE = 0.05, 1e-3
#: Largest shift of a place by wrong optics, cells: a larger one is another place.
_MOVED = 0.5
#: Share of a normal variance within three deviations, for which fitted_noise corrects: mean squares of
#: several residuals have no tails.
_TAILS = 0.9733
#: Variance assumed before noise is measured, over the squared contrast.
_FIRST = 1e-5


def lookup_rows(light: Light, noise: Noise, table: Table, rows: tuple[int, int], estimate: Estimate) -> None:
    """Decode rows start..stop, in place; of a code (WITHIN), refine the given centres of cells.

    Each row is independent of the others. NaN, infinite variance and error 1: no pattern.
    """
    misfit2 = max(noise.misfit2, table.misfit2)
    camera = Camera(
        *(light.raw, light.table, float(light.clip)),
        *(float(noise.read2), float(noise.gain), float(misfit2)),
    )
    limit = float(chdtri(max(table.freedom, 1), _RARE))
    edges = float(table.unsure), float(table.cell)
    match_rows(camera, table.book, table.way, table.search, limit, edges, *rows, estimate)


def prepare(
    sequence: Sequence,
    plan: Plan,
    axis: AxisPlan,
    light: Light,
    noise: Noise | None,
    lit: Sample,
    cells: F64 | None = None,
    blur: float | None = None,
) -> Table:
    """Table of an axis, with the spread measured on illuminated pixels.

    cells (K,): of a code, coordinate of the cell of each pixel of `lit`, NaN: unknown; the search stays
    within the cells. noise: None if unknown; blur: rms, pattern px, if known.
    """

    def table_for(way: int, spread: float) -> Table:
        rounded = float(_STEP ** np.rint(np.log(spread) / np.log(_STEP))) if spread > 0 else 0.0
        return table_of(sequence, plan, axis, way, Optics(rounded, blur))

    way = WITHIN if cells is not None else SEARCH if axis.stripes is None else SWEEP
    usual = float(np.hypot(USUAL, blur or 0.0))
    if not len(lit.places):
        return table_for(way, usual)
    pixels = _pilot(light, noise, lit, cells)
    one_way = way
    if way == SEARCH:
        found = pixels.decoded(table_for(SEARCH, usual))
        start = np.where(found.error < _SAFE, found.coordinate, np.nan)[0].astype(np.float64)
        pixels, one_way = replace(pixels, start=start), WITHIN
        if not np.isfinite(start).any():
            return replace(table_for(way, usual), noise=pixels.noise if noise is None else None)
    spreads = np.geomspace(_SHARPEST, max(_WIDEST, 0.5 * axis.stripes.width if axis.stripes else 0), _TRIED)
    spreads = np.hypot(spreads, blur or 0.0)
    on_cells = way != SWEEP and bool(axis.levels or axis.code)
    if not on_cells:
        spreads = np.append(0.0, spreads)  # an ideal surface without cells

    def fitted(spread: float) -> _Fit:
        return pixels.fitted(table_for(one_way, spread))

    spread, error = _likeliest(fitted, spreads)
    low, fit, high = (fitted(spread * (1 + n)) for n in (-_NUDGE, 0.0, _NUDGE))
    # an error of the spread shifts places by less than the spread changes; places of stripes, which are
    # symmetric, not at all
    most = 0.0 if way == SWEEP else min(low.moved_to(high) / float(np.log((1 + _NUDGE) / (1 - _NUDGE))), 1.0)
    # a wrong shape of the spread crowds places; a known blur leaves no other shape
    shape = fit.crowding if blur is None else 0.0
    unsure = min(most * error + shape, most)
    table = replace(table_for(way, spread), unsure=unsure)
    if noise is None:
        return replace(table, noise=fit.noise(pixels.noise))
    return replace(table, misfit2=fit.beyond(noise))


def _pilot(light: Light, noise: Noise | None, lit: Sample, cells: F64 | None) -> "_Pixels":
    """At most _PIXELS illuminated pixels over the image; if the noise is unknown, a rough value."""
    every = max(1, -(-len(lit.places) // _PIXELS))
    row, col = lit.places[::every].T
    small = replace(light, raw=np.ascontiguousarray(light.raw[:, row, col][:, None, :]))
    if noise is None:
        contrast = float(np.mean(np.square(np.ptp(small.linear(small.raw), axis=0))))
        floor = max(light.rounding, 1e-12)
        noise = Noise(max(floor, _FIRST * contrast), rounding2=floor)
    return _Pixels(small, noise, None if cells is None else cells[::every])


@dataclass(frozen=True, slots=True)
class _Fit:
    """Fit of sampled pixels by one table: place, its variance, amplitude, offset, chi2 over freedom
    (infinite: not decoded)."""

    table: Table
    place: F64
    variance: F64
    amplitude: F64
    offset: F64
    misfit: F64

    @property
    def excess(self) -> float:
        """Median of the misfit over its value for noise alone (Wilson & Hilferty)."""
        known = self.misfit[np.isfinite(self.misfit)]
        usual = (1 - 2 / (9 * max(self.table.freedom, 1))) ** 3
        return float(np.median(known)) / usual if len(known) else 1.0

    @property
    def crowding(self) -> float:
        """Magnitude of the mean exp(2 pi i u / cell) over the sample and each place's posterior (so that half
        a tread does not count): 0, except for chance, for evenly spread places.
        """
        known = np.isfinite(self.misfit)
        if not known.any():
            return 0.0
        turn = 2j * np.pi * self.place[known] / self.table.cell
        mean = np.exp(turn - 2 * np.pi**2 * self.variance[known] / self.table.cell**2).mean()
        return float(np.abs(mean))

    def moved_to(self, other: "_Fit") -> float:
        """Relative change of the distances of places to the cell's nearest edge, by least squares."""
        both = np.isfinite(self.misfit) & np.isfinite(other.misfit)
        way = self.place[both] / self.table.cell + 0.5
        way -= np.rint(way)
        moved = np.clip((other.place - self.place)[both] / self.table.cell, -_MOVED, _MOVED)
        return abs(float(moved @ way)) / max(float(way @ way), 1e-12)

    def unlikely(self, excess: float) -> float:
        """-2 log likelihood: squared residuals over `excess` times their variance, clipped at noise's
        limit."""
        freedom = max(self.table.freedom, 1)
        return float(np.minimum(self.misfit * freedom / excess, float(chdtri(freedom, _RARE))).sum())

    def noise(self, assumed: Noise) -> Noise:
        """The camera's noise, from the residuals; assumed: noise of the fit, independent of the level."""
        known = np.isfinite(self.misfit)
        deviation = np.sqrt(_TAILS * self.misfit[known] * assumed.read2).astype(np.float32)
        return fitted_noise(self.offset[known].astype(np.float32), deviation, assumed.rounding2)

    def beyond(self, noise: Noise) -> float:
        """Variance of the residuals beyond noise, over the squared amplitude."""
        used = np.isfinite(self.misfit)
        if not used.any():
            return 0.0
        own = noise.variance(self.offset[used]) / np.square(self.amplitude[used])
        own /= self.table.book.frames.shape[2]
        # chance error of the median of so many pixels
        chance = 4 * np.sqrt(2 / (max(self.table.freedom, 1) * np.count_nonzero(used)))
        return float((self.excess - 1) * np.median(own)) if self.excess - 1 > chance else 0.0


@dataclass(frozen=True, slots=True)
class _Pixels:
    """Pixels of a sample as frames of one row, and the starts of their search."""

    light: Light
    noise: Noise
    start: F64 | None

    def decoded(self, table: Table) -> Estimate:
        """Decode the sample by a table, with a misfit of 0."""
        found = Estimate.empty(1, self.light.raw.shape[2])
        if table.way == WITHIN:
            assert self.start is not None
            found.coordinate[0], found.variance[:] = self.start, np.inf
        lookup_rows(self.light, replace(self.noise, misfit2=0.0), table, (0, 1), found)
        return found

    def fitted(self, table: Table) -> _Fit:
        """Fit of the sample by a table."""
        found = self.decoded(table)
        parts = found.coordinate, found.variance, found.amplitude, found.offset, found.chi2
        place, variance, amplitude, offset, chi2 = (part[0].astype(np.float64) for part in parts)
        misfit = np.where(np.isfinite(variance), chi2 / max(table.freedom, 1), np.inf)
        return _Fit(table, place, variance, amplitude, offset, misfit)


def _likeliest(fitted: Callable[[float], _Fit], spreads: F64) -> tuple[float, float]:
    """The likeliest spread, and its relative error from the likelihood's curvature (1 at most); the variance
    of residuals is scaled to the best spread's."""
    fits = [fitted(float(spread)) for spread in spreads]
    excess = max(min(fit.excess for fit in fits), 1e-3)
    values = [fit.unlikely(excess) for fit in fits]
    k = int(np.argmin(values))
    spread, least = float(spreads[k]), values[k]
    if spread == 0:
        return 0.0, 0.0
    bounds = spreads[max(k - 1, 0)], spreads[min(k + 1, len(spreads) - 1)]
    found = minimize_scalar(
        lambda spread: fitted(spread).unlikely(excess),
        bounds=bounds,
        method="bounded",
        options={"xatol": 0.5 * (_STEP - 1) * spread},
    )
    if found.fun < least:
        spread, least = float(found.x), float(found.fun)
    beside = [fitted(spread * (1 + step)).unlikely(excess) for step in (-_NUDGE, _NUDGE)]
    rise = max(sum(beside) / 2 - least, _NUDGE**2)
    return spread, _NUDGE / rise**0.5
