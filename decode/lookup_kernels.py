"""Compiled: a pixel's samples against codewords, v = o + a t(u), t a polyline through codewords at close
places.

Codewords are stored without their mean, so that the offset o drops out: y = v - mean(v) is compared with
z(f) = z_q + f d_q, d_q = z_(q+1) - z_q, and the scale a and the place f of the best fit are a 2 x 2 system.
"""

from typing import Any, NamedTuple

import numpy as np

from optolever.kernels import exact, kernel

from .lookup_light import BATCH, beside, brightest, gather

__all__ = ["ANGLES", "COARSE", "LANES", "PER_PX", "SEARCH", "SWEEP", "WITHIN", "Book", "Camera", "match_rows"]

#: Codewords per pattern pixel, and samples per vector instruction: codewords are filled up to a multiple.
PER_PX, LANES = 8, 8
#: Codewords per pattern pixel of the search over the whole surface.
COARSE = 2
#: Numbers kept of a codeword: |z|^2, z.d, |d|^2, least sin^2 of the next angles where they differ (else 1),
#: mean, whether the way is straight from the codeword before to the one after the next.
ANGLES, MEAN, STRAIGHT = 6, 4, 5
#: Steps of a walk, each at most a pixel long; places that a search compares; pattern pixels around an answer
#: that are no other answer.
_STEPS, _ANSWERS = 16, 12
#: Where a pixel's search starts.
SEARCH, SWEEP, WITHIN = 0, 1, 2
#: Share of a stripe's light that another place has to show to be another answer, whatever the noise.
_RIVAL = 0.6
#: Squared deviations up to which another place is as good: 4.5 sigma.
_NEAR = 20.0
#: -log of the probability of another answer below which a search may be left out.
_SURE = 16.0
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
    """Codewords of B blocks: frames (M,); samples of a codeword n; its first frame (B,); z (B, Q, n filled
    up); ANGLES (B, Q, 6); coordinate of codeword 0 (B,); codewords around an answer that may be as good;
    freedom."""

    index: Any
    samples: Any
    begin: Any
    words: Any
    angles: Any
    first: Any
    reach: Any
    freedom: Any


@kernel
def _walk(batch: Any, pixel: Any, power: Any, words: Any, angles: Any, b: Any, q: Any) -> Any:
    """From codeword q downhill: (q, f, a, squared residuals) of the best place on segments q..q+1; by how
    much more the best one on the other side of a sharp corner leaves, and how far off it is (0: no
    corner)."""
    last = words.shape[1] - 2
    q = min(max(q, 0), last)
    best_q, best_f, best_a, best, before = q, 0.0, 0.0, power, -1
    probe, centre, second, apart = 0, q, power, 0.0
    for _ in range(_STEPS):
        near, rise = np.float32(0), np.float32(0)
        for i in range(batch.shape[1]):
            near += batch[pixel, i] * words[b, q, i]
            rise += batch[pixel, i] * (words[b, q + 1, i] - words[b, q, i])
        zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
        det = zz * dd - zd * zd
        a, af = near * dd - rise * zd, rise * zz - near * zd
        f = 0.0
        if det > 1e-9 * zz * zz:
            f = af / a if a > 0 else (99.0 if af > 0 else -99.0)
        inside = min(max(f, 0.0), 1.0)
        if angles[b, q, STRAIGHT] > 0:
            inside = min(max(f, -1.0), 2.0)
        length = zz + inside * (2 * zd + inside * dd)
        along = near + inside * rise
        rss = power - along * along / max(length, 1e-12)
        away = abs(q + inside - best_q - best_f)
        if along > 0 and rss < best:
            if probe > 0 and away > 0:
                second, apart = best, away
            best_q, best_f, best_a, best = q, inside, along / max(length, 1e-12), rss
        elif probe > 0 and away > 0 and rss < second:
            second, apart = rss, away
        target = min(max(q + min(max(int(np.floor(f)), -PER_PX), PER_PX), 0), last)
        if probe == 0 and f != inside and target != q and target != before:
            q, before = target, q
            continue
        # both sides of a sharp corner may have a best place of their own
        if probe == 0:
            centre = best_q
        if probe == 4 or angles[b, centre, STRAIGHT] >= 0:
            break
        probe += 1
        q = min(max(centre + (probe - 3 if probe < 3 else probe - 2), 0), last)
    return best_q, best_f, best_a, max(best, 0.0), second - best, apart


@kernel
def _spread(
    batch: Any,
    pixel: Any,
    power: Any,
    words: Any,
    angles: Any,
    b: Any,
    middle: Any,
    reach: Any,
    variance: Any,
) -> Any:
    """Posterior over segments around one: (mean place, its variance, a, squared residuals of the best).

    A segment has the weight exp(-rss / 2 variance) at its best place times the posterior's width in it:
    all of a tread, sqrt(2 pi) deviations of a steep one.
    """
    low, high = max(middle - reach, 0), min(middle + reach, words.shape[1] - 2)
    best, best_a = power, 0.0
    total, moment, square = 0.0, 0.0, 0.0
    for q in range(low, high + 1):
        near, rise = np.float32(0), np.float32(0)
        for i in range(batch.shape[1]):
            near += batch[pixel, i] * words[b, q, i]
            rise += batch[pixel, i] * (words[b, q + 1, i] - words[b, q, i])
        zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
        det = max(zz * dd - zd * zd, 1e-9 * zz * zz)
        a, af = near * dd - rise * zd, rise * zz - near * zd
        own = variance * zz * zz / max(near * near * det / max(zz, 1e-12), 1e-12)  # of f, at a = near / zz
        f = min(max(af / a, 0.0), 1.0) if own < 1 and a > 0 else 0.5
        length, along = max(zz + f * (2 * zd + f * dd), 1e-12), near + f * rise
        if along > 0:
            rss = power - along * along / length
            if rss < best:
                shrink = np.exp(-0.5 * (best - rss) / variance)
                total, moment, square = total * shrink, moment * shrink, square * shrink
                best, best_a = rss, along / length
            weight = np.exp(-0.5 * (rss - best) / variance) * min(np.sqrt(2 * np.pi * own), 1.0)
            place = f + (q - middle)
            total += weight
            moment += weight * place
            square += weight * (place * place + min(own, 1 / 12))
    if total <= 0:
        return float(middle), np.inf, 0.0, power
    mean = moment / total
    return middle + mean, square / total - mean * mean, best_a, max(best, 0.0)


@kernel
def _weighted_level(offset: Any, a: Any, words: Any, angles: Any, b: Any, q: Any, f: Any, n: Any) -> Any:
    """Mean level of the samples, weighted by what each of them tells of the place."""
    zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
    turn = (zd + f * dd) / max(zz + f * (2 * zd + f * dd), 1e-12)
    total, level = 0.0, 0.0
    for i in range(n):
        d = words[b, q + 1, i] - words[b, q, i]
        z = words[b, q, i] + f * d
        own = (d - z * turn) * (d - z * turn)
        total += own
        level += own * max(offset + a * (angles[b, q, MEAN] + z), 0.0)
    return level / max(total, 1e-12)


@kernel
def _masked(words: Any, angles: Any, b: Any, low: Any, used: Any, own: Any, new: Any) -> None:
    """Codewords low.. of block b without the samples that are not used, into own and new, as many as fit."""
    n, count = used.size, 0
    for i in range(n):
        count += used[i]
    for k in range(own.shape[1]):
        total = np.float32(0)
        for i in range(n):
            total += words[b, low + k, i] if used[i] else np.float32(0)
        total /= np.float32(max(count, 1))
        new[0, k, MEAN] = angles[b, low + k, MEAN] + total
        for i in range(n):
            own[0, k, i] = words[b, low + k, i] - total if used[i] else np.float32(0)
    for k in range(own.shape[1]):
        zz, zd, dd = np.float32(0), np.float32(0), np.float32(0)
        beyond = min(k + 1, own.shape[1] - 1)
        for i in range(n):
            d = own[0, beyond, i] - own[0, k, i]
            zz += own[0, k, i] * own[0, k, i]
            zd += own[0, k, i] * d
            dd += d * d
        new[0, k, 0], new[0, k, 1], new[0, k, 2], new[0, k, 3] = zz, zd, dd, angles[b, low + k, 3]
        new[0, k, STRAIGHT] = min(angles[b, low + k, STRAIGHT], np.float32(0))


@kernel
def _fit(
    camera: Any, shape: Any, words: Any, angles: Any, b: Any, batch: Any, pixel: Any, sums: Any, q: Any
) -> Any:
    """Best place from codeword q of block b downhill: (place in codewords, its variance, scale, offset,
    squared residuals, chi2).

    camera (read2, gain, misfit2), shape (samples, freedom, reach), sums of the pixel (mean, power, samples
    used)
    """
    read2, gain, misfit2 = camera
    n, freedom, reach = shape
    middle, power, count = sums
    q, f, a, rss, worse, apart = _walk(batch, pixel, power, words, angles, b, q)
    level = angles[b, q, MEAN] + f * (angles[b, q + 1, MEAN] - angles[b, q, MEAN])
    offset = middle - a * level
    noise = read2 + gain * max(middle, 0.0) + misfit2 * 0.25 * a * a
    own_freedom = max(count - 3.0, 1.0)
    excess = max(rss / (own_freedom * noise) - 2 * np.sqrt(2.0 / own_freedom), 1.0)
    place, variance = q + f, np.inf
    if power * angles[b, q, 3] < _NEAR * noise * excess:
        place, variance, a, rss = _spread(batch, pixel, power, words, angles, b, q, reach, noise * excess)
    else:
        zz, zd, dd = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2]
        across = zd + f * dd
        told = a * a * (dd - across * across / max(zz + f * (2 * zd + f * dd), 1e-12))
        here = noise
        if gain > 0:
            here = noise + gain * (_weighted_level(offset, a, words, angles, b, q, f, n) - max(middle, 0.0))
        if told > 0:
            # the place on the other side of a sharp corner has a share of the posterior
            share = 1 / (1 + np.exp(min(0.5 * worse / (noise * excess), 80.0)))
            variance = max(here, read2) * excess / told + share * apart * apart
    return place, variance, a, offset, rss, rss / noise * (freedom / own_freedom)


@kernel
def _scores(batch: Any, pixel: Any, used: Any, whole: Any, coarse: Any, score: Any) -> None:
    """Correlation of samples with all codewords (M, P) of unit length; without samples that are not used."""
    score[:] = np.float32(0)
    for m in range(coarse.shape[0]):
        v = batch[pixel, m]
        for p in range(score.size):
            score[p] += v * coarse[m, p]
    if not whole:
        total, square = np.zeros(score.size, np.float32), np.zeros(score.size, np.float32)
        count = np.float32(0)
        for m in range(coarse.shape[0]):
            if used[m]:
                count += np.float32(1)
                for p in range(score.size):
                    total[p] += coarse[m, p]
                    square[p] += coarse[m, p] * coarse[m, p]
        for p in range(score.size):
            score[p] /= np.sqrt(
                max(square[p] - total[p] * total[p] / max(count, np.float32(1)), np.float32(1e-2))
            )


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
def _others(left: Any, found: Any, best: Any, least: Any, noise: Any, guard: Any) -> Any:
    """Probability that one of some places, other than the best, is the right one, from their squared
    residuals."""
    total = 0.0
    for k in range(left.size):
        again = abs(found[k] - best) <= guard
        for j in range(k):  # two maxima may lead to the same place
            again |= abs(found[k] - found[j]) < PER_PX
        if not again:
            total += np.exp(-0.5 * max(left[k] - least, 0.0) / noise)
    return total / (1 + total)


@exact
def match_rows(
    camera: Any, book: Any, way: Any, coarse: Any, apart: Any, limit: Any, start: Any, stop: Any, out: Any
) -> None:
    """All pixels of rows start..stop into out, the arrays of an Estimate.

    WITHIN  around the places that are there (cells of a code) where that is better
    SWEEP   a stripe: block k of the book holds the places around stripe k, of the frames begin[k]..
    SEARCH  from the neighbour's place on, or over the whole surface where that does not lead to an answer
    that
            fits (squared residuals below `limit` variances) and that is surely the only one: coarse (M, P)
            are unit codewords of the whole surface, apart (P, 2) sine and cosine of the angle to the most
            similar one elsewhere. With t the angle between samples and the answer, those to other codewords
            are apart - t at least, and their squared residuals larger by power sin(apart) sin(apart - 2 t).
    """
    raw, n, width, freedom = camera.raw, book.samples, camera.raw.shape[2], max(book.freedom, 1)
    top, other, at = np.zeros(width, raw.dtype), np.zeros(width, raw.dtype), np.zeros(width, np.int16)
    batch, used = np.zeros((BATCH, book.words.shape[2]), np.float32), np.ones(n, np.bool_)
    lines, pixels = np.empty((n, BATCH), np.float32), np.empty((3, BATCH), np.float32)
    score = np.empty(coarse.shape[1], np.float32)
    nodes = min(2 * book.reach + 2 * PER_PX + 2, book.words.shape[1])
    own = np.zeros((1, nodes, batch.shape[1]), np.float32)
    own_angles = np.zeros((1, nodes, ANGLES), np.float32)
    numbers, shape = (camera.read2, camera.gain, camera.misfit2), (n, book.freedom, book.reach)
    words, angles, index, begin, origin = book.words, book.angles, book.index, book.begin, book.first
    coordinates, variances, errors, amplitudes, offsets, chi2, clipped = out
    clip, table, reach = camera.clip, camera.table, book.reach
    place, value = np.empty(_ANSWERS, np.int64), np.empty(_ANSWERS)
    left, found = np.empty(_ANSWERS), np.empty(_ANSWERS)
    many, per = np.log(coarse.shape[1] + 1.0), PER_PX // COARSE
    for row in range(start, stop):
        r, last, slope, block = row - start, -1.0, 0.0, np.int64(0)
        if way == SWEEP:
            brightest(raw, index, row, top, at)
            beside(raw, index, row, at, n // 2, other)
            for x in range(width):
                if top[x] >= clip:  # the middle of those that are saturated one after the other
                    ahead = np.int64(at[x])
                    while ahead + 1 < index.size and raw[index[ahead + 1], row, x] >= clip:
                        ahead += 1
                    at[x] = (at[x] + ahead) // 2
        for x in range(width):
            if x % BATCH == 0:
                gather(camera, book, row, x, at, lines, batch, pixels)
            pixel, b = x % BATCH, np.int64(at[x])
            middle, power = float(pixels[0, pixel]), float(pixels[1, pixel])
            count = np.int64(pixels[2, pixel] + 0.5)
            sums = (middle, power, count)
            if count < n:
                for i in range(n):
                    used[i] = raw[index[begin[b] + i], row, x] < clip
            if way != WITHIN:
                clipped[r, x] = n - count
                coordinates[r, x], variances[r, x], errors[r, x] = np.nan, np.inf, 1.0
                amplitudes[r, x], offsets[r, x], chi2[r, x] = np.sqrt(power / (count + 1e-6)), middle, 0.0
            noise = camera.read2 + camera.gain * max(middle, 0.0)
            nothing = power < (count - 1 + 5 * np.sqrt(2.0 * n)) * noise or count < 4
            if nothing or (way == WITHIN and not np.isfinite(coordinates[r, x])):
                last = -1.0
                continue
            noise += camera.misfit2 * power / n
            guess = int(last + slope)
            if way == WITHIN:
                guess = int(np.rint((coordinates[r, x] - origin[0]) * PER_PX))
            elif way == SWEEP and (last < 0 or b != block):
                guess = words.shape[1] // 2
            fit, error, sure = (0.0, np.inf, 0.0, 0.0, power, 0.0), 1.0, False
            for k in range(-1 if way != SEARCH or last >= 0 else 0, _ANSWERS):
                if k == 0:
                    _scores(batch, pixel, used, count == n, coarse, score)
                    _highest(score, place, value)
                    fit, left[:], found[:] = (0.0, np.inf, 0.0, 0.0, power, 0.0), power, -1e9
                if k >= 0:
                    guess = place[k] * per + per // 2
                    # codewords are half a step from the best place at most: that costs less than half the
                    # score
                    if place[k] < 0 or value[k] < 0.5 * value[0]:
                        continue
                if count < n:
                    low = min(max(guess - nodes // 2, 0), words.shape[1] - nodes)
                    _masked(words, angles, b, low, used, own, own_angles)
                    one = _fit(numbers, shape, own, own_angles, 0, batch, pixel, sums, guess - low)
                    one = (one[0] + low, one[1], one[2], one[3], one[4], one[5])
                else:
                    one = _fit(numbers, shape, words, angles, b, batch, pixel, sums, guess)
                if one[4] < fit[4]:
                    fit = one
                if k >= 0:
                    left[k], found[k] = one[4], one[0]
                elif way != SEARCH:
                    sure = True
                elif fit[4] < limit * noise:
                    s, c = apart[int(fit[0]) // per, 0], apart[int(fit[0]) // per, 1]
                    share = fit[4] / power
                    lead = s * (s * (1 - 2 * share) - c * 2 * np.sqrt(share * max(1 - share, 0.0)))
                    # samples that are dropped take their share of the distance with them
                    lead = 0.5 * lead * (2.0 * count / n - 1) * power / noise - many
                    sure, error = lead > _SURE, np.exp(-lead)
                if sure:
                    break
            if not sure:
                excess = max(fit[4] / (freedom * noise) - 2 * np.sqrt(2.0 / freedom), 1.0)
                error = _others(left, found, fit[0], fit[4], noise * excess, 2 * reach)
            if power - fit[4] < _NOTHING * noise or fit[2] <= 0:
                last = -1.0
                continue
            coordinate, variance = origin[b] + fit[0] / PER_PX, fit[1] / (PER_PX * PER_PX)
            if way == WITHIN:
                if abs(coordinate - coordinates[r, x]) * PER_PX < reach and variance < variances[r, x]:
                    coordinates[r, x], variances[r, x], chi2[r, x] = coordinate, variance, fit[5]
                    amplitudes[r, x], offsets[r, x] = 0.5 * fit[2], fit[3] + 0.5 * fit[2]
                continue
            if way == SWEEP:
                rival = table[np.int64(other[x])] if table.size > 0 else np.float32(other[x])
                rival = max(rival - fit[3], 0.0)
                lead = 0.5 * (fit[2] * fit[2] - rival * rival) / noise
                error = 1 / (1 + np.exp(min(max(lead, -80.0), 80.0)))
                # another place that is more than half as bright is no noise
                if rival * rival > 25 * noise and rival > _RIVAL * fit[2]:
                    error = max(error, rival / (rival + fit[2]))
            slope = fit[0] - last if last >= 0 and b == block and abs(fit[0] - last) < 4 * PER_PX else 0.0
            last, block = fit[0], b
            coordinates[r, x], variances[r, x], errors[r, x] = coordinate, variance, error
            amplitudes[r, x], offsets[r, x], chi2[r, x] = 0.5 * fit[2], fit[3] + 0.5 * fit[2], fit[5]
