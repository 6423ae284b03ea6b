"""Compiled: samples of a pixel against codewords, v = o + a t(u), t a polyline through codewords at close
places.

t(f) = z_q + f (z_(q+1) - z_q). A descent by unweighted squares finds the segment, from the place before or
from a search over the surface; squares weighted by the noise of each level give place, variance and chi2.
"""

from typing import NamedTuple

import numpy as np

from optolever.kernels import F32, F64, I64, exact, inlined, kernel

__all__ = ["COARSE", "PER_PX", "RIVALS", "Book", "match", "similar"]

#: Segment, place on it, squared residuals, scale and level of a descent.
_Walk = tuple[int, float, float, float, float]
#: Squared sum, number of unsaturated samples and of all of a pixel.
_Sums = tuple[float, int, int]
#: Codewords per pattern pixel, those of the search over the surface.
PER_PX, COARSE = 8, 2
#: Places per search, and similar codewords listed for each.
RIVALS = 12
#: Steps of the posterior to either side, over one cell; its relative value at which the tail ends.
_SIDE, _UNLIKELY = 8, 1e-4


class Book(NamedTuple):
    """Codewords of B blocks.

    words    (B, Q, n) z
    coarse   (n, P) unit codewords of the search over the surface; P = 0: no search
    rivals   (P, RIVALS) the most similar ones elsewhere, descending; apart (P, RIVALS, 2): sine and
             cosine of the angles to them
    reach    codewords around a place that are the same place; cell: codewords of a cell
    """

    words: F32
    coarse: F32
    rivals: I64
    apart: F32
    reach: int
    cell: int


@kernel
def _walk(v: F32, weight: F64, z: F32, b: int, start: int, most: int = 16) -> _Walk:
    """Descend from codeword `start` to the best place of z, at most a pixel a step; v is 0 where its weight
    is."""
    last = z.shape[1] - 2
    q, before, steps = min(max(start, 0), last), -1, 0
    total, ev, power = 1e-30, 0.0, 0.0
    for i in range(v.size):
        total, ev = total + weight[i], ev + weight[i] * v[i]
    ev /= total
    for i in range(v.size):
        power += weight[i] * (v[i] - ev) * (v[i] - ev)
    best_q, best_f, best, best_a, best_c = q, 0.0, power, 0.0, ev
    while steps < most:
        ez, ed = 0.0, 0.0
        for i in range(v.size):
            ez, ed = ez + weight[i] * z[b, q, i], ed + weight[i] * (z[b, q + 1, i] - z[b, q, i])
        ez, ed = ez / total, ed / total
        zz, zd, dd, vz, vd = 1e-12, 0.0, 0.0, 0.0, 0.0
        for i in range(v.size):
            one, step, y = z[b, q, i] - ez, z[b, q + 1, i] - z[b, q, i] - ed, v[i] - ev
            zz, zd, dd = zz + weight[i] * one * one, zd + weight[i] * one * step, dd + weight[i] * step * step
            vz, vd = vz + weight[i] * one * y, vd + weight[i] * step * y
        a, af = vz * dd - vd * zd, vd * zz - vz * zd
        f = af / a if a > 0.0 else (99.0 if af > 0.0 else -99.0)
        f = f if zz * dd - zd * zd > 1e-9 * zz * zz else 0.0
        inside = min(max(f, 0.0), 1.0)
        along, square = vz + inside * vd, zz + inside * (zd + zd + inside * dd)
        left = power - along * along / square
        if along > 0.0 and left < best:
            best_q, best_f, best, best_a = q, inside, left, along / square
            best_c = ev - best_a * (ez + inside * ed)
        target = min(max(q + int(min(max(np.floor(f), -PER_PX), PER_PX)), 0), last)
        steps = most if f == inside or target in (q, before) else steps + 1
        before, q = q, target
    return best_q, best_f, max(best, 0.0), best_a, best_c


@kernel
def _scores(y: F32, used: F64, whole: bool, coarse: F32, score: F32) -> None:
    """Correlation of samples with all codewords (n, P) of unit length, over the samples in use."""
    for p in range(score.size):
        score[p] = np.float32(0)
    for m in range(coarse.shape[0]):
        for p in range(score.size):
            score[p] += y[m] * coarse[m, p]
    if not whole:
        total, square = np.zeros(score.size, np.float32), np.zeros(score.size, np.float32)
        count = np.float32(1e-6)
        for m in range(coarse.shape[0]):
            w = np.float32(used[m])
            count += w
            for p in range(score.size):
                total[p] += w * coarse[m, p]
                square[p] += w * coarse[m, p] * coarse[m, p]
        for p in range(score.size):
            score[p] /= np.sqrt(max(square[p] - total[p] * total[p] / count, np.float32(1e-2)))


@exact
def _highest(score: F32, own: int, guard: int, place: I64, value: F64) -> int:
    """The highest local maxima of a score, descending, but those beside `own`, and how many are half as high
    as the first.

    Codewords are half a step from the best place at most, which costs less than half the score.
    """
    last = value.size - 1
    for k in range(value.size):
        value[k], place[k] = 0.0, -1
    for p in range(score.size):
        one = score[p]
        if (
            one > value[last]
            and abs(p - own) > guard
            and (p == 0 or one >= score[p - 1])
            and (p + 1 == score.size or one > score[p + 1])
        ):
            k = last
            while k > 0 and value[k - 1] < one:
                value[k], place[k] = value[k - 1], place[k - 1]
                k -= 1
            value[k], place[k] = one, p
    count = 0
    while count < value.size and place[count] >= 0 and value[count] >= 0.5 * value[0]:
        count += 1
    return count


@exact
def similar(coarse: F32, guard: int, place: I64, cosine: F64) -> None:
    """Of each codeword (n, P) the most similar ones elsewhere, (P, RIVALS), descending; -1: no more."""
    word, score = np.empty(coarse.shape[0], np.float32), np.empty(coarse.shape[1], np.float32)
    used = np.ones(word.size)
    for p in range(score.size):
        for m in range(word.size):
            word[m] = coarse[m, p]
        _scores(word, used, True, coarse, score)
        _highest(score, p, guard, place[p], cosine[p])


@exact
def _compared(
    v: F32, used: F64, count: int, book: Book, places: I64, noise: float, first: _Walk
) -> tuple[_Walk, float]:
    """Best of a first result and of those from coarse codewords at other places; probability of another
    one."""
    left, found = np.empty(places.size + 1), np.empty(places.size + 1)
    per, fit = PER_PX // COARSE, first
    left[0], found[0] = first[2], first[0] + first[1]
    for j in range(places.size):
        one = _walk(v, used, book.words, 0, places[j] * per + per // 2)
        fit = one if one[2] < fit[2] else fit
        left[j + 1], found[j + 1] = one[2], one[0] + one[1]
    own = max(count - 3.0, 1.0)
    noise *= max(fit[2] / (own * noise) - 2 * np.sqrt(2.0 / own), 1.0)
    total = 0.0
    for i in range(left.size):
        again = abs(found[i] - fit[0] - fit[1]) <= 2 * book.reach
        for j in range(i):  # two maxima may lead to the same place
            again |= abs(found[i] - found[j]) < PER_PX
        if not again:
            total += np.exp(-0.5 * max(left[i] - fit[2], 0.0) / noise)
    return fit, total / (1 + total)


@exact
def _rivals(fit: _Walk, sums: _Sums, apart: F32, noise: float) -> int:
    """Number of codewords similar to a result that may fit as well; -1: more than the list holds.

    With t the angle between samples and the result, the angle to another codeword is at least apart - t, and
    its squared residuals are larger by power sin(apart) sin(apart - 2 t). It shrinks with omitted samples.
    """
    power, count, n = sums
    lead = (12.0 + np.log(apart.shape[0] + 1.0)) * noise * n  # a probability of exp(-12) elsewhere
    q = min(fit[0] // (PER_PX // COARSE), apart.shape[0] - 1)
    rss = min(fit[2], power)
    half = 2 * np.sqrt(rss * (power - rss))
    for k in range(RIVALS):
        s, c = apart[q, k, 0], apart[q, k, 1]
        if 0.5 * s * (s * (power - rss - rss) - c * half) * (2 * count - n) > lead:
            return k
    return -1


@exact
def _searched(
    v: F32, y: F32, used: F64, sums: _Sums, book: Book, guess: int, limit: float, noise: float
) -> tuple[_Walk, float]:
    """(descent's result, probability of another place): from a guess (-1: none) if it fits and is better than
    all similar ones, else by a search over the surface."""
    fit, error, sure = (0, 0.0, sums[0], 0.0, 0.0), 0.0, book.coarse.shape[1] == 0
    if guess >= 0:
        fit = _walk(v, used, book.words, 0, guess)
        some = _rivals(fit, sums, book.apart, noise) if fit[2] < limit * noise else -1
        sure = some == 0
        if some > 0:
            before = fit[0]
            places = book.rivals[min(before // (PER_PX // COARSE), book.rivals.shape[0] - 1), :some]
            fit, error = _compared(v, used, sums[1], book, places, noise, fit)
            sure = abs(fit[0] - before) <= 2 * book.reach
    if not sure:
        score, place = np.empty(book.coarse.shape[1], np.float32), np.empty(RIVALS, np.int64)
        _scores(y, used, sums[1] == sums[2], book.coarse, score)
        some = _highest(score, -1, 0, place, np.empty(RIVALS))
        fit, error = _compared(v, used, sums[1], book, place[:some], noise, fit)
    return fit, error


@kernel
def _fitted(v: F32, weight: F64, z: F32, b: int, q: int, f: float) -> tuple[float, float]:
    """Weighted squared residuals of the best scale and level at a place; squares that its change by a
    codeword adds at scale 1."""
    total, ev, ez, ed = 1e-30, 0.0, 0.0, 0.0
    for i in range(v.size):
        step = z[b, q + 1, i] - z[b, q, i]
        total, ev = total + weight[i], ev + weight[i] * v[i]
        ez, ed = ez + weight[i] * (z[b, q, i] + f * step), ed + weight[i] * step
    ev, ez, ed = ev / total, ez / total, ed / total
    vv, zz, zd, dd, vz = 0.0, 1e-12, 0.0, 0.0, 0.0
    for i in range(v.size):
        step = z[b, q + 1, i] - z[b, q, i] - ed
        one, y = z[b, q, i] + f * (step + ed) - ez, v[i] - ev
        zz, zd, dd = zz + weight[i] * one * one, zd + weight[i] * one * step, dd + weight[i] * step * step
        vv, vz = vv + weight[i] * y * y, vz + weight[i] * one * y
    scale = max(vz, 0.0) / zz
    return vv - scale * scale * zz, max(dd - zd * zd / zz, 0.0)


@exact
def _placed(
    v: F32,
    used: F64,
    count: int,
    book: Book,
    b: int,
    fit: _Walk,
    noise: tuple[float, float, float],
    weight: F64,
) -> tuple[float, float, float, float, float]:
    """Place (codewords), its variance, scale, offset and chi2 over its freedom.

    The variance is the larger one of that of the posterior over a cell to either side, which holds the treads
    of sharp cells, and of the inverse Fisher information, which is none there: at most the posterior's width.
    """
    z, (read2, gain, misfit2) = book.words, noise
    q, f, _, a, c = fit
    for _ in range(2):
        for i in range(v.size):
            level = c + a * (z[b, q, i] + f * (z[b, q + 1, i] - z[b, q, i]))
            weight[i] = used[i] / (read2 + gain * max(level, 0.0) + misfit2 * a * a)
        q, f, _, a, c = _walk(v, weight, z, b, q, 2)
    least, rise = _fitted(v, weight, z, b, q, f)
    own = max(count - 3.0, 1.0)
    excess = max(least / own - 2 * np.sqrt(2 / own), 1.0)
    total, moment, width, step = 1.0, 0.0, 0.0, max(book.cell // _SIDE, 1)
    for side in (-step, step):
        likely, k = 1.0, 0
        while likely >= _UNLIKELY and k < _SIDE and 0 <= q + (k + 1) * side <= z.shape[1] - 2:
            k += 1
            more = _fitted(v, weight, z, b, q + k * side, f)[0]
            likely = np.exp(-0.5 * max(more - least, 0.0) / excess)
            total, moment = total + likely, moment + likely * (k * step) ** 2
        width += k * step if likely < _UNLIKELY else np.inf
    fisher = min(excess / max(a * a * rise, 1e-12), width * width / 12)
    variance = max(fisher, moment / total)
    return q + f, variance, a, c, least / own


@inlined
def _guess(place: float, slope: float) -> int:
    return int(max(place + slope, 0.0)) if place == place else -1


@exact
def match(
    samples: F32,
    block: I64,
    start: I64,
    cols: int,
    book: Book,
    noise: tuple[float, float, float],
    limit: float,
    out: F64,
) -> None:
    """Match pixels (K, n), NaN where saturated, of rows of `cols`; into out (K, 6): place in codewords (NaN:
    no pattern), its variance, scale, offset, chi2 over freedom, probability of another place.

    block, start  (K,) block of the codewords, and first codeword; -1: from the places of the neighbours
                  before
    noise         read2, gain, and misfit over the squared scale; limit: squared residuals that noise reaches
                  rarely
    """
    n = samples.shape[1]
    y, v, used, weight = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n), np.zeros(n)
    for p in range(len(samples)):
        mean, count, power = 0.0, 0, 0.0
        for i in range(n):
            used[i] = 1.0 if np.isfinite(samples[p, i]) else 0.0
            v[i] = samples[p, i] if used[i] > 0 else np.float32(0)
            mean, count = mean + v[i], count + int(used[i])
        mean /= max(count, 1)
        for i in range(n):
            y[i] = np.float32(used[i] * (v[i] - mean))
            power += y[i] * y[i]
        usual = noise[0] + noise[1] * max(mean, 0.0)
        row = out[p]
        row[0], row[1], row[4], row[5] = np.nan, np.inf, 0.0, 1.0
        row[2] = 2 * np.sqrt(power / max(count, 1))
        row[3] = mean - 0.5 * row[2]
        if count <= 3 or power < (count - 1 + 5 * np.sqrt(2.0 * count)) * usual:
            continue
        usual += noise[2] * power / n
        if start[p] >= 0:
            fit, error = _walk(v, used, book.words, block[p], start[p]), 0.0
        else:
            guess = -1
            if p % cols > 0 and out[p - 1, 0] == out[p - 1, 0]:
                slope = out[p - 1, 0] - out[p - 2, 0] if p % cols > 1 else 0.0
                guess = _guess(out[p - 1, 0], slope if abs(slope) < 4 * PER_PX else 0.0)
            elif p >= cols:
                guess = _guess(out[p - cols, 0], 0.0)
            fit, error = _searched(v, y, used, (power, count, n), book, guess, limit, usual)
        if power - fit[2] > 18.0 * usual:  # noise exceeds it once in 1e4
            found = _placed(v, used, count, book, block[p], fit, noise, weight)
            row[0], row[1], row[2], row[3], row[4] = found[0], found[1], found[2], found[3], found[4]
            row[5] = error
