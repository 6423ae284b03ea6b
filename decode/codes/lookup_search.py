"""Compiled: a pixel's samples against codewords, v = o + a t(u), t a polyline through codewords at close
places.

Codewords are stored without their mean, which removes the offset o: y = v - mean(v) is compared with z(f) =
z_q + f d_q, d_q = z_(q+1) - z_q, and the scale a and the place f of the best fit solve a 2 x 2 system.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import Real, exact, inlined, kernel

__all__ = [
    "AROUND",
    "COARSE",
    "LANES",
    "PER_PX",
    "RIVALS",
    "SURE",
    "Book",
    "Bounds",
    "Search",
    "answer_of",
    "fitted",
    "lead_of",
    "target_of",
    "used_products",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
#: Squared residuals of a fit, and lead over other places, over the noise's variance.
Bounds = tuple[np.float32, np.float32]
#: Segment, place on it, scale and squared residuals of a walk; mean, squared sum, number of unsaturated
#: samples and of all of a pixel.
_Walk = tuple[int, np.float32, np.float32, np.float32]
_Sums = tuple[np.float32, np.float32, int, int]
_ZERO, _ONE = np.float32(0), np.float32(1)
#: Codewords per pattern pixel, and samples per vector instruction: codewords are filled up to a multiple.
PER_PX, LANES = 8, 8
#: Codewords per pattern pixel of the search over the whole surface.
COARSE = 2
#: Steps of a walk, each at most a pixel long; places per search.
_STEPS, _ANSWERS = 16, 12
#: Number of similar codewords listed for each codeword.
RIVALS = _ANSWERS
#: Distance of two further starts of a walk from the neighbour's place, codewords: off the tread of a sharp
#: cell.
_BESIDE = 5
#: -log of the probability of another place below which the search is skipped.
SURE = 12.0
#: Cells around a place that may fit as well: half a cell beyond its cell.
AROUND = 1.5


class Book(NamedTuple):
    """Codewords of B blocks.

    frames   (K, n, S) of each stripe or spot of a sweep (one of all others): n samples, each the mean of S
    block, first  (K,) its block, and the coordinate of codeword 0
    words    (B, Q, n filled up) z
    angles   (B, Q, 6) |z|^2, z.d, |d|^2, mean, least sin^2 of the next angles where they differ, else 1, and
             height above the mean of the samples that change (weighted by their squares)
    reach    codewords around a place that may fit as well
    swept    (K,) frames of the stripes or spots; across: how many lie side by side along the other axis
    """

    frames: I64
    block: I64
    first: F64
    words: F32
    angles: F32
    reach: int
    freedom: int
    swept: I64
    across: int


class Search(NamedTuple):
    """Of the surface: coarse (M, P) unit codewords; rivals (P, RIVALS), the most similar ones elsewhere, in
    descending order; apart (RIVALS + 1, P, 2), sine and cosine of the angles to them and to the next one."""

    coarse: F32
    rivals: I64
    apart: F32


@kernel
def used_products(
    used: F32, z: F32, b: int, q: int
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """|z|^2, z.d, |d|^2 over the samples in use, less their means; means of z and d."""
    count, mean, step = np.float32(1e-6), np.float32(0), np.float32(0)
    zz, zd, dd = np.float32(0), np.float32(0), np.float32(0)
    for i in range(z.shape[2]):
        w, d = used[i], z[b, q + 1, i] - z[b, q, i]
        count, mean, step = count + w, mean + w * z[b, q, i], step + w * d
        zz, zd, dd = zz + w * z[b, q, i] * z[b, q, i], zd + w * z[b, q, i] * d, dd + w * d * d
    mean, step = mean / count, step / count
    return zz - count * mean * mean, zd - count * mean * step, dd - count * step * step, mean, step


@inlined
def fitted(
    near: np.float32, rise: np.float32, zz: np.float32, zd: np.float32, dd: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Of y = a (z + f d): f and its numerator, and scale and squared length of the best fit within 0..1."""
    a, af = near * dd - rise * zd, rise * zz - near * zd
    f = af / a if a > _ZERO else (np.float32(99) if af > _ZERO else np.float32(-99))
    f = f if zz * dd - zd * zd > np.float32(1e-9) * zz * zz else _ZERO
    inside = min(max(f, _ZERO), _ONE)
    along = near + inside * rise
    scale = along / max(zz + inside * (zd + zd + inside * dd), np.float32(1e-12))
    return f, inside, scale, along * scale


@inlined
def target_of(q: int, f: np.float32, last: int) -> int:
    """The segment of a fit, limited to a step of one pixel."""
    away = min(max(np.floor(f), np.float32(-PER_PX)), np.float32(PER_PX))
    return min(max(q + int(away), 0), last)


@inlined
def lead_of(rss: Real, power: Real, s: np.float32, c: np.float32) -> Real:
    """Lower bound on the excess of another codeword's squared residuals, halved; s, c: sine and cosine of its
    angle to the result.

    With t the angle between samples and the result, the angle to another codeword is at least apart - t, and
    its squared residuals are larger by power sin(apart) sin(apart - 2 t).
    """
    rss = min(rss, power)
    half: Real = np.sqrt(rss * (power - rss))
    return np.float32(0.5) * s * (s * (power - rss - rss) - c * (half + half))


@kernel
def _walk(
    y: F32, k: int, used: F32, whole: bool, power: np.float32, z: F32, angles: F32, b: int, start: int
) -> _Walk:
    """Descend from codeword `start`: (q, f, a, squared residuals) of the best place on segments q..q+1, over
    the samples in use (whole: all); y is 0 for the others."""
    last = z.shape[1] - 2
    q, before, steps = min(max(start, 0), last), -1, 0
    best_q, best_f, best_a, best = q, _ZERO, _ZERO, power
    while steps < _STEPS:
        near, rise = _ZERO, _ZERO
        for i in range(y.shape[1]):
            near += y[k, i] * z[b, q, i]
            rise += y[k, i] * (z[b, q + 1, i] - z[b, q, i])
        zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
        if not whole:
            zz, zd, dd, _, _ = used_products(used, z, b, q)
        f, inside, scale, explained = fitted(near, rise, zz, zd, dd)
        if scale > _ZERO and power - explained < best:
            best_q, best_f, best_a, best = q, inside, scale, power - explained
        target = target_of(q, f, last)
        steps = _STEPS if f == inside or target in (q, before) else steps + 1
        before, q = q, target
    return best_q, best_f, best_a, max(best, _ZERO)


@kernel
def _scores(y: F32, k: int, used: F32, whole: bool, coarse: F32, score: F32) -> None:
    """Correlation of samples with all codewords (M, P) of unit length, over the samples in use."""
    score[:] = np.float32(0)
    for m in range(coarse.shape[0]):
        v = y[k, m]
        for p in range(score.size):
            score[p] += v * coarse[m, p]
    if not whole:
        total, square = np.zeros(score.size, np.float32), np.zeros(score.size, np.float32)
        count = np.float32(1e-6)
        for m in range(coarse.shape[0]):
            count += used[m]
            for p in range(score.size):
                total[p] += used[m] * coarse[m, p]
                square[p] += used[m] * coarse[m, p] * coarse[m, p]
        for p in range(score.size):
            score[p] /= np.sqrt(max(square[p] - total[p] * total[p] / count, np.float32(1e-2)))


@exact
def _highest(score: F32, place: I64, value: F64) -> None:
    """The highest local maxima of a score, descending."""
    value[:] = 0.0
    place[:] = -1
    last = value.size - 1
    for p in range(score.size):
        own = score[p]
        if own > value[last]:
            left = score[p - 1] if p > 0 else np.float32(-1e30)
            right = score[p + 1] if p + 1 < score.size else np.float32(-1e30)
            if own >= left and own > right:
                k = last
                while k > 0 and value[k - 1] < own:
                    value[k], place[k] = value[k - 1], place[k - 1]
                    k -= 1
                value[k], place[k] = own, p


@exact
def _compared(
    y: F32, k: int, used: F32, sums: _Sums, book: Book, places: I64, noise: Real, first: _Walk
) -> tuple[_Walk, np.float32]:
    """Best of a first result and the results from coarse codewords at other places: (walk's result,
    probability of another place)."""
    left, found = np.empty(_ANSWERS + 1), np.empty(_ANSWERS + 1)
    whole, per, count = sums[2] == sums[3], PER_PX // COARSE, 1 + places.size
    fit = first
    left[0], found[0] = first[3], first[0] + first[1]
    for j in range(1, count):
        one = _walk(y, k, used, whole, sums[1], book.words, book.angles, 0, places[j - 1] * per + per // 2)
        fit = one if one[3] < fit[3] else fit
        left[j], found[j] = one[3], one[0] + one[1]
    own = max(sums[2] - 3.0, 1.0)
    noise *= max(fit[3] / (own * noise) - 2 * np.sqrt(2.0 / own), 1.0)
    total = 0.0
    for i in range(count):
        again = abs(found[i] - fit[0] - fit[1]) <= 2 * book.reach
        for j in range(i):  # two maxima may lead to the same place
            again |= abs(found[i] - found[j]) < PER_PX
        if not again:
            total += np.exp(-0.5 * max(left[i] - fit[3], 0.0) / noise)
    return fit, np.float32(total / (1 + total))


@exact
def _likely(
    y: F32, pixel: int, used: F32, whole: bool, coarse: F32, score: F32, place: I64, value: F64
) -> int:
    """Number of candidate places over the whole surface; they are the first of `place`."""
    _scores(y, pixel, used, whole, coarse, score)
    _highest(score, place, value)
    count = 0
    # codewords are half a step from the best place at most, which costs less than half the score
    while count < place.size and place[count] >= 0 and value[count] >= 0.5 * value[0]:
        count += 1
    return count


@exact
def _rivals(fit: _Walk, sums: _Sums, apart: F32, lead: Real) -> int:
    """Number of codewords similar to a result that may fit as well, within a margin `lead`; -1: more than the
    list holds."""
    power, count, n = sums[1:]
    q = fit[0] // (PER_PX // COARSE)
    for k in range(apart.shape[0]):
        # the distance shrinks with the omitted samples
        if lead_of(fit[3], power, apart[k, q, 0], apart[k, q, 1]) * (2 * count - n) > lead * n:
            return k
    return -1


@exact
def answer_of(
    y: F32,
    k: int,
    used: F32,
    sums: _Sums,
    book: Book,
    search: Search,
    b: int,
    guess: int,
    bounds: Bounds,
    noise: Real,
) -> tuple[_Walk, np.float32]:
    """(walk's result, probability of another place) of a pixel: from a guess (-1: none), or by a search over
    the surface, if allowed, unless the result fits and is better than all similar ones."""
    words, angles, (coarse, rivals, apart) = book.words, book.angles, search
    whole, power, searched = sums[2] == sums[3], sums[1], apart.shape[1] > 0
    (limit, lead), sure = bounds, not searched
    fit, error = (0, _ZERO, _ZERO, power), _ZERO
    if guess >= 0:
        fit = _walk(y, k, used, whole, power, words, angles, b, guess)
        for side in (-_BESIDE, _BESIDE):
            if fit[3] > limit * noise:
                one = _walk(y, k, used, whole, power, words, angles, b, guess + side)
                fit = one if one[3] < fit[3] else fit
        if searched and fit[3] < limit * noise:
            some = _rivals(fit, sums, apart, lead * noise)
            sure = some == 0
            if some > 0:
                before, similar = fit[0], rivals[fit[0] // (PER_PX // COARSE), :some]
                fit, error = _compared(y, k, used, sums, book, similar, noise, fit)
                sure = abs(fit[0] - before) <= 2 * book.reach
    if not sure:
        score, place = np.empty(coarse.shape[1], np.float32), np.empty(_ANSWERS, np.int64)
        some = _likely(y, k, used, whole, coarse, score, place, np.empty(_ANSWERS))
        fit, error = _compared(y, k, used, sums, book, place[:some], noise, fit)
    return fit, error
