"""What the cells of a display shift: the blur that the map tells, what that takes off, what stays unsure.

The blur is what the map tells itself: where the place of a pixel follows from its neighbours, what it reads
is compared with what it would read behind each blur (see display), and the one that leaves least is taken if
it leaves significantly less than no cells at all do, and would have to. Then E[u | reading] replaces the
reading, and what is unsure (Var[u | reading], and the range of blurs that explain the map as well) joins the
variance. Where the map does not tell, nothing is taken off and all that may be there joins the variance. What
neighbours then still show beyond noise joins it, too.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .border import SHADOW2
from .display import FINE, PLACES, WIDEST, WIDTHS, cell_error, inverted, shares_of
from .noise import Sample
from .plan import Plan

__all__ = ["REACH", "SLIGHT", "Pixelation", "measured_pixelations", "usual_width"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Pixels on either side over which a footprint is taken: over fewer the cells would count as gradient.
REACH = 4
#: Blurs that are compared, cells rms.
_BLURS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7)
#: Neighbours that tell a pixel's place, and their weights in the middle of the parabola through them.
_BESIDE, _PARABOLA = [0, 1, 3, 4], np.array([-1, 4, 4, -1], np.float32) / 6
#: Nodes and weights that have the first five moments of a normal distribution.
_NODES = np.array([-(3**0.5), 0, 3**0.5], np.float32)
_WEIGHTS = np.array([1, 4, 1], np.float32) / 6
#: Change of chi2 that is significant (three deviations).
_SIGNIFICANT = 9.0
#: Squared deviations beyond which a pixel says nothing of cells.
_OUTLYING = 400.0
#: Pixels that tell it.
_FEWEST = 200
#: Blur that is assumed where nothing tells it, cells.
_UNKNOWN = 1.0
#: Of the mean square of fourth differences along a row, how much more it varies than one of independent ones:
#: sum over k of the squared correlation C(8, 4 + k) / C(8, 4), C(16, 8) / C(8, 4)^2.
_OVERLAP = 12870 / 70**2
#: Share of sigma that may be left out.
SLIGHT = 0.1
#: Pixels of the sample that are compared at most.
_MOST = 1024


@dataclass(frozen=True, slots=True)
class Pixelation:
    """What is added to a reading, and its variance, by footprint (51,) and place in the cell (128,), cells.

    bound: the largest blur that explains the map, rms, cells. roughness: variance (px^2) that neighbours
    show beyond noise and cells: whatever else the frames hold that was not described.
    """

    shift: F32
    variance: F32
    bound: float
    roughness: float

    def tables(self) -> tuple[F32, F32]:
        """Both by footprint in steps of a place, so that the nearest entry is as near in either; one 0 of a
        correction that is empty."""
        if not self.shift.size:
            return np.zeros(1, np.float32), np.zeros(1, np.float32)
        step = np.arange(int(WIDEST * PLACES) + 1) / PLACES / WIDTHS[1]
        row = np.minimum(step.astype(int), len(WIDTHS) - 2)
        part = (step - row).astype(np.float32)[:, None]
        shift, variance = ((1 - part) * one[row] + part * one[row + 1] for one in (self.shift, self.variance))
        return shift.ravel(), variance.ravel()


def measured_pixelations(
    plan: Plan,
    maps: tuple[tuple[F32, F32], ...],
    on_cells: bool,
    blur: float | None,
    lit: Sample,
) -> list[Pixelation]:
    """Of each axis, from its decoded map (H, W) and variance at the sampled pixels that see the pattern.

    on_cells: fringes were shown on cells; blur: rms, cells, if it is known. Both axes are of one display: the
    blur is what explains both.
    """
    shares = [shares_of(axis) if on_cells else () for axis in plan.axes]
    extents = [axis.extent if on_cells else np.inf for axis in plan.axes]
    seen = [_neighbours(lit, *own, extent) for own, extent in zip(maps, extents, strict=True)]
    sigmas = [0.05 if one is None else float(np.sqrt(np.median(one.noise))) for one in seen]
    usual = [float(2.0 ** np.clip(np.rint(2 * np.log2(max(sigma, 1e-6))) / 2, -8, -1)) for sigma in sigmas]
    allowed, bound = ((0.0, 0.0), _UNKNOWN) if blur is None else ((blur, blur), blur)
    asked = [
        _misfits(share, sigma, one)
        for share, sigma, one in zip(shares, usual, seen, strict=True)
        if blur is None and share and one is not None
    ]
    if asked:
        blur, allowed = _fitted_blur(*np.sum(asked, axis=0))
        bound = allowed[1] if allowed[1] < _BLURS[-1] else _UNKNOWN
    tables = [_table(share, blur, allowed, sigma) for share, sigma in zip(shares, usual, strict=True)]
    return [
        Pixelation(*table, bound, 0.0 if one is None else one.roughness(*table))
        for table, one in zip(tables, seen, strict=True)
    ]


@lru_cache(maxsize=64)
def _table(
    shares: tuple[tuple[float, float], ...], blur: float | None, allowed: tuple[float, float], sigma: float
) -> tuple[F32, F32]:
    """shift and variance of a Pixelation: the correction for a blur (None: none), what blurs between the
    allowed ones would change in the variance. Empty where that is next to nothing, and of ideal fringes."""
    shift, variance = np.zeros((2, len(WIDTHS), PLACES), np.float32)
    own = np.zeros((len(WIDTHS), FINE))
    if shares and blur is not None:
        shift, variance = inverted(shares, blur, sigma)
        variance = np.maximum(variance, 0)
        own = cell_error(shares, blur)
    unsure = [cell_error(shares, end) - own for end in allowed] if shares else [own]
    extra = np.max([(part**2).mean(axis=1) for part in unsure], axis=0)
    if (shift**2 + variance + extra[:, None]).max() < (SLIGHT * sigma) ** 2:
        return shift[:0], shift[:0]
    return shift, (variance + extra[:, None]).astype(np.float32)


@dataclass(frozen=True, slots=True)
class _Neighbours:
    """Readings (5, K) of neighbours in a row and their variance (K,); rows of a table by footprint and place
    (K,) that is theirs, and how far their footprint is to the next one's row (K,)."""

    place: F32
    noise: F32
    row: NDArray[np.int64]
    part: F32

    def looked_up(self, table: F32, place: F32) -> Any:
        """Entries of a table (W, PLACES) at places (..., K), or (B, N, K) of tables (B, W, PLACES) at places
        (N, K), or at its own of each, (B, N, K)."""
        if not table.size:
            return np.float32(0)
        entry = self.row * PLACES + np.rint((place - np.floor(place)) * PLACES).astype(np.int64) % PLACES
        if table.ndim > 2:
            entry = entry if place.ndim > 2 else entry[None]
            entry = entry + (table[0].size * np.arange(len(table)))[:, None, None]
        flat = table.ravel()
        return (1 - self.part) * flat[entry] + self.part * flat[entry + PLACES]

    def roughness(self, shift: F32, variance: F32) -> float:
        """Variance of a coordinate that fourth differences of neighbours, which no smooth map has, show
        beyond noise and a Pixelation: their variance is 1 + 16 + 36 + 16 + 1 times that of a coordinate."""
        noise = self.noise + self.looked_up(variance, self.place[2])
        fourth = np.diff(self.place + self.looked_up(shift, self.place), 4, axis=0)[0] ** 2 / (70 * noise)
        kept = fourth < _OUTLYING
        excess = float(fourth[kept].mean()) - 1 if kept.any() else 0.0
        sure = 3 * np.sqrt(2 * _OVERLAP / max(int(kept.sum()), 1))
        return excess / float(np.mean(1 / noise[kept])) if excess > max(sure, SLIGHT) else 0.0


def _neighbours(lit: Sample, coord: F32, variance: F32, extent: float) -> _Neighbours | None:
    """Of neighbours along the direction in which the coordinate changes most, outside of what the border of a
    surface (infinite: it has none) may take from what they see."""
    row, col = _inner(lit, coord.shape)
    lines = [np.stack([coord[row + d * y, col + d * x] for d in range(-2, 3)]) for y, x in ((0, 1), (1, 0))]
    steps = _steps(coord, row, col)
    noise = variance[row, col]
    with np.errstate(invalid="ignore"):
        five, width = np.where(steps[0] >= steps[1], *lines), np.hypot(*steps)
        away = np.minimum(five + 0.5, extent - 0.5 - five).min(axis=0)
        keep = (
            (noise > 0)
            & (noise < 1 / 6)
            & (width < WIDEST - WIDTHS[1])
            & (np.abs(np.diff(five, 2, axis=0)).max(axis=0) < 1)
            & (away**2 > SHADOW2 * (_BLURS[-1] ** 2 + (1 + width**2) / 12))
        )
    if np.count_nonzero(keep) < _FEWEST:
        return None
    place, steps = five[:, keep], width[keep] / WIDTHS[1]
    whole = np.minimum(steps.astype(int), len(WIDTHS) - 2)
    return _Neighbours(place, noise[keep], whole, (steps - whole).astype(np.float32))


def _misfits(shares: tuple[tuple[float, float], ...], sigma: float, seen: _Neighbours) -> tuple[F64, F64]:
    """-2 log likelihood of readings whose neighbours are known, less that by no cells, of each blur; how much
    less that has to be if the blur is right.

    A parabola through four neighbours tells the place, and what a pixel reads there is compared. (Of what is
    left after the correction it would be none: that takes noise off, too, and where pixels keep step with the
    cells all have the same gain.) What the map bends more is noise of a size that each fits for itself.
    """
    shift, variance, error = _every_blur(shares, sigma)
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


@lru_cache(maxsize=16)
def _every_blur(shares: tuple[tuple[float, float], ...], sigma: float) -> tuple[F32, F32, F32]:
    """Shift and variance by reading, e by place, of each blur and of no correction (B, W, PLACES)."""
    none = np.zeros((1, len(WIDTHS), PLACES), np.float32)
    taken_off = [inverted(shares, blur, sigma) for blur in _BLURS]
    errors = [cell_error(shares, blur)[:, :: FINE // PLACES] for blur in _BLURS]
    three = (*zip(*taken_off, strict=True), errors)
    shift, variance, error = (np.concatenate([np.stack(one), none]).astype(np.float32) for one in three)
    return shift, variance, error


def _fitted_blur(left: F64, shown: F64) -> tuple[float | None, tuple[float, float]]:
    """The blur that leaves least (None: none leaves significantly less than no cells do, or none that would
    have to), and the ends of those that do as well, of sums of what `_misfits` returns."""
    best = int(np.argmin(np.where(shown > _SIGNIFICANT, left, 0.0)))
    told = min(-left[best], shown[best]) > _SIGNIFICANT
    near = np.flatnonzero(left <= (left[best] if told else 0.0) + _SIGNIFICANT)
    allowed = (_BLURS[near[0]], _BLURS[near[-1]]) if len(near) else (_BLURS[-1], _BLURS[-1])
    return (_BLURS[best] if told else None), allowed


def usual_width(lit: Sample, coord: F32, flags: NDArray[np.uint16]) -> float:
    """Median footprint of the sampled pixels that are good, cells, in steps of a twentieth."""
    row, col = _inner(lit, coord.shape)
    ends = ((row, col - REACH), (row, col + REACH), (row - REACH, col), (row + REACH, col))
    width = np.hypot(*_steps(coord, row, col))[np.all([flags[end] == 0 for end in ends], axis=0)]
    usual = float(np.median(width)) if width.size else 1.0
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
