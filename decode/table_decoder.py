"""Decoding against known grey values: any code at all, and sub-cell answers of binary codes.

A pixel's samples are compared with what each place of the surface showed (nearest code words by normalised
correlation), then these places are refined between cells. Sigma is the Fisher information of the best fit;
what the others leave tells the probability that it is one of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter1d

from optolever.blocks import Work
from optolever.errors import InputError
from optolever.patterns import Sequence

from .arrays import chi_squared_limit
from .display_kernels import MOST_LOST
from .flag_kernels import merge_rows
from .plan import AxisPlan, Plan
from .table_kernels import refine_rows

__all__ = [
    "Shown",
    "by_table",
    "flags_of_fit",
    "sampled_rows",
    "shown_on",
    "store",
    "subpixel_step",
    "table_step",
]

Map = NDArray[Any]
_PER_CELL = 8
#: Rms blurs that are tried, cells; besides them a pixel sees a footprint of one cell.
_BLURS = tuple(float(blur) for blur in np.geomspace(0.1, 4.0, 17))
_USUAL_BLUR = 0.5
#: Errors of real displays and cameras that are no fault, share of the contrast.
_UNEVEN = 0.02
#: Share of the pixels that no place explains, above which frames are not those described.
_MANY = 0.15
#: Variance of the residuals, over the most that is noise, above which frames are not those described.
_STRANGE = 2.0
_DARK, _SATURATED, _LOW, _ORDER, _OFF, _MOVED, _INVALID = 1, 2, 4, 8, 16, 64, 128
_DOUBT = 1e-4
#: Answers of a pixel that are compared; pixels around one that do not count as another.
_ANSWERS, _GUARD = 4, 3


@dataclass(frozen=True, slots=True)
class Shown:
    """Frames (M,) of an axis, their levels 0..1 on cells (M, extent), width of the code's cells; dark: the
    surface ends there, and is not only the unit of coordinates."""

    index: NDArray[np.int64]
    levels: NDArray[np.float64]
    cell: float = 1.0
    dark: bool = True

    def fine(self, blur: float) -> NDArray[np.float32]:
        """Levels at _PER_CELL places per cell, seen through a footprint of a cell and a blur (rms, cells)."""
        return _seen(self.levels, blur, "constant" if self.dark else "nearest")

    def lost(self, blur: float) -> NDArray[np.float32]:
        """Share of the light that falls beyond the border, at the same places."""
        whole = np.ones((1, self.levels.shape[1]))
        return np.asarray(1 - _seen(whole, blur, "constant" if self.dark else "nearest")[0])


def _seen(
    levels: NDArray[np.float64], blur: float, beyond: Literal["constant", "nearest"]
) -> NDArray[np.float32]:
    fine = np.repeat(levels, _PER_CELL, axis=1)
    # a box of an even number of samples has its ends at half weight, or it would shift them
    box = np.full(_PER_CELL + 1, 1 / _PER_CELL)
    box[[0, -1]] /= 2
    fine = correlate1d(fine, box, axis=1, mode=beyond)
    return np.asarray(gaussian_filter1d(fine, blur * _PER_CELL, axis=1, mode=beyond), np.float32)


def by_table(axis: AxisPlan) -> bool:
    """True if only known grey values lead to an answer: free levels, fringes of fewer than three shifts."""
    return bool(axis.levels) or any(fringe.few() for fringe in axis.fringes)


def shown_on(sequence: Sequence, wanted: Plan, axis: AxisPlan) -> Shown:
    """All frames of an axis, and white and black, which fix offset and scale."""
    own = [i for i, frame in enumerate(sequence.frames) if frame.axis == axis.axis]
    own += [i for i in (wanted.white, wanted.black) if i >= 0]
    tables = sequence.tables()["uv".index(axis.axis)][own].astype(np.float64) / 255
    for k, i in enumerate(own):
        if i == wanted.black:
            tables[k] = 0.0
        elif i == wanted.white:
            tables[k] = 1.0
    if len(own) < 3:
        raise InputError(f"decode: axis {axis.axis} has {len(own)} frames, must have at least 3")
    cell = max(sequence.frames[i].cell_px for i in own)
    return Shown(np.array(own, np.int64), tables, cell, not sequence.nominal)


def table_step(
    frames: Map,
    clip: float,
    shown: Shown,
    axis: AxisPlan,
    joined: bool,
    maps: tuple[Map, Map],
    common: tuple[Map, ...],
    even: bool = True,
) -> Work:
    """Work on a block of rows: nearest code word of the whole surface, refined.

    even: levels are as noisy as each other; a response's inverse magnifies the noise of dark ones.
    """
    sample = np.ascontiguousarray(frames[:, sampled_rows(frames.shape[1])])
    coarse = _search(sample, clip, shown, answers=1)(0, sample.shape[1])[0]
    blur, noise2 = _calibrate(sample, clip, shown, coarse)
    most = _most_noise(sample, clip, shown)
    noise2, residue = min(noise2, most), noise2
    search = _search(frames, clip, shown, blur)
    # coarse patterns hardly tell a small blur, and the border does not wait for it
    fine, lost = shown.fine(blur), shown.lost(max(blur, _USUAL_BLUR))
    # what the model does not explain goes into sigma, up to three times the noise
    limit = 3 * chi_squared_limit(len(shown.index) - 3)
    _, _, misfit, _, scale, _ = _refine(sample, clip, 0, sample.shape[1], shown, fine, coarse)
    lit = scale > 0.25 * np.percentile(scale, 95)
    # where many pixels fit no place, others fit a wrong one by chance
    misfits = bool(lit.any() and np.mean(misfit[lit] > limit * noise2) > _MANY)
    wrong_frames = misfits or (even and residue > _STRANGE * most)

    def step(start: int, stop: int) -> None:
        answers = [_refine(frames, clip, start, stop, shown, fine, word) for word in search(start, stop)]
        every = [np.stack(each) for each in zip(*answers, strict=True)]
        best, wrong = _likeliest(every[2], every[5], noise2)
        coord, curvature, misfit, offset, scale, count = (
            np.take_along_axis(each, best[None], axis=0)[0] for each in every
        )
        why = flags_of_fit(curvature, misfit, scale, count, offset, noise2, limit)
        why |= np.where(wrong > _DOUBT, _ORDER, 0) | (_MOVED if wrong_frames else 0)
        why |= np.where(lost[_fine_place(coord, len(lost))] > MOST_LOST, _OFF, 0)
        with np.errstate(divide="ignore"):
            variance = noise2 / curvature * _excess(misfit, count, noise2)
        store(start, stop, coord, variance, why, wrong, scale, offset, axis, joined, maps, common)

    return step


def _likeliest(misfits: Map, counts: Map, noise2: float) -> tuple[NDArray[np.int64], Map]:
    """Which of some answers (K, rows, W) fits best, and the probability that it is another one of them; where
    the best one leaves more than noise, the model is off, by as much for the others."""
    best = misfits.argmin(axis=0)
    least, count = (np.take_along_axis(each, best[None], axis=0)[0] for each in (misfits, counts))
    worse = (misfits - least) / (2 * noise2 * _excess(least, count, noise2))
    others = np.exp(-np.minimum(worse, 80)).sum(axis=0) - 1
    return best, others / (1 + others)


def _fine_place(coord: Map, places: int) -> NDArray[np.int64]:
    """Of Shown.fine's places, those of coordinates."""
    return np.clip((np.nan_to_num(coord) + 0.5) * _PER_CELL, 0, places - 1).astype(np.int64)


def _most_noise(sample: Map, clip: float, shown: Shown) -> float:
    """Variance that noise and an uneven display explain: a wrong frame's residuals must not pass for noise.

    From second differences along rows, of the calmest frame: what it shows adds to them. Black is calmer than
    all others where noise grows with the light, and so is what is clipped.
    """
    levels = sample[shown.index].astype(np.float64)
    calm = []
    for own in levels[shown.levels.any(axis=1)]:
        second = np.abs(np.diff(own, 2, axis=1))[(own[:, 1:-1] < clip) & (own[:, 1:-1] > 0)]
        calm += [float(np.median(second))] if second.size > own.size // 4 else []
    if not calm:
        return float("inf")
    spatial = 1.4826 * min(calm) / np.sqrt(6)
    contrast = float(np.percentile(np.ptp(levels, axis=0), 75))
    return float(max(2 * spatial, 0.3) ** 2 + (_UNEVEN * contrast) ** 2)


def _excess(misfit: Map, count: Map, noise2: float) -> Map:
    """Factor of the variance where residuals are larger than noise makes them: the model is off there."""
    freedom = np.maximum(count - 3, 1)
    return np.asarray(np.maximum(misfit / (freedom * noise2) - 2 * np.sqrt(2 / freedom), 1.0))


def subpixel_step(
    frames: Map, clip: float, shown: Shown, coarse: Work, maps: tuple[Map, Map], least: float
) -> Work:
    """Work on a block of rows: answers within the cells that `coarse` found, where blur tells them apart.

    least: variance of a sample, at least; residuals tell less where most bits are black, clipped at zero.
    """
    sample = sampled_rows(frames.shape[1])
    for row in sample:
        coarse(int(row), int(row) + 1)
    blur, noise2 = _calibrate(np.ascontiguousarray(frames[:, sample]), clip, shown, maps[0][sample])
    noise2 = max(noise2, least)
    flat = _flat_variance(np.ascontiguousarray(frames[:, sample]), clip, shown, maps[0][sample])
    if flat < 1.5 * noise2:
        return coarse
    fine = shown.fine(blur)
    limit = 3 * chi_squared_limit(len(shown.index) - 3)
    # next to the border, what is missing beyond it moves all edges
    inner = shown.lost(blur) <= MOST_LOST

    def step(start: int, stop: int) -> None:
        coarse(start, stop)
        cell, sigma = maps[0][start:stop], maps[1][start:stop]
        coord, curvature, misfit, _, _, count = _refine(frames, clip, start, stop, shown, fine, cell)
        error = np.sqrt(noise2 / np.maximum(curvature, 1e-12) * _excess(misfit, count, noise2))
        better = (np.abs(coord - cell) < 1.5) & (error < sigma) & (misfit < limit * noise2)
        better &= inner[_fine_place(coord, len(inner))]
        maps[0][start:stop] = np.where(better, coord, cell)
        maps[1][start:stop] = np.where(better, np.maximum(error, 0.01), sigma)

    return step


def sampled_rows(rows: int) -> NDArray[np.int64]:
    """Rows on which blur and noise are measured."""
    return np.unique(np.linspace(0, rows - 1, min(rows, 24)).astype(np.int64))


def _calibrate(frames: Map, clip: float, shown: Shown, coarse: Map) -> tuple[float, float]:
    """Blur (rms, cells) on sampled rows, and the variance of the residuals.

    Samples tell in what shares a pixel sees two neighbouring cells, but hardly how far from their edge it is:
    that depends on the blur. With the right one the answers are spread evenly over the cells, with one that
    is too small they crowd at the edges. So of the blurs whose residuals are least, the most even one.
    """
    tried = [(blur, *_fit_quality(frames, clip, shown, coarse, blur)) for blur in _BLURS]
    least = min(variance for _, variance, _ in tried)
    if not np.isfinite(least):
        return _USUAL_BLUR, 1 / 12
    best = _most_even(tried, least)[0]
    tried += [
        (blur, *_fit_quality(frames, clip, shown, coarse, blur))
        for blur in best * np.array([0.88, 0.94, 1.06, 1.12])
    ]
    blur, variance, _ = _most_even(tried, least)
    return blur, max(variance, 1 / 12)


def _most_even(tried: list[tuple[float, float, float]], least: float) -> tuple[float, float, float]:
    """(blur, variance, crowding) of the least crowding whose variance is about the least."""
    return min((trial for trial in tried if trial[1] <= 1.2 * least), key=lambda trial: trial[2])


def _fit_quality(frames: Map, clip: float, shown: Shown, coarse: Map, blur: float) -> tuple[float, float]:
    """Variance of the residuals of the lit pixels, and the crowding |mean exp(2 pi i u / cell)|."""
    found = _refine(frames, clip, 0, frames.shape[1], shown, shown.fine(blur), coarse)
    coord, misfit, scale, count = found[0], found[2], found[4], found[5]
    lit = (scale > 0.25 * np.percentile(scale, 95)) & (count > 3)
    if not lit.any():
        return float("inf"), 1.0
    freedom = np.maximum(count[lit] - 3, 1)
    # the median of chi squared lies below its mean (Wilson & Hilferty)
    variance = float(np.median(misfit[lit] / freedom / (1 - 2 / (9 * freedom)) ** 3))
    return variance, float(np.abs(np.exp(2j * np.pi * coord[lit] / shown.cell).mean()))


def _flat_variance(frames: Map, clip: float, shown: Shown, cell: Map) -> float:
    """Variance of the residuals if every pixel saw one cell alone: no larger, edges tell nothing."""
    shape = cell.shape
    coord, count = np.empty(shape), np.empty(shape, np.int32)
    curvature, misfit, offset, scale = (np.empty(shape, np.float32) for _ in range(4))
    levels = shown.levels.astype(np.float32)
    refine_rows(
        *(frames, clip, 0, shape[0], shown.index, levels, 1, 0, cell),
        *(coord, curvature, misfit, offset, scale, count),
    )
    lit = (scale > 0.25 * np.percentile(scale, 95)) & (count > 3)
    return float(np.mean(misfit[lit] / (count[lit] - 3))) if lit.any() else 0.0


def _refine(
    frames: Map, clip: float, start: int, stop: int, shown: Shown, fine: Map, coarse: Map
) -> tuple[Map, ...]:
    shape = (stop - start, frames.shape[2])
    coord = np.empty(shape)
    curvature, misfit, offset, scale = (np.empty(shape, np.float32) for _ in range(4))
    count = np.empty(shape, np.int32)
    refine_rows(
        *(frames, clip, start, stop, shown.index, fine, _PER_CELL, 2 * _PER_CELL, coarse),
        *(coord, curvature, misfit, offset, scale, count),
    )
    return coord, curvature, misfit, offset, scale, count


def _search(
    frames: Map, clip: float, shown: Shown, blur: float = _USUAL_BLUR, answers: int = _ANSWERS
) -> Callable[[int, int], list[Map]]:
    """The nearest code words, not next to each other, of the whole surface by normalised correlation; the
    later half of those of pixels with clipped samples without these."""
    words = shown.fine(blur)[:, _PER_CELL // 4 :: _PER_CELL // 2]
    far = words - words.mean(axis=0)
    length = np.sqrt((far**2).sum(axis=0))
    units = (far / np.maximum(length, 1e-6) * (length > 1e-3)).astype(np.float32)
    # a small surface has no room for more
    answers = min(answers, 1 + (words.shape[1] - 1) // (4 * _GUARD + 1))

    def nearest(samples: Map) -> Map:
        """Of pixels (M, K), (answers, K)."""
        place = np.empty((answers, samples.shape[1]), np.float32)
        score = (samples - samples.mean(axis=0)).T @ units
        clipped = np.flatnonzero((samples >= clip).any(axis=0))
        pick = np.arange(len(score))
        for rank in range(answers):
            if 0 < rank == answers // 2 and clipped.size:
                own = _correlation(samples[:, clipped], samples[:, clipped] < clip, words)
                score[clipped] = np.where(np.isinf(score[clipped]), -np.inf, own)
            best = score.argmax(axis=1)
            place[rank] = 0.5 * best - 0.25
            for near in range(-2 * _GUARD, 2 * _GUARD + 1):
                score[pick, np.clip(best + near, 0, words.shape[1] - 1)] = -np.inf
        return place

    def search(start: int, stop: int) -> list[Map]:
        samples = frames[shown.index, start:stop].reshape(len(shown.index), -1).astype(np.float32)
        parts = [nearest(samples[:, at : at + 4096]) for at in range(0, samples.shape[1], 4096)]
        return list(np.concatenate(parts, axis=1).reshape(answers, stop - start, frames.shape[2]))

    return search


def _correlation(samples: Map, used: Map, words: Map) -> Map:
    """Normalised, of samples (M, K) that are used with words (M, L), (K, L); in units of the samples."""
    some = used.astype(np.float32)
    count = np.maximum(some.sum(axis=0), 1)[:, None]
    own = np.where(used, samples - (samples * some).sum(axis=0) / count.T, 0).astype(np.float32)
    spread = some.T @ words**2 - (some.T @ words) ** 2 / count
    return np.asarray(own.T @ words / np.sqrt(np.maximum(spread, 1e-6)) * (spread > 1e-6))


def flags_of_fit(
    curvature: Map, misfit: Map, scale: Map, count: Map, offset: Map, noise2: float | Map, limit: float
) -> NDArray[np.int32]:
    why = np.zeros(curvature.shape, np.int32)
    low = 0.5 * scale < 4 * np.sqrt(noise2)
    why |= np.where(low, _LOW, 0)
    why |= np.where(low & (offset + scale < 8 * np.sqrt(noise2)), _DARK, 0)
    why |= np.where(count < 4, _SATURATED, 0)
    why |= np.where(misfit > limit * noise2, _MOVED, 0)
    why |= np.where(~(curvature > 0), _INVALID, 0)
    return why


def store(
    start: int,
    stop: int,
    coord: Map,
    variance: Map,
    why: Map,
    wrong: Map,
    scale: Map,
    offset: Map,
    axis: AxisPlan,
    joined: bool,
    maps: tuple[Map, Map],
    common: tuple[Map, ...],
) -> None:
    sigma = np.sqrt(np.where(variance > 0, variance, np.inf))
    beyond = np.abs(coord - 0.5 * (axis.extent - 1)) - 0.5 * axis.extent
    why |= np.where(beyond > np.maximum(0.5, np.where(np.isfinite(sigma), 3 * sigma, 0)), _OFF, 0)
    maps[0][start:stop] = coord
    maps[1][start:stop] = np.maximum(sigma, 0.01)
    half = (0.5 * scale).astype(np.float32)
    mean = (offset + 0.5 * scale).astype(np.float32)
    merge_rows(start, stop, joined, why.astype(np.int32), half, mean, wrong.astype(np.float32), *common)
