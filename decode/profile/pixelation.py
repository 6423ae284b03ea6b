"""Pixelation by a display's cells: estimate of the optics from the map, correction, and residual variance.

The map determines blur and the luminous share of a cell: the neighbours of a pixel predict its place, its
reading is compared with the reading through each optics (see display), and the optics with the least misfit
are selected if they fit significantly better than no cells, as they are expected to. Then E[u | reading]
replaces the reading, and its uncertainty (Var[u | reading], and the range of optics that explain the map
equally well) joins the variance. If the map does not determine the optics, no correction is applied, and the
whole possible shift joins the variance. The remaining differences of neighbours beyond noise join it, too.
Where sampling and cells are commensurate, the error is common to all pixels (see _in_step).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..display import FINE, PLACES, WIDEST, WIDTHS, cell_error, inverted, shares_of
from ..plan import Plan
from .border import SHADOW2
from .noise import Sample

__all__ = ["REACH", "SLIGHT", "Pixelation", "measured_pixelations", "usual_width"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Shares = tuple[tuple[float, float], ...]
Tables = tuple[F32, F32, F32]
#: Pixels on either side for the slope of a footprint: over fewer the cells would count as gradient.
REACH = 4
#: Trial optics: rms blur, cells, and luminous share of a cell along an axis (a display's cells have dark
#: rims); sorted from soft to sharp for each share, and start of each share.
_BLURS = (0.7, 0.6, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05, 0.0)
_OPTICS = (
    *((b, 1.0) for b in _BLURS),
    *((b, lit) for lit in (0.8, 0.6, 0.4) for b in (0.6, 0.5, 0.4, 0.3, 0.2)),
)
_BEGIN = [k for k, (_, lit) in enumerate(_OPTICS) if k == 0 or lit != _OPTICS[k - 1][1]]
_FULL, _SHARP = _BEGIN[1], float(_BEGIN[1] - 1)
#: Thinning of pixels in the coarse search; steps between optics of one share in the fine search.
_COARSE, _STEPS = 3, np.arange(-4, 5) / 4
#: Neighbours that predict a pixel's place, and their weights in the parabola through them.
_BESIDE, _PARABOLA = [0, 1, 3, 4], np.array([-1, 4, 4, -1], np.float32) / 6
#: Nodes and weights with the first five moments of a normal distribution.
_NODES = np.array([-(3**0.5), 0, 3**0.5], np.float32)
_WEIGHTS = np.array([1, 4, 1], np.float32) / 6
#: Change of chi2 that is significant (three deviations).
_SIGNIFICANT = 9.0
#: Squared deviations beyond which a pixel is an outlier.
_OUTLYING = 400.0
#: Fewest pixels for an estimate.
_FEWEST = 200
#: Blur if it is undetermined, cells.
_UNKNOWN = 1.0
#: Increase of the variance of a mean of squared fourth differences by their overlap along a row: sum over k
#: of the squared correlation C(8, 4 + k) / C(8, 4), C(16, 8) / C(8, 4)^2.
_OVERLAP = 12870 / 70**2
#: Magnitude of the mean of exp(2 pi i u) beyond which most pixels sample one place of their cells.
_CROWDED = 0.5
#: Side of the squares in the test of commensurate sampling, pixels, and squares along the image.
_SQUARE, _SQUARES = 32, 5
#: Negligible share of sigma.
SLIGHT = 0.1
#: Largest number of pixels in the comparison.
_MOST = 1024


@dataclass(frozen=True, slots=True)
class Pixelation:
    """Correction of a reading, and its variance, by footprint (51,) and place in the cell (128,), cells.

    common (51,): rms error common to all pixels of a footprint that sample one place of their cells, cells;
    empty without cells. bound: the largest blur that explains the map, rms, cells. roughness: variance (px^2)
    of neighbours beyond noise and cells: all other deviations of the frames from their description.
    """

    shift: F32
    variance: F32
    common: F32
    bound: float
    roughness: float

    def in_common(
        self, width: float, lit: Sample, coord: F32, variance: F32, flags: NDArray[np.uint16]
    ) -> float:
        """Error common to all pixels by commensurate sampling, rms, px; 0 if negligible beside noise in a sum
        along the image. width: median footprint, cells; maps (H, W)."""
        if not self.common.size:
            return 0.0
        own = float(np.sqrt(self.common[np.abs(WIDTHS - width).argmin()] ** 2 + self.roughness))
        noise = variance[tuple(lit.places.T)][flags[tuple(lit.places.T)] == 0]
        least = SLIGHT * float(np.sqrt(np.median(noise) / max(coord.shape))) if noise.size else np.inf
        shared = own * _in_step(coord, flags) if own > least else 0.0
        return shared if shared > least else 0.0

    def tables(self) -> tuple[F32, F32]:
        """Correction and variance, with footprints in steps of a place for nearest-entry look-up; one 0 for
        an empty correction."""
        if not self.shift.size:
            return np.zeros(1, np.float32), np.zeros(1, np.float32)
        step = np.arange(int(WIDEST * PLACES) + 1) / PLACES / WIDTHS[1]
        row = np.minimum(step.astype(int), len(WIDTHS) - 2)
        part = (step - row).astype(np.float32)[:, None]
        shift, variance = ((1 - part) * one[row] + part * one[row + 1] for one in (self.shift, self.variance))
        return shift.ravel(), variance.ravel()


def measured_pixelations(
    plan: Plan,
    maps: Sequence[tuple[F32, F32]],
    on_cells: bool,
    blur: float | None,
    lit: Sample,
    footprint: float,
) -> list[Pixelation]:
    """Pixelation of each axis, from its decoded map (H, W) and variance at the sampled pixels.

    on_cells: fringes are displayed on cells; blur: rms, cells, if known; footprint: side of a pixel over its
    pitch. Both axes share one display, so that one blur must explain both.
    """
    shares = [shares_of(axis) if on_cells else () for axis in plan.axes]
    extents = [axis.extent if on_cells else np.inf for axis in plan.axes]
    seen = [_neighbours(lit, *own, extent, footprint) for own, extent in zip(maps, extents, strict=True)]
    sigmas = [0.05 if one is None else float(np.sqrt(np.median(one.noise))) for one in seen]
    usual = [float(2.0 ** np.clip(np.rint(2 * np.log2(max(sigma, 1e-6))) / 2, -8, -1)) for sigma in sigmas]
    asked = [
        (_every_optics(share, sigma), one)
        for share, sigma, one in zip(shares, usual, seen, strict=True)
        if blur is None and share and one is not None
    ]
    apart = [one for one in asked if not one[1].crowded()]
    fitted = _Fitted(None, (0.0, _SHARP))
    if asked:  # at one place of the cells a common gain resembles optics with dark rims
        fitted = _fitted(apart, len(_OPTICS)) if apart else _fitted(asked, _FULL)
    bound = _softest(fitted) if blur is None else blur
    tables = [
        _reduced(*(_taken_off(share, fitted, sigma) if blur is None else _of_blur(share, blur, sigma)), sigma)
        for share, sigma in zip(shares, usual, strict=True)
    ]
    return [
        Pixelation(*table, bound, 0.0 if one is None else one.roughness(*table[:2]))
        for table, one in zip(tables, seen, strict=True)
    ]


class _Fitted(NamedTuple):
    """Index among the _OPTICS of the best fit (None: undetermined or unnecessary), indices of all that fit as
    well, and some with their relative likelihood."""

    best: float | None
    alike: tuple[float, ...]
    likely: tuple[tuple[float, float], ...] = ()


def _softest(fitted: _Fitted) -> float:
    """The largest blur that explains a map, cells."""
    blurs = np.interp(fitted.alike, np.arange(len(_OPTICS)), np.array(_OPTICS)[:, 0])
    return _UNKNOWN if max(blurs, default=0) >= _BLURS[0] else float(blurs.max())


def _taken_off(shares: Shares, fitted: _Fitted, sigma: float) -> Tables:
    """shift, variance and common of a Pixelation: the correction; the variance, with the largest difference
    to optics that fit as well; and the mean difference to likely optics."""
    shift, variance = np.zeros((2, len(WIDTHS), PLACES), np.float32)
    if not shares:
        return shift, variance, shift[:0, 0]
    shifts, variances, errors = _every_optics(shares, sigma)
    own = np.zeros_like(shift)
    if fitted.best is not None:
        shift, variance, own = (_between(one, fitted.best) for one in (shifts, variances, errors))
    unsure = [np.square(_between(errors, end) - own).mean(axis=1) for end in fitted.alike]
    variance = np.maximum(variance, 0) + np.max(unsure, axis=0)[:, None]
    common = np.zeros(len(WIDTHS), np.float32)
    biased = np.square(own + _on_average(shift, own, sigma)).mean(axis=1)
    for at, weight in fitted.likely:
        common += np.float32(weight) * np.square(_between(errors, at) - own).mean(axis=1)
    whole = sum(weight for _, weight in fitted.likely) + (fitted.best is None)
    return shift, variance, np.sqrt(biased + common / np.float32(whole))


def _on_average(shift: F32, error: F32, sigma: float) -> F32:
    """Mean correction (W, PLACES) of readings with an error, over their noise."""
    reading = np.arange(PLACES) + PLACES * error
    at = (np.rint(reading + PLACES * sigma * node).astype(np.int64) % PLACES for node in _NODES)
    each = (weight * np.take_along_axis(shift, one, axis=1) for one, weight in zip(at, _WEIGHTS, strict=True))
    return np.asarray(np.sum(list(each), axis=0), np.float32)


def _between(tables: F32, at: float) -> F32:
    """Interpolate tables (B, W, PLACES) linearly at an index."""
    low = min(int(at), len(_OPTICS) - 2)
    return np.asarray((low + 1 - at) * tables[low] + (at - low) * tables[low + 1], np.float32)


def _of_blur(shares: Shares, blur: float, sigma: float) -> Tables:
    """As _taken_off, for a known blur."""
    shift, variance = np.zeros((2, len(WIDTHS), PLACES), np.float32)
    if shares:
        shift, variance = inverted(shares, blur, sigma)
    return shift, np.maximum(variance, 0), np.zeros(len(WIDTHS) if shares else 0, np.float32)


def _reduced(shift: F32, variance: F32, common: F32, sigma: float) -> Tables:
    """Replace negligible tables by empty ones."""
    slight = (shift**2 + variance).max() < (SLIGHT * sigma) ** 2
    return (shift[:0], shift[:0], common) if slight else (shift, variance, common)


@dataclass(frozen=True, slots=True)
class _Neighbours:
    """Readings (5, K) of neighbours in a row and their variance (K,); row of a table by footprint and place
    (K,), and its fraction to the next row (K,)."""

    place: F32
    noise: F32
    row: NDArray[np.int64]
    part: F32

    def crowded(self) -> bool:
        """Whether most of them sample one place of their cells."""
        return bool(np.abs(np.exp(2j * np.pi * self.place[2]).mean()) > _CROWDED)

    def thinned(self) -> "_Neighbours":
        """A subsample."""
        every = slice(None, None, _COARSE)
        return _Neighbours(self.place[:, every], self.noise[every], self.row[every], self.part[every])

    def looked_up(self, table: F32, place: F32) -> Any:
        """Entries of a table (W, PLACES) at places (..., K), or (B, N, K) of tables (B, W, PLACES) at common
        places (N, K) or at separate ones (B, N, K)."""
        if not table.size:
            return np.float32(0)
        entry = self.row * PLACES + np.rint((place - np.floor(place)) * PLACES).astype(np.int64) % PLACES
        if table.ndim > 2:
            entry = entry if place.ndim > 2 else entry[None]
            entry = entry + (table[0].size * np.arange(len(table)))[:, None, None]
        flat = table.ravel()
        return (1 - self.part) * flat[entry] + self.part * flat[entry + PLACES]

    def roughness(self, shift: F32, variance: F32) -> float:
        """Variance of a coordinate beyond noise and a Pixelation, from fourth differences of neighbours,
        which vanish for smooth maps: their variance is 1 + 16 + 36 + 16 + 1 times a coordinate's."""
        noise = self.noise + self.looked_up(variance, self.place[2])
        fourth = np.diff(self.place + self.looked_up(shift, self.place), 4, axis=0)[0] ** 2 / (70 * noise)
        kept = fourth < _OUTLYING
        excess = float(fourth[kept].mean()) - 1 if kept.any() else 0.0
        sure = 3 * np.sqrt(2 * _OVERLAP / max(int(kept.sum()), 1))
        return excess / float(np.mean(1 / noise[kept])) if excess > max(sure, SLIGHT) else 0.0


def _neighbours(
    lit: Sample, coord: F32, variance: F32, extent: float, footprint: float
) -> _Neighbours | None:
    """Neighbours along the direction of the largest gradient, outside the shadow of a surface's border
    (infinite extent: no border)."""
    row, col = _inner(lit, coord.shape)
    lines = [np.stack([coord[row + d * y, col + d * x] for d in range(-2, 3)]) for y, x in ((0, 1), (1, 0))]
    steps = _steps(coord, row, col)
    noise = variance[row, col]
    with np.errstate(invalid="ignore"):
        five, width = np.where(steps[0] >= steps[1], *lines), footprint * np.hypot(*steps)
        away = np.minimum(five + 0.5, extent - 0.5 - five).min(axis=0)
        keep = (
            (noise > 0)
            & (noise < 1 / 6)
            & (width < WIDEST - WIDTHS[1])
            & (np.abs(np.diff(five, 2, axis=0)).max(axis=0) < 1)
            & (away**2 > SHADOW2 * (_BLURS[0] ** 2 + (1 + width**2) / 12))
        )
    if np.count_nonzero(keep) < _FEWEST:
        return None
    place, steps = five[:, keep], width[keep] / WIDTHS[1]
    whole = np.minimum(steps.astype(int), len(WIDTHS) - 2)
    return _Neighbours(place, noise[keep], whole, (steps - whole).astype(np.float32))


def _misfits(tables: Tables, seen: _Neighbours) -> tuple[F64, F64]:
    """-2 log likelihood of readings given their neighbours, for each optics, relative to no cells; and its
    expected decrease if the optics is right. tables: see _every_optics.

    A parabola through four neighbours predicts the place, and the predicted reading is compared. (The
    residual after correction is no measure: correction reduces noise, too, and with commensurate sampling all
    pixels have the same gain.) Curvature beyond the parabola counts as noise, of a size that each optics
    fits.
    """
    shift, variance, error = tables
    four, parts = seen.place[_BESIDE], _PARABOLA[:, None]
    middle = (parts * (four + seen.looked_up(shift, four))).sum(axis=1)
    unsure = (parts**2 * np.maximum(seen.noise + seen.looked_up(variance, four), 0)).sum(axis=1)
    place = middle[:, None] + np.sqrt(unsure)[:, None] * _NODES[:, None]
    off = place + seen.looked_up(error, place) - seen.place[2]
    read = np.einsum("n,bnk->bk", _WEIGHTS, off)
    spread = seen.noise + np.einsum("n,bnk->bk", _WEIGHTS, (off - read[:, None]) ** 2)
    chi2 = np.minimum(read**2 / spread, _OUTLYING)
    more = np.maximum(1.0, chi2.mean(axis=1, keepdims=True))
    left = (chi2 / more + np.log(spread / seen.noise * more)).sum(axis=1)
    shown = np.minimum((read - read[-1]) ** 2 / spread[-1], _OUTLYING).sum(axis=1) / more[-1]
    return (left - left[-1])[:-1].astype(np.float64), shown[:-1].astype(np.float64)


@lru_cache(maxsize=8)
def _every_optics(shares: Shares, sigma: float) -> Tables:
    """Shift and variance by reading, e by place, of each optics and of no correction (B, W, PLACES)."""
    none = np.zeros((1, len(WIDTHS), PLACES), np.float32)
    taken_off = [inverted(shares, blur, sigma, fill) for blur, fill in _OPTICS]
    errors = [cell_error(shares, *one)[:, :: FINE // PLACES] for one in _OPTICS]
    three = (*zip(*taken_off, strict=True), errors)
    shift, variance, error = (np.concatenate([np.stack(one), none]).astype(np.float32) for one in three)
    return shift, variance, error


def _fitted(asked: list[tuple[Tables, _Neighbours]], most: int) -> _Fitted:
    """Best optics among the first `most`, by tables (see _every_optics) and neighbours of each axis: a coarse
    search on some pixels, then a fine one on all, between the best and adjacent optics, also of fully
    luminous cells. None: no optics fits significantly better than no cells, or none is expected to."""
    left, shown = np.sum([_misfits(tables, seen.thinned()) for tables, seen in asked], axis=0)[:, :most]
    usual = np.where(_COARSE * shown > _SIGNIFICANT, left, 0.0)
    near = np.flatnonzero(left <= min(usual.min(), 0.0) + _SIGNIFICANT / _COARSE)
    places = np.unique([one for k in (usual[:_FULL].argmin(), usual.argmin()) for one in _around(int(k))])
    left, shown = np.sum([_misfits(_mixed(tables, places), seen) for tables, seen in asked], axis=0)
    best = int(np.where(shown > _SIGNIFICANT, left, 0.0).argmin())
    told = min(-left[best], shown[best]) > _SIGNIFICANT
    weight = np.exp(-0.5 * np.maximum(left - (left[best] if told else 0.0), 0.0))
    likely = tuple(zip(places.tolist(), weight.tolist(), strict=True))
    if not told:
        return _Fitted(None, tuple(near[near <= _SHARP].tolist()) or (0.0,), likely)
    alike = {*near.tolist(), *places[left <= left[best] + _SIGNIFICANT].tolist()}
    return _Fitted(float(places[best]), tuple(sorted(alike)), likely)


def _around(k: int) -> F64:
    """Indices around one, among optics of the same share."""
    begin = max(one for one in _BEGIN if one <= k)
    end = min((one for one in _BEGIN if one > k), default=len(_OPTICS))
    return np.clip(k + _STEPS, begin, end - 1)


def _mixed(tables: Tables, places: F64) -> Tables:
    """Interpolate tables of optics at indices."""
    shift, variance, error = (np.stack([*(_between(one, at) for at in places), one[-1]]) for one in tables)
    return shift, variance, error


def _in_step(coord: F32, flags: NDArray[np.uint16]) -> float:
    """Coherence of sampling and cells: rms of the mean of exp(2 pi i u) in squares of the image, so that
    residual pixelation is common to neighbours. 0: incoherent; 1: every pixel samples one place of its
    cell."""
    if min(coord.shape) < _SQUARE:
        return 1.0
    rows, cols = (np.linspace(0, size - _SQUARE, _SQUARES).astype(int) for size in coord.shape)
    place, bad = (sliding_window_view(one, (_SQUARE, _SQUARE))[rows[:, None], cols] for one in (coord, flags))
    good = bad == 0
    count = good.sum(axis=(2, 3))
    sums = np.where(good, np.exp(2j * np.pi * np.where(good, place, 0)), 0).sum(axis=(2, 3))
    told = count > _SQUARE
    pairs = (np.square(np.abs(sums)) - count)[told] / (count * (count - 1.0))[told]
    return float(np.sqrt(max(pairs.mean(), 0.0))) if told.any() else 1.0


def usual_width(lit: Sample, coord: F32, flags: NDArray[np.uint16], footprint: float) -> float:
    """Median footprint of the good sampled pixels, cells, in steps of a twentieth; footprint: side of a pixel
    over its pitch."""
    row, col = _inner(lit, coord.shape)
    ends = ((row, col - REACH), (row, col + REACH), (row - REACH, col), (row + REACH, col))
    width = np.hypot(*_steps(coord, row, col))[np.all([flags[end] == 0 for end in ends], axis=0)]
    usual = footprint * float(np.median(width)) if width.size else 1.0
    return 0.05 * max(round(usual / 0.05), 1)


def _inner(lit: Sample, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (K,) of sampled pixels at least REACH from the image's border."""
    row, col = lit.places[:: max(1, len(lit.places) // _MOST)].T
    inside = (col >= REACH) & (col < shape[1] - REACH) & (row >= REACH) & (row < shape[0] - REACH)
    return row[inside], col[inside]


def _steps(coord: F32, row: NDArray[Any], col: NDArray[Any]) -> tuple[F32, F32]:
    """Size of the change per pixel along columns and rows, at pixels REACH from the image's border."""
    along = coord[row, col + REACH] - coord[row, col - REACH]
    down = coord[row + REACH, col] - coord[row - REACH, col]
    return np.abs(along) / (2 * REACH), np.abs(down) / (2 * REACH)
