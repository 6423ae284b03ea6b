"""Tables of known levels: codewords of each place of the surface through optics (see `Optics`)."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import upfirdn

from optolever.errors import InputError
from optolever.patterns import Sequence

from ..display import cell_light
from ..plan import AxisPlan, Plan, raster_axes
from ..plan import plan as described
from ..profile.noise import Noise
from .lookup_kernels import SEARCH, SWEEP
from .lookup_search import AROUND, COARSE, LANES, PER_PX, RIVALS, Book, Search

__all__ = ["USUAL", "Optics", "Table", "table_of"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Spread of a pixel of one cell without blur: the first assumption.
USUAL = 12**-0.5
_NO_SEARCH = Search(
    np.zeros((0, 0), np.float32), np.zeros((0, RIVALS), np.int64), np.zeros((RIVALS + 1, 0, 2), np.float32)
)
#: Number of cached tables: as many as one axis needs to measure its spread.
_KEPT = 40


class Optics(NamedTuple):
    """Optical transfer of a cell's light.

    spread  rms of footprint and blur, pattern px; 0: an ideal surface without cells
    blur    its part by the blur, if known
    """

    spread: float
    blur: float | None = None

    @property
    def with_cell(self) -> float:
        """rms of the spread and a cell, pattern px."""
        return math.hypot(self.spread, USUAL) if self.spread else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Known levels of one axis.

    way      SEARCH (any levels), SWEEP (stripes) or WITHIN (codes)
    book     codewords
    search   see Search; empty but for SEARCH
    optics   between cells and pixels
    misfit2  variance of the residuals, over the squared amplitude
    noise    of the camera, from residuals; None: given
    unsure   relative error of the spread, and so of a place's distance to the cell's nearest edge
    """

    way: int
    book: Book
    search: Search
    optics: Optics
    cell: float = 1.0
    misfit2: float = 0.0
    unsure: float = 0.0
    noise: Noise | None = None

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2: samples of a codeword less offset, scale and place."""
        return int(self.book.freedom)


@lru_cache(maxsize=_KEPT)
def _cached(sequence: Sequence, index: tuple[int, ...], axis: str, optics: Optics) -> tuple[F32, F32]:
    """Words and angles of any levels at the places -1 + k / PER_PX."""
    if optics.spread == 0:
        return _words(_cosines(sequence, index, axis)[None])
    levels = sequence.tables()["uv".index(axis)][list(index)].astype(np.float64) / 255
    for k, i in enumerate(index):
        frame = sequence.frames[i]
        if frame.kind in ("white", "black"):
            levels[k] = float((frame.kind == "white") != frame.inverted)
        elif frame.kind == "levels":
            free = frame.free_levels(np.arange(levels.shape[1], dtype=np.float64)) / 255
            levels[k] = 1 - free if frame.inverted else free
    seen = _seen(levels, optics, "edge" if sequence.nominal else "constant")
    return _words(seen[None])


@lru_cache(maxsize=8)
def _search(sequence: Sequence, index: tuple[int, ...], axis: str, optics: Optics, reach: int) -> Search:
    """Codewords of the surface, and the most similar ones of each."""
    words = _cached(sequence, index, axis, optics)[0][0][:, : len(index)].astype(np.float64)
    length = np.sqrt(np.square(words).sum(axis=1))
    unit = words / np.maximum(length, 1e-3 * length.max() + 1e-12)[:, None]
    per = PER_PX // COARSE
    coarse = np.ascontiguousarray(unit[per // 2 :: per][: (len(unit) - 1) // per], np.float32)
    count, guard = len(coarse), 2 * math.ceil(reach / per)
    rivals, place = np.zeros((count, RIVALS + 1), np.int64), np.arange(count)
    cosine = np.zeros((count, RIVALS + 1))
    near, around = np.arange(-per, per + 1), np.arange(-per // 2, per // 2 + 1)
    for some in np.array_split(place, math.ceil(count / 256)):
        alike = coarse[some] @ coarse.T
        peak = alike >= maximum_filter1d(alike, 3, axis=1, mode="nearest")
        alike[~peak | (np.abs(place - some[:, None]) <= guard)] = -1.0
        last = min(RIVALS + 1, count)
        best = np.argsort(-alike, axis=1)[:, :last]
        rivals[some, :last] = best
        mine = unit[np.clip(per * some[:, None] + per // 2 + around, 0, len(unit) - 1)]
        theirs = unit[np.clip((best * per + per // 2)[..., None] + near, 0, len(unit) - 1)]
        every = np.einsum("pan,pkbn->pkab", mine, theirs, optimize=True).max(axis=(2, 3))
        cosine[some, :last] = np.where(np.take_along_axis(alike, best, axis=1) > -1, every, 0.0)
    cosine = np.clip(cosine, 0.0, 1.0)
    apart = np.ascontiguousarray(
        np.stack([np.sqrt(1 - cosine**2), cosine], axis=2).swapaxes(0, 1), np.float32
    )
    return Search(np.ascontiguousarray(coarse.T), rivals[:, :-1], apart)


def table_of(sequence: Sequence, plan: Plan, axis: AxisPlan, way: int, optics: Optics) -> Table:
    """The table of an axis for a search mode."""
    if way == SWEEP:
        return Table(way, _sweep(sequence, axis.axis, optics), _NO_SEARCH, optics)
    # with free levels a code only gives the start: the blur of its edges is less well known
    own = axis.levels if len(axis.levels) >= 3 else axis.frames()
    # white and black include indirect light from the whole surface, bits from about half of it
    ends = () if axis.code and not axis.levels and len(own) > 3 else (plan.white, plan.black)
    index = own + tuple(i for i in ends if i >= 0)
    if len(index) < 3:
        raise InputError(f"decode: axis {axis.axis} has {len(index)} frames, must have at least 3")
    cell = max(sequence.frames[i].cell_px for i in index)
    reach = math.ceil(AROUND * max(cell, 1.0 if axis.code is None else axis.code.cell) * PER_PX)
    key = sequence, index, axis.axis, optics
    one, first, frames = np.zeros(1, np.int64), np.array([-1.0]), np.array(index)
    book = Book(frames[None, :, None], one, first, *_cached(*key), reach, len(index) - 3, frames, 1)
    return Table(way, book, _search(*key, reach) if way == SEARCH else _NO_SEARCH, optics, cell)


@lru_cache(maxsize=_KEPT)
def _sweep(sequence: Sequence, axis: str, optics: Optics) -> Book:
    """Raised cosines around each place of a sweep, over as many frames as illuminate one place; of spots the
    mean over as many along the other axis: their light is a product."""
    axes = raster_axes(sequence) or described(sequence).axes
    (stripes,) = (one.stripes for one in axes if one.axis == axis)
    assert stripes is not None
    spread = optics.spread
    at, index = stripes.at, stripes.index.reshape(len(stripes.at), -1)
    samples, begin = _around(at, 1.25 * stripes.width + 2 * spread, 2)
    summed, side = _around(stripes.beside, stripes.width - stripes.pitch, 1)
    half, beyond = math.ceil(1.25 * np.diff(at).max()) + 1, math.ceil(4 * spread) + 1
    first = np.rint(at).astype(np.float64) - half
    # stripes at equal offsets from cells share a block
    away = at[begin[:, None] + np.arange(samples)] - first[:, None]
    away, block = np.unique(away, axis=0, return_inverse=True)
    place = np.arange(2 * half * PER_PX + 1) / PER_PX
    cell = np.arange(-beyond, 2 * half + beyond + 1.0) if spread > 0 else place
    shown = np.abs(cell - away[:, :, None]) / stripes.width
    seen = np.where(shown < 1, 0.5 + 0.5 * np.cos(np.pi * np.minimum(shown, 1.0)), 0.0)
    if spread > 0:
        if len(stripes.beside) == 1:  # cells have 8 bits; the rounding of a spot is that of a product
            seen = np.rint(255 * seen) / 255
        seen = seen @ _weight(cell[:, None] - place, optics)
    # raised cosines at equal steps add up to their width over the step
    words, angles = _words(seen * min(stripes.width / (stripes.pitch * summed), 1.0))
    window = begin[:, None, None, None] + np.arange(samples)[:, None]
    frames = index[window, side[:, None, None] + np.arange(summed)]
    every = len(side)
    return Book(
        frames=frames.reshape(-1, samples, summed),
        block=np.repeat(block.ravel(), every),
        first=np.repeat(first, every),
        words=words,
        angles=angles,
        reach=math.ceil(AROUND * PER_PX),
        freedom=samples - 3,
        swept=index.ravel(),
        across=every,
    )


def _around(at: F64, reach: float, least: int) -> tuple[int, NDArray[np.int64]]:
    """Number of places within reach of each place, equal for all, and the first of them."""
    count = len(at)
    if count == 1:
        return 1, np.zeros(1, np.int64)
    half = min(max(least, math.ceil(reach / float(np.median(np.diff(at))))), (count - 1) // 2)
    return 2 * half + 1, np.clip(np.arange(count) - half, 0, count - 2 * half - 1)


def _weight(distance: F64, optics: Optics) -> F64:
    """Share of a cell's light in a pixel at a distance (pattern px).

    The cell through a footprint and a Gaussian blur that add up to the spread. An unknown blur has half of
    its variance, or more where the footprint would be wider than a cell.
    """
    spread, known = optics
    widest = math.sqrt(6) * spread if known is None else math.sqrt(12 * max(spread**2 - known**2, 0.0))
    width = max(min(widest, 1.0) if known is None else widest, 0.05)
    blur = math.sqrt(max(spread**2 - width**2 / 12, 1e-6))
    return cell_light(distance, np.array(width), blur)


def _cosines(sequence: Sequence, index: tuple[int, ...], axis: str) -> F64:
    """Levels (M, (E + 1) PER_PX + 1) of fringes on a surface without cells, at -1 + k / PER_PX."""
    extent = sequence.cols if axis == "u" else sequence.rows
    place = np.arange((extent + 1) * PER_PX + 1) / PER_PX - 1
    frames = [sequence.frames[i] for i in index]
    levels = [frame.ideal_levels(place, "u" if frame.axis is None else axis) for frame in frames]
    return np.stack(levels) / 255


def _seen(levels: F64, optics: Optics, beyond: Literal["edge", "constant"]) -> F64:
    """Levels (M, E) of cells as read by pixels at -1 + k / PER_PX, (M, (E + 1) PER_PX + 1)."""
    reach = math.ceil(4 * optics.spread) + 1
    around = np.pad(levels, ((0, 0), (reach + 1, reach + 1)), mode=beyond)
    weight = _weight(np.arange(-reach * PER_PX, reach * PER_PX + 1) / PER_PX, optics)
    seen = upfirdn(weight, around, up=PER_PX)[:, 2 * reach * PER_PX :]
    return np.asarray(seen[:, : (levels.shape[1] + 1) * PER_PX + 1], np.float64)


def _words(seen: F64) -> tuple[F32, F32]:
    """Levels (B, n, Q) -> codewords without mean (B, Q, n filled up); Book.angles (B, Q, 6)."""
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
    middle = words + 0.5 * step
    turn = (zd + 0.5 * dd) / np.maximum(np.square(middle).sum(axis=2), 1e-12)
    power = np.square(step - middle * turn[..., None])
    level = (power * middle).sum(axis=2) / np.maximum(power.sum(axis=2), 1e-12)
    return words, np.stack([*products, mean, uneven, level], axis=2, dtype=np.float32, casting="same_kind")
