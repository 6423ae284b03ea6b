"""Compiled: the stairs of the cells, taken off pixel by pixel (see cells)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import kernel, leaf_kernel
from .steep_kernels import PLACES, likely_place, read_as

__all__ = ["Footprint", "Points", "undo_rows"]

Map = NDArray[Any]
#: Steps of the inversion.
_STEPS = 4
#: Step of a footprint (cells) on steep stairs, what keeps two of them apart, curves that are kept.
_FINE, _MANY, _KEPT = 0.01, 4096.0, 256
#: Half a cell. Slope of stairs from which on the outermost cell is a tread up to the border, as nothing lies
#: beyond it, and the variance of a place on its outer half, cells^2.
_HALF, _STEEP, _ALONE = 0.5, 0.4, 0.04
#: Variance (cells^2) of noise that reaches from one cell to the next: the stairs are lost in it.
_WIDE = 0.25**2
#: Footprint below which a pixel is a point, cells.
_POINT = 1e-6


class Points(NamedTuple):
    """Stairs as a point sees them: periods, shares (G,), whose weighed mean a coordinate is; heights
    (G, 2, K): the sidebands of each, m = 1, 2, ... and -1, -2, ..."""

    periods: Map
    shares: Map
    heights: Map


class Footprint(NamedTuple):
    """Of a pixel: `fill` times the gradient of guide (H, W) over at most `reach` pixels on either side that
    have no flag (H, W); uneven: rms change of a coordinate over that of a footprint, whose error is told by
    half the reach (0: it does not matter)."""

    fill: float
    guide: Map
    reach: int
    flags: Map
    uneven: float


@kernel
def undo_rows(
    start: int,
    stop: int,
    points: Points,
    footprint: Footprint,
    doubt: float,
    gentle: float,
    extent: float,
    seen: Map,
    coord: Map,
    sigma: Map,
) -> None:
    """coord: solution of coord + e(coord) = seen; where stairs are steep, the mean of what it may be.

    doubt: share of the stairs' variance that is reckoned as unknown; gentle: largest slope of stairs (-1 on a
    tread) that are inverted; extent: cells along the axis; seen, coord, sigma (H, W).
    """
    periods, shares, heights = points
    fill, guide, reach, flags, uneven = footprint
    bands, weights, waves = np.empty(heights.shape), np.empty(len(shares)), np.empty((2, heights.shape[2]))
    room, kept = np.empty((4, PLACES), np.float32), np.empty((_KEPT, PLACES + 1), np.float32)
    known = np.full((_KEPT, 3), -1.0)  # footprint, variance and largest slope of its stairs
    _seen_by(0.0, 0.0, points, waves, weights, bands)
    # low stairs are gentle whatever the footprint
    sharp = _variance(periods, weights, bands)[1] >= gentle
    for row in range(start, stop):
        for col in range(coord.shape[1]):
            along = fill * _gradient(row, col, reach, guide, flags)
            down = fill * _gradient(col, row, reach, guide.T, flags.T)
            target, noise = seen[row, col], sigma[row, col] ** 2
            if not (abs(target) < np.inf and noise < np.inf and along < np.inf and down < np.inf):
                continue
            if noise > _WIDE:
                _seen_by(along, down, points, waves, weights, bands)
                stairs, slope = _variance(periods, weights, bands)
                place, variance = target, noise + stairs
            else:
                slot = _slot(along, down, points, waves, weights, bands, known, room, kept) if sharp else 0
                if sharp and known[slot, 2] >= gentle:
                    place, variance = likely_place(target, noise + doubt * known[slot, 1], kept[slot])
                    slope = known[slot, 2]
                else:
                    _seen_by(along, down, points, waves, weights, bands)
                    place, variance = _inverted(target, noise, periods, weights, bands, waves)
                    stairs, slope = _variance(periods, weights, bands)
                    variance += doubt * stairs
            if slope >= _STEEP and not _HALF < target < extent - 1 - _HALF:
                variance += _ALONE
            if uneven > 0:
                along -= fill * _gradient(row, col, reach // 2, guide, flags)
                down -= fill * _gradient(col, row, reach // 2, guide.T, flags.T)
                variance += uneven * uneven * (along * along + down * down)
            coord[row, col] = place
            sigma[row, col] = np.sqrt(variance)


@leaf_kernel
def _slot(
    along: float,
    down: float,
    points: Points,
    waves: Map,
    weights: Map,
    bands: Map,
    known: Map,
    room: Map,
    kept: Map,
) -> int:
    """Where `known` and `kept` hold a footprint's stairs: in steps, so that neighbours share them."""
    right, below = np.rint(along / _FINE), np.rint(down / _FINE)
    key = right * _MANY + below
    slot = int(key) % _KEPT
    if known[slot, 0] != key:
        _seen_by(_FINE * right, _FINE * below, points, waves, weights, bands)
        known[slot, 0] = key
        known[slot, 1], known[slot, 2] = _variance(points.periods, weights, bands)
        read_as(points.periods, weights, bands, room, kept[slot])
    return slot


@leaf_kernel
def _inverted(
    target: float, noise: float, periods: Map, weights: Map, bands: Map, waves: Map
) -> tuple[float, float]:
    """The place read as `target`, by Newton's steps, and its variance."""
    place, slope = target, 0.0
    for _ in range(_STEPS):
        error, slope = _stairs(periods, weights, bands, waves, place)
        place += (target - place - error) / (1 + slope)
    return place, noise / ((1 + slope) * (1 + slope))


@leaf_kernel
def _gradient(row: int, col: int, reach: int, guide: Map, flags: Map) -> float:
    """Along a row, over pixels without a flag; over all of them where there are no such."""
    first, last = max(col - reach, 0), min(col + reach, guide.shape[1] - 1)
    left, right = first, last
    while left < col and flags[row, left]:
        left += 1
    while right > col and flags[row, right]:
        right -= 1
    if right == left:
        left, right = first, last
    return float(abs(guide[row, right] - guide[row, left]) / max(right - left, 1))


@leaf_kernel
def _seen_by(along: float, down: float, points: Points, waves: Map, weights: Map, bands: Map) -> None:
    """weights (G,), bands (G, 2, K): of a pixel that averages so many cells along its sides."""
    periods, shares, heights = points
    for g in range(len(shares)):
        weights[g] = shares[g]
        for k in range(heights.shape[2]):
            bands[g, 0, k], bands[g, 1, k] = heights[g, 0, k], heights[g, 1, k]
    _average(along, periods, waves, weights, bands)
    _average(down, periods, waves, weights, bands)


@leaf_kernel
def _waves(angle: float, waves: Map) -> None:
    """waves (2, K): cosines and sines of an angle and its multiples."""
    one_c, one_s = np.cos(angle), np.sin(angle)
    c, s = 1.0, 0.0
    for k in range(waves.shape[1]):
        c, s = c * one_c - s * one_s, s * one_c + c * one_s
        waves[0, k], waves[1, k] = c, s


@leaf_kernel
def _average(width: float, periods: Map, waves: Map, weights: Map, bands: Map) -> None:
    """A pixel that averages `width` cells: bands by sinc((1/P + m) w) / sinc(w/P), weights by sinc(w/P)^2."""
    if width < _POINT:
        return
    _waves(np.pi * width, waves)
    for g in range(len(periods)):
        angle = np.pi * width / periods[g]
        c, s = np.cos(angle), np.sin(angle)
        weights[g] *= (s / angle) ** 2
        for k in range(waves.shape[1]):
            m = k + 1
            bands[g, 0, k] *= (waves[0, k] + waves[1, k] * c / s) / (1 + m * periods[g])
            bands[g, 1, k] *= (waves[0, k] - waves[1, k] * c / s) / (1 - m * periods[g])


@leaf_kernel
def _variance(periods: Map, weights: Map, bands: Map) -> tuple[float, float]:
    """Of the stairs, and a bound of their slope, to first order."""
    total, steepest, whole = 0.0, 0.0, 0.0
    for weight in weights:
        whole += weight
    for k in range(bands.shape[2]):
        height = 0.0
        for g in range(len(periods)):
            height += weights[g] / whole * (bands[g, 0, k] - bands[g, 1, k]) * periods[g] / (2 * np.pi)
        total += 0.5 * height * height
        steepest += 2 * np.pi * (k + 1) * abs(height)
    return total, steepest


@leaf_kernel
def _stairs(periods: Map, weights: Map, bands: Map, waves: Map, place: float) -> tuple[float, float]:
    """e and its derivative at a coordinate, of all periods, weighed by the contrast that they have there."""
    _waves(2 * np.pi * (place - np.rint(place)), waves)
    total, change, whole = 0.0, 0.0, 0.0
    for g in range(len(periods)):
        real, imag, d_real, d_imag = 1.0, 0.0, 0.0, 0.0
        for k in range(waves.shape[1]):
            both, odd = bands[g, 0, k] + bands[g, 1, k], bands[g, 0, k] - bands[g, 1, k]
            real += both * waves[0, k]
            imag += odd * waves[1, k]
            d_real -= (k + 1) * both * waves[1, k]
            d_imag += (k + 1) * odd * waves[0, k]
        power = real * real + imag * imag
        total += weights[g] * power * periods[g] / (2 * np.pi) * np.arctan2(imag, real)
        change += weights[g] * periods[g] * (real * d_imag - imag * d_real)
        whole += weights[g] * power
    return total / whole, change / whole
