"""Contacts of one frame, and their identities with those of the last frame.

A contact is a peak of the height that rises above its noise and above the saddle to a higher one; its figures
are those of the cells around it that are deeper than half of it (a ball's contact ends there: K. L. Johnson,
Contact Mechanics, 1985, ch. 3)."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from optolever.reconstruct import basins

from .arrays import Cells, Float, Mask
from .contact import Touch
from .prepared import Prepared
from .reading import Reading
from .shape import shape_of

__all__ = ["Touches", "widened"]

_SIGNIFICANT = 6.0  # standard deviations of the height
_RISEN = 0.25
_PROMINENT = 0.2  # of a peak's height, over the saddle to a higher one
_FEWEST = 3  # cells of the coarser grid in which peaks are looked for
_CLOSED = 11  # cells between parts of one hole, at most
_RISING = 30.0  # sigma at rest: median height beside a hole that is no speck of dust
_COLUMNS = 80  # of the coarser grid
_SAME = 3.0  # mm from frame to frame, beyond the contact's radius: two that merge lie there
_HALF = 0.5
_MARGIN = 2  # cells around a region
_LARGEST = 8  # contacts of a frame


@dataclass(frozen=True, slots=True, eq=False)
class _Region:
    """Cells (R, C) of a contact and its peak."""

    row: int
    col: int
    inside: Mask


class Touches:
    """Contacts frame by frame. An untrusted frame has none; identities survive it."""

    def __init__(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self._last: tuple[Touch, ...] = ()
        self._next = 1

    def update(self, reading: Reading) -> tuple[Touch, ...]:
        """The contacts of a reading, the deepest first; all of its sigma is noise."""
        if not reading.trusted:
            return ()
        nothing = np.zeros_like(reading.z)
        return self.named([touch for touch, _ in self.found(reading, nothing, nothing)[0]])

    def found(
        self, reading: Reading, crept: Cells, size: Cells
    ) -> tuple[list[tuple[Touch, tuple[int, int]]], bool]:
        """Contacts beyond noise, the deepest first, and their deepest cells; whether there is a steep dent,
        but none of them. crept, size (R, C): heights by a shift of the image, and their size: contacts rise
        above the former by a share of the latter."""
        filled, steep = _holes_filled(self._prepared, reading)
        regions = _regions(
            self._prepared, filled, crept, np.maximum(_SIGNIFICANT * filled.sigma, _RISEN * size)
        )
        touches = [_measured(self._prepared, filled, one, reading.good) for one in regions]
        found: list[tuple[Touch, tuple[int, int]]] = []
        for touch, region in zip(touches, regions, strict=True):  # parts of one hole's flank are one contact
            if not (touch.cut and any(one.hole and _near(one, touch) for one, _ in found)):
                found.append((touch, (region.row, region.col)))
        return found, steep and not found

    def named(self, touches: list[Touch]) -> tuple[Touch, ...]:
        """The contacts of the next frame with their identities."""
        named = []
        free = list(self._last)
        for touch in touches:
            near = min(free, key=lambda one, at=touch: _apart(one, at), default=None)  # type: ignore[misc]
            if near is not None and _near(near, touch):
                free.remove(near)
                named.append(replace(touch, identity=near.identity))
            else:
                named.append(replace(touch, identity=self._next))
                self._next += 1
        self._last = tuple(named)
        return self._last


def widened(touch: Touch, common: float) -> Touch:
    """With a sigma (mm) that all of its heights have in common; the area changes as that of a ball does."""
    return replace(
        touch,
        depth_sigma=math.hypot(touch.depth_sigma, common),
        area_sigma=math.hypot(touch.area_sigma, touch.area * common / touch.depth),
        volume_sigma=math.hypot(touch.volume_sigma, touch.area * common),
    )


def _apart(one: Touch, other: Touch) -> float:
    return math.dist((one.x, one.y), (other.x, other.y))


def _near(one: Touch, other: Touch) -> bool:
    return _apart(one, other) < _SAME + math.sqrt(other.area / math.pi)


def _regions(prepared: Prepared, reading: Reading, crept: Cells, rise: Cells) -> list[_Region]:
    """Half-depth regions of the peaks that rise above crept, the deepest first."""
    z = reading.z  # where it is not measured: interpolated by the equations
    known = reading.good & ~prepared.rig.rim & (z > 0)
    sure = known & (z > crept + rise)
    if not sure.any():
        return []
    peaks = _peaks(z, sure, known & (z > crept + rise / 2), reading.sigma)
    regions = _parted([_half_depth(z, *at) for at in peaks])
    tops = [_highest(z, known & region.inside) for region in regions]  # it may be less sure than its flank
    if tops != peaks:
        regions = _parted([_half_depth(z, *at) for at in tops])
    return regions


def _half_depth(z: Cells, row: int, col: int) -> _Region:
    labels = cv2.connectedComponents((z > _HALF * z[row, col]).astype(np.uint8), connectivity=4)[1]
    return _Region(row, col, labels == labels[row, col])


def _highest(z: Cells, among: Mask) -> tuple[int, int]:
    row, col = np.unravel_index(int(np.where(among, z, 0).argmax()), z.shape)
    return int(row), int(col)


def _holes_filled(prepared: Prepared, reading: Reading) -> tuple[Reading, bool]:
    """The reading whose cells without a height, where measured ones enclose them, are at least as deep as the
    deepest beside them, their sigma as large as what they are deeper: what presses so steeply that its middle
    has no fringe is one contact. And whether a flank rises to one of them: it is no speck of dust."""
    lost = (prepared.rig.lit & ~reading.good).astype(np.uint8)
    if not lost.any():
        return reading, False
    closed = cv2.morphologyEx(lost, cv2.MORPH_CLOSE, np.ones((_CLOSED, _CLOSED), np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    z, sigma, good, steep = reading.z.copy(), reading.sigma.copy(), reading.good.copy(), False
    for label, (x0, y0, width, height, cells) in enumerate(boxes[1:].tolist(), start=1):
        cut = slice(max(y0 - 3, 0), y0 + height + 3), slice(max(x0 - 3, 0), x0 + width + 3)
        hole = labels[cut] == label
        beside = reading.good[cut] & _grown(hole, 7) & ~hole
        if cells < _FEWEST or not beside.any() or (hole & prepared.rig.rim[cut]).any():
            continue
        deepest = int(np.where(beside, reading.z[cut], -np.inf).argmax())
        edge, sure = reading.z[cut].flat[deepest], reading.sigma[cut].flat[deepest]
        z[cut][hole] = np.maximum(z[cut][hole], edge)
        sigma[cut][hole] = np.hypot(sure, z[cut][hole] - edge)
        good[cut] |= hole
        rise = np.median(np.abs(reading.z[cut][beside]) / prepared.noise.sigma[cut][beside])
        steep |= bool(rise > _RISING)
    return replace(reading, z=z, sigma=sigma, good=good), steep


def _peaks(z: Cells, sure: Mask, known: Mask, sigma: Cells) -> list[tuple[int, int]]:
    """Cells (row, col) of the peaks that stand out from their saddles, the highest first. known: cells that
    may be saddles."""
    coarse = max(1, z.shape[1] // _COLUMNS)
    small, noise = (part[::coarse, ::coarse].astype(np.float64) for part in (z, sigma))
    peak, part = sure[::coarse, ::coarse], known[::coarse, ::coarse]
    margin = np.maximum(_SIGNIFICANT * noise, _PROMINENT * small) / 2
    numbers, peaks = basins(small, np.where(part, margin, 0), part, 1.0)
    cells = np.bincount(numbers[peak], minlength=len(peaks))
    found = [
        divmod(int(at), small.shape[1]) for at, count in zip(peaks, cells, strict=True) if count >= _FEWEST
    ]
    return [_climbed(z, sure, row * coarse, col * coarse, coarse) for row, col in found[:_LARGEST]]


def _climbed(z: Cells, sure: Mask, row: int, col: int, reach: int) -> tuple[int, int]:
    """The highest cell near a peak of the coarser grid."""
    top, left = max(row - reach, 0), max(col - reach, 0)
    part = np.where(sure, z, 0)[top : row + reach + 1, left : col + reach + 1]
    down, along = _highest(part, part > 0)
    return top + down, left + along


def _parted(regions: list[_Region]) -> list[_Region]:
    """Disjoint regions: cells of a region that contains another one's peak go to the nearest peak."""
    if len(regions) < 2:
        return regions
    rows = np.arange(regions[0].inside.shape[0])[:, None]
    cols = np.arange(regions[0].inside.shape[1])
    parted = []
    for region in regions:
        inside = region.inside
        own = np.hypot(rows - region.row, cols - region.col)
        for other in regions:
            if other is not region and (inside & other.inside).any():
                inside = inside & (own <= np.hypot(rows - other.row, cols - other.col))
        parted.append(_Region(region.row, region.col, inside))
    return parted


def _measured(prepared: Prepared, reading: Reading, region: _Region, good: Mask) -> Touch:
    """Figures of a region; cell areas are those on the dented mirror, projected on x, y; good (R, C): cells
    that are measured."""
    at = region.row, region.col
    rows, cols = np.flatnonzero(region.inside.any(axis=1)), np.flatnonzero(region.inside.any(axis=0))
    top, left = max(int(rows[0]) - _MARGIN, 0), max(int(cols[0]) - _MARGIN, 0)
    cut = slice(top, int(rows[-1]) + 1 + _MARGIN), slice(left, int(cols[-1]) + 1 + _MARGIN)
    inside, z = region.inside[cut], np.asarray(reading.z[cut], np.float64)
    x, y = reading.x[cut].astype(np.float64), reading.y[cut].astype(np.float64)
    (x_row, x_col), (y_row, y_col) = np.gradient(x), np.gradient(y)
    areas = np.abs(x_col * y_row - x_row * y_col)
    depth, volume = float(reading.z[at]), float((areas * z)[inside].sum())
    centre = float((areas * x * z)[inside].sum() / volume), float((areas * y * z)[inside].sum() / volume)
    factor = float(reading.sigma[at] / prepared.noise.sigma[at])
    draws = np.float32(factor) * prepared.noise.draws[:, cut[0], cut[1]]
    heights = draws[:, inside].astype(np.float64) * areas[inside]
    arms = [part[inside] - middle for part, middle in zip((x, y), centre, strict=True)]
    moved = [_rms(heights @ arm / volume) for arm in arms]
    peak = factor * prepared.noise.draws[:, at[0], at[1]].astype(np.float64)
    deeper = reading.z[cut] + draws > (_HALF * (depth + peak)).astype(np.float32)[:, None, None]
    area = float(areas[inside].sum())
    changed = np.count_nonzero(deeper & _grown(inside), axis=(1, 2))
    edge = np.count_nonzero(inside) - np.count_nonzero(_shrunk(inside))
    cells = math.hypot(_rms(changed - np.count_nonzero(inside)), math.sqrt(edge / 12))
    off = math.hypot(*moved, math.sqrt(edge / 12) * prepared.area / math.sqrt(math.pi * area)) / math.sqrt(2)
    border = prepared.rig.rim[cut] | ~good[cut]
    return Touch(
        identity=0,
        x=centre[0],
        y=centre[1],
        position_sigma=off,
        depth=depth,
        depth_sigma=float(reading.sigma[at]),
        area=area,
        area_sigma=prepared.area * cells,
        volume=volume,
        volume_sigma=_rms(heights.sum(axis=1)),
        cut=bool((border & _grown(inside)).any()),
        hole=bool((inside & ~good[cut]).any()),
        shape=shape_of((x - centre[0], y - centre[1], z), draws, inside & ~border, depth, off),
    )


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _grown(mask: Mask, side: int = 3) -> Mask:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def _shrunk(mask: Mask) -> Mask:
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
