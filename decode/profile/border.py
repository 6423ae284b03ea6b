"""The border of the display: beyond it is dark, which shifts a pixel's centre of light inwards.

A pixel at a distance a from the border takes the share W(k - u) of the light of cell k (see display), and
nothing from cells beyond the border. For a fringe of P cells this shifts the reading by

    s(a) = P / 2 pi (arg sum over k inside of W(k - u) exp(2 pi i (k - u) / P) - arg sum over every k).

The missing light is the sum of W over cells beyond the border, which determines the blur. For codes and
look-ups, which read about the centre of the light, P is infinite.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from optolever.kernels import exact

from ..display import cell_light

__all__ = [
    "MARGIN",
    "NO_BLUR",
    "NO_BORDER",
    "SHADOW2",
    "Border",
    "BorderBlur",
    "border_of",
    "inwards",
    "measured_blur",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Shares = tuple[tuple[float, float], ...]
#: Cells from the border within which light may be missing: three deviations of a blur of three cells.
MARGIN = 9.0
#: Squared deviations of a pixel's response within which the border takes some of its light.
_SHADOW = 4
SHADOW2 = np.float32(_SHADOW**2)
#: Range of missing light for the measurement of blur; largest missing light of a good pixel.
_DARK, _LOST = (0.05, 0.45), 0.1
#: Lines in the sample along either axis; fewest pixels for a blur; pixels inwards to light without loss.
_LINES, _FEWEST, _FARTHEST = 100, 8, 60
#: Tabulated blurs, cells rms.
_BLURS = np.array([0.0, *np.geomspace(0.2, 3.2, 13)])
#: Tabulated shares of a pixel's deviation that are not footprint, and readings, in deviations from the
#: border; number of deviations.
_LEAST, _RATIOS, _STEPS = np.float32(0.1), 18, 16
_TRUE = np.linspace(0.0, 5.0, 101)
#: A period that approximates infinity; uncertain share of the shift where it stands for a code.
_CENTRE, _SHAPE = ((1e6, 1.0),), 0.25


class BorderBlur(NamedTuple):
    """Range of the blur at the border, cells; measured: from light; else it is an upper bound."""

    low: float
    blur: float
    high: float
    measured: bool


@dataclass(frozen=True, slots=True)
class Border:
    """Effect of the border on the pixels of an axis. reach: deviation of the response of a pixel without
    footprint, cells; table (_RATIOS + 1, 4 _STEPS + 1, 3): share of missing light, shift of a reading and its
    uncertainty, both in deviations, by reach over deviation and reading."""

    reach: float
    table: F32


#: Blur of a surface without a border.
NO_BLUR = BorderBlur(0.0, 0.0, 0.0, False)
#: Table of a surface without a border.
NO_BORDER = Border(0.0, np.zeros((_RATIOS + 1, _SHADOW * _STEPS + 1, 3), np.float32))


@lru_cache(maxsize=16)
def border_of(shares: Shares, blurs: BorderBlur) -> Border:
    """Border of periods (see display) and a blur. If the blur is an upper bound, half of its shift is
    subtracted, with the same uncertainty."""
    low, blur, high, told = blurs
    missing, shift = _of_blur(shares, blur)
    reach = float(_reach(blur))
    deviation = reach / np.linspace(_LEAST, 1.0, _RATIOS + 1, dtype=np.float64)[:, None]
    away = np.arange(_SHADOW * _STEPS + 1) / _STEPS * deviation
    width2 = deviation**2 - reach**2
    ends = (_shift(shares, end, away, width2) for end in (low, high))
    unsure = np.max([np.abs(shift - end / deviation) for end in ends], axis=0)
    unsure += 0 if shares else _SHAPE * shift
    three = (missing, shift, unsure) if told else (missing, shift / 2, shift / 2)
    return Border(reach, np.ascontiguousarray(np.stack(three, axis=-1), np.float32))


def _reach(blur: float | F64) -> F64:
    """Standard deviation of a cell with its blur."""
    return np.sqrt(1 / 12 + blur**2)


def _of_blur(shares: Shares, blur: float) -> F64:
    """Missing light and shift (2, _RATIOS + 1, 4 _STEPS + 1), interpolated between tabulated blurs."""
    after = int(np.clip(np.searchsorted(_BLURS, blur), 1, len(_BLURS) - 1))
    part = min((blur - _BLURS[after - 1]) / (_BLURS[after] - _BLURS[after - 1]), 1.0)
    return np.asarray((1 - part) * _table(shares, after - 1) + part * _table(shares, after))


@lru_cache(maxsize=1024)
def _table(shares: Shares, index: int) -> F64:
    """Table of one of the blurs, as `_of_blur`."""
    read = np.arange(_SHADOW * _STEPS + 1) / _STEPS
    out = []
    for deviation, distance, light, inside in _light(index):
        seen, whole = (_phase(shares or _CENTRE, distance, part) for part in (light * inside, light))
        reading, missing = np.maximum.accumulate(_TRUE + seen / deviation), 1 - (light * inside).sum(axis=0)
        out.append([np.interp(read, reading, one) for one in (missing, (seen - whole) / deviation)])
    return np.asarray(out).transpose(1, 0, 2)


def _phase(shares: Shares, distance: F64, light: F64) -> F64:
    """Shift (A,), cells, of fringes for pixels with light (K, A) from cells at distances (K, A), cells."""
    shift, weight = np.zeros(light.shape[1]), np.full(light.shape[1], 1e-30)
    for period, share in shares:
        seen = (light * np.exp(2j * np.pi / period * distance)).sum(axis=0)
        own = share * np.abs(seen) ** 2
        shift += own * period / (2 * np.pi) * np.angle(seen)
        weight += own
    return np.asarray(shift / weight)


@lru_cache(maxsize=len(_BLURS))
def _light(index: int) -> list[tuple[float, F64, F64, NDArray[np.bool_]]]:
    """For each footprint deviation, distances (K, A) of cells from a pixel at the places `_TRUE`, their
    light, and whether they are inside."""
    blur, out = float(_BLURS[index]), []
    for ratio in np.linspace(_LEAST, 1.0, _RATIOS + 1):
        deviation = float(_reach(blur) / ratio)
        width = max(math.sqrt(12) * float(np.sqrt(deviation**2 - _reach(blur) ** 2)), 0.02)
        place = _TRUE * deviation - 0.5
        half = math.ceil(width / 2 + 0.5 + 5 * blur)
        cell = np.rint(place) + np.arange(-half, half + 1)[:, None]
        out.append((deviation, cell - place, cell_light(cell - place, np.array(width), blur), cell >= 0))
    return out


def measured_blur(
    coord: F32, flags: NDArray[np.uint16], light: tuple[F32, F32], extent: int, shares: Shares = ()
) -> tuple[BorderBlur, int]:
    """Blur from the light that is missing at the border, and number of pixels in the estimate (0: too few).
    coord, flags: (H, W); extent: of the surface.

    light: mean level and amplitude (H, W). Ambient light is in the level only: the amplitude gives the
    display's share of it.
    """
    parts, nothing = [], (BorderBlur(math.nan, math.nan, math.nan, False), 0)
    for turned, count in enumerate(coord.shape):
        every = slice(None, None, max(1, count // _LINES))
        lines: list[Any] = [(one.T if turned else one)[every] for one in (coord, flags, *light)]
        parts.append(_beside(extent, *lines))
    away, width2, bend, level, lost = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    told = (lost > 0.1) & (lost < 0.9)
    if np.count_nonzero(told) < _FEWEST:
        return nothing
    level = level / np.clip(level[told].sum() / lost[told].sum(), 0.1, 1.0)
    each = (_expected(_table(shares, i)[0], blur, away, width2) for i, blur in enumerate(_BLURS))
    expected = [_missing(1 - one) for one in each]
    more = [(one - level)[(one > _DARK[0]) & (one < _DARK[1])] for one in expected]
    blurs, more = _BLURS[[len(one) >= _FEWEST for one in more]], [one for one in more if len(one) >= _FEWEST]
    if not more:
        return nothing
    quartiles = np.transpose([np.quantile(one, (0.75, 0.5, 0.25)) for one in more])
    low, blur, high = (float(np.interp(0.0, line, blurs)) for line in quartiles)
    shift = _shift(shares, blur, away, width2)
    dims = _missing(1 - _expected(_of_blur(shares, blur)[0], blur, away, width2))
    # noise of faint light resembles missing light: a blur must explain most of the pattern of loss at the
    # border, and more than a constant share does, as by a falloff over the image
    share = np.sum(level * dims) / np.maximum(np.sum(dims**2), 1e-9)
    unlike = np.sum((level - share * dims) ** 2) > min(0.5 * np.sum(level**2), len(level) * np.var(level))
    # uneven light shifts no reading: readings must show the curvature that the blur predicts
    straight = np.abs(bend - (shift[0] - 2 * shift[1] + shift[2])).sum() > np.abs(bend).sum()
    count = np.count_nonzero((dims > _DARK[0]) & (dims < _DARK[1]))
    unbounded = low >= _BLURS[-1]
    return nothing if unlike or straight or unbounded else (BorderBlur(low, blur, high, True), int(count))


def _missing(light: F32 | F64) -> F64:
    """Share (K,) that is missing of light (3, K), relative to the straight line from inwards."""
    near, middle, far = light
    return np.asarray(1 - near / np.maximum(2 * middle - far, 1e-6))


def _expected(table: F64, blur: float, away: F64, width2: F64) -> F64:
    """Table of a blur at readings of a distance from the border, for footprints of a variance."""
    deviation = _deviation(blur, width2)
    ratio = (_reach(blur) / deviation - _LEAST) * (_RATIOS / (1 - _LEAST))
    place = np.broadcast_arrays(ratio, away / deviation * _STEPS)
    return np.asarray(map_coordinates(table, place, order=1, mode="nearest"))


def _shift(shares: Shares, blur: float, away: F64, width2: F64) -> F64:
    """Shift of readings at a distance from the border, cells."""
    return _expected(_of_blur(shares, blur)[1], blur, away, width2) * _deviation(blur, width2)


def _deviation(blur: float, width2: F64) -> F64:
    """Standard deviation of the response of pixels with a footprint of a variance, cells."""
    return np.asarray(np.sqrt(_reach(blur) ** 2 + width2))


def _beside(
    extent: int, coord: F32, flags: NDArray[np.uint16], level: F32, amplitude: F32
) -> tuple[NDArray[Any], ...]:
    """For K pixels at the border, on lines (L, W) of maps: distances (3, K) from it of the pixel, of one
    inwards and of one twice as far; variance (K,) of the footprint; inward second difference of the three
    readings; missing shares of the level and of the amplitude (K,).
    """
    away = extent / 2 - np.abs(coord - (extent - 1) / 2)
    line, at = np.divmod(np.flatnonzero((away > 0) & (away < MARGIN / 2)), coord.shape[1])
    seen = flags[line, at] == 0
    line, at = line[seen], at[seen]
    after, before = np.minimum(at + 1, coord.shape[1] - 1), np.maximum(at - 1, 0)
    slope = (coord[line, after] - coord[line, before]) / np.maximum(after - before, 1)
    slope *= np.where(2 * coord[line, at] < extent, 1, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        half = np.ceil(MARGIN / 2 / np.abs(slope))
        half = np.where(half < _FARTHEST / 2, half, 0).astype(np.int64) * np.sign(slope).astype(np.int64)
    kept = (half != 0) & (at + 2 * half >= 0) & (at + 2 * half < coord.shape[1])
    line, half = line[kept], half[kept]
    three = at[kept] + np.arange(3)[:, None] * half
    within = np.abs(coord[line, three[2]] - coord[line, three[0]])
    kept = (within > 0.8 * MARGIN) & (within < 3 * MARGIN) & (flags[line, three[1:]] == 0).all(axis=0)
    line, three, half = line[kept], three[:, kept], half[kept]
    (near, middle, far), sign = coord[line, three], np.where(2 * coord[line, three[0]] < extent, 1, -1)
    # at the border neighbours read nearly the same place: take the footprint of the next ones inwards
    width2 = ((far - middle) / half) ** 2 / 12
    bend = sign * (near - 2 * middle + far)
    missing = (_missing(one[line, three]) for one in (level, amplitude))
    return away[line, three], width2, bend, *missing


@exact
def inwards(
    c: np.float32,
    noise: np.float32,
    gx: np.float32,
    gy: np.float32,
    reach: np.float32,
    table: F32,
    extent: np.float32,
) -> tuple[bool | np.bool, np.float32, np.float32]:
    """Whether more light is missing than allowed for a good pixel; shift inwards and its variance, by the
    table of a `Border`. noise: variance of the reading c, which makes the shift uncertain; gx, gy: the
    footprint."""
    none, half = np.float32(0), np.float32(0.5)
    if extent <= 0:
        return False, none, none
    deviation = np.sqrt(reach * reach + (gx * gx + gy * gy) * np.float32(1 / 12))
    low, high = c + half, extent - half - c
    away = max(min(low, high), none)
    if away * away >= SHADOW2 * deviation * deviation:
        return False, none, none
    _, shift, unsure = _looked_up(table, reach, deviation, away)
    # sharp cells are treads: the place may be nearer to the border than a noisy reading indicates
    sigma = np.sqrt(noise)
    dark, _, _ = _looked_up(table, reach, deviation, max(away - sigma, none))
    _, most, _ = _looked_up(table, reach, deviation, max(away - sigma - sigma, none))
    by_noise = half * (most - shift)
    return dark > _LOST, shift if low < high else -shift, unsure * unsure + by_noise * by_noise


@exact
def _looked_up(
    table: F32, reach: np.float32, deviation: np.float32, away: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Interpolated entries of a table, shifts in cells."""
    one = np.float32(1)
    ratio = max(reach / deviation - _LEAST, np.float32(0)) * (np.float32(_RATIOS) / (one - _LEAST))
    step = away / deviation * np.float32(_STEPS)
    i, j = min(int(ratio), _RATIOS - 1), min(int(step), _SHADOW * _STEPS - 1)
    p, q = ratio - np.float32(i), step - np.float32(j)
    a, b, d, e = (one - p) * (one - q), (one - p) * q, p * (one - q), p * q
    near, next_ = table[i], table[i + 1]
    dark = a * near[j, 0] + b * near[j + 1, 0] + d * next_[j, 0] + e * next_[j + 1, 0]
    shift = a * near[j, 1] + b * near[j + 1, 1] + d * next_[j, 1] + e * next_[j + 1, 1]
    unsure = a * near[j, 2] + b * near[j + 1, 2] + d * next_[j, 2] + e * next_[j + 1, 2]
    return dark, shift * deviation, unsure * deviation
