"""Compiled: a pixel's samples against codewords, v = o + a t(u), t a polyline through codewords at close
places.

Codewords are stored without their mean, so that the offset o drops out: y = v - mean(v) is compared with
z(f) = z_q + f d_q, d_q = z_(q+1) - z_q, and the scale a and the place f of the best fit are a 2 x 2 system.
"""

from typing import Any, NamedTuple

import numpy as np

from optolever.kernels import exact, kernel

from .estimate import less_likely
from .lookup_light import BATCH, SATURATED, beside, brightest, gather

__all__ = [
    "AROUND",
    "COARSE",
    "LANES",
    "PER_PX",
    "RIVALS",
    "SEARCH",
    "SWEEP",
    "WITHIN",
    "Book",
    "Camera",
    "Search",
    "match_rows",
]

_ONE = np.float32(1)
#: Codewords per pattern pixel, and samples per vector instruction: codewords are filled up to a multiple.
PER_PX, LANES = 8, 8
#: Codewords per pattern pixel of the search over the whole surface.
COARSE = 2
#: Where a pixel's search starts.
SEARCH, SWEEP, WITHIN = 0, 1, 2
#: Steps of a walk, each at most a pixel long; places that a search compares.
_STEPS, _ANSWERS = 16, 12
#: Similar codewords that are listed of each.
RIVALS = _ANSWERS
#: Codewords beside the neighbour's place from which a walk starts, too: off the tread of a sharp cell.
_BESIDE = 5
#: Share of a stripe's light that another place has to show to be another answer, whatever the noise.
_RIVAL = 0.6
#: -log of the probability of another answer below which a search may be left out.
_SURE = 16.0
#: Cells around an answer that may be as good: half a cell beyond its own.
AROUND = 1.5
#: Explained power over the noise below which there is no pattern: chance reaches it once in 1e4 (2 freedoms).
_NOTHING = 18.0


class Camera(NamedTuple):
    """raw (N, H, W), level of each raw value (empty: linear), white level, variance = read2 + gain level +
    misfit2 amplitude^2."""

    raw: Any
    table: Any
    clip: Any
    read2: Any
    gain: Any
    misfit2: Any


class Book(NamedTuple):
    """Codewords of B blocks.

    frames   (K, n, S) of each stripe or spot of a sweep (one of all others): n samples, each the mean of S
    block, first  (K,) its block, and the coordinate of codeword 0
    words    (B, Q, n filled up) z
    angles   (B, Q, 6) |z|^2, z.d, |d|^2, mean, least sin^2 of the next angles where they differ, else 1, and
             how far the level of the samples that change (by their squares) is above the mean
    reach    codewords around an answer that may be as good
    index    (K,) frames of the stripes or spots; across: how many lie side by side along the other axis
    """

    frames: Any
    block: Any
    first: Any
    words: Any
    angles: Any
    reach: Any
    freedom: Any
    index: Any
    across: Any


class Search(NamedTuple):
    """Of the whole surface: coarse (M, P) unit codewords; of each the most similar ones elsewhere, rivals
    (P, RIVALS), descending, and sine and cosine of the angles to them and to the next one, apart
    (P, RIVALS + 1, 2)."""

    coarse: Any
    rivals: Any
    apart: Any


@kernel
def _products(y: Any, k: Any, z: Any, b: Any, q: Any) -> Any:
    """y.z and y.d of pixel k and segment q of block b."""
    near, rise = np.float32(0), np.float32(0)
    for i in range(y.shape[1]):
        near += y[k, i] * z[b, q, i]
        rise += y[k, i] * (z[b, q + 1, i] - z[b, q, i])
    return near, rise


@kernel
def _of_used(used: Any, z: Any, b: Any, q: Any) -> Any:
    """|z|^2, z.d, |d|^2 over the samples that are used, less their means; means of z and d."""
    count, mean, step = np.float32(1e-6), np.float32(0), np.float32(0)
    zz, zd, dd = np.float32(0), np.float32(0), np.float32(0)
    for i in range(z.shape[2]):
        w, d = used[i], z[b, q + 1, i] - z[b, q, i]
        count, mean, step = count + w, mean + w * z[b, q, i], step + w * d
        zz, zd, dd = zz + w * z[b, q, i] * z[b, q, i], zd + w * z[b, q, i] * d, dd + w * d * d
    mean, step = mean / count, step / count
    return zz - count * mean * mean, zd - count * mean * step, dd - count * step * step, mean, step


@kernel
def _walk(y: Any, k: Any, used: Any, whole: Any, power: Any, z: Any, angles: Any, b: Any, start: Any) -> Any:
    """From codeword `start` downhill: (q, f, a, squared residuals) of the best place on segments q..q+1, over
    the samples that are used (whole: all are); y is 0 elsewhere."""
    last = z.shape[1] - 2
    q, before, steps = min(max(start, 0), last), -1, 0
    best_q, best_f, best_a, best = q, 0.0, 0.0, power
    while steps < _STEPS:
        near, rise = _products(y, k, z, b, q)
        zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
        if not whole:
            zz, zd, dd, _, _ = _of_used(used, z, b, q)
        a, af = near * dd - rise * zd, rise * zz - near * zd
        f = 0.0
        if zz * dd - zd * zd > 1e-9 * zz * zz:
            f = af / a if a > 0 else (99.0 if af > 0 else -99.0)
        inside = min(max(f, 0.0), 1.0)
        length = max(zz + inside * (2 * zd + inside * dd), 1e-12)
        along = near + inside * rise
        rss = power - along * along / length
        if along > 0 and rss < best:
            best_q, best_f, best_a, best = q, inside, along / length, rss
        target = min(max(q + min(max(int(np.floor(f)), -PER_PX), PER_PX), 0), last)
        steps = _STEPS if f == inside or target in (q, before) else steps + 1
        before, q = q, target
    return best_q, best_f, best_a, max(best, 0.0)


@kernel
def _placed(numbers: Any, fit: Any, sums: Any, seen: Any, angles: Any, b: Any, shape: Any) -> Any:
    """Of a walk's result: (place in codewords, its variance, scale, offset, chi2).

    numbers: read2, gain, misfit2; sums of the pixel: mean, power, samples used, all samples; seen: see
    _of_used; shape: codewords of a cell, freedom. Where codewords differ less on a part of the cell (a tread
    of a sharp display) noise may lead anywhere on it: the variance is that of these, of the whole cell at
    most.
    """
    (q, f, a, rss), (read2, gain, misfit2), (middle, power, count, _) = fit, numbers, sums
    zz, zd, dd, low, step = seen
    mean = angles[b, q, 3] + f * (angles[b, q + 1, 3] - angles[b, q, 3])
    offset = middle - a * (mean + low + f * step)
    # squared change per codeword that no scale or offset makes
    told = (zz * dd - zd * zd) / max(zz + f * (2 * zd + f * dd), 1e-12)
    own = max(count - 3.0, 1.0)
    noise = read2 + gain * max(middle, 0.0) + misfit2 * 0.25 * a * a
    excess = max(rss / (own * noise) - 2 * np.sqrt(2.0 / own), 1.0)
    here = read2 + gain * max(offset + a * (mean + angles[b, q, 5]), 0.0) + misfit2 * 0.25 * a * a
    flat = noise * excess / max(power * angles[b, q, 4], 1e-12)
    variance = max(here * excess / max(a * a * told, 1e-12), min(flat, shape[0] * shape[0] / 12))
    return q + f, variance, a, offset, rss / noise * shape[1] / own


@kernel
def _scores(y: Any, k: Any, used: Any, whole: Any, coarse: Any, score: Any) -> None:
    """Correlation of samples with all codewords (M, P) of unit length; without samples that are not used."""
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
def _highest(score: Any, place: Any, value: Any) -> None:
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
    y: Any,
    pixel: Any,
    used: Any,
    sums: Any,
    z: Any,
    angles: Any,
    reach: Any,
    places: Any,
    noise: Any,
    first: Any,
) -> Any:
    """(walk's result, probability of another answer) of the best of an answer and those at other places,
    coarse codewords; first: the result that there is."""
    left, found = np.empty(_ANSWERS + 1), np.empty(_ANSWERS + 1)
    whole, per, count = sums[2] == sums[3], PER_PX // COARSE, 1 + places.size
    fit = first
    left[0], found[0] = first[3], first[0] + first[1]
    for k in range(1, count):
        one = _walk(y, pixel, used, whole, sums[1], z, angles, 0, places[k - 1] * per + per // 2)
        fit = one if one[3] < fit[3] else fit
        left[k], found[k] = one[3], one[0] + one[1]
    own = max(sums[2] - 3.0, 1.0)
    noise *= max(fit[3] / (own * noise) - 2 * np.sqrt(2.0 / own), 1.0)
    total = 0.0
    for k in range(count):
        again = abs(found[k] - fit[0] - fit[1]) <= 2 * reach
        for j in range(k):  # two maxima may lead to the same place
            again |= abs(found[k] - found[j]) < PER_PX
        if not again:
            total += np.exp(-0.5 * max(left[k] - fit[3], 0.0) / noise)
    return fit, total / (1 + total)


@exact
def _likely(
    y: Any, pixel: Any, used: Any, whole: Any, coarse: Any, score: Any, place: Any, value: Any
) -> Any:
    """How many places of the whole surface may be the answer; they are the first of `place`."""
    _scores(y, pixel, used, whole, coarse, score)
    _highest(score, place, value)
    count = 0
    # codewords are half a step from the best place at most: that costs less than half the score
    while count < place.size and place[count] >= 0 and value[count] >= 0.5 * value[0]:
        count += 1
    return count


@exact
def _rivals(fit: Any, sums: Any, apart: Any, many: Any, noise: Any) -> Any:
    """How many of the codewords that are most similar to an answer may be as good; -1: more than are listed.

    With t the angle between samples and the answer, those to other codewords are apart - t at least, and
    their squared residuals larger by power sin(apart) sin(apart - 2 t). many: log of the number of answers.
    """
    _, power, count, n = sums
    rss, q = min(fit[3], power), fit[0] // (PER_PX // COARSE)
    for k in range(apart.shape[1]):
        s, c = apart[q, k, 0], apart[q, k, 1]
        lead = s * (s * (power - 2 * rss) - c * 2 * np.sqrt(rss * (power - rss)))
        # samples that are dropped take their share of the distance with them
        if 0.5 * lead * (2 * count - n) > (_SURE + many) * n * noise:
            return k
    return -1


@exact
def _second_stripe(fit: Any, rival: Any, offset: Any, noise: Any) -> Any:
    """Probability that a sweep's answer is the stripe of that level."""
    light = max(rival - offset, 0.0)
    lead = 0.5 * (fit[2] * fit[2] - light * light) / noise
    unlike = less_likely(np.float32(abs(lead)))
    error = unlike if lead > 0 else _ONE - unlike
    # another place that is more than half as bright is no noise
    if light * light > 25 * noise and light > _RIVAL * fit[2]:
        error = max(error, light / (light + fit[2]))
    return error


@exact
def match_rows(
    camera: Any, book: Any, way: Any, search: Any, limit: Any, start: Any, stop: Any, out: Any
) -> None:
    """All pixels of rows start..stop into out, the arrays of an Estimate.

    WITHIN  around the places that are there (cells of a code) where that is better
    SWEEP   a stripe: block k of the book holds the places around stripe k
    SEARCH  from the neighbour's place on, or over the whole surface where that does not lead to an answer
            that fits (squared residuals below `limit` variances) and is better than all similar ones
    """
    raw, n, width, freedom = camera.raw, book.frames.shape[1], camera.raw.shape[2], max(book.freedom, 1)
    top, other, at = np.zeros(width, raw.dtype), np.zeros(width, raw.dtype), np.zeros(width, np.int16)
    # what codewords are filled up with is no sample
    batch, used = (
        np.zeros((BATCH, book.words.shape[2]), np.float32),
        np.zeros(book.words.shape[2], np.float32),
    )
    lines, pixels = np.empty((n, BATCH), np.float32), np.empty((3, BATCH), np.float32)
    coarse, rivals, apart = search
    score = np.empty(coarse.shape[1], np.float32)
    place, value = np.empty(_ANSWERS, np.int64), np.empty(_ANSWERS)
    many = np.log(coarse.shape[1] + 1.0)
    summed, table = book.frames.shape[2], camera.table
    read2, gain = camera.read2 / summed, camera.gain / summed
    numbers = read2, gain, camera.misfit2
    words, angles, first = book.words, book.angles, book.first
    coordinates, variances, errors, amplitudes, offsets, chi2, clipped = out
    for row in range(start, stop):
        r, last, slope = row - start, np.nan, 0.0
        if way == SWEEP:
            brightest(raw, book.index, row, camera.clip, top, at)
            beside(raw, book.index, row, at, n // 2, book.across, other)
        for x in range(width):
            if x % BATCH == 0:
                gather(camera, book, row, x, at, lines, batch, pixels)
            k, stripe = x % BATCH, np.int64(at[x])
            b = book.block[stripe]
            middle, power, count = float(pixels[0, k]), float(pixels[1, k]), np.int64(pixels[2, k] + 0.5)
            sums, whole = (middle, power, count, n), count == n
            if not whole:
                for i in range(n):
                    used[i] = np.float32(lines[i, k] > SATURATED)
            if way != WITHIN:
                clipped[r, x] = n - count
                coordinates[r, x], variances[r, x], errors[r, x] = np.nan, np.inf, 1.0
                amplitudes[r, x], offsets[r, x], chi2[r, x] = np.sqrt(power / (count + 1e-6)), middle, 0.0
            else:
                last, slope = float(coordinates[r, x]), 0.0
            noise = read2 + gain * max(middle, 0.0)
            nothing = power < (count - 1 + 5 * np.sqrt(2.0 * n)) * noise or count < 4
            if nothing or (way == WITHIN and not np.isfinite(last)):
                last = np.nan
                continue
            noise += camera.misfit2 * power / n
            known = last == last
            guess = int(np.floor((last + slope - first[stripe]) * PER_PX)) if known else words.shape[1] // 2
            fit, error, sure = (0, 0.0, 0.0, power), 0.0, way != SEARCH
            if known or way != SEARCH:
                fit = _walk(batch, k, used, whole, power, words, angles, b, guess)
                for side in (-_BESIDE, _BESIDE):
                    if fit[3] > limit * noise:
                        one = _walk(batch, k, used, whole, power, words, angles, b, guess + side)
                        fit = one if one[3] < fit[3] else fit
                if way == SEARCH and fit[3] < limit * noise:
                    some = _rivals(fit, sums, apart, many, noise)
                    sure = some == 0
                    if some > 0:
                        before, similar = fit[0], rivals[fit[0] // (PER_PX // COARSE), :some]
                        fit, error = _compared(
                            batch, k, used, sums, words, angles, book.reach, similar, noise, fit
                        )
                        sure = abs(fit[0] - before) <= 2 * book.reach
            if not sure:
                some = _likely(batch, k, used, whole, coarse, score, place, value)
                fit, error = _compared(
                    batch, k, used, sums, words, angles, book.reach, place[:some], noise, fit
                )
            if power - fit[3] < _NOTHING * noise or fit[2] <= 0:
                last = np.nan
                continue
            shape = book.reach / AROUND, freedom
            q = fit[0]
            seen = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2], np.float32(0), np.float32(0)
            seen = seen if whole else _of_used(used, words, b, q)
            steps, variance, a, offset, misfit = _placed(numbers, fit, sums, seen, angles, b, shape)
            coordinate, variance = first[stripe] + steps / PER_PX, variance / (PER_PX * PER_PX)
            if way == WITHIN:
                if abs(coordinate - last) * PER_PX >= book.reach or variance >= variances[r, x]:
                    continue
            else:
                if way == SWEEP:
                    rival = table[np.int64(other[x])] if table.size > 0 else np.float32(other[x])
                    error = _second_stripe(fit, rival, offset, noise * summed)
                errors[r, x] = error
                slope = coordinate - last if abs(coordinate - last) < 4 else 0.0
                last = coordinate
            coordinates[r, x], variances[r, x], chi2[r, x] = coordinate, variance, misfit
            amplitudes[r, x], offsets[r, x] = 0.5 * a, offset + 0.5 * a
