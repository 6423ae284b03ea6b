"""Look-ups: a pixel's samples against known levels.

Two kinds. Stripes swept over an axis: the brightest frame and its neighbours. A table of anything else:
fringes of one or two shifts (micro phase shifting: M. Gupta, S. K. Nayar, CVPR 2012,
doi:10.1109/CVPR.2012.6247753) and free grey values. The levels of each place of the surface through a pixel
(cell, footprint, blur) are known, with a codeword for each eighth of a pattern pixel; see `match`. The spread
of pixel and blur is the likeliest one on a sample of pixels.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.kernels import F32, F64, I64
from optolever.patterns import Sequence

from ..correspondence import Flag
from ..frames import Light, Settings
from ..noise import Noise, Sample, noise_of
from ..plan import AxisPlan, Plan, Stripes
from ..plan import plan as plan_of
from .match import COARSE, PER_PX, RIVALS, Book, match, similar

__all__ = ["Lines", "LookUp", "Table", "beside", "lookup_rows", "prepare", "table_of"]

#: Pixels of the sample on which the spread is measured.
_PIXELS = 2048
#: Trial spreads, pattern pixels rms: from a pixel of a third of a cell to defocus, or to half a stripe.
_SHARPEST, _WIDEST, _TRIED = 0.12, 2.4, 8
#: First assumptions: a pixel of one cell without blur, and blurred ones; shares of the blur tried at last.
_STARTS, _SHARES = (0.29, 0.6, 1.2), (0.05, 0.25, 0.75, 0.95)
#: Squared residuals that noise reaches once in so many pixels; probability of another place that is doubtful,
#: or excludes a pixel of the sample; modulation over its noise below which there is no contrast.
_RARE, _DOUBT, _CONTRAST = 1e-5, 1e-4, 5.0
#: chi2 over freedom from which on a cost grows by its logarithm; without a place.
_TAIL, _NO_FIT = 3.0, 1e4
#: Cells around a place that may fit as well: half a cell beyond its cell.
_AROUND = 1.5
#: Share of a stripe's light from which on a second place is doubtful, whatever the noise.
_RIVAL = 0.6
#: No search over the surface.
_NOWHERE = (
    np.zeros((0, 0), np.float32),
    np.zeros((0, RIVALS), np.int64),
    np.zeros((0, RIVALS, 2), np.float32),
)
#: Tables kept: as many as the spreads of both axes.
_KEPT = 40


class Lines(NamedTuple):
    """Output of one axis for rows of an image, each (R, W): place and variance (pattern px, px^2), amplitude
    and offset (levels), error (probability of a wrong place), chi2 (sum of squares over noise) float32; flags
    int32."""

    place: F32
    variance: F32
    amplitude: F32
    offset: F32
    error: F32
    chi2: F32
    flags: NDArray[np.int32]


class Optics(NamedTuple):
    """Between a cell and a sample: spread, rms, pattern px (0: an ideal surface without cells), and the
    Gaussian blur's share of its variance; the rest is a square footprint. light (256,): relative light of the
    levels 0 to 255; empty: proportional to them."""

    spread: float
    share: float
    light: tuple[float, ...] = ()

    def emitted(self, levels: F64) -> F64:
        """Light 0..1 of levels 0..1."""
        if not self.light:
            return levels
        return np.asarray(np.interp(255 * levels, np.arange(len(self.light)), self.light))


class LookUp(NamedTuple):
    """Estimates of a table, see there; optics: between cells and samples."""

    optics: Optics
    misfit2: float
    noise: Noise | None


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Known levels of one axis.

    book     codewords; frames (K, n): samples of each place of a sweep (K = 1: of anything else); block,
             first (K,): block of the book, and coordinate of its first codeword
    misfit2  variance of the residuals beyond noise over the squared contrast
    noise    of the camera, from the residuals; None: it was known
    """

    axis: AxisPlan
    book: Book
    frames: I64
    block: I64
    first: F64
    misfit2: float = 0.0
    noise: Noise | None = None

    @property
    def dof(self) -> int:
        """Degrees of freedom of chi2: samples less offset, scale and place."""
        return max(int(self.frames.shape[1]) - 3, 1)

    @property
    def jump(self) -> float:
        """Largest difference of neighbours, pattern px: a stripe, or two cells."""
        return self.axis.stripes.width if self.axis.stripes else 2.0 * self.book.cell / PER_PX


class _Found(NamedTuple):
    """Of K pixels: samples (K, n), block of the book, codeword; place in px (NaN: none), variance, scale,
    offset, chi2 over freedom, error."""

    samples: F32
    block: I64
    codeword: F64
    place: F64
    variance: F64
    scale: F64
    offset: F64
    chi2: F64
    error: F64


class _Trial(NamedTuple):
    """A sample matched by a table."""

    optics: Optics
    table: Table
    found: _Found


def lookup_rows(light: Light, noise: Noise, table: Table, either: int, out: Lines) -> None:
    """Decode frames into out; either: flags where two places fit."""
    noise, cols, extent = table.noise or noise, light.raw.shape[2], table.axis.extent
    found = _matched(light, light.raw.reshape(len(light.raw), -1), cols, noise, table)
    none, contrast = np.isnan(found.place), 0.5 * found.scale
    middle = found.offset + contrast
    place = np.where(none, 0.0, found.place)
    variance = np.where(none, float(extent) ** 2, found.variance)
    faint = contrast**2 < 0.5 * _CONTRAST**2 * noise.variance(middle)
    blind = none | (variance > float(extent) ** 2 / 12)
    dim = middle + contrast < (light.white / 16 if math.isfinite(light.white) else 0.0)
    clipped = np.isnan(found.samples).any(axis=1)
    flags = np.zeros(place.shape, np.int32)
    for flag, where in (
        (Flag.DARK, faint & dim),
        (Flag.LOW_CONTRAST, faint),
        (Flag.SATURATED, clipped & (faint | blind)),
        (Flag.ORDER_DOUBTFUL, blind),
        (either, ~blind & (found.error > _DOUBT)),
        (Flag.OFF_PATTERN, ~none & ((place < -0.5) | (place > extent - 0.5))),
        (Flag.INVALID, none),
    ):
        flags |= np.where(where, np.int32(flag), np.int32(0))
    error = np.where(flags & int(either), 1.0, found.error)
    maps: list[NDArray[Any]] = [place, variance, contrast, middle, error, found.chi2 * table.dof, flags]
    for into, values in zip(out, maps, strict=True):
        into[...] = values.reshape(into.shape)


def beside(
    light: Light, noise: Noise, table: Table, place: F32, other: F32
) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Of pixels (N, K) of light, the place next to `other` (K,), pattern px, its variance, and whether it
    fits as well as the one next to `place`."""
    noise, cols = table.noise or noise, place.size
    own, found = (
        _matched(light, light.raw, cols, noise, table, one.astype(np.float64)) for one in (place, other)
    )
    beyond = (found.chi2 - own.chi2) * table.dof
    fits = np.isfinite(found.place) & (scipy.special.expit(-0.5 * np.nan_to_num(beyond)) > _DOUBT)
    return np.nan_to_num(found.place), found.variance, fits


def _matched(
    light: Light, raw: NDArray[Any], cols: int, noise: Noise, table: Table, start: F64 | None = None
) -> _Found:
    """Match pixels (N, K) of rows of `cols`; start (K,): coordinates from which the match begins (NaN:
    none)."""
    count, stripes = raw.shape[1], table.axis.stripes
    at, begin = np.zeros(count, np.int64), np.full(count, -1, np.int64)
    if stripes is not None:
        at = _brightest(raw, stripes, light.clip)
        begin[:] = table.book.words.shape[1] // 2
    elif start is not None:
        begin = (np.nan_to_num(start - table.first[0]) * PER_PX).astype(np.int64).clip(0)
    of = table.frames[0] if stripes is None else table.frames[at].T
    shown = raw[of] if stripes is None else np.take_along_axis(raw, of, axis=0)
    samples = np.ascontiguousarray(light.linear(shown).T)
    if start is not None:
        samples[np.isnan(start)] = np.nan
    numbers, camera = np.empty((count, 6)), (noise.read2, noise.gain, table.misfit2)
    limit = float(scipy.special.chdtri(table.dof, _RARE))
    match(samples, table.block[at], begin, cols, table.book, camera, limit, numbers)
    place, variance, *rest = numbers.T
    px = table.first[at] + place / PER_PX
    found = _Found(samples, table.block[at], place, px, variance / PER_PX**2, *rest)
    if stripes is None:
        return found
    return found._replace(error=_rival_error(light, raw, stripes.index, at, noise, found))


def _brightest(raw: NDArray[Any], stripes: Stripes, clip: float) -> I64:
    """Number of the place (K,) whose frame is brightest; of saturated ones the middle."""
    index = stripes.index
    top, at = raw[index[0]].copy(), np.zeros(raw.shape[1], np.int64)
    for k, i in enumerate(index[1:], 1):
        at[raw[i] > top] = k
        np.maximum(top, raw[i], out=top)
    full = np.flatnonzero(top >= clip)
    if len(full):
        over = (raw[index[:, None], full] >= clip).astype(np.float64)
        at[full] = np.rint(np.arange(len(index)) @ over / over.sum(axis=0)).astype(np.int64)
    return at


def _rival_error(light: Light, raw: NDArray[Any], index: I64, at: I64, noise: Noise, found: _Found) -> F64:
    """Probability that the true place is the brightest of the other stripes; (K,)."""
    other = np.zeros_like(raw[0])
    for k, i in enumerate(index):
        near = np.abs(at - k) <= found.samples.shape[1] // 2
        np.maximum(other, np.where(near, 0, raw[i]), out=other, casting="unsafe")
    rival = np.nan_to_num(light.linear(other), nan=light.white)
    bright = np.maximum(rival - found.offset, 0.0)
    variance = noise.variance(rival)
    error = scipy.special.expit(-0.5 * (found.scale**2 - bright**2) / variance)
    doubtful = (bright**2 > 25 * variance) & (bright > _RIVAL * found.scale)
    error = np.where(doubtful, np.maximum(error, bright / np.maximum(bright + found.scale, 1e-9)), error)
    return np.where(np.isnan(found.place), 1.0, error)


def prepare(
    sequence: Sequence,
    axis: AxisPlan,
    light: Light,
    sample: Sample,
    noise: Noise | None,
    settings: Settings,
) -> LookUp:
    """Estimates of an axis, with the spread that is likeliest on a sample of lit pixels.

    noise: None if unknown, then from the residuals.
    """
    blur = None if math.isnan(settings.blur) else settings.blur
    display: tuple[float, ...] = () if settings.display is None else tuple(settings.display.light().tolist())

    few = sample.levels[:, :: max(1, -(-sample.levels.shape[1] // _PIXELS))].astype(np.float32)
    raw = np.where(np.isnan(few), np.float32(np.inf), few)
    levels = replace(light, raw=raw[:, None, :], clip=math.inf, table=np.zeros(0, np.float32))
    floor = max(light.rounding, 1e-12)
    contrast = float(np.square(np.ptp(np.nan_to_num(few), axis=0)).mean()) if few.size else 0.0
    assumed = noise or Noise(max(floor, 1e-5 * contrast))
    on_cells = settings.on_cells or bool(axis.levels or axis.code)

    def fitted(optics: Optics, start: F64 | None) -> _Trial:
        optics = optics._replace(light=display)
        table = _known(sequence, axis.axis, optics, start is None)
        return _Trial(optics, table, _matched(levels, raw, raw.shape[1], assumed, table, start))

    # grey values of single cells are found only by a spread that is near the true one
    starts = _STARTS if axis.levels else _STARTS[:1]
    first = [fitted(_optics(spread, blur, on_cells), None) for spread in starts]
    best = _likeliest(first)
    start = np.where(best.found.error < 1e-3, best.found.place, np.nan)
    if not np.isfinite(start).any():
        return LookUp(first[0].optics, 0.0, noise)
    if noise is None:
        assumed = _residual_noise(best, floor)
    best = _likeliest(_tried(lambda optics: fitted(optics, start), axis, blur, on_cells))
    if noise is None:
        return LookUp(best.optics, 0.0, _residual_noise(best, floor))
    return LookUp(best.optics, _beyond(best, noise), None)


def table_of(sequence: Sequence, axis: AxisPlan, estimates: LookUp) -> Table:
    """Table of an axis by the estimates of an earlier capture."""
    table = _known(sequence, axis.axis, estimates.optics, True)
    return replace(table, misfit2=estimates.misfit2, noise=estimates.noise)


@lru_cache(maxsize=_KEPT)
def _known(sequence: Sequence, name: str, optics: Optics, search: bool) -> Table:
    """search: see _table."""
    plan = plan_of(sequence)
    axis = next(one for one in plan.axes if one.axis == name)
    if axis.stripes is not None:
        return _sweep(axis, axis.stripes, optics)
    return _table(sequence, axis, optics, _frames_of(plan, axis), search)


def _optics(spread: float, blur: float | None, on_cells: bool) -> Optics:
    """Optics of a spread without the blur, if that is known; else half of its variance is blur."""
    if not on_cells or spread == 0:
        return Optics(0.0, 1.0)
    if blur is None:
        return Optics(spread, 0.5)
    spread = math.hypot(spread, blur)
    return Optics(spread, (blur / spread) ** 2)


def _tried(
    fitted: Callable[[Optics], _Trial], axis: AxisPlan, blur: float | None, on_cells: bool
) -> list[_Trial]:
    """Trials of spreads, ever closer around the best one; of grey values, then of other shares of the
    blur."""
    if not on_cells:
        return [fitted(_optics(0.0, blur, on_cells))]
    widest = max(_WIDEST, 0.5 * axis.stripes.width if axis.stripes else 0.0)
    trials = [fitted(_optics(one, blur, True)) for one in np.geomspace(_SHARPEST, widest, _TRIED).tolist()]
    if not (axis.levels or axis.code):
        trials.append(fitted(_optics(0.0, blur, True)))
    for factor in (1.24, 1.11, 1.05):
        best = _likeliest(trials).optics
        if best.spread > 0:
            own = math.sqrt(max(best.spread**2 - (blur or 0.0) ** 2, 1e-4))
            trials += [fitted(_optics(own * one, blur, True)) for one in (1 / factor, factor)]
    best = _likeliest(trials).optics
    if axis.levels and best.spread > 0 and blur is None:
        trials += [fitted(best._replace(share=one)) for one in _SHARES]
    return trials


def _likeliest(trials: list[_Trial]) -> _Trial:
    """By -2 log likelihood over all places of each pixel: squared residuals with long tails."""
    dof = trials[0].table.dof
    variance = np.array([one.found.variance for one in trials])
    misfit = np.where(np.isfinite(variance), np.minimum([one.found.chi2 for one in trials], _NO_FIT), _NO_FIT)
    variance = np.minimum(variance, 1.0)
    cost = (_TAIL * dof * np.log1p(misfit / _TAIL) - np.log(variance)).sum(axis=1)
    return trials[int(np.argmin(cost))]


def _beyond(trial: _Trial, noise: Noise) -> float:
    """Variance of the residuals beyond noise, over the squared scale, from their median."""
    table, found = trial.table, trial.found
    used = np.isfinite(found.variance)
    usual = (1 - 2 / (9 * table.dof)) ** 3  # of chi2 over its freedom, for noise alone
    excess = float(np.median(found.chi2[used])) / usual - 1 if used.any() else 0.0
    count = int(np.count_nonzero(used))
    chance = 4 * math.sqrt(2 / (table.dof * max(count, 1)))
    own = noise.variance(found.offset[used]) / np.square(found.scale[used])
    return excess * float(np.median(own)) if excess > chance else 0.0


def _residual_noise(trial: _Trial, floor: float) -> Noise:
    """Noise from the residuals of a sample, by level."""
    found, used = trial.found, np.isfinite(trial.found.variance)
    words, n, at = trial.table.book.words, found.samples.shape[1], found.codeword[used]
    block, q = found.block[used], np.minimum(at.astype(np.int64), words.shape[1] - 2)
    z = words[block, q] + (at - q)[:, None] * (words[block, q + 1] - words[block, q])
    level = found.offset[used, None] + found.scale[used, None] * z
    residual = (found.samples[used] - level) * math.sqrt(n / max(n - 3, 1))
    good = np.isfinite(residual)
    return noise_of([(level[good], residual[good])], floor)


def _frames_of(plan: Plan, axis: AxisPlan) -> tuple[int, ...]:
    """Frames of a table: free grey values alone where there are enough; white and black."""
    own = axis.levels if len(axis.levels) >= 3 else axis.frames()
    index = own + tuple(i for i in (plan.white, plan.black) if i >= 0)
    if len(index) < 4:
        raise InputError(f"decode: axis {axis.axis} has {len(index)} frames, must have at least 4")
    return index


def _table(sequence: Sequence, axis: AxisPlan, optics: Optics, index: tuple[int, ...], search: bool) -> Table:
    """Table of any levels at the places -1 + k / PER_PX; search: over the whole surface, else from given
    places."""
    name = axis.axis
    frames = [sequence.frames[i] for i in index]
    if optics.spread == 0:
        place = np.arange((axis.extent + 1) * PER_PX + 1) / PER_PX - 1
        levels = (
            np.stack([one.ideal_levels(place, "u" if one.axis is None else name) for one in frames]) / 255
        )
        levels = optics.emitted(levels)
    else:
        levels = _through(optics.emitted(_shown(sequence, name, index)), optics, sequence.nominal)
    words = np.ascontiguousarray(levels.T[None], np.float32)
    cell = max(one.cell_px for one in frames)
    reach = math.ceil(_AROUND * cell * PER_PX)
    book = Book(words, *(_surface(words[0], reach) if search else _NOWHERE), reach, math.ceil(cell * PER_PX))
    return Table(axis, book, np.array(index)[None], np.zeros(1, np.int64), np.array([-1.0]))


def _shown(sequence: Sequence, name: str, index: tuple[int, ...]) -> F64:
    """Levels 0..1 (M, E) of the cells along an axis; free ones as they are described."""
    levels = sequence.tables()["uv".index(name)][list(index)].astype(np.float64) / 255
    for row, frame in zip(levels, (sequence.frames[i] for i in index), strict=True):
        if frame.kind in ("white", "black"):
            row[:] = float((frame.kind == "white") != frame.inverted)
        elif frame.kind == "levels":
            free = frame.free_levels(np.arange(len(row), dtype=np.float64)) / 255
            row[:] = 1 - free if frame.inverted else free
    return levels


def _weight(distance: F64, optics: Optics) -> F64:
    """Share of a cell's light in a pixel at a distance (pattern px): cell, footprint and Gaussian blur.

    Second difference of the Gaussian integrated twice, t Phi(t / b) + b phi(t / b).
    """
    width = max(math.sqrt(12 * (1 - optics.share)) * optics.spread, 0.05)
    soft = max(math.sqrt(optics.share) * optics.spread, 1e-3)

    def twice(t: F64) -> F64:
        z = t / soft
        return np.asarray(t * scipy.special.ndtr(z) + soft * np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi))

    far, near = (1 + width) / 2, (1 - width) / 2
    ends = twice(distance + far) - twice(distance + near) - twice(distance - near) + twice(distance - far)
    return np.asarray(ends / width)


def _through(levels: F64, optics: Optics, nominal: bool) -> F64:
    """Levels (M, E) of cells as read by pixels at -1 + k / PER_PX: (M, (E + 1) PER_PX + 1)."""
    reach, cells = math.ceil(4 * optics.spread) + 1, levels.shape[1]
    around = np.pad(levels, ((0, 0), (reach + 1, reach + 2)), mode="edge" if nominal else "constant")
    seen = np.zeros((len(levels), cells + 2, PER_PX))
    for away in range(-reach, reach + 2):
        share = _weight(away - np.arange(PER_PX) / PER_PX, optics)
        part = around[:, max(reach + away, 0) : reach + away + cells + 2]
        seen[:, : part.shape[1]] += part[..., None] * share
    return seen.reshape(len(levels), -1)[:, : (cells + 1) * PER_PX + 1]


def _surface(words: F32, reach: int) -> tuple[F32, I64, F32]:
    """Book.coarse, rivals and apart of codewords (Q, n)."""
    words = words - words.mean(axis=1, keepdims=True)
    length = np.sqrt(np.square(words).sum(axis=1))
    unit = words / np.maximum(length, 1e-3 * length.max() + 1e-12)[:, None]
    per = PER_PX // COARSE
    coarse = np.ascontiguousarray(unit[per // 2 :: per][: (len(unit) - 1) // per].T)
    rivals, cosine = np.empty((coarse.shape[1], RIVALS), np.int64), np.empty((coarse.shape[1], RIVALS))
    similar(coarse, 2 * math.ceil(reach / per), rivals, cosine)
    mine, theirs = (
        unit[np.clip(per * at[..., None] + per // 2 + np.arange(-side, side + 1), 0, len(unit) - 1)]
        for at, side in ((np.arange(len(rivals)), per // 2), (rivals, per))
    )
    every = np.einsum("pan,pkbn->pkab", mine, theirs, optimize=True).max(axis=(2, 3))
    cosine = np.where(rivals >= 0, np.clip(every, 0.0, 1.0), 0.0)
    return coarse, rivals, np.stack([np.sqrt(1 - cosine**2), cosine], axis=2).astype(np.float32)


def _sweep(axis: AxisPlan, stripes: Stripes, optics: Optics) -> Table:
    """Raised cosines around each place of a sweep, over the frames that illuminate one place."""
    spread = optics.spread
    at, reach = stripes.at, 1.25 * stripes.width + 2 * spread
    side = min(max(2, math.ceil(reach / float(np.median(np.diff(at))))), (len(at) - 1) // 2)
    samples = np.arange(2 * side + 1)
    samples = np.clip(np.arange(len(at)) - side, 0, len(at) - len(samples))[:, None] + samples
    half, beyond = math.ceil(1.25 * np.diff(at).max()) + 1, math.ceil(4 * spread) + 1
    first = np.rint(at) - half
    # stripes at equal offsets from cells share a block
    away, block = np.unique(at[samples] - first[:, None], axis=0, return_inverse=True)
    place = np.arange(2 * half * PER_PX + 1) / PER_PX
    cell = np.arange(-beyond, 2 * half + beyond + 1.0) if spread > 0 else place
    shown = np.abs(cell - away[:, :, None]) / stripes.width
    levels = np.where(shown < 1, 0.5 + 0.5 * np.cos(np.pi * np.minimum(shown, 1.0)), 0.0)
    if spread > 0:  # cells have 8 bits
        levels = optics.emitted(np.rint(255 * levels) / 255) @ _weight(cell[:, None] - place, optics)
    words = np.ascontiguousarray(levels.swapaxes(1, 2), np.float32)
    book = Book(words, *_NOWHERE, math.ceil(_AROUND * PER_PX), PER_PX)
    return Table(axis, book, stripes.index[samples], block.ravel(), first)
