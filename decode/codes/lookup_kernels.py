"""Compiled: rows of pixels against codewords, batch by batch.

Most pixels continue the places of the pixels before them: batches of these are followed in vectorised loops.
The remaining pixels are searched one by one (lookup_search).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, kernel

from ..estimate import Estimate, less_likely
from ..frames import RawFrames
from .lookup_light import BATCH, SATURATED, Camera, beside, brightest, gather
from .lookup_search import (
    AROUND,
    COARSE,
    PER_PX,
    SURE,
    Book,
    Bounds,
    Search,
    answer_of,
    fitted,
    lead_of,
    target_of,
    used_products,
)

__all__ = ["SEARCH", "SWEEP", "WITHIN", "match_rows"]

F32 = NDArray[np.float32]
_ZERO, _ONE = np.float32(0), np.float32(1)
#: Start of a pixel's search.
SEARCH, SWEEP, WITHIN = 0, 1, 2
#: Pixels per group, which start from the places before them; steps of each pixel; pixels over which the slope
#: is taken.
_GROUP, _TURNS, _BACK = 16, 2, 8
#: Layout of a batch's workspace: mean, power and samples, see gather, and the results.
_MEAN, _POWER, _COUNT, _NOISE, _GUESS, _NEAR, _RISE, _ZZ, _ZD, _DD, _LOW, _STEP = range(0, 12 * BATCH, BATCH)
_F, _SCALE, _RSS, _ERROR, _LEFT = range(12 * BATCH, 17 * BATCH, BATCH)
_ROOM = 17 * BATCH
#: Share of a stripe's light from which on a second place is ambiguous, regardless of noise.
_RIVAL = np.float32(0.6)
#: Explained power over the noise below which there is no pattern: noise exceeds it once in 1e4 (2 freedoms).
_NOTHING = np.float32(18)
#: Slope of an edge, pattern pixels per pixel.
_STEEP = np.float32(4)


class Batch(NamedTuple):
    """A batch of pixels of a row, K = BATCH.

    lines   (n, K) levels, and y (K, n filled up) without their mean, see gather
    used    of one pixel, mask of unsaturated samples
    room    numbers of each pixel: _MEAN + k and so on
    block, low, place  (K,) block of the book, coordinate of its first codeword, number of the codeword
    """

    lines: F32
    y: F32
    used: F32
    room: F32
    block: NDArray[np.int64]
    low: F32
    place: NDArray[np.int64]


@kernel
def _begin(batch: Batch, camera: Camera, book: Book, at: NDArray[np.int16], given: F32) -> None:
    """Noise of a batch's pixels; mark those with a pattern and, if places are given, with a place."""
    n, summed, room = book.frames.shape[1], book.frames.shape[2], batch.room
    read2, gain = np.float32(camera.read2 / summed), np.float32(camera.gain / summed)
    misfit2, chance = np.float32(camera.misfit2 / n), np.float32(5 * np.sqrt(2.0 * n) - 1)
    for k in range(at.size):
        batch.block[k], batch.low[k] = book.block[at[k]], np.float32(book.first[at[k]])
    for k in range(BATCH):
        noise = read2 + gain * max(room[_MEAN + k], _ZERO)
        lit = (room[_POWER + k] >= (room[_COUNT + k] + chance) * noise) & (room[_COUNT + k] > np.float32(3.5))
        room[_LEFT + k] = _ONE if lit else _ZERO
        room[_NOISE + k] = noise + misfit2 * room[_POWER + k]
        room[_LOW + k], room[_STEP + k], room[_ERROR + k] = _ZERO, _ZERO, _ZERO
    for k in range(given.size):
        room[_GUESS + k] = given[k]
        room[_LEFT + k] = room[_LEFT + k] if np.isfinite(given[k]) else _ZERO


@kernel
def _follow(
    batch: Batch, book: Book, apart: F32, way: int, bounds: Bounds, line: F32, x: int, begin: int
) -> int:
    """Follow a batch's pixels from the places before them, group by group from `begin` on, up to the first
    group with unfinished pixels.

    A pixel is finished if after a few steps its segment holds a minimum that fits and is better than the most
    similar codeword elsewhere, or if it has no pattern.
    """
    words, angles, whole = book.words, book.angles, np.float32(book.frames.shape[1] - 0.5)
    (limit, sure), last = bounds, words.shape[1] - 2
    while begin < BATCH:
        # views: the compiler knows that places are not negative
        y, room, place = batch.y[begin:], batch.room[begin:], batch.place[begin:]
        block, low, found = batch.block[begin:], batch.low[begin:], line[x + begin :]
        if way != WITHIN:
            before, slope = _before(line, x + begin, _BACK)
            for k in range(_GROUP):
                room[_GUESS + k] = before + slope * np.float32(k + 1)
        for k in range(_GROUP):
            guess = room[_GUESS + k] - low[k]
            place[k] = min(max(np.int64(guess * PER_PX), 0), last) if guess == guess else last // 2
        for turn in range(_TURNS):
            for k in range(_GROUP):
                near, rise, b, q = _ZERO, _ZERO, block[k], place[k]
                for i in range(y.shape[1]):
                    near += y[k, i] * words[b, q, i]
                    rise += y[k, i] * (words[b, q + 1, i] - words[b, q, i])
                room[_NEAR + k], room[_RISE + k] = near, rise
                room[_ZZ + k], room[_ZD + k] = angles[b, q, 0], angles[b, q, 1]
                room[_DD + k] = angles[b, q, 2]
            for k in range(_GROUP):
                near, rise = room[_NEAR + k], room[_RISE + k]
                f, _, scale, explained = fitted(near, rise, room[_ZZ + k], room[_ZD + k], room[_DD + k])
                room[_F + k], room[_SCALE + k] = f, scale
                room[_RSS + k] = max(room[_POWER + k] - explained, _ZERO)
            if turn + 1 < _TURNS:
                for k in range(_GROUP):
                    place[k] = target_of(place[k], room[_F + k], last)
        for k in range(_GROUP):
            q = place[k] // (PER_PX // COARSE)
            room[_NEAR + k] = apart[0, q, 0] if way == SEARCH else _ONE
            room[_RISE + k] = apart[0, q, 1] if way == SEARCH else _ZERO
        left = _ZERO
        for k in range(_GROUP):
            rss, power, noise, f = room[_RSS + k], room[_POWER + k], room[_NOISE + k], room[_F + k]
            done = (f >= _ZERO) & (f <= _ONE) & (rss < limit * noise) & (room[_COUNT + k] > whole)
            done &= lead_of(rss, power, room[_NEAR + k], room[_RISE + k]) > sure * noise
            lit = room[_LEFT + k] > _ZERO
            room[_LEFT + k] = _ZERO if done or not lit else _ONE
            room[_SCALE + k] = room[_SCALE + k] if lit and power - rss > _NOTHING * noise else _ZERO
            left += room[_LEFT + k]
        for k in range(_GROUP):
            here = low[k] + (np.float32(place[k]) + room[_F + k]) * np.float32(1 / PER_PX)
            found[k] = here if room[_SCALE + k] > _ZERO else np.float32(np.nan)
        if left > _ZERO:
            return begin
        begin += _GROUP
    return begin


@kernel
def _before(line: F32, x: int, back: int) -> tuple[np.float32, np.float32]:
    """Place of the pixel before x (NaN: unknown), and slope between that and one `back` before it."""
    before = line[x - 1] if x > 0 else np.float32(np.nan)
    slope = (before - line[x - 1 - back]) / np.float32(back) if x > back else _ZERO
    return before, slope if abs(slope) < _STEEP else _ZERO


@exact
def _alone(
    batch: Batch, book: Book, search: Search, way: int, bounds: Bounds, line: F32, x: int, k: int
) -> None:
    """Search pixel k of a batch that starts at x."""
    words, angles, room, b = book.words, book.angles, batch.room, batch.block[k]
    n, count = batch.lines.shape[0], np.int64(room[_COUNT + k] + 0.5)
    for i in range(n):
        batch.used[i] = np.float32(batch.lines[i, k] > SATURATED)
    guess = room[_GUESS + k]
    if way != WITHIN:
        before, slope = _before(line, x + k, 1)
        guess = before + slope
    place = -1 if way == SEARCH else words.shape[1] // 2
    if guess == guess:
        place = max(np.int64((guess - batch.low[k]) * PER_PX), 0)
    sums = room[_MEAN + k], room[_POWER + k], count, n
    noise = room[_NOISE + k]
    (q, f, scale, rss), error = answer_of(batch.y, k, batch.used, sums, book, search, b, place, bounds, noise)
    batch.place[k], room[_F + k], room[_RSS + k], room[_ERROR + k] = q, f, rss, error
    room[_SCALE + k] = scale if sums[1] - rss > _NOTHING * noise else _ZERO
    seen = angles[b, q, 0], angles[b, q, 1], angles[b, q, 2], _ZERO, _ZERO
    seen = seen if count == n else used_products(batch.used, words, b, q)
    room[_ZZ + k], room[_ZD + k], room[_DD + k], room[_LOW + k], room[_STEP + k] = seen
    here = batch.low[k] + (np.float32(q) + f) / np.float32(PER_PX)
    line[x + k] = here if room[_SCALE + k] > _ZERO else np.float32(np.nan)


@kernel
def _placed(batch: Batch, book: Book, camera: Camera) -> None:
    """Variances (px^2), offsets and chi2 of a batch; they replace guesses, means of codewords and squared
    residuals.

    Where codewords differ less on a part of the cell (a tread of a sharp display), noise may shift the place
    anywhere on it: the variance is that of these codewords, limited to that of the cell.
    """
    summed, room, angles = book.frames.shape[2], batch.room, book.angles
    read2, gain = np.float32(camera.read2 / summed), np.float32(camera.gain / summed)
    misfit2, freedom = np.float32(0.25 * camera.misfit2), np.float32(max(book.freedom, 1))
    none, two, cell = np.float32(1e-12), np.float32(2), np.float32(book.reach / AROUND)
    for k in range(BATCH):
        b, q = batch.block[k], batch.place[k]
        mean, step = angles[b, q, 3], angles[b, q + 1, 3] - angles[b, q, 3]
        room[_LOW + k] += mean + room[_F + k] * (step + room[_STEP + k])
        room[_NEAR + k], room[_RISE + k] = angles[b, q, 4], angles[b, q, 5] + mean + room[_F + k] * step
    for k in range(BATCH):
        middle, f, a, rss = room[_MEAN + k], room[_F + k], room[_SCALE + k], room[_RSS + k]
        zz, zd, dd = room[_ZZ + k], room[_ZD + k], room[_DD + k]
        offset = middle - a * room[_LOW + k]
        # squared change per codeword that scale and offset do not absorb
        told = (zz * dd - zd * zd) / max(zz + f * (zd + zd + f * dd), none)
        own = max(room[_COUNT + k] - np.float32(3), _ONE)
        noise = read2 + gain * max(middle, _ZERO) + misfit2 * a * a
        excess = max(rss / (own * noise) - two * np.sqrt(two / own), _ONE)
        here = read2 + gain * max(offset + a * room[_RISE + k], _ZERO) + misfit2 * a * a
        flat = min(
            noise * excess / max(room[_POWER + k] * room[_NEAR + k], none), cell * cell / np.float32(12)
        )
        variance = max(here * excess / max(a * a * told, none), flat)
        room[_GUESS + k] = variance * np.float32(1 / (PER_PX * PER_PX))
        room[_LOW + k], room[_RSS + k] = offset, rss / noise * freedom / own


@kernel
def _write(
    batch: Batch, line: F32, edges: tuple[float, float], r: int, x: int, reach: np.float32, out: Estimate
) -> None:
    """Write a batch into row r of an Estimate; reach (px, 0: write all): only results with a lower variance
    than the given place's, and within reach of it."""
    coordinates, variances, errors, amplitudes, offsets, chi2, clipped = out
    room, n, count = batch.room, np.float32(batch.lines.shape[0]), min(BATCH, coordinates.shape[1] - x)
    half, unsure, cell = np.float32(0.5), np.float32(edges[0]), np.float32(edges[1])
    for k in range(count):
        found, variance = line[x + k], room[_GUESS + k]
        better = (abs(found - coordinates[r, x + k]) < reach) & (variance < variances[r, x + k])
        room[_LEFT + k] = _ONE if better | (reach == _ZERO) else _ZERO
        # the shift is proportional to the distance to the nearest edge and to the error of the spread
        phase = (found + half) / cell
        edge = unsure * cell * (phase - np.rint(phase))
        room[_GUESS + k] = variance + edge * edge
    for k in range(count):
        if room[_LEFT + k] > _ZERO:
            coordinates[r, x + k], known = line[x + k], line[x + k] == line[x + k]
            deviation = np.sqrt(room[_POWER + k] / max(room[_COUNT + k], _ONE))
            variances[r, x + k] = room[_GUESS + k] if known else np.float32(np.inf)
            chi2[r, x + k] = room[_RSS + k] if known else _ZERO
            amplitudes[r, x + k] = half * room[_SCALE + k] if known else deviation
            offsets[r, x + k] = room[_LOW + k] + half * room[_SCALE + k] if known else room[_MEAN + k]
    if reach == _ZERO:
        for k in range(count):
            errors[r, x + k] = room[_ERROR + k] if line[x + k] == line[x + k] else _ONE
            clipped[r, x + k] = n - room[_COUNT + k]


@kernel
def _second_stripe(batch: Batch, other: RawFrames, camera: Camera, summed: int) -> None:
    """Probability that a sweep's true place is the stripe of `other` levels (K,), elsewhere."""
    room = batch.room
    for k in range(other.size):
        rival = camera.table[np.int64(other[k])] if camera.table.size > 0 else np.float32(other[k])
        scale, light = room[_SCALE + k], max(rival - room[_LOW + k], _ZERO)
        noise = room[_NOISE + k] * np.float32(summed)
        lead = np.float32(0.5) * (scale * scale - light * light) / noise
        unlike = less_likely(abs(lead))
        error = unlike if lead > _ZERO else _ONE - unlike
        # a second place with more than half of the light is not noise
        if light * light > np.float32(25) * noise and light > _RIVAL * scale:
            error = max(error, light / (light + scale))
        room[_ERROR + k] = error


@exact
def match_rows(
    camera: Camera,
    book: Book,
    way: int,
    search: Search,
    limit: float,
    edges: tuple[float, float],
    start: int,
    stop: int,
    out: Estimate,
) -> None:
    """Decode rows start..stop into out, the arrays of an Estimate.

    WITHIN  around given places (cells of a code), if the result is better
    SWEEP   a stripe: block k of the book holds the places around stripe k
    SEARCH  from the neighbours' places; over the whole surface, if the result does not fit (squared residuals
            below `limit` variances) or is not better than all similar ones
    edges: relative error of the distance to the nearest edge, and distance of edges (px)
    """
    raw, n, width = camera.raw, book.frames.shape[1], camera.raw.shape[2]
    top, other, at = np.zeros(width, raw.dtype), np.zeros(width, raw.dtype), np.zeros(width, np.int16)
    # padding of the codewords holds no samples
    y, used = np.zeros((BATCH, book.words.shape[2]), np.float32), np.zeros(book.words.shape[2], np.float32)
    lines, room, low = (
        np.empty((n, BATCH), np.float32),
        np.zeros(_ROOM, np.float32),
        np.zeros(BATCH, np.float32),
    )
    batch = Batch(lines, y, used, room, np.zeros(BATCH, np.int64), low, np.zeros(BATCH, np.int64))
    line, most = np.zeros(width + BATCH, np.float32), np.log(search.coarse.shape[1] + 1.0)
    bounds = np.float32(limit), np.float32(SURE + most if way == SEARCH else -np.inf)
    reach = np.float32(book.reach / PER_PX) if way == WITHIN else _ZERO
    for row in range(start, stop):
        r = row - start
        if way == SWEEP:
            brightest(raw, book.swept, row, camera.clip, top, at)
            beside(raw, book.swept, row, at, n // 2, book.across, other)
        for x in range(0, width, BATCH):
            stop_x = min(x + BATCH, width)
            gather(camera, book, row, x, at, lines, y, room)
            room[_COUNT + stop_x - x : _NOISE] = _ZERO  # no samples beyond the last pixel
            _begin(batch, camera, book, at[x:stop_x], out.coordinate[r, x : stop_x if way == WITHIN else x])
            begin = 0
            while begin < BATCH:
                begin = _follow(batch, book, search.apart, way, bounds, line, x, begin)
                for k in range(begin, min(begin + _GROUP, BATCH)):
                    if room[_LEFT + k] > _ZERO:
                        _alone(batch, book, search, way, bounds, line, x, k)
                begin += _GROUP
            _placed(batch, book, camera)
            if way == SWEEP:
                _second_stripe(batch, other[x:stop_x], camera, book.frames.shape[2])
            _write(batch, line, edges, r, x, reach, out)
