"""Look-up: a pixel's samples against known levels, whatever they are.

Free grey values, fringes of a single shift each, swept stripes, binary codes within their cells: the levels
that each place of the surface shows through a pixel (cell, footprint, blur) are known, a codeword for each
eighth of a pattern pixel. Samples are v = o + a t(u): normalised correlation finds the place, least squares
between adjacent codewords refines it, the Fisher information of the fit is its variance; where codewords
hardly differ over a part of the way (the treads of a sharp display's cells) mean and variance of the
posterior. Probability of another answer: from the angle to the most similar
codeword elsewhere, or from the highest correlations of all. Where no rule of the frames tells the camera's
noise, it is that of the residuals.

Start of the search: the neighbour's place (any levels), the brightest frame (stripes), the decoded cell
(codes).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.special import ndtr
from scipy.stats import chi2

from optolever.errors import InputError
from optolever.patterns import Sequence

from .estimate import Estimate
from .frames import Light
from .lookup_kernels import (
    COARSE,
    LANES,
    PER_PX,
    SEARCH,
    SWEEP,
    WITHIN,
    Book,
    Camera,
    match_rows,
)
from .noise import Noise, Sample, fitted_noise
from .plan import AxisPlan, Plan
from .plan import plan as described

__all__ = ["Table", "lookup_rows", "prepare"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Pixels of the sample on which the spread is measured.
_PIXELS = 4096
#: Spreads that are tried, pattern pixels rms: from a pixel of a third of a cell to out of focus.
_SPREADS: tuple[float, ...] = (0.12, 0.2, 0.29, 0.45, 0.7, 1.2, 2.4)
#: Spread of a pixel of one cell, no blur: what is assumed before anything is known.
_USUAL = 12**-0.5
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


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Known levels of one axis, as they are seen through `spread` (rms of footprint and blur, pattern px).

    way      SEARCH (any levels), SWEEP (stripes) or WITHIN (codes)
    book     codewords
    coarse   (M, P) unit codewords of a search; apart (P, 2) sine and cosine of the angle to the most similar
    one
    misfit2  variance of what the levels leave, over the squared amplitude
    noise    of the camera, as residuals tell it; None: it was known
    unsure   relative error of the spread: by as much of the way to the cell's nearest edge are places wrong
    """

    way: int
    book: Book
    coarse: F32
    apart: F64
    spread: float
    cell: float = 1.0
    misfit2: float = 0.0
    unsure: float = 0.0
    noise: Noise | None = None

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2: samples of a codeword less offset, scale and place."""
        return int(self.book.freedom)


def lookup_rows(light: Light, noise: Noise, table: Table, rows: tuple[int, int], estimate: Estimate) -> None:
    """Decode rows start..stop, in place; of a code (WITHIN), refine the cells' centres that are there.

    A row's answers depend on nothing but that row. NaN, infinite variance and error 1: no pattern.
    """
    misfit2 = max(noise.misfit2, table.misfit2)
    camera = Camera(
        *(light.raw, light.table, float(light.clip)),
        *(float(noise.read2), float(noise.gain), float(misfit2)),
    )
    limit = float(chi2.isf(_RARE, max(table.freedom, 1)))
    match_rows(camera, table.book, table.way, table.coarse, table.apart, limit, *rows, estimate.arrays())
    if table.unsure > 0:
        # the way to the nearest edge is proportional to the spread of the edges
        phase = (estimate.coordinate + 0.5) / table.cell
        estimate.variance[:] += np.square(table.unsure * table.cell * (phase - np.rint(phase)))


def prepare(
    sequence: Sequence,
    plan: Plan,
    axis: AxisPlan,
    light: Light,
    noise: Noise,
    lit: Sample,
    cells: F64 | None = None,
    measure: bool = False,
) -> Table:
    """Table of an axis, its spread measured on pixels that see the pattern.

    cells (K,): of a code, coordinate of the cell of each pixel of `lit`, NaN: unknown; look within the cells.
    measure: the noise is not known.
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
    if len(places) == 0:
        return _table(sequence, plan, axis, way, _USUAL)
    if measure:
        contrast = float(np.mean(np.square(np.ptp(small.linear(small.raw), axis=0))))
        noise = Noise(max(light.rounding, _FIRST * contrast))
    trial = _Trial(small, noise, start, way)
    first = _table(sequence, plan, axis, way, _USUAL)
    if way == SEARCH:
        found = trial.decoded(first)
        trial = replace(
            trial, start=np.where(found.error < _SAFE, found.coordinate, np.nan)[0].astype(np.float64)
        )
        first = _table(sequence, plan, axis, WITHIN, _USUAL)
    if measure:
        trial = replace(trial, noise=trial.left(first))

    def tried(spread: float) -> _Quality:
        return trial.of(_table(sequence, plan, axis, WITHIN if way == SEARCH else way, spread))

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
        spread, unsure = _evened(tried, spread)
    table = replace(_table(sequence, plan, axis, way, _rounded(spread)), unsure=unsure)
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
        found = Estimate.empty(1, self.light.raw.shape[2], table.freedom)
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
        lit[np.arange(len(lit)) % (1 + lit.size * book.samples // _RESIDUALS) > 0] = False
        if table.way == SWEEP:
            lit &= found.error[0] < _SAFE
        place, amplitude, offset = (
            part[0, lit].astype(np.float64) for part in (found.coordinate, found.amplitude, found.offset)
        )
        if not len(place):
            return self.noise
        middle = book.first + (book.words.shape[1] - 1) / (2 * PER_PX)
        stripe = np.abs(place[:, None] - middle).argmin(axis=1)
        block = book.block[stripe]
        at = np.clip((place - book.first[stripe]) * PER_PX, 0, book.words.shape[1] - 1.001)
        q = at.astype(np.int64)
        f, n = (at - q)[:, None], book.samples
        words = book.words[:, :, :n] + book.angles[:, :, 3:4]
        shown = (1 - f) * words[block, q] + f * words[block, q + 1]
        raw = self.light.raw[
            book.index[book.begin[stripe][:, None] + np.arange(n)], 0, np.flatnonzero(lit)[:, None]
        ]
        told = (offset - amplitude)[:, None] + 2 * amplitude[:, None] * shown
        # divided by what the fit of offset, scale and place leaves of a sample's own deviation
        scale, step = (
            part - part.mean(axis=1, keepdims=True) for part in (shown, words[block, q + 1] - words[block, q])
        )
        scale /= np.sqrt(np.square(scale).sum(axis=1, keepdims=True)) + _TINY
        step -= (step * scale).sum(axis=1, keepdims=True) * scale
        step /= np.sqrt(np.square(step).sum(axis=1, keepdims=True)) + _TINY
        left = 1 - 1 / n - scale**2 - step**2
        residual = (self.light.linear(raw) - told) / np.sqrt(np.maximum(left, 1 / n))
        kept = (raw < self.light.clip) & (left > 1 / n)
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
        # median of chi2 over freedom (Wilson & Hilferty), and what chance adds to that of so many pixels
        freedom = max(table.freedom, 1)
        usual = (1 - 2 / (9 * freedom)) ** 3
        beyond = np.median(quality.misfit[used]) / usual - 1
        chance = 4 * np.sqrt(2 / (freedom * np.count_nonzero(used)))
        return replace(table, misfit2=float(beyond * np.median(own)) if beyond > chance else 0.0)


def _evened(tried: Callable[[float], _Quality], spread: float) -> tuple[float, float]:
    """Spread with which places are spread evenly over the cells, and its relative error.

    Levels tell in what shares a pixel sees two cells, hardly how far from their edge it is. With a wrong
    spread places crowd: z = mean exp(2 pi i u / cell) is 0 but for chance, which parts of the sample tell.
    Newton's steps on z(log spread). What is left of z beyond chance (pixels in step with the cells) may be
    due to the spread.

    A relative error e of the spread moves places by k e of their way to the cell's nearest edge, and z by k
    e, k = 1 without blur: so z is the relative error of that way.
    """
    unsure, least = 1.0, np.inf
    for _ in range(6):
        low, mid, high = (tried(_rounded(spread * (1 + step))) for step in (-_NUDGE, 0.0, _NUDGE))
        slope = (high.crowding - low.crowding).mean() / np.log(high.spread / low.spread)
        crowding, steep = mid.crowding.mean(), float(np.abs(slope)) ** 2
        if steep < 1e-6:
            return spread, unsure
        step = float(np.clip(-(np.conj(slope) * crowding).real / steep, -0.3, 0.3))
        chance = float(np.sqrt(0.5 * np.mean(np.abs(mid.crowding - crowding) ** 2) / (_GROUPS - 1)))
        left = max(float(np.abs(crowding + slope * step)) - 3 * chance, 0.0)
        unsure = min(max(left + chance, _SHAPE), 1.0)
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
        return _USUAL
    least = misfit[:, known].min(axis=0)
    total = misfit[:, known][:, least <= 3 * np.median(least)].mean(axis=1)
    k = int(np.argmin(total))
    if 0 < k < len(tried) - 1:
        square = np.array([one.spread**2 for one in tried[k - 1 : k + 2]])
        bend, slope, _ = np.polyfit(square, total[k - 1 : k + 2], 2)
        if bend > 0:
            return float(np.sqrt(np.clip(-slope / (2 * bend), square[0], square[-1])))
    return tried[k].spread


@lru_cache(maxsize=32)
def _cached(sequence: Sequence, index: tuple[int, ...], axis: str, spread: float) -> tuple[F32, F32]:
    """Words and angles of any levels at the places -1 + k / PER_PX."""
    levels = sequence.tables()["uv".index(axis)][list(index)].astype(np.float64) / 255
    for k, i in enumerate(index):
        frame = sequence.frames[i]
        if frame.kind in ("white", "black"):
            levels[k] = float((frame.kind == "white") != frame.inverted)
    return _words(_seen(levels, spread, "edge" if sequence.nominal else "constant")[None])


@lru_cache(maxsize=8)
def _similar(
    sequence: Sequence, index: tuple[int, ...], axis: str, spread: float, reach: int
) -> tuple[F32, F64]:
    """Coarse unit codewords (M, P), and sine and cosine of the angle to the most similar one elsewhere."""
    words = _cached(sequence, index, axis, spread)[0][0][:, : len(index)].astype(np.float64)
    length = np.sqrt(np.square(words).sum(axis=1))
    unit = words / np.maximum(length, 1e-3 * length.max() + 1e-12)[:, None]
    per = PER_PX // COARSE
    coarse = np.ascontiguousarray(unit[per // 2 :: per][: (len(unit) - 1) // per], np.float32)
    count, guard = len(coarse), 2 * math.ceil(reach / per)
    nearest = np.empty(count, np.int64)
    place = np.arange(count)
    for start in range(0, count, 256):
        part = coarse[start : start + 256] @ coarse.T
        for row, k in enumerate(place[start : start + 256]):
            part[row, max(k - guard, 0) : k + guard + 1] = -1.0
        nearest[start : start + 256] = part.argmax(axis=1)
    near, fine = np.arange(-per, per + 1), place[:, None] * per + per // 2
    mine = unit[np.clip(fine + np.arange(-per // 2, per // 2 + 1), 0, len(unit) - 1)]
    theirs = unit[np.clip((nearest * per + per // 2)[:, None] + near, 0, len(unit) - 1)]
    cosine = np.clip((mine @ theirs.transpose(0, 2, 1)).max(axis=(1, 2)), 0.0, 1.0)
    if count <= 2 * guard + 1:
        cosine[:] = 0.0
    return np.ascontiguousarray(coarse.T), np.stack([np.sqrt(1 - cosine**2), cosine], axis=1)


def _table(sequence: Sequence, plan: Plan, axis: AxisPlan, way: int, spread: float) -> Table:
    if way == SWEEP:
        return Table(
            way, _sweep(sequence, axis.axis, spread), np.zeros((0, 0), np.float32), np.zeros((0, 2)), spread
        )
    index = axis.frames() + tuple(i for i in (plan.white, plan.black) if i >= 0)
    if len(index) < 3:
        raise InputError(f"decode: axis {axis.axis} has {len(index)} frames, must have at least 3")
    cell = max(sequence.frames[i].cell_px for i in index)
    reach = math.ceil(1.5 * cell * PER_PX)
    key = sequence, index, axis.axis, spread
    one, first = np.zeros(1, np.int64), np.array([-1.0])
    book = Book(np.array(index), len(index), one, one, first, *_cached(*key), reach, len(index) - 3)
    empty = np.zeros((len(index), 0), np.float32), np.zeros((0, 2))
    return Table(way, book, *(_similar(*key, reach) if way == SEARCH else empty), spread, cell)


@lru_cache(maxsize=32)
def _sweep(sequence: Sequence, axis: str, spread: float) -> Book:
    """Raised cosines around each place of a sweep, of as many frames as one lights."""
    (stripes,) = (one.stripes for one in described(sequence).axes if one.axis == axis)
    assert stripes is not None
    at, count = stripes.at, len(stripes.at)
    pitch, gap = float(np.median(np.diff(at))), float(np.diff(at).max())
    window = max(2, math.ceil((1.25 * stripes.width + 2 * spread) / pitch))
    samples = 2 * min(window, (count - 1) // 2) + 1
    begin = np.clip(np.arange(count) - samples // 2, 0, count - samples)
    half, beyond = math.ceil(1.25 * gap) + 1, math.ceil(4 * spread) + 1
    first = np.rint(at).astype(np.float64) - half
    # stripes at equal steps from cells share a block
    away = at[begin[:, None] + np.arange(samples)] - first[:, None]
    away, block = np.unique(away, axis=0, return_inverse=True)
    place = np.arange(2 * half * PER_PX + 1) / PER_PX
    cell = np.arange(-beyond, 2 * half + beyond + 1.0) if spread > 0 else place
    shown = np.abs(cell - away[:, :, None]) / stripes.width
    seen = np.where(shown < 1, 0.5 + 0.5 * np.cos(np.pi * np.minimum(shown, 1.0)), 0.0)
    if spread > 0:
        seen = seen @ _weight(cell[:, None] - place, spread)
    words, angles = _words(seen)
    return Book(
        *(stripes.index, samples, begin, block.ravel(), first),
        *(words, angles, PER_PX + PER_PX // 2, samples - 3),
    )


def _weight(distance: F64, spread: float) -> F64:
    """Share of a cell's light in what a pixel at a distance (pattern px) sees.

    The cell through a footprint of up to a cell; a larger spread is a Gaussian blur besides. Differences of
    the antiderivative t Phi(t / b) + b phi(t / b) of the normal distribution Phi.
    """
    width = min(max(spread * math.sqrt(12), 0.05), 1.0)
    blur = math.sqrt(max(spread**2 - 1 / 12, 1e-6))

    def integral(t: F64) -> F64:
        z = t / blur
        return np.asarray(t * ndtr(z) + blur / math.sqrt(2 * math.pi) * np.exp(-0.5 * z * z))

    def edge(t: F64) -> F64:
        return np.asarray((integral(t + 0.5 * width) - integral(t - 0.5 * width)) / width)

    return edge(distance + 0.5) - edge(distance - 0.5)


def _seen(levels: F64, spread: float, beyond: Any) -> F64:
    """Levels (M, E) of cells as pixels at -1 + k / PER_PX see them, (M, (E + 1) PER_PX + 1)."""
    extent, reach = levels.shape[1], math.ceil(4 * spread) + 1
    around = np.pad(levels, ((0, 0), (reach + 2, reach + 2)), mode=beyond)
    seen = np.zeros((len(levels), extent + 2, PER_PX))
    for s in range(PER_PX):
        for r in range(-reach, reach + 1):
            # cell m + r - 1 of the place m - 1 + s / PER_PX
            weight = float(_weight(np.array(r - s / PER_PX), spread))
            if weight > 0:
                seen[:, :, s] += weight * around[:, reach + 1 + r : reach + 1 + r + extent + 2]
    return seen.reshape(len(levels), -1)[:, : (extent + 1) * PER_PX + 1]


def _words(seen: F64) -> tuple[F32, F32]:
    """Levels (B, n, Q) -> codewords without mean (B, Q, n filled up); Book.angles (B, Q, 5)."""
    mean = seen.mean(axis=1)
    blocks, n, count = seen.shape
    words = np.zeros((blocks, count, -(-n // LANES) * LANES), np.float32)
    words[:, :, :n] = (seen - mean[:, None, :]).transpose(0, 2, 1)
    step = np.diff(words, axis=1, append=words[:, -1:])
    products = [
        np.einsum("bqn,bqn->bq", one, other, dtype=np.float32)
        for one, other in ((words, words), (words, step), (step, step))
    ]
    zz, zd, dd = (product.astype(np.float64) for product in products)
    sine2 = np.maximum(zz * dd - zd * zd, 0.0) / np.maximum(zz * zz, 1e-12)
    sine2[:, -1] = sine2[:, -2]
    least, most = (filtered(sine2, PER_PX + 1, axis=1) for filtered in (minimum_filter1d, maximum_filter1d))
    uneven = np.where(most > 4 * least, least, 1.0)
    return words, np.stack([*products, mean, uneven], axis=2, dtype=np.float32, casting="same_kind")
