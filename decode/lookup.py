"""Look-up: a pixel's samples against known levels, whatever they are.

Free grey values, fringes of a single shift each, swept stripes, binary codes within their cells: the levels
that each place of the surface shows through a pixel (cell, footprint, blur) are known, a codeword for each
eighth of a pattern pixel. Samples are v = o + a t(u): normalised correlation finds the place, least squares
between adjacent codewords refines it, the Fisher information of the fit is its variance, or that of the
flattest codewords of the cell (the treads of a sharp display). Probability of another answer: from the angle
to the most similar codeword elsewhere, or from the highest correlations of all. Where no rule of the frames
tells the camera's noise, it is that of the residuals.

Start of the search: the neighbour's place (any levels), the brightest frame (stripes), the decoded cell
(codes).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from optolever.patterns import Sequence

from .estimate import Estimate
from .frames import Light
from .lookup_kernels import (
    PER_PX,
    SEARCH,
    SWEEP,
    WITHIN,
    Camera,
    match_rows,
)
from .lookup_tables import USUAL, Table, table_of
from .noise import Noise, Sample, fitted_noise
from .plan import AxisPlan, Plan

__all__ = ["Table", "lookup_rows", "prepare"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Pixels of the sample on which the spread is measured.
_PIXELS = 2048
#: Spreads that are tried, pattern pixels rms: from a pixel of a third of a cell to out of focus.
_SPREADS: tuple[float, ...] = (0.12, 0.2, 0.29, 0.45, 0.7, 1.2, 2.4)
#: Tables are kept for spreads in steps of 1 %, so that a series of captures shares them.
_STEP = 1.01
#: Squared residuals that noise reaches once in so many pixels.
_RARE = 1e-5
#: Relative step of a spread's derivatives; probability of another place below which a pixel may judge a
#: spread.
_NUDGE, _SAFE = 0.05, 1e-3
#: Relative error of a spread at least: of a footprint and a blur only one number is known.
_SHAPE = 0.07
#: Misfit over the least up to which places may decide on the spread.
_WORSE = 1.05
#: Parts of the sample that tell by how much places crowd by chance.
_GROUPS = 16
#: Share of the amplitude from which on a pixel of the sample counts.
_LIT = 0.25
#: Variance that is assumed before noise is measured, over the squared contrast.
_FIRST = 1e-5
#: Change of codewords that is none.
_TINY = 1e-6
#: Residuals that tell the noise at most.
_RESIDUALS = 16384


def lookup_rows(light: Light, noise: Noise, table: Table, rows: tuple[int, int], estimate: Estimate) -> None:
    """Decode rows start..stop, in place; of a code (WITHIN), refine the cells' centres that are there.

    A row's answers depend on nothing but that row. NaN, infinite variance and error 1: no pattern.
    """
    misfit2 = max(noise.misfit2, table.misfit2)
    camera = Camera(
        *(light.raw, light.table, float(light.clip)),
        *(float(noise.read2), float(noise.gain), float(misfit2)),
    )
    limit = float(chdtri(max(table.freedom, 1), _RARE))
    match_rows(camera, table.book, table.way, table.coarse, table.apart, limit, *rows, estimate)
    if table.unsure > 0:
        # the way to the nearest edge is proportional to the spread of the edges
        phase = (estimate.coordinate + 0.5) / table.cell
        estimate.variance[:] += np.square(table.unsure * table.cell * (phase - np.rint(phase)))


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
    """Table of an axis, its spread measured on pixels that see the pattern.

    cells (K,): of a code, coordinate of the cell of each pixel of `lit`, NaN: unknown; look within the cells.
    noise: None where it is not known; blur: rms, pattern px, if it is known.
    """
    places, start = _thinned(lit.places, cells)
    small = replace(light, raw=np.ascontiguousarray(light.raw[:, places[:, 0], places[:, 1]][:, None, :]))
    way, spreads = SEARCH if cells is None else WITHIN, _SPREADS
    if cells is None and axis.stripes is not None:
        # 0: an ideal surface without cells; up to half a stripe's width
        width = axis.stripes.width
        wide = [share * width for share in (0.18, 0.25, 0.35, 0.5) if share * width > _SPREADS[-1]]
        near = [spread for spread in _SPREADS if spread <= max(0.5 * width, 1.2)]
        way, spreads = SWEEP, (0.0, *near, *wide)
    spreads = tuple(float(np.hypot(spread, blur or 0.0)) for spread in spreads)

    def table_for(way: int, spread: float) -> Table:
        return table_of(sequence, plan, axis, way, spread, blur)

    usual = float(np.hypot(USUAL, blur or 0.0))
    if len(places) == 0:
        return table_for(way, usual)
    if measure := noise is None:
        contrast = float(np.mean(np.square(np.ptp(small.linear(small.raw), axis=0))))
        noise = Noise(max(light.rounding, _FIRST * contrast))
    trial = _Trial(small, noise, start, way)
    first = table_for(way, usual)
    if way == SEARCH:
        found = trial.decoded(first)
        trial = replace(
            trial, start=np.where(found.error < _SAFE, found.coordinate, np.nan)[0].astype(np.float64)
        )
        first = table_for(WITHIN, usual)
    if measure:
        trial = replace(trial, noise=trial.left(first))

    def tried(spread: float) -> _Quality:
        return trial.of(table_for(WITHIN if way == SEARCH else way, spread))

    quality = [tried(one) for one in spreads]
    spread, unsure = _best(quality), 0.0
    fits = [one.usual for one in quality]
    alike = [one for one, fit in zip(quality, fits, strict=True) if fit <= _WORSE * min(fits)]
    if way != SWEEP and len(alike) > 1:
        spread = min(alike, key=lambda one: float(np.abs(one.crowding.mean()))).spread
    if way == SWEEP:
        if spread > 0:  # a parabola through wide steps is rough
            spread = _best([tried(_rounded(spread * share)) for share in (0.9, 1.0, 1.1)])
    else:
        spread, unsure = _evened(tried, spread, blur is not None)
    table = replace(table_for(way, _rounded(spread)), unsure=unsure)
    return replace(table, noise=trial.left(table)) if measure else trial.judged(table)


def _thinned(places: NDArray[np.int64], cells: F64 | None) -> tuple[NDArray[np.int64], F64 | None]:
    """At most _PIXELS of the places, from all over the image."""
    every = max(1, -(-len(places) // _PIXELS))
    return places[::every], None if cells is None else cells[::every]


def _rounded(spread: float) -> float:
    return float(_STEP ** np.rint(np.log(spread) / np.log(_STEP))) if spread > 0 else 0.0


@dataclass(frozen=True, slots=True)
class _Quality:
    """Of a spread: chi2 over freedom of the sample's pixels (NaN: not decoded), crowding of the places
    of _GROUPS parts of the sample, see _evened."""

    spread: float
    misfit: F64
    crowding: NDArray[np.complex128]

    @property
    def usual(self) -> float:
        """Median of the misfit."""
        known = self.misfit[np.isfinite(self.misfit)]
        return float(np.median(known)) if len(known) else np.inf


@dataclass(frozen=True, slots=True)
class _Trial:
    """Pixels of a sample as frames of one row, and where their answers start."""

    light: Light
    noise: Noise
    start: F64 | None
    way: int

    def decoded(self, table: Table) -> Estimate:
        """The sample by a table, without its misfit."""
        found = Estimate.empty(1, self.light.raw.shape[2])
        if table.way == WITHIN:
            assert self.start is not None
            found.coordinate[0], found.variance[:] = self.start, np.inf
        lookup_rows(self.light, replace(self.noise, misfit2=0.0), table, (0, 1), found)
        return found

    def of(self, table: Table) -> _Quality:
        """How well a table fits."""
        found = self.decoded(table)
        used = np.isfinite(found.variance[0])
        if table.way != WITHIN and used.any():
            used &= found.amplitude[0] > _LIT * np.percentile(found.amplitude[0][used], 95)
        misfit = np.where(used, found.chi2[0].astype(np.float64) / max(table.freedom, 1), np.nan)
        # the mean of exp(2 pi i u) over each place's posterior: half a tread is no crowd
        place, variance = (part[0][used].astype(np.float64) for part in (found.coordinate, found.variance))
        turn = np.exp(2j * np.pi * place / table.cell - 2 * np.pi**2 * variance / table.cell**2)
        groups = np.array_split(turn, _GROUPS) if len(turn) >= _GROUPS else [np.ones(1)] * _GROUPS
        return _Quality(table.spread, misfit, np.array([group.mean() for group in groups], np.complex128))

    def left(self, table: Table) -> Noise:
        """The camera's noise by what a table leaves of the samples."""
        found, book = self.decoded(replace(table, way=WITHIN) if self.way == SEARCH else table), table.book
        lit = np.isfinite(found.variance[0]) & (found.amplitude[0] > 0)
        lit[np.arange(len(lit)) % (1 + lit.size * table.book.frames.shape[1] // _RESIDUALS) > 0] = False
        if table.way == SWEEP:
            lit &= found.error[0] < _SAFE
        place, amplitude, offset = (
            part[0, lit].astype(np.float64) for part in (found.coordinate, found.amplitude, found.offset)
        )
        if not len(place):
            return self.noise
        raw = self.light.raw[:, 0, lit]
        swept = raw[book.index].argmax(axis=0) if table.way == SWEEP else np.zeros(len(place), np.intp)
        first, block = book.first[swept], book.block[swept]
        at = np.clip((place - first) * PER_PX, 0, book.words.shape[1] - 1.001)
        q = at.astype(np.int64)
        f, (n, summed) = (at - q)[:, None], book.frames.shape[1:]
        words = book.words[:, :, :n] + book.angles[:, :, 3:4]
        shown = (1 - f) * words[block, q] + f * words[block, q + 1]
        raw = raw[book.frames[swept], np.arange(len(place))[:, None, None]]
        told = (offset - amplitude)[:, None] + 2 * amplitude[:, None] * shown
        # divided by what the fit of offset, scale and place leaves of a sample's own deviation
        scale, step = (
            part - part.mean(axis=1, keepdims=True) for part in (shown, words[block, q + 1] - words[block, q])
        )
        scale /= np.sqrt(np.square(scale).sum(axis=1, keepdims=True)) + _TINY
        step -= (step * scale).sum(axis=1, keepdims=True) * scale
        step /= np.sqrt(np.square(step).sum(axis=1, keepdims=True)) + _TINY
        left = 1 - 1 / n - scale**2 - step**2
        residual = (self.light.linear(raw).mean(axis=2) - told) / np.sqrt(np.maximum(left, 1 / n) / summed)
        kept = (raw < self.light.clip).all(axis=2) & (left > 1 / n)
        return fitted_noise(
            told[kept].astype(np.float32), residual[kept].astype(np.float32), max(self.light.rounding, 1e-12)
        )

    def judged(self, table: Table) -> Table:
        """The table with what it leaves beyond noise."""
        found, quality = self.decoded(table), self.of(table)
        used = np.isfinite(quality.misfit)
        if not used.any():
            return table
        own = self.noise.variance(found.offset[0][used]) / np.square(found.amplitude[0][used])
        own /= table.book.frames.shape[2]
        # median of chi2 over freedom (Wilson & Hilferty), and what chance adds to that of so many pixels
        freedom = max(table.freedom, 1)
        usual = (1 - 2 / (9 * freedom)) ** 3
        beyond = np.median(quality.misfit[used]) / usual - 1
        chance = 4 * np.sqrt(2 / (freedom * np.count_nonzero(used)))
        return replace(table, misfit2=float(beyond * np.median(own)) if beyond > chance else 0.0)


def _evened(tried: Callable[[float], _Quality], spread: float, known: bool) -> tuple[float, float]:
    """Spread with which places are spread evenly over the cells, and its relative error.

    Levels tell in what shares a pixel sees two cells, hardly how far from their edge it is. With a wrong
    spread places crowd: z = mean exp(2 pi i u / cell) is 0 but for chance, which parts of the sample tell.
    Newton's steps on z(log spread). What is left of z beyond chance (pixels in step with the cells) may be
    due to the spread.

    A relative error e of the spread moves places by k e of their way to the cell's nearest edge, and z by k
    e, k = 1 without blur: so z is the relative error of that way. Where the blur is known the shape is, too,
    and no spread moves z by more than its slope.
    """
    unsure, least = 0.0 if known else 1.0, np.inf
    for _ in range(6):
        low, mid, high = (tried(_rounded(spread * (1 + step))) for step in (-_NUDGE, 0.0, _NUDGE))
        slope = (high.crowding - low.crowding).mean() / np.log(high.spread / low.spread)
        crowding, steep = mid.crowding.mean(), float(np.abs(slope)) ** 2
        if steep < 1e-6:
            return spread, unsure
        step = float(np.clip(-(np.conj(slope) * crowding).real / steep, -0.3, 0.3))
        chance = float(np.sqrt(0.5 * np.mean(np.abs(mid.crowding - crowding) ** 2) / (_GROUPS - 1)))
        left = max(float(np.abs(crowding + slope * step)) - 3 * chance, 0.0)
        unsure = min(left + chance, steep**0.5) if known else min(max(left + chance, _SHAPE), 1.0)
        least = min(least, mid.usual)
        if abs(step) < 0.5 * (_STEP - 1):
            break
        better = tried(_rounded(spread * np.exp(step)))
        if not better.usual <= _WORSE * least:
            return spread, unsure
        spread = better.spread
    return spread, unsure


def _best(tried: list[_Quality]) -> float:
    """The spread that fits best, between those that were tried: misfits of the same pixels, without those
    that no spread explains."""
    misfit = np.array([one.misfit for one in tried])
    known = np.isfinite(misfit).all(axis=0)
    if not known.any():
        return USUAL
    least = misfit[:, known].min(axis=0)
    total = misfit[:, known][:, least <= 3 * np.median(least)].mean(axis=1)
    k = int(np.argmin(total))
    if 0 < k < len(tried) - 1:
        square = np.array([one.spread**2 for one in tried[k - 1 : k + 2]])
        bend, slope, _ = np.polyfit(square, total[k - 1 : k + 2], 2)
        if bend > 0:
            return float(np.sqrt(np.clip(-slope / (2 * bend), square[0], square[-1])))
    return tried[k].spread
