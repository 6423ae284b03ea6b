"""Micro phase shifting: one period with steps of its own, one frame each of others that are nearly as long.

The steps tell the place within their period, up to a whole number of periods k. At each of the places
p (t + k) every other frame would show a known level o + a cos(2 pi u / p_m - d_m), so a table over the phase
and the levels of three of them lists the k that are within the noise. The best of them is refined with all
samples at once: least squares for offset, amplitude and place, started at the fit of the steps (M. Gupta,
S. K. Nayar, CVPR 2012, doi:10.1109/CVPR.2012.6247753). A blur takes more of a shorter period's contrast,
which would shift all pixels of a region alike: it is measured, frame by frame.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .estimate import vanishing
from .flags import Into, merge_line
from .frames import Light, level_of
from .noise import Noise
from .phase import Periods, fit_line
from .plan import AxisPlan
from .unwrap import Candidates, in_steps, listed_by, listed_first

__all__ = ["MicroTable", "micro_table", "unwrap_micro"]

#: Entries of the table along the phase and along each of three levels, which reach from -1.25 to 1.25.
_PHASES, _LEVELS, _REACH = 32, 20, 1.25
#: Deviations within which an order is listed. A level's own noise, that of offset and amplitude, and that of
#: the phase add up to 1 + 1/3 + 2/3 + 2/3 of a sample's variance at most; over five levels the errors that
#: they share to 1 + 5/3 + 5/3.
_DEVIATIONS, _OF_LEVEL, _OF_ALL = 5.0, 8 / 3, 13 / 3
#: Pixels that tell a contrast.
_FEWEST = 64
_ONE, _HALF, _TWO_PI = np.float32(1), np.float32(0.5), np.float32(2 * np.pi)


class MicroTable(NamedTuple):
    """frames (M,): numbers of the single frames, periods and shifts (turns) of them; used (3,): those of the
    table; listed: orders by cell; tolerance: of a level over the amplitude; contrast (M,): over that of the
    steps, as a blur takes more of a shorter period; rounding2: variance by rounding of what is shown,
    over the squared amplitude."""

    frames: NDArray[np.int64]
    periods: NDArray[np.float32]
    shifts: NDArray[np.float32]
    used: NDArray[np.int64]
    listed: Candidates
    tolerance: np.float32
    contrast: NDArray[np.float32]
    rounding2: np.float32

    def with_contrast(self, place: NDArray[np.float32], level: NDArray[np.float32]) -> "MicroTable":
        """The table with the contrast that most pixels show (not those that see a steep part of the mirror):
        places (K,), pattern px, levels (M, K) over the steps' amplitude, from their offset on."""
        if place.size < _FEWEST:
            return self
        told = np.cos(2 * np.pi * (place / self.periods[:, None] - self.shifts[:, None]))
        most = np.abs(told) >= np.median(np.abs(told), axis=1, keepdims=True)
        shares = np.divide(level, told, out=np.full(told.shape, np.nan), where=most)
        return self._replace(contrast=np.nanmedian(shares, axis=1).astype(np.float32))


def micro_table(axis: AxisPlan, deviation: float, rounding2: float) -> MicroTable:
    """Orders of the period with steps; deviation: of a sample over the usual amplitude; see MicroTable."""
    tolerance = in_steps(max(_DEVIATIONS * np.sqrt(_OF_LEVEL) * deviation, 0.01))
    singles = [
        (i, f.period, d) for f in axis.singles for i, d in zip(f.index, f.shifts.tolist(), strict=True)
    ]
    # those of the table last: what it has not sorted out yet, the others refuse
    tabled = (0, len(singles) // 2, len(singles) - 1)
    order = sorted(range(len(singles)), key=lambda k: k in tabled)
    used = tuple(order.index(k) for k in tabled)
    singles = [singles[k] for k in order]
    periods, shifts = tuple(s[1] for s in singles), tuple(s[2] / (2 * np.pi) for s in singles)
    listed = _orders(axis.fringes[0].period, periods, shifts, used, axis.extent, tolerance)
    return MicroTable(
        frames=np.array([s[0] for s in singles]),
        periods=np.array(periods, np.float32),
        shifts=np.array(shifts, np.float32),
        used=np.array(used),
        listed=listed,
        tolerance=np.float32(tolerance),
        contrast=np.ones(len(singles), np.float32),
        rounding2=np.float32(rounding2),
    )


@lru_cache(maxsize=8)
def _orders(
    period: float,
    periods: tuple[float, ...],
    shifts: tuple[float, ...],
    used: tuple[int, ...],
    extent: int,
    tolerance: float,
) -> Candidates:
    """Which orders may show which levels: in a cell of phases every level runs through an interval."""
    order = np.arange(-1, int(np.ceil(extent / period)) + 1)
    phase = (np.arange(_PHASES)[:, None] + np.linspace(0, 1, 9)) / _PHASES
    place = period * (order[:, None, None] + phase)  # (K, phases, 9)
    low, high = [], []
    for m in used:
        level = np.cos(2 * np.pi * (place / periods[m] - shifts[m]))
        ends = level.min(axis=2) - tolerance, level.max(axis=2) + tolerance
        cells = [np.clip((end + _REACH) / (2 * _REACH) * _LEVELS, 0, _LEVELS - 1).astype(int) for end in ends]
        low.append(cells[0])
        high.append(cells[1])
    number, column = (part.ravel() for part in np.indices(low[0].shape))
    found, owner, distance = [], [], []
    spans = [int((h - l).max()) + 1 for l, h in zip(low, high, strict=True)]
    for offset in np.ndindex(*spans):
        at = [l.ravel() + o for l, o in zip(low, offset, strict=True)]
        inside = np.all([a <= h.ravel() for a, h in zip(at, high, strict=True)], axis=0)
        cell = ((column * _LEVELS + at[0]) * _LEVELS + at[1]) * _LEVELS + at[2]
        found.append(cell[inside])
        owner.append(number[inside])
        middle = [a - 0.5 * (l.ravel() + h.ravel()) for a, l, h in zip(at, low, high, strict=True)]
        distance.append(np.sum(np.square(middle), axis=0)[inside])
    every = np.concatenate(found), order[np.concatenate(owner)], np.concatenate(distance)
    return listed_by(*every, _PHASES * _LEVELS**3)


def unwrap_micro(
    light: Light, noise: Noise, periods: Periods, table: MicroTable, rows: tuple[int, int], into: Into
) -> None:
    """Coordinates of rows start..stop from the period with steps and the single frames."""
    _micro_rows(light.numbers(), noise.numbers(), periods, table, rows, into)


@inlined
def cosine_of(turns: Any) -> Any:
    """cos(2 pi turns), float32, to 3e-6: sin of what is left of a quarter turn, by its series to the 11th
    power."""
    y = np.float32(0.25) - abs(turns - np.rint(turns))
    z = y * y * (_TWO_PI * _TWO_PI)
    p = np.float32(-1 / 39916800)
    p = p * z + np.float32(1 / 362880)
    p = p * z + np.float32(-1 / 5040)
    p = p * z + np.float32(1 / 120)
    p = p * z + np.float32(-1 / 6)
    p = p * z + _ONE
    return _TWO_PI * y * p


@exact
def _micro_rows(light: Any, noise: Any, fringe: Any, singles: Any, rows: Any, into: Any) -> None:
    """A row at a time, so that what its fit tells is still in the cache."""
    frames, periods, shifts, used, (first, second, start, listed), tolerance, contrast, rounded = singles
    place, var, width, (raw, table, _, (_, white)) = into.place, into.variance, into.place.shape[1], light
    count, period, steps = frames.size, fringe.period[0], np.float32(fringe.number[0])
    work = np.empty((2 + fringe.frame.shape[1], width), np.float32)
    level = np.empty((count, width), np.float32)
    cell = np.empty(width, np.uint32)
    room = np.empty((2, width), np.uint32), np.empty((4, width), np.float32)
    one, other = np.empty(width, np.float32), np.empty(width, np.float32)
    beside = np.empty(width, np.float32)  # places of the other
    score, rival = np.empty(width, np.float32), np.empty(width, np.float32)
    sums, own = np.empty((8, width), np.float32), np.empty((8, width), np.float32)
    t, v, a, o, fitted, clipped, error, chi2 = own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7]
    for row in range(rows[0], rows[1]):
        fit_line(light, noise, fringe, 0, row, work, (t, v, a, o, fitted, clipped))
        for m in range(count):
            _level(raw[frames[m], row], table, (o, a, contrast[m]), white, level[m], clipped)
        _cell(t, level[used[0]], level[used[1]], level[used[2]], cell)
        listed_first(first, second, cell, one, other)
        _places(t, one, period, place[row], score)
        _places(t, other, period, beside, rival)
        for m in range(count):
            _score(place[row], level[m], _ONE / periods[m], shifts[m], score)
            _score(beside, level[m], _ONE / periods[m], shifts[m], rival)
        _choose(one, other, score, rival)
        _search((t, level, period, periods, shifts), start, listed, cell, room, one, score, rival)
        _normal(t, one, period, _HALF * steps, place[row], sums)
        for m in range(count):
            _add_sample(level[m], place[row], _ONE / periods[m], shifts[m], sums)
        found = place[row], var[row], error, a, o, chi2, clipped
        _solve(
            sums, steps + np.float32(count), (one, score, rival, fitted), (tolerance, rounded), noise, found
        )
        merge_line(found, noise, row, into)


@kernel
def _level(line: Any, table: Any, light: Any, white: Any, level: Any, clipped: Any) -> None:
    """Levels over the amplitude, from the offset on; light: both of a line, and the frame's contrast."""
    offset, amplitude, contrast = light
    for x in range(level.size):
        value = level_of(line[x], table)
        level[x] = (value - offset[x]) / max(contrast * amplitude[x], np.float32(1e-6))
        clipped[x] += _ONE if value >= white else np.float32(0)


@kernel
def _cell(turn: Any, a: Any, b: Any, c: Any, cell: Any) -> None:
    scale, top, zero = np.float32(_LEVELS / (2 * _REACH)), np.float32(_LEVELS - 1), np.float32(0)
    reach, levels = np.float32(_REACH), np.int32(_LEVELS)
    for x in range(cell.size):
        phase = turn[x] - np.floor(turn[x])
        i = np.int32(min(phase * np.float32(_PHASES), np.float32(_PHASES - 1)))
        j = np.int32(min(max((a[x] + reach) * scale, zero), top))
        k = np.int32(min(max((b[x] + reach) * scale, zero), top))
        l = np.int32(min(max((c[x] + reach) * scale, zero), top))
        cell[x] = np.uint32(((i * levels + j) * levels + k) * levels + l)


@kernel
def _places(turn: Any, order: Any, period: Any, place: Any, score: Any) -> None:
    """Places of an order, and the score to which their samples are added: beyond all others without one."""
    for x in range(order.size):
        place[x] = period * (order[x] + (turn[x] - np.floor(turn[x])))
        score[x] = np.float32(1e9) if order[x] < np.float32(-10000) else np.float32(0)


@kernel
def _score(place: Any, level: Any, per_period: Any, shift: Any, score: Any) -> None:
    for x in range(place.size):
        left = level[x] - cosine_of(place[x] * per_period - shift)
        score[x] += left * left


@kernel
def _choose(one: Any, other: Any, score: Any, rival: Any) -> None:
    for x in range(one.size):
        swap = rival[x] < score[x]
        best, rest = min(score[x], rival[x]), max(score[x], rival[x])
        one[x] = other[x] if swap else one[x]
        score[x], rival[x] = best, rest


@exact
def _search(
    seen: Any, start: Any, listed: Any, cell: Any, room: Any, one: Any, score: Any, rival: Any
) -> None:
    """The listed orders after the second: of all pixels that have a third, then of those that have a fourth,
    and so on, so that they are compared in loops of vectors. Of every one the frames of the table come last:
    the others refuse most."""
    turn, level, period, periods, shifts = seen
    pixels, asked, lines = room[0][0], room[0][1], room[1]
    for x in range(cell.size):
        pixels[x] = x
    rank, left = 2, _with_more(start, cell, 2, pixels)
    while left > 0:
        at, order, of_one, total = lines[0][:left], lines[1][:left], lines[2][:left], lines[3][:left]
        of_rank, some = listed[rank:], pixels[:left]
        for n in range(left):
            phase, number = turn[some[n]], np.float32(of_rank[np.uint32(start[cell[some[n]]])])
            at[n], order[n] = period * (number + (phase - np.floor(phase))), number
            asked[n], total[n] = some[n], np.float32(0)
        for m in range(periods.size):
            of_all, count = level[m], at.size
            for n in range(count):
                of_one[n] = of_all[asked[n]]
            _score(at, of_one, _ONE / periods[m], shifts[m], total)
            if m < periods.size - 3:
                count = _not_refused(asked, at, order, total, rival)
                at, order, of_one, total = at[:count], order[:count], of_one[:count], total[:count]
        for n in range(total.size):
            x, better = asked[n], total[n] < score[asked[n]]
            rival[x] = score[x] if better else min(rival[x], total[n])
            score[x], one[x] = (total[n], order[n]) if better else (score[x], one[x])
        rank += 1
        left = _with_more(start, cell, rank, some)


@exact
def _not_refused(asked: Any, at: Any, order: Any, total: Any, rival: Any) -> Any:
    """How many of the orders fit better than the second best so far; they move to the front."""
    count = 0
    for n in range(total.size):
        x, so_far = asked[n], total[n]
        asked[count], at[count], order[count], total[count] = x, at[n], order[n], so_far
        count += 1 if so_far < rival[x] else 0
    return count


@exact
def _with_more(start: Any, cell: Any, rank: Any, pixels: Any) -> Any:
    """How many of the pixels have more than `rank` listed orders; they move to the front."""
    count, end = 0, start[1:]
    for n in range(pixels.size):
        x = pixels[n]
        pixels[count] = x
        count += 1 if end[cell[x]] - start[cell[x]] > rank else 0
    return count


@kernel
def _normal(turn: Any, order: Any, period: Any, half: Any, place: Any, sums: Any) -> None:
    """Normal equations for offset, amplitude (of it) and place of 2 `half` even steps: diagonal."""
    curve, none = half * (_TWO_PI / period) * (_TWO_PI / period), np.float32(0)
    for x in range(order.size):
        place[x] = period * (order[x] + turn[x] - np.floor(turn[x]))
        sums[0, x], sums[1, x], sums[2, x], sums[3, x] = half, curve, none, none
        sums[4, x], sums[5, x], sums[6, x], sums[7, x] = none, none, none, none


@kernel
def _add_sample(level: Any, place: Any, per_period: Any, shift: Any, sums: Any) -> None:
    """One more sample: diagonals a, u, off-diagonals oa, ou, au, right sides o, a, u; residuals start at the
    steps' fit."""
    slope = _TWO_PI * per_period
    for x in range(place.size):
        phase = place[x] * per_period - shift
        c, s = cosine_of(phase), -slope * cosine_of(phase - np.float32(0.25))
        left = level[x] - c
        sums[0, x] += c * c
        sums[1, x] += s * s
        sums[2, x] += c
        sums[3, x] += s
        sums[4, x] += c * s
        sums[5, x] += left
        sums[6, x] += c * left
        sums[7, x] += s * left


@kernel
def _solve(sums: Any, oo: Any, orders: Any, limits: Any, numbers: Any, found: Any) -> None:
    of_level, of_all = np.float32(_OF_LEVEL), np.float32(_OF_ALL)
    (one, score, rival, fitted), (read2, gain, rounding2, misfit2) = orders, numbers
    tolerance, rounded = limits
    place, var, error, amplitude, offset, chi2, _ = found
    for x in range(place.size):
        aa, uu = sums[0, x], sums[1, x]
        oa, ou, au = sums[2, x], sums[3, x], sums[4, x]
        bo, ba, bu = sums[5, x], sums[6, x], sums[7, x]
        # offset and amplitude eliminated
        det = oo * aa - oa * oa
        po, pa = (ou * aa - au * oa) / det, (au * oo - ou * oa) / det
        curve = uu - po * ou - pa * au
        step = (bu - po * bo - pa * ba) / curve
        noise = read2 + gain * max(offset[x], np.float32(0))
        power = max(amplitude[x] * amplitude[x], np.float32(1e-6))
        relative = noise / power
        place[x] += step
        var[x] = (relative + misfit2 + rounded) / curve
        lone = rival[x] > np.float32(1e8)
        wrong = vanishing(_HALF * min((rival[x] - score[x]) / (of_all * relative), np.float32(1e4)))
        wrong = np.float32(0) if lone else wrong / (_ONE + wrong)
        left = vanishing(min(_HALF * tolerance * tolerance / (of_level * relative), np.float32(1e4)))
        none = one[x] < np.float32(-10000)
        error[x] = _ONE if none else min(wrong + np.float32(3) * left, _ONE)
        # what offset, amplitude and place explain of the residuals
        fo, fa = (bo * aa - ba * oa) / det, (ba * oo - bo * oa) / det
        rss = score[x] - fo * bo - fa * ba - step * step * curve
        judged = relative + rounding2 / power + misfit2
        chi2[x] = fitted[x] + max(rss, np.float32(0)) / judged
