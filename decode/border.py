"""The border of the display: beyond it is dark, so what a pixel sees there lies further inwards.

A pixel sees the display through a kernel of some deviation s: cell, blur and footprint. Of a normal
distribution cut at t deviations from its centre a share Q(t) is dark, and what is left has its centre
hazard(t) = phi(t) / (1 - Q(t)) deviations further inwards. So a reading at r from the border and the light
that is missing there tell s = r / (t + hazard(t)), whatever the code.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from optolever.kernels import exact

__all__ = ["SHADOW2", "border_reach", "inwards"]

F32 = NDArray[np.float32]
#: Cells from the border within which light may be missing: three deviations of a blur of three cells.
_MARGIN = 9.0
#: Squared deviations of what a pixel sees within which the border takes some of it.
SHADOW2 = np.float32(4**2)
#: Light that is missing where the reach is measured, and that may be missing of a good pixel.
_DARK, _LOST = (0.1, 0.45), 0.1
#: Lines that are looked at along either axis; pixels that tell a reach; pixels inwards at which no light is
#: missing.
_LINES, _FEWEST, _FARTHEST = 100, 8, 60
#: Deviations from the border at which it takes nothing.
_NOWHERE = 5.0
#: Share of a shift by a measured reach that is unsure: a box in place of the normal distribution (a sixth), a
#: fringe whose contrast the blur halves (a tenth of the reach).
_SHAPE = 0.25


def border_reach(
    coord: F32, offset: F32, amplitude: F32, flags: NDArray[np.uint16], extent: int
) -> tuple[float, int]:
    """Deviation (cells) of what a pixel of no footprint sees, by the light that is missing beside the border,
    and how many pixels tell it (0: too few). coord, offset (mean level), amplitude, flags: (H, W); extent: of
    the surface. Light of a room is in the mean level only, the amplitude swings with the display's cells: the
    two tell how much of the level is the display's."""
    maps = coord, offset, amplitude, flags
    every, beside = (max(1, count // _LINES) for count in coord.shape)
    along, down = tuple(one[::every] for one in maps), tuple(one[:, ::beside].T for one in maps)
    both = zip(_beside(along, extent), _beside(down, extent), strict=True)
    away, width2, bend, dark, lost = (np.concatenate(parts, axis=-1) for parts in both)
    telling = (lost > _DARK[0]) & (lost < 1 - _DARK[0])
    if np.count_nonzero(telling) < _FEWEST:
        return math.nan, 0
    dark = dark / np.clip(np.median(dark[telling] / lost[telling]), _DARK[0], 1.0)
    kept = (dark > _DARK[0]) & (dark < _DARK[1])
    if np.count_nonzero(kept) < _FEWEST:
        return math.nan, 0
    t = -ndtri(dark[kept])
    squares = (away[0, kept] / (t + _hazard(t))) ** 2 - width2[kept]
    found = float(np.sqrt(max(np.median(squares), 0.0)))
    deviation = np.sqrt(found**2 + width2)
    read = np.minimum(away / deviation, _NOWHERE)
    true = _true(read)
    shift = deviation * (read - true)
    # noise of faint light is missing anywhere: a reach has to explain most of what is, and is not, beside it
    unlike = np.sum((dark - ndtr(-true[0])) ** 2) > 0.5 * np.sum(dark**2)
    # uneven light shifts nothing: as the reach says readings have to bend
    straight = np.abs(bend - (shift[0] - 2 * shift[1] + shift[2])).sum() > np.abs(bend).sum()
    return (math.nan, 0) if unlike or straight else (found, len(squares))


def _true(read: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from the border of what is read at a distance, both in deviations."""
    true = np.linspace(-2.0, _NOWHERE, 141)
    return np.interp(read, true + _hazard(true), true)


def _hazard(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the normal distribution, phi(t) / Phi(t)."""
    return np.asarray(np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi) / ndtr(t))


def _beside(maps: tuple[Any, ...], extent: int) -> tuple[NDArray[np.float64], ...]:
    """Of K pixels beside the border, on lines (L, W) of the maps of `border_reach`: distances (3, K) from it
    of the pixel, of one inwards and of one twice as far; variance (K,) of the footprint; by how much the
    three bend inwards; and the shares of level and amplitude that are missing against the last.
    """
    coord, offset, amplitude, flags = maps
    away = extent / 2 - np.abs(coord - (extent - 1) / 2)
    line, at = np.divmod(np.flatnonzero((away > 0) & (away < _MARGIN / 2)), coord.shape[1])
    seen = flags[line, at] == 0
    line, at = line[seen], at[seen]
    after, before = np.minimum(at + 1, coord.shape[1] - 1), np.maximum(at - 1, 0)
    slope = (coord[line, after] - coord[line, before]) / np.maximum(after - before, 1)
    slope *= np.where(2 * coord[line, at] < extent, 1, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        half = np.ceil(_MARGIN / 2 / np.abs(slope))
        half = np.where(half < _FARTHEST / 2, half, 0).astype(np.int64) * np.sign(slope).astype(np.int64)
    kept = (half != 0) & (at + 2 * half >= 0) & (at + 2 * half < coord.shape[1])
    line, half = line[kept], half[kept]
    three = at[kept] + np.arange(3)[:, None] * half
    within = np.abs(coord[line, three[2]] - coord[line, three[0]])
    kept = (within > 0.8 * _MARGIN) & (within < 3 * _MARGIN) & (flags[line, three[1:]] == 0).all(axis=0)
    line, three, half = line[kept], three[:, kept], half[kept]
    (near, middle, far), sign = coord[line, three], np.where(2 * coord[line, three[0]] < extent, 1, -1)
    shares = (
        1.0 - one[line, three[0]] / np.maximum(2 * one[line, three[1]] - one[line, three[2]], 1e-6)
        for one in (offset, amplitude)
    )
    # beside the border neighbours read nearly the same place: the footprint is that of the next ones inwards
    width2 = ((far - middle) / half) ** 2 / 12
    found = (away[line, three], width2, sign * (near - 2 * middle + far), *shares)
    return tuple(np.asarray(one, np.float64) for one in found)


@exact
def inwards(c: Any, gx: Any, gy: Any, reach: Any, told: Any, extent: Any) -> tuple[Any, Any, Any]:
    """Whether more light is missing than a good pixel may lack; shift inwards and its variance.

    gx, gy: the footprint. A reach that is not measured (told = 0) bounds what a pixel sees: half of the shift
    is taken off, and as much is unsure.
    """
    none = np.float32(0)
    if extent <= 0:
        return False, none, none
    deviation = np.sqrt(reach * reach + (gx * gx + gy * gy) * np.float32(1 / 12))
    low, high = c + np.float32(0.5), extent - np.float32(0.5) - c
    away = min(low, high)
    if away > 0 and away * away > SHADOW2 * deviation * deviation:
        return False, none, none
    true, hazard = away / deviation, 0.0
    for _ in range(6):
        left = 0.5 * math.erfc(-true * 0.7071067811865476)
        hazard = 0.3989422804014327 * math.exp(-0.5 * true * true) / max(left, 1e-9)
        true = max(away / deviation - hazard, -2.0)
    dark = 0.5 * math.erfc(true * 0.7071067811865476)
    shift = np.float32(hazard) * deviation
    unsure = np.float32(_SHAPE if told else 0.5) * shift
    taken = shift if told else np.float32(0.5) * shift
    return dark > _LOST, taken if low < high else -taken, unsure * unsure
