"""Small blocks of the image, decoded plainly: which of their pixels have a place, and where.

A pixel is placed where its bits are decided, its fringes are sinusoids, and its place lies on the pattern and
continues its neighbours'. The decoder proper is sharper; this one says how well an order or a description
fits, for hundreds of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.kernels import F32, F64, I64
from optolever.patterns import Sequence

from ..noise import quantile
from ..plan import AxisPlan, Code, Fringe, Plan, plan

__all__ = [
    "Fits", "Trial", "Words", "blocks_of", "cut", "fits_of", "places", "plain_decode",
    "shortfall", "word_places", "words_of",
]  # fmt: skip

Mask = NDArray[np.bool_]
#: Blocks, side of one, pixels; places at which they may lie.
_BLOCKS, _SIDE, _PLACES = 36, 10, 1500
#: Residual of a fringe over its amplitude, at most (gamma 2.2: .57).
_SINE = 0.7
#: Shortfall of a share without pixels.
_NONE = 0.05


class Trial(NamedTuple):
    """A hypothesis. order (N,): captured picture of each image of `sequence`; free: image that no picture
    shows, -1: none; before: share of the picture before in every one."""

    name: str
    order: I64
    sequence: Sequence
    free: int = -1
    before: float = 0.0


class Fit(NamedTuple):
    """A fringe's sinusoid in pixels (B, side, side): phase, periods; residual over amplitude."""

    period: float
    phase: F32
    amplitude: F32
    offset: F32
    residual: F32


Words = tuple[F32, F32, Mask]
#: Fits of the fringes of each axis, the coarsest first; None: less than three samples.
Fits = dict[str, list[Fit | None]]


def blocks_of(frames: NDArray[Any], mask: Mask | None) -> I64 | None:
    """First pixels (B, 2) of lit blocks; for every frame two with an edge of it, the rarest edges first."""
    half, step, rng = _SIDE // 2, _SIDE // 2 - 1, np.random.default_rng(0)
    stride = max(4, int((frames[0].size / _PLACES) ** 0.5))
    inside = tuple(slice(half, extent - half + 1, stride) for extent in frames.shape[1:])
    if 0 in frames[0][inside].shape:
        return None
    low, high = (_corners(way, frames, half - step, 2 * step, stride) for way in (np.minimum, np.maximum))
    span = np.subtract(high.max(axis=0), low.min(axis=0), dtype=np.float32)
    lit = span > 0.4 * quantile(span, 0.95)
    if mask is not None:
        lit &= mask[inside]
    where = rng.permutation(np.flatnonzero(lit))
    if not len(where):
        return None
    edges = (high - low > 0.5 * span).reshape(len(high), -1).take(where, axis=1)
    first, every = edges.argmax(axis=1), np.arange(len(edges))
    rest = edges.copy()
    rest[every, first] = False
    two = np.stack([first, rest.argmax(axis=1)], axis=1)
    chosen, found, many = list[int](), np.zeros(len(edges), np.int64), np.count_nonzero(edges, axis=1)
    for i in np.argsort(many, kind="stable").tolist():
        for j in two[i, : max(min(2 - found[i], many[i]), 0)].tolist():
            if j not in chosen:
                chosen.append(j)
                found += edges[:, j]
    some = list(dict.fromkeys((*chosen, *range(min(len(where), _BLOCKS)))))[:_BLOCKS]
    return stride * np.stack(np.divmod(rng.permutation(where[some]), lit.shape[1]), axis=1)


def _corners(way: np.ufunc, frames: NDArray[Any], first: int, side: int, stride: int) -> NDArray[Any]:
    """Least or largest levels (N, h, w) at the corners of squares of a side, in each picture."""
    rows, cols = ((extent - first - side - 1) // stride + 1 for extent in frames.shape[1:])
    upper, lower = (frames[:, y::stride][:, :rows] for y in (first, first + side))
    lines = way(upper, lower)
    left, right = (lines[..., x::stride][..., :cols] for x in (first, first + side))
    return np.asarray(way(left, right))


def cut(image: NDArray[Any], at: I64) -> NDArray[Any]:
    """Blocks (..., B, side, side) of an image (..., H, W)."""
    return np.stack([image[..., y : y + _SIDE, x : x + _SIDE] for y, x in at], axis=-3)


def plain_decode(blocks: F32, trial: Trial) -> list[F64]:
    """Share of pixels with a place, by block (B,), of each axis. InputError where the description is none."""
    return [share for share, _ in _decoded(_images(blocks, trial), plan(trial.sequence), trial.free)[0]]


def _decoded(images: F32, known: Plan, free: int) -> tuple[list[tuple[F64, list[float]]], Fits]:
    """`places` of each axis that plain decoding knows, and the fits."""
    fits = fits_of(images, known, free)
    axes = [axis for axis in known.axes if (axis.code is not None or axis.fringes) and not axis.looked_up]
    words = words_of(images, known, fits, free)
    return [places(images.shape[1:], axis, words.get(axis.axis), fits) for axis in axes], fits


def _images(blocks: F32, trial: Trial) -> F32:
    """Images (N, B, side, side) of a hypothesis."""
    if not trial.before:
        return blocks[trial.order]
    mixture = (1 - trial.before) * np.eye(len(blocks)) + trial.before * np.eye(len(blocks), k=-1)
    mixture[0, 0] = 1.0
    return np.tensordot(np.linalg.inv(mixture).astype(np.float32), blocks[trial.order], 1)


def shortfall(blocks: F32, trial: Trial, base: Any = _NONE) -> F64:
    """1 - share: of axes (twice), finer fringes, equal mean levels, no residuals, white over black; without
    pixels half as much as in base."""
    try:
        known = plan(trial.sequence)
    except InputError:
        return np.array([np.inf])
    found, fits = _decoded(_images(blocks, trial), known, trial.free)
    shares = [value for share, phasors in found for value in (share.mean(), share.mean(), *phasors)]
    shares += _light(fits)
    ends = [known.white, known.black]
    if min(ends) >= 0:
        white, black = blocks[trial.order[ends]]
        bright = np.mean(white - black > 0.25 * np.ptp(blocks, axis=0))
        shares.append(np.nan if trial.free in ends else bright)
    one = np.array(shares)
    unknown = np.maximum(0.5 * base, _NONE) if np.shape(base) == one.shape else _NONE
    return np.where(np.isnan(one), unknown, 1 - one)


def _light(fits: Fits) -> list[float]:
    """1 less the median deviation of a fringe's mean level from all others', and less its residual, both in
    amplitudes; NaN of a fringe that has lost its steps."""
    every = [fit for one in fits.values() for fit in one]
    known = [fit.offset for fit in every if fit is not None]
    usual, shares = np.median(known, axis=0) if known else 0.0, list[float]()
    for fit in every:
        off = (np.nan, np.nan) if fit is None else (np.abs(fit.offset - usual) / fit.amplitude, fit.residual)
        shares += [1 - min(float(np.median(one)), 1.0) for one in off]
    return shares


def places(
    shape: tuple[int, ...], axis: AxisPlan, words: Words | None, fits: Fits, lit: Mask | None = None
) -> tuple[F64, list[float]]:
    """Share of pixels of a shape (B, side, side) with a place, by block (B,), or of the lit ones, (); without
    these mean phasor of each finer fringe against the coarser place (NaN: too few pixels)."""
    fringes = [fit for fit in fits[axis.axis] if fit is not None]
    ok: Mask = np.ones(shape, np.bool_)
    for fit in fringes:
        ok &= fit.residual < _SINE
    slack: Any = 0.0
    width, phasors, slope = np.zeros(shape, np.float32), list[float](), 0.0
    if axis.code is not None and words is not None:
        place, width, decided = words
        if fringes and len(place) > 1:  # the other value mirrors the place: the fringe knows its half
            gap = fringes[0].phase - place / np.float32(fringes[0].period)
            which = np.abs(gap - np.rint(gap)).argmin(axis=0)
            place = np.take_along_axis(place, which[None], axis=0)
        ok &= decided & (width <= max(8 * axis.code.cell, axis.extent / 16))
        slack, slope = 3 * width, 0.5
    elif fringes:
        place = _ladder_place(fringes, axis.extent)[None]
    else:
        return np.zeros(len(width)), phasors
    for period, turn, *_ in fringes:
        gap = turn - place / period
        if lit is None and (axis.code is not None or period < fringes[0].period):
            use = (width < 0.75 * period) & ok
            mean = np.cos(2 * np.pi * gap) / np.sinc(np.minimum(width / period, 0.75))
            share = (mean * use).sum(axis=(2, 3)).max(axis=0).sum() / max(use.sum(), 1)
            phasors.append(min(share, 1.0) if use.mean() > 0.2 else np.nan if ok.mean() > 0.2 else 0.0)
        place, width = period * (turn - np.rint(gap)), np.zeros_like(width)
        slack, slope = 0.25 * period, 0.25
    good = _smooth(place, slack, slope) & ok[:, 1:-1, 1:-1]
    inner = place[..., 1:-1, 1:-1]
    good = good & (inner > -0.02 * axis.extent - 1) & (inner < 1.02 * axis.extent)
    placed = good[0] if len(good) == 1 else good[good.mean(axis=(2, 3)).argmax(axis=0), np.arange(shape[0])]
    return np.asarray(placed.mean(axis=(1, 2)) if lit is None else placed[lit[:, 1:-1, 1:-1]].mean()), phasors


def fits_of(blocks: F32, known: Plan, free: int = -1) -> Fits:
    """Of all axes whose fringes are no look-ups."""
    return {
        axis.axis: [_fit(blocks, fringe, free) for fringe in axis.fringes if not axis.looked_up]
        for axis in known.axes
    }


def _fit(blocks: F32, fringe: Fringe, free: int) -> Fit | None:
    keep = [k for k, i in enumerate(fringe.index) if i != free]
    if len(keep) < 3:
        return None
    own = fringe if len(keep) == len(fringe.index) else replace(fringe, shifts=fringe.shifts[keep])
    levels = blocks[[fringe.index[k] for k in keep]]
    fit = np.tensordot(own.inverse.astype(np.float32), levels, 1)
    amplitude = np.hypot(fit[1], fit[2]) + np.float32(1e-3)
    rest = np.tensordot(own.unlike.astype(np.float32), levels, 1)
    residual = np.sqrt(np.square(rest).sum(axis=0) / max(len(rest), 1)) / amplitude
    turn = np.arctan2(fit[2], fit[1]) / np.float32(2 * np.pi)
    return Fit(fringe.period, turn, amplitude, fit[0], residual)


def words_of(blocks: F32, known: Plan, fits: Fits, free: int = -1) -> dict[str, Words]:
    """`word_places` of all axes with a code."""
    return {
        axis.axis: word_places(blocks, axis.code, known, [fit for fit in fits[axis.axis] if fit], free)
        for axis in known.axes if axis.code is not None
    }  # fmt: skip


def word_places(blocks: F32, code: Code, known: Plan, fits: list[Fit], free: int = -1) -> Words:
    """Place (1 or 2, B, side, side), of both values of an unknown bit; width of its interval, pattern px;
    whether all but the finest bits are decided."""
    ends = [known.white, known.black]
    used = [i for i in (*code.plain, *code.inverse) if i >= 0 and i != free]
    some = blocks[used]
    high, low = some.max(axis=0), some.min(axis=0)
    middle, half = 0.5 * (high + low), np.maximum(0.5 * (high - low), 1)
    if min(ends) >= 0 and free not in ends:
        middle = 0.5 * (blocks[known.white] + blocks[known.black])
    elif fits:
        middle = fits[0].offset
    pairs = [[-1 if i == free else i for i in pair] for pair in zip(code.plain, code.inverse, strict=True)]
    unknown = [b for b, pair in enumerate(pairs) if max(pair) < 0]

    def bright(i: int, j: int) -> F32:
        """Level of a bit beyond its middle, by its frame, that of its inverse, or both."""
        if min(i, j) >= 0:
            return np.asarray((blocks[i] - blocks[j]) / 2)
        return np.asarray(blocks[i] - middle if i >= 0 else middle - blocks[j])

    word, run, doubts = (np.zeros(half.shape, kind) for kind in (np.int32, np.int8, np.int8))
    together = code.kind == "binary"  # several bits change between adjacent cells; in Gray codes one does
    opened, quarter = [], 0.25 * half
    for b, pair in enumerate(pairs):
        level = half if b in unknown else bright(*pair)
        opened.append(np.abs(level) < quarter)
        word |= (level > 0).astype(np.int32) << b
        if not together:
            run += (run == b) & opened[b]
    fine = bool(unknown) and unknown[0] <= 2 and not fits  # coarser ones are constant in most blocks
    run = np.maximum(run, unknown[0] + 1 if fine else 0).astype(np.int32)
    for b, one in enumerate(opened):
        doubts += one & (run <= b)
    decided = doubts <= (3 if together else 1)
    words = np.stack([word, word ^ (1 << unknown[0])]) if unknown and not fine else word[None]
    finest = (1 << run) - 1
    cell = np.minimum(code.cells[words & ~finest], code.cells[words | finest]) >> run << run
    width = np.asarray((1 << run) * code.cell, np.float32)
    return np.asarray(cell * code.cell + 0.5 * (width - 1) + code.origin, np.float32), width, decided


def _ladder_place(fits: list[Fit], extent: int) -> F32:
    """Place by the coarsest fringe; its order is that which the others confirm best."""
    period, turn, *_ = fits[0]
    place = np.asarray(np.mod(turn + 0.5 / period, 1) * period - 0.5, np.float32)
    if period >= extent or len(fits) == 1:
        return place
    best, cost = place, np.full(place.shape, np.inf, np.float32)
    for order in range(int(np.ceil(extent / period))):
        tried = place + np.float32(order * period)
        gaps = [other.phase - tried / other.period for other in fits[1:]]
        square = sum(np.square(gap - np.rint(gap)) for gap in gaps)
        best, cost = np.where(square < cost, tried, best), np.minimum(square, cost)
    return best


def _smooth(place: F32, slack: Any, share: float) -> Mask:
    """Inner pixels whose second differences are below slack and a share of the first differences."""
    good: Any = True
    for axis in (2, 3):
        first = np.abs(step := np.diff(place, axis=axis))
        a, b = (first[:, :, :-1], first[:, :, 1:]) if axis == 2 else (first[..., :-1], first[..., 1:])
        rough = np.abs(np.diff(step, axis=axis)) - share * (a + b)
        inner = (..., slice(None), slice(1, -1)) if axis == 2 else (..., slice(1, -1), slice(None))
        good = good & (rough[inner] <= (slack[..., 1:-1, 1:-1] if np.ndim(slack) else slack))
    return np.asarray(good, np.bool_)
