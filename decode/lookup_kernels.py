"""Compiled: a pixel's samples against codewords, v = o + a t(u), t a polyline through codewords at close places.

Codewords are stored without their mean, so that the offset o drops out: y = v - mean(v) is compared with
z(f) = z_q + f d_q, d_q = z_(q+1) - z_q, and the scale a and the place f of the best fit are a 2 x 2 system.
"""

from typing import Any, NamedTuple

import numpy as np

from optolever.kernels import exact, kernel

from .frames import fetch_rows

__all__ = ["ANGLES", "LANES", "PER_PX", "Book", "Camera", "search_rows", "sweep_rows", "within_rows"]

#: Codewords per pattern pixel, and samples per vector instruction: codewords are filled up to a multiple.
PER_PX, LANES = 8, 8
#: Codewords per pattern pixel of the search over the whole surface.
COARSE = 2
#: Numbers kept of a codeword: |z|^2, z.d, |d|^2, least sin^2 of the next angles where they differ (else 1).
ANGLES = 4
#: Steps of a walk, each at most a pixel long; places that a search compares; pattern pixels around an answer
#: that are no other answer.
_STEPS, _ANSWERS, _GUARD = 12, 12, 2
#: Pixels whose samples are turned into vectors together: they stay in the first cache.
_BATCH = 64
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
    """Codewords of B blocks: frames (M,); samples of a codeword n; its first frame (B,); z (B, Q, n filled up);
    ANGLES (B, Q, 4); mean level (B, Q); coordinate of codeword 0 (B,); codewords around an answer that may be
    as good; freedom."""

    index: Any
    samples: Any
    begin: Any
    words: Any
    angles: Any
    mean: Any
    first: Any
    reach: Any
    freedom: Any


@kernel
def _walk(y: Any, power: Any, words: Any, angles: Any, q: Any) -> Any:
    """From codeword q downhill: (q, f, a, squared residuals) of the best place on segments q..q+1."""
    last = words.shape[0] - 2
    q = min(max(q, 0), last)
    best_q, best_f, best_a, best, before = q, 0.0, 0.0, power, -1
    for _ in range(_STEPS):
        near, rise = np.float32(0), np.float32(0)
        for i in range(y.size):
            near += y[i] * words[q, i]
            rise += y[i] * (words[q + 1, i] - words[q, i])
        zz, zd, dd = angles[q, 0], angles[q, 1], angles[q, 2]
        det = zz * dd - zd * zd
        a, af = near * dd - rise * zd, rise * zz - near * zd
        f = 0.0
        if det > 1e-9 * zz * zz:
            f = af / a if a > 0 else (99.0 if af > 0 else -99.0)
        inside = min(max(f, 0.0), 1.0)
        length = zz + inside * (2 * zd + inside * dd)
        along = near + inside * rise
        rss = power - along * along / max(length, 1e-12)
        if along > 0 and rss < best:
            best_q, best_f, best_a, best = q, inside, along / max(length, 1e-12), rss
        if f == inside:
            break
        step = min(max(int(np.floor(f)), -PER_PX), PER_PX)
        target = min(max(q + step, 0), last)
        if target in (q, before):
            break
        q, before = target, q
    return best_q, best_f, best_a, max(best, 0.0)


@kernel
def _spread(y: Any, power: Any, words: Any, angles: Any, middle: Any, reach: Any, variance: Any) -> Any:
    """Posterior over the codewords around one: (mean place, its variance, a and squared residuals of the best),
    places in codewords."""
    low, high = max(middle - reach, 0), min(middle + reach, words.shape[0] - 1)
    best, best_a = power, 0.0
    total, moment, square = 0.0, 0.0, 0.0
    for q in range(low, high + 1):
        near = np.float32(0)
        for i in range(y.size):
            near += y[i] * words[q, i]
        if near > 0:
            rss = power - near * near / max(angles[q, 0], 1e-12)
            if rss < best:
                shrink = np.exp(-0.5 * (best - rss) / variance)
                total, moment, square = total * shrink, moment * shrink, square * shrink
                best, best_a = rss, near / max(angles[q, 0], 1e-12)
            weight = np.exp(-0.5 * (rss - best) / variance)
            place = float(q - middle)
            total, moment, square = (
                total + weight,
                moment + weight * place,
                square + weight * place * place,
            )
    if total <= 0:
        return float(middle), np.inf, 0.0, power
    mean = moment / total
    return middle + mean, square / total - mean * mean + 1 / 12, best_a, max(best, 0.0)


@kernel
def _uneven(y: Any, offset: Any, a: Any, words: Any, mean: Any, q: Any, f: Any, n: Any) -> Any:
    """Mean level of the samples, weighted by what each tells of the place."""
    zz, zd = 0.0, 0.0
    for i in range(n):
        z, d = words[q, i] + f * (words[q + 1, i] - words[q, i]), words[q + 1, i] - words[q, i]
        zz += z * z
        zd += z * d
    told, level = 0.0, 0.0
    for i in range(n):
        z, d = words[q, i] + f * (words[q + 1, i] - words[q, i]), words[q + 1, i] - words[q, i]
        own = (d - z * zd / max(zz, 1e-12)) ** 2
        told += own
        level += own * (offset + a * (mean + z))
    return level / max(told, 1e-12)


@kernel
def _settle(
    camera: Any, book: Any, words: Any, angles: Any, mean: Any, y: Any, used: Any, middle: Any, power: Any, fit: Any
) -> Any:
    """(place in codewords, its variance, scale, offset, chi2) of a fit (q, f, a, squared residuals)."""
    q, f, a, rss = fit
    level = mean[q] + f * (mean[q + 1] - mean[q])
    offset = middle - a * level
    usual = camera.read2 + camera.gain * max(middle, 0.0) + camera.misfit2 * 0.25 * a * a
    freedom = max(used - 3, 1)
    excess = max(rss / (freedom * usual) - 2 * np.sqrt(2.0 / freedom), 1.0)
    place, variance = q + f, np.inf
    if power * angles[q, 3] < _NEAR * usual * excess:
        place, variance, a, rss = _spread(y, power, words, angles, q, book.reach, usual * excess)
    else:
        zz, zd, dd = angles[q, 0], angles[q, 1], angles[q, 2]
        across = zd + f * dd
        told = a * a * (dd - across * across / max(zz + f * (2 * zd + f * dd), 1e-12))
        if camera.gain > 0:
            own = camera.read2 + camera.misfit2 * 0.25 * a * a
            own += camera.gain * max(_uneven(y, offset, a, words, level, q, f, book.samples), 0.0)
        else:
            own = usual
        if told > 0:
            variance = own * excess / told
    return place, variance, a, offset, rss / usual * (book.freedom / freedom)


@exact
def _masked(book: Any, b: Any, low: Any, used: Any, words: Any, angles: Any, mean: Any) -> None:
    """Codewords low.. of block b without the samples that are not used, into the scratch of a pixel."""
    n, count = book.samples, 0
    for i in range(n):
        count += used[i]
    for k in range(words.shape[0]):
        total = 0.0
        for i in range(n):
            total += book.words[b, low + k, i] if used[i] else 0.0
        total /= max(count, 1)
        mean[k] = book.mean[b, low + k] + total
        for i in range(n):
            words[k, i] = book.words[b, low + k, i] - total if used[i] else 0.0
    for k in range(words.shape[0]):
        zz, zd, dd = 0.0, 0.0, 0.0
        for i in range(n):
            d = words[k + 1, i] - words[k, i] if k + 1 < words.shape[0] else 0.0
            zz += words[k, i] * words[k, i]
            zd += words[k, i] * d
            dd += d * d
        angles[k, 0], angles[k, 1], angles[k, 2] = zz, zd, dd
        angles[k, 3] = book.angles[b, low + k, 3]


@exact
def _centre(y: Any, used: Any, n: Any) -> Any:
    """Samples without their mean, in place: (mean, power) of those that are used; the others become 0."""
    count, total = 0, 0.0
    for i in range(n):
        count += used[i]
        total += y[i] if used[i] else 0.0
    middle, power = total / max(count, 1), 0.0
    for i in range(n):
        y[i] = y[i] - middle if used[i] else 0.0
        power += y[i] * y[i]
    return middle, power


@exact
def _store(out: Any, r: Any, x: Any, coordinate: Any, variance: Any, error: Any, a: Any, offset: Any, chi2: Any) -> None:
    out[0][r, x], out[1][r, x], out[2][r, x] = coordinate, variance, error
    out[3][r, x], out[4][r, x], out[5][r, x] = 0.5 * a, offset + 0.5 * a, chi2


@exact
def _nothing(out: Any, r: Any, x: Any, middle: Any, power: Any, used: Any) -> None:
    """No pattern: the samples' deviation stands for the amplitude."""
    out[0][r, x], out[1][r, x], out[2][r, x] = np.nan, np.inf, 1.0
    out[3][r, x], out[4][r, x], out[5][r, x] = np.sqrt(power / max(used, 1)), middle, 0.0


@kernel
def _scores(y: Any, coarse: Any, score: Any) -> None:
    """Correlation of samples with all unit codewords (M, P)."""
    score[:] = np.float32(0)
    for m in range(coarse.shape[0]):
        v = y[m]
        for p in range(score.size):
            score[p] += v * coarse[m, p]


@kernel
def _masked_scores(y: Any, used: Any, coarse: Any, score: Any) -> None:
    """The same without samples that are not used."""
    total, square = np.zeros(score.size, np.float32), np.full(score.size, np.float32(1e-6))
    score[:] = np.float32(0)
    count = 0
    for m in range(coarse.shape[0]):
        if used[m]:
            v = y[m]
            count += 1
            for p in range(score.size):
                c = coarse[m, p]
                score[p] += v * c
                total[p] += c
                square[p] += c * c
    part = np.float32(1.0 / max(count, 1))
    for p in range(score.size):
        score[p] /= np.sqrt(max(square[p] - total[p] * total[p] * part, np.float32(1e-3)))


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
def _around(book: Any, b: Any, q: Any, used: Any, clipped: Any, scratch: Any) -> Any:
    """First of the codewords around q, and these: the book's own, or without the clipped samples."""
    if not clipped:
        return 0
    words, angles, mean = scratch
    low = min(max(q - words.shape[0] // 2, 0), book.words.shape[1] - words.shape[0])
    _masked(book, b, low, used, words, angles, mean)
    return low


@exact
def _walked(book: Any, b: Any, y: Any, power: Any, q: Any, used: Any, clipped: Any, scratch: Any) -> Any:
    """_walk from codeword q of block b; clipped: without the samples that are not used."""
    if clipped:
        low = _around(book, b, q, used, True, scratch)
        k, f, a, rss = _walk(y, power, scratch[0], scratch[1], q - low)
        return k + low, f, a, rss
    return _walk(y, power, book.words[b], book.angles[b], q)


@exact
def _settled(
    camera: Any, book: Any, b: Any, y: Any, count: Any, middle: Any, power: Any, fit: Any, used: Any, scratch: Any
) -> Any:
    """_settle, of samples some of which may be clipped."""
    q, f, a, rss = fit
    if count < book.samples:
        low = _around(book, b, q, used, True, scratch)
        k = min(q - low, scratch[0].shape[0] - 2)
        place, variance, a, offset, chi2 = _settle(
            camera, book, scratch[0], scratch[1], scratch[2], y, count, middle, power, (k, f, a, rss)
        )
        return place + low, variance, a, offset, chi2
    return _settle(camera, book, book.words[b], book.angles[b], book.mean[b], y, count, middle, power, fit)


@exact
def _search(
    book: Any, y: Any, power: Any, used: Any, clipped: Any, coarse: Any, score: Any, lists: Any, variance: Any, scratch: Any
) -> Any:
    """The best place of the whole surface, and the probability that it is another one of the highest."""
    place, value, left, found = lists
    if clipped:
        _masked_scores(y, used, coarse, score)
    else:
        _scores(y, coarse, score)
    _highest(score, place, value)
    per = PER_PX // COARSE
    fit = (0, 0.0, 0.0, power)
    for k in range(place.size):
        left[k], found[k] = power, -1e9
        # codewords lie half a step from the best place at most, which costs no more than half of the score
        if place[k] >= 0 and value[k] > 0.5 * value[0]:
            one = _walked(book, 0, y, power, place[k] * per + per // 2, used, clipped, scratch)
            left[k], found[k] = one[3], one[0] + one[1]
            if one[3] < fit[3]:
                fit = one
    freedom = max(book.samples - 3, 1)
    excess = max(fit[3] / (freedom * variance) - 2 * np.sqrt(2.0 / freedom), 1.0)
    others = 0.0
    for k in range(place.size):
        if abs(found[k] - fit[0] - fit[1]) > _GUARD * book.reach:
            again = False  # two maxima may lead to the same place
            for j in range(k):
                again |= abs(found[k] - found[j]) < PER_PX
            if not again:
                others += np.exp(-0.5 * max(left[k] - fit[3], 0.0) / (variance * excess))
    return fit, others / (1 + others)


@exact
def search_rows(camera: Any, book: Any, coarse: Any, apart: Any, limit: Any, start: Any, stop: Any, out: Any) -> None:
    """Any levels: from the neighbour's place on, or over the whole surface where that does not lead to an answer
    that fits (squared residuals below `limit` variances) and that is surely the only one.

    coarse (M, P): unit codewords of the whole surface; apart (P, 2): sine and cosine of the angle to the most
    similar one elsewhere. With t the angle between samples and the answer, those to other codewords are apart - t
    at least, and squared residuals power sin(apart) sin(apart - 2 t) larger.
    """
    n, width = book.samples, camera.raw.shape[2]
    light = np.empty((n, width), np.float32)
    batch = np.zeros((_BATCH, book.words.shape[2]), np.float32)
    used, score = np.ones(n, np.bool_), np.empty(coarse.shape[1], np.float32)
    nodes = min(2 * book.reach + 2 * PER_PX + 2, book.words.shape[1])
    scratch = (
        np.zeros((nodes, book.words.shape[2]), np.float32),
        np.zeros((nodes, ANGLES), np.float32),
        np.zeros(nodes, np.float32),
    )
    lists = (np.empty(_ANSWERS, np.int64), np.empty(_ANSWERS), np.empty(_ANSWERS), np.empty(_ANSWERS))
    many, per = np.log(coarse.shape[1]), PER_PX // COARSE
    for row in range(start, stop):
        saturated = fetch_rows(camera.raw, book.index, row, camera.table, camera.clip, light)
        last, slope = -1.0, 0.0
        for begin in range(0, width, _BATCH):
            end = min(begin + _BATCH, width)
            _turn(light, begin, end, batch)
            for x in range(begin, end):
                y, r = batch[x - begin], row - start
                count = n
                if saturated:
                    for i in range(n):
                        used[i] = camera.raw[book.index[i], row, x] < camera.clip
                        count -= not used[i]
                out[6][r, x] = n - count
                clipped = count < n
                middle, power = _centre(y, used, n) if clipped else _centred(y, n)
                variance = camera.read2 + camera.gain * max(middle, 0.0)
                if power < (count - 1 + 5 * np.sqrt(2.0 * n)) * variance or count < 4:
                    _nothing(out, r, x, middle, power, count)
                    last = -1.0
                    continue
                variance += camera.misfit2 * power / n
                fit, error, sure = (0, 0.0, 0.0, power), 1.0, False
                if last >= 0:
                    guess = int(last + slope)
                    fit = _walked(book, 0, y, power, guess, used, clipped, scratch)
                    if fit[3] < limit * variance:
                        s, c = apart[fit[0] // per, 0], apart[fit[0] // per, 1]
                        share = fit[3] / power
                        lead = s * (s * (1 - 2 * share) - c * 2 * np.sqrt(share * max(1 - share, 0.0)))
                        # dropped samples take their share of the distance with them
                        lead *= (2.0 * count / n - 1) if clipped else 1.0
                        lead = 0.5 * power * lead / variance - many
                        sure = lead > _SURE
                        error = np.exp(-lead)
                if not sure:
                    fit, error = _search(book, y, power, used, clipped, coarse, score, lists, variance, scratch)
                place, var, a, offset, chi2 = _settled(
                    camera, book, 0, y, count, middle, power, fit, used, scratch
                )
                if power - fit[3] < _NOTHING * variance or a <= 0:
                    _nothing(out, r, x, middle, power, count)
                    last = -1.0
                    continue
                slope = place - last if last >= 0 and abs(place - last) < 4 * PER_PX else 0.0
                last = place
                _store(
                    *(out, r, x, book.first[0] + place / PER_PX, var / (PER_PX * PER_PX)),
                    *(error, a, offset, chi2),
                )


@kernel
def _turn(light: Any, begin: Any, end: Any, batch: Any) -> None:
    for m in range(light.shape[0]):
        for x in range(begin, end):
            batch[x - begin, m] = light[m, x]


@kernel
def _centred(y: Any, n: Any) -> Any:
    """_centre of samples all of which are used."""
    total, power = np.float32(0), np.float32(0)
    for i in range(n):
        total += y[i]
    middle = total / np.float32(n)
    for i in range(n):
        y[i] -= middle
        power += y[i] * y[i]
    return float(middle), float(power)


@exact
def within_rows(camera: Any, book: Any, start: Any, stop: Any, out: Any) -> None:
    """Places around those that are there already (cells of a code), where they fit; else these stay."""
    n, width = book.samples, camera.raw.shape[2]
    light = np.empty((n, width), np.float32)
    batch = np.zeros((_BATCH, book.words.shape[2]), np.float32)
    used = np.ones(n, np.bool_)
    nodes = min(2 * book.reach + 2 * PER_PX + 2, book.words.shape[1])
    scratch = (
        np.zeros((nodes, book.words.shape[2]), np.float32),
        np.zeros((nodes, ANGLES), np.float32),
        np.zeros(nodes, np.float32),
    )
    for row in range(start, stop):
        saturated = fetch_rows(camera.raw, book.index, row, camera.table, camera.clip, light)
        for begin in range(0, width, _BATCH):
            end = min(begin + _BATCH, width)
            _turn(light, begin, end, batch)
            for x in range(begin, end):
                y, r = batch[x - begin], row - start
                count = n
                if saturated:
                    for i in range(n):
                        used[i] = camera.raw[book.index[i], row, x] < camera.clip
                        count -= not used[i]
                cell = out[0][r, x]
                if not np.isfinite(cell) or count < 4:
                    continue
                middle, power = _centre(y, used, n)
                q = int(np.rint((cell - book.first[0]) * PER_PX))
                fit = _walked(book, 0, y, power, q, used, count < n, scratch)
                if fit[2] <= 0:
                    continue
                place, var, a, offset, chi2 = _settled(
                    camera, book, 0, y, count, middle, power, fit, used, scratch
                )
                coordinate, variance = book.first[0] + place / PER_PX, var / (PER_PX * PER_PX)
                if abs(coordinate - cell) * PER_PX < book.reach and variance < out[1][r, x]:
                    out[0][r, x], out[1][r, x], out[5][r, x] = coordinate, variance, chi2


@kernel
def _brightest(raw: Any, index: Any, row: Any, top: Any, at: Any) -> None:
    """Largest level of each pixel of a row, and which of the frames shows it first."""
    line = raw[index[0], row]
    for x in range(top.size):
        top[x], at[x] = line[x], 0
    for k in range(1, index.size):
        line = raw[index[k], row]
        place = np.int16(k)
        for x in range(top.size):
            v = line[x]
            at[x] = place if v > top[x] else at[x]
            top[x] = max(v, top[x])


@kernel
def _beside(raw: Any, index: Any, row: Any, at: Any, away: Any, other: Any) -> None:
    """Largest level of the frames that are more than `away` from `at`."""
    other[:] = 0
    for k in range(index.size):
        line = raw[index[k], row]
        low, high = np.int16(k - away), np.int16(k + away)
        for x in range(at.size):
            v = line[x]
            v = v if (at[x] < low) | (at[x] > high) else raw.dtype.type(0)
            other[x] = max(v, other[x])


@exact
def _linear(camera: Any, value: Any) -> Any:
    return camera.table[np.int64(value)] if camera.table.size > 0 else np.float32(value)


@exact
def sweep_rows(camera: Any, book: Any, away: Any, start: Any, stop: Any, out: Any) -> None:
    """A swept stripe: block k of the book holds the places around stripe k, of the frames begin[k].. ."""
    n, width = book.samples, camera.raw.shape[2]
    top, other = np.empty(width, camera.raw.dtype), np.empty(width, camera.raw.dtype)
    at = np.empty(width, np.int16)
    y, used = np.zeros(book.words.shape[2], np.float32), np.ones(n, np.bool_)
    nodes = book.words.shape[1]
    scratch = (
        np.zeros((nodes, book.words.shape[2]), np.float32),
        np.zeros((nodes, ANGLES), np.float32),
        np.zeros(nodes, np.float32),
    )
    for row in range(start, stop):
        _brightest(camera.raw, book.index, row, top, at)
        _beside(camera.raw, book.index, row, at, away, other)
        block, hint = -1, 0
        for x in range(width):
            r, k, count = row - start, int(at[x]), n
            if top[x] >= camera.clip:
                ahead = k
                while ahead + 1 < book.index.size and camera.raw[book.index[ahead + 1], row, x] >= camera.clip:
                    ahead += 1
                k = (k + ahead) // 2
            for i in range(n):
                value = camera.raw[book.index[book.begin[k] + i], row, x]
                y[i] = _linear(camera, value)
                used[i] = value < camera.clip
                count -= not used[i]
            out[6][r, x] = n - count
            middle, power = _centre(y, used, n) if count < n else _centred(y, n)
            variance = camera.read2 + camera.gain * max(middle, 0.0)
            if power < _NOTHING * variance or count < 4:
                _nothing(out, r, x, middle, power, count)
                block = -1
                continue
            if block != k:
                hint = nodes // 2
            fit = _walked(book, k, y, power, hint, used, count < n, scratch)
            place, var, a, offset, chi2 = _settled(camera, book, k, y, count, middle, power, fit, used, scratch)
            if power - fit[3] < _NOTHING * variance or a <= 0:
                _nothing(out, r, x, middle, power, count)
                block = -1
                continue
            block, hint = k, int(place)
            rival = max(_linear(camera, other[x]) - offset, 0.0)
            lead = 0.5 * (a * a - rival * rival) / variance
            error = 1 / (1 + np.exp(min(max(lead, -80.0), 80.0)))
            # another place that is more than half as bright is no noise
            if rival * rival > 25 * variance and rival > 0.6 * a:
                error = max(error, rival / (rival + a))
            _store(
                *(out, r, x, book.first[k] + place / PER_PX, var / (PER_PX * PER_PX)),
                *(error, a, offset, chi2),
            )
