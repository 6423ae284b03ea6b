"""How far a pixel sees (footprint and blur, rms): what makes known levels the likeliest that were seen.

A pixel's samples v = o + a t(u) + noise, with any offset, scale and place u, have the likelihood

    p(v | spread) ~ integral over u of exp(-rss(u) / 2 variance),

rss what the best offset and scale leave, the integral over the segments between codewords in Laplace's
approximation. Where a pixel sees two cells only, levels tell its share of each whatever the spread; then the
integral's width, the derivative of the place by the share, tells the spread at which places are as likely
everywhere. The noise's variance, where it is unknown, is the likeliest one at each spread.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .frames import Light
from .lookup_kernels import PER_PX
from .lookup_tables import Pixel, Table
from .noise import Noise, fitted_noise

__all__ = ["FINE", "Fit", "fitted", "likeliest"]

F64 = NDArray[np.float64]
#: Spreads that are tried: pattern px rms, a pixel of a third of a cell, in steps of 1 % (a series of captures
#: shares their tables) to out of focus; the first ones of them in steps of a half.
_FIRST, _STEP, _LAST, _COARSE = 0.1, 1.01, 500, 40
#: Codewords per pattern pixel that tell the treads of a sharp display.
FINE = 32
#: Shares of the footprint in the squared spread that are tried.
_SHARES = 8
#: Log likelihood below the largest up to which another pixel is as likely.
_NEARLY = 8.0
#: Over the median of squared residuals, what is no pixel of the pattern alone (an edge, a gloss).
_OUTLYING = 3.0
#: Residuals that tell the noise at most.
_RESIDUALS = 16384
_TINY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Of K pixels and the Q segments around their places, by one table.

    chi2 (K, Q): squared residuals over the noise's variance; sharp (K, Q): the inverse of the place's
    variance, 1 / segments^2; place (K,): where it fits best, pattern px
    level, residual (K, n): what the best place makes of the samples, and what it leaves, over what a fit of
    offset, scale and place leaves of a sample's own deviation (0: nothing)
    amplitude (K,), variance (K,): half of white minus black, of a sample; freedom
    """

    chi2: F64
    sharp: F64
    place: F64
    level: F64
    residual: F64
    amplitude: F64
    variance: F64
    freedom: int

    @property
    def misfit(self) -> F64:
        """Least chi2 (K,) over freedom."""
        return np.asarray(self.chi2.min(axis=1) / max(self.freedom, 1))

    def likelihood(self, kept: NDArray[np.bool_], even: bool, measure: bool) -> float:
        """Log likelihood of the kept pixels, but for a constant. even: places are as likely everywhere; else
        they are the best ones. measure: the noise is unknown."""
        times = max(float(self.misfit[kept].mean()), _TINY if measure else 1.0)
        exponent = -0.5 * self.chi2[kept] / times
        each = top = exponent.max(axis=1)
        if even:
            width = np.minimum(np.sqrt(2 * np.pi * times / np.maximum(self.sharp[kept], _TINY)), 1.0)
            each = top + np.log((np.exp(exponent - top[:, None]) * width).sum(axis=1))
        return float((each - 0.5 * (self.freedom + 1) * np.log(times)).sum())

    def noise(self, floor: float) -> Noise:
        """The camera's noise by the residuals."""
        kept = (self.misfit <= _OUTLYING * np.median(self.misfit))[:, None] & (self.residual != 0)
        level, residual = (part[kept] for part in (self.level, self.residual))
        some = slice(None, None, 1 + len(level) // _RESIDUALS)
        return fitted_noise(
            level[some].astype(np.float32), residual[some].astype(np.float32), max(floor, 1e-12)
        )

    def misfit2(self) -> float:
        """Variance of what the levels leave beyond noise, over the squared amplitude."""
        # median of chi2 over freedom (Wilson & Hilferty), and what chance adds to that of so many pixels
        freedom = max(self.freedom, 1)
        beyond = float(np.median(self.misfit)) / (1 - 2 / (9 * freedom)) ** 3 - 1
        chance = 4 * np.sqrt(2 / (freedom * len(self.misfit)))
        own = float(np.median(self.variance / (np.square(self.amplitude) + _TINY)))
        return beyond * own if beyond > chance else 0.0


def fitted(light: Light, noise: Noise, table: Table, start: F64) -> Fit:
    """Pixels that are one row of frames (N, 1, K), around their places start (K,), all within the table."""
    book = table.book
    size, last = book.samples, book.words.shape[1] - 2
    per, reach = table.per, book.reach * table.per // PER_PX
    middle = book.first + (last + 1) / (2 * per)
    stripe = np.abs(start[:, None] - middle).argmin(axis=1)
    raw = light.raw[
        book.index[book.begin[stripe][:, None] + np.arange(size)], 0, np.arange(len(start))[:, None]
    ]
    whole = (raw < light.clip).all(axis=1)
    stripe, start, levels = stripe[whole], start[whole], light.linear(raw[whole]).astype(np.float64)
    at = np.rint((start - book.first[stripe]) * per).astype(np.int64)
    q = np.clip(at[:, None] + np.arange(-reach, reach + 1), 0, last)
    block = book.block[stripe][:, None]
    mean = levels.mean(axis=1, keepdims=True)
    y = levels - mean
    words = book.words[..., :size]
    near, far = ((words[block, one] @ y[:, :, None].astype(np.float32))[..., 0] for one in (q, q + 1))
    rise, (zz, zd, dd) = far - near, np.moveaxis(book.angles[block, q, :3], 2, 0).astype(np.float64)
    scale, along = near * dd - rise * zd, rise * zz - near * zd
    part = np.clip(
        np.where(scale > 0, along / np.where(scale > 0, scale, 1), np.where(along > 0, 1, 0)), 0, 1
    )
    length = np.maximum(zz + part * (2 * zd + part * dd), _TINY)
    told = np.maximum(near + part * rise, 0)
    variance = noise.variance(mean)
    rss = np.square(y).sum(axis=1, keepdims=True) - told**2 / length
    turn = np.maximum(zz * dd - zd**2, 0) / length
    k, best = np.arange(len(y)), rss.argmin(axis=1)
    one, f, a = q[k, best], part[k, best][:, None], (told / length)[k, best][:, None]
    block, place = block[:, 0], book.first[stripe] + (one + f[:, 0]) / per
    step = words[block, one + 1].astype(np.float64) - words[block, one]
    shown = words[block, one] + f * step
    left = _left(shown, step)
    residual = np.where(left > 1 / size, (y - a * shown) / np.sqrt(np.maximum(left, 1 / size)), 0)
    return Fit(
        np.maximum(rss, 0) / variance,
        np.square(told / length) * turn / variance,
        np.asarray(place, np.float64),
        np.asarray(mean + a * shown, np.float64),
        np.asarray(residual, np.float64),
        0.5 * a[:, 0],
        variance[:, 0],
        table.freedom,
    )


def _left(shown: F64, step: F64) -> F64:
    """Share (K, n) of a sample's own deviation that offset, scale and place do not take up."""
    scale, step = (part - part.mean(axis=1, keepdims=True) for part in (shown, step))
    scale /= np.sqrt(np.square(scale).sum(axis=1, keepdims=True)) + _TINY
    step -= (step * scale).sum(axis=1, keepdims=True) * scale
    step /= np.sqrt(np.square(step).sum(axis=1, keepdims=True)) + _TINY
    return np.asarray(1 - 1 / shown.shape[1] - scale**2 - step**2)


def likeliest(
    tried: Callable[[Pixel, int], Fit], most: float, cell: float, sweep: bool, measure: bool
) -> tuple[Pixel, float]:
    """The likeliest pixel of a spread up to `most` (px), and the relative error of the way to a cell's edge.

    That error is two deviations of the places between pixels that are nearly as likely. sweep: an ideal
    surface may be it, cells and footprint hardly matter.
    """
    log = math.log(_STEP)
    start = [(k, _usual_share(_FIRST * math.exp(log * k))) for k in range(0, _LAST, _COARSE)]
    start = [one for one in start if _FIRST * math.exp(log * one[0]) <= max(most, _FIRST)]
    fits = [tried(_pixel(*one), FINE) for one in start]
    least = np.min([fit.misfit for fit in fits], axis=0)
    kept = least <= _OUTLYING * np.median(least)
    found = {
        one: (fit.likelihood(kept, not sweep, measure), fit.place)
        for one, fit in zip(start, fits, strict=True)
    }
    best = max(found, key=lambda one: found[one][0])
    if sweep and tried((0.0, 0.0), FINE).likelihood(kept, not sweep, measure) > found[best][0]:
        return (0.0, 0.0), 0.0

    def height(one: tuple[int, int]) -> float:
        if one not in found:
            fit = tried(_pixel(*one), FINE)
            found[one] = fit.likelihood(kept, not sweep, measure), fit.place
        return found[one][0]

    def climbed(one: tuple[int, int], steps: tuple[int, ...]) -> tuple[int, int]:
        """The likeliest spread of a share."""
        k, j = one
        for step in steps:
            before = None
            while before != k:
                before, k = k, max((k, k - step, k + step), key=lambda at: height((at, j)))
        return k, j

    # the likeliest spread of a share is near that of the next one
    best = climbed(best, (20, 5, 1))
    for turn in (0,) if sweep else (4, 2, 1, 1):
        beside = [
            climbed((best[0], best[1] + d), (5, 1)) for d in (-turn, turn) if 0 <= best[1] + d <= _SHARES
        ]
        best = max((best, *beside), key=height)
    if sweep:
        return _pixel(*best), 0.0
    top, place = found[best]
    way = (place + 0.5) / cell - np.rint((place + 0.5) / cell)
    usual = cell * math.sqrt(float(np.mean(np.square(way[kept])))) + _TINY
    # two deviations, as all pixels share this error
    moved = [
        2 * math.sqrt(float(np.mean(np.square(other - place)[kept])) / max(2 * (top - own), 1.0))
        for own, other in found.values()
        if top - own < _NEARLY
    ]
    # and what the decoder's fewer codewords make of it
    chord = tried(_pixel(*best), PER_PX).place - place
    moved.append(math.sqrt(float(np.mean(np.square(chord)[kept]))))
    # pixels in step with the cells are not everywhere: z = mean exp(2 pi i u / cell) beyond chance, which an
    # error e of the way to the edge moves by e, without blur
    crowd = abs(complex(np.mean(np.exp(2j * np.pi * way[kept])))) - 3 / math.sqrt(np.count_nonzero(kept))
    return _pixel(*best), min(max(*moved, crowd * usual) / usual, 1.0)


def _usual_share(spread: float) -> int:
    """Share of the footprint in the squared spread: all of it up to a cell."""
    return round(_SHARES * min(1.0, 1 / (12 * spread**2)))


def _pixel(k: int, j: int) -> Pixel:
    """Footprint and blur of the spread k, of whose square j / _SHARES are the footprint's."""
    spread = _FIRST * _STEP**k
    return max(spread * math.sqrt(12 * j / _SHARES), 0.05), spread * math.sqrt(1 - j / _SHARES)
