"""Regions: the peaks of a map that rise above its noise, each with the cells deeper than half of it.

A peak counts if its lower bound exceeds the upper bound of its saddle to a deeper one (persistence: H.
Edelsbrunner, J. Harer, Computational Topology, 2010, ch. VII), on levels that fall by a tenth. Under a ball
on an elastic half-space the contact ends at half the depth (K. L. Johnson, Contact Mechanics, 1985, ch. 3).
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from optolever.arrays import Circle, Floats, Map, Mask

from .surface import Surface, filled

__all__ = ["COLUMNS", "Region", "areas", "regions"]

SIGNIFICANT = 6.0  # standard deviations of the height by noise and motion
_PROMINENT = 0.2  # of a peak's height, over the saddle to a higher one
_SHALLOWEST = 0.02  # of the deepest one's depth
_FALL = 0.9  # of a level: the next one
_FEWEST, _SURE = (12, 5), 8.0  # cells of a region; of one beyond so many standard deviations
COLUMNS = 256  # of the grid in which peaks are looked for
_LARGEST = 16  # regions of a map
_HALF = 0.5
_MARGIN = 2  # cells around a region
_LONGEST = 6  # circles along a region


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A contact's deepest cell (row, col), depth, and its cells: box of the map, inside (r, c) of the box; x,
    y: centroid, radius: of a circle of its area, mm; cut: the map's end or unknown cells end it; hole: cells
    that are not measured are inside; circles: of equal areas, one after the other along a long contact."""

    row: int
    col: int
    depth: float
    x: float
    y: float
    radius: float
    box: tuple[slice, slice]
    inside: Mask
    cut: bool
    hole: bool

    circles: tuple[Circle, ...]


def regions(surface: Surface, columns: int = COLUMNS) -> tuple[Region, ...]:
    """Dents of a map, the deepest first, 16 at most: peaks of six standard deviations above the surface at
    rest and above the saddle to a deeper peak, and of .02 of the deepest. columns: of the grid in which peaks
    are looked for."""
    z, known, holes = filled(surface.z, surface.good)
    sigma = np.where(known & np.isfinite(surface.sigma), surface.sigma, 0)
    rise = SIGNIFICANT * np.sqrt(np.square(sigma) + np.square(surface.unsettled))
    sure = known & (z > rise) & (~holes | (z > 0))
    if not sure.any():
        return ()
    tops = _peaks(z, sure, known & (z > rise / 2), sigma, columns)
    masks = _parted(tops, [_half_depth(z, *at) for at in tops])
    every = (
        _region(surface, z, holes, known, at, mask, _least(z, rise, at))
        for at, mask in zip(tops, masks, strict=True)
    )
    found = sorted((one for one in every if one is not None), key=lambda one: -one.depth)
    return tuple(one for one in found if one.depth > _SHALLOWEST * found[0].depth)[:_LARGEST]


def areas(x: Map, y: Map) -> Floats:
    """Of the cells on the mirror, (R, C), mm^2."""
    (x_row, x_col), (y_row, y_col) = (np.gradient(np.asarray(part, np.float64)) for part in (x, y))
    area = np.abs(x_col * y_row - x_row * y_col)
    known = np.isfinite(area)
    return np.where(known, area, np.median(area[known]) if known.any() else 0.0)


def _peaks(z: Map, sure: Mask, known: Mask, sigma: Map, columns: int) -> list[tuple[int, int]]:
    """Cells (row, col) of the peaks that stand out from their saddles, the highest first; known: cells that
    may be saddles."""
    step = max(1, z.shape[1] // columns)
    small, noise, peak, saddle = (part[::step, ::step] for part in (z, sigma, sure, known))
    margin = np.maximum(SIGNIFICANT * noise, _PROMINENT * small) / 2
    lower, upper = np.where(peak, small - margin, -np.inf), np.where(saddle, small + margin, -np.inf)
    level, found = float(lower.max()), list[tuple[int, int]]()
    least = _SHALLOWEST * level
    left, top, width, height = cv2.boundingRect((upper > _FALL * least).view(np.uint8))
    lower, upper = (part[top : top + height, left : left + width].copy() for part in (lower, upper))
    while level > least and len(found) < 2 * _LARGEST:
        level *= _FALL
        if not lower.max() > level:  # what is joined to a peak stays so at lower levels
            continue
        count, labels = cv2.connectedComponents((upper > level).view(np.uint8))
        joined = np.zeros(count, np.bool_)
        joined[[labels[at] for at in found]] = True
        np.copyto(lower, -np.inf, where=joined[labels])
        while lower.max() > level:
            found.append(divmod(int(lower.argmax()), width))
            np.copyto(lower, -np.inf, where=labels == labels[found[-1]])
    climbed = [_climbed(z, known, (top + row) * step, (left + col) * step, step) for row, col in found]
    return sorted(dict.fromkeys(climbed), key=lambda at: -float(z[at]))


def _climbed(z: Map, known: Mask, row: int, col: int, reach: int) -> tuple[int, int]:
    """The highest cell that uphill steps lead to."""
    while True:
        top, left = max(row - reach, 0), max(col - reach, 0)
        box = slice(top, row + reach + 1), slice(left, col + reach + 1)
        near = np.where(known[box], z[box], 0)
        down, along = np.unravel_index(int(near.argmax()), near.shape)
        if not near[down, along] > z[row, col]:
            return row, col
        row, col = top + int(down), left + int(along)


def _half_depth(z: Map, row: int, col: int) -> Mask:
    labels = cv2.connectedComponents((z > _HALF * z[row, col]).astype(np.uint8), connectivity=4)[1]
    return np.asarray(labels == labels[row, col])


def _parted(tops: list[tuple[int, int]], masks: list[Mask]) -> list[Mask]:
    """Disjoint: where two overlap, cells go to the nearer peak."""
    if len(masks) < 2:
        return masks
    rows, cols = np.ogrid[: masks[0].shape[0], : masks[0].shape[1]]
    away = np.stack([np.hypot(rows - row, cols - col) for row, col in tops])
    others = [[bool((mask & other).any()) for other in masks] for mask in masks]
    return [mask & (away[k] <= away[others[k]].min(axis=0)) for k, mask in enumerate(masks)]


def _least(z: Map, rise: Floats, at: tuple[int, int]) -> int:
    """Cells of a region at least; rise (R, C): six standard deviations."""
    return _FEWEST[bool(z[at] > _SURE / SIGNIFICANT * rise[at])]


def _region(
    surface: Surface, z: Map, holes: Mask, known: Mask, at: tuple[int, int], mask: Mask, least: int
) -> Region | None:
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    rows, cols = mask.shape
    box = (
        slice(max(top - _MARGIN, 0), min(top + height + _MARGIN, rows)),
        slice(max(left - _MARGIN, 0), min(left + width + _MARGIN, cols)),
    )
    inside = mask[box]
    measured = inside & np.isfinite(surface.x[box])
    cell = areas(surface.x[box], surface.y[box])
    if np.count_nonzero(measured) < least or not cell[measured].any():
        return None
    area, (x, y) = (
        float(cell[inside].sum()),
        (part[box][measured].astype(np.float64) for part in (surface.x, surface.y)),
    )
    weight = cell[measured] / cell[measured].sum()
    ended = top == 0 or left == 0 or top + height == rows or left + width == cols
    grown = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    cut = bool(ended or (grown & ~known[box]).any())
    return Region(
        *at,
        depth=float(z[at]),
        x=float(weight @ x),
        y=float(weight @ y),
        radius=math.sqrt(area / math.pi),
        box=box,
        inside=inside,
        cut=cut,
        hole=bool((inside & holes[box]).any()),
        circles=_circles(x, y, weight, area, cut),
    )


def _circles(x: Floats, y: Floats, weight: Floats, area: float, cut: bool) -> tuple[Circle, ...]:
    """As many as it is longer than wide (of a cut disc one), of cells (n,) with weights that sum to one."""
    at = np.stack([x, y])
    off = at - (at @ weight)[:, None]
    (least, most), axes = np.linalg.eigh((off * weight) @ off.T)
    longer = min(math.sqrt(most / least), _LONGEST) if least > 0 else 1.0
    count = int(longer) if cut else round(longer)
    along = np.argsort(axes[:, 1] @ off)
    part = np.empty(x.size, np.int64)
    part[along] = np.minimum(count * np.cumsum(weight[along]), count - 1).astype(np.int64)
    total = np.bincount(part, weight, count)
    kept = total > 0  # a part whose cells have no area
    places = [np.bincount(part, weight * one, count)[kept] / total[kept] for one in at]
    radii = np.sqrt(total[kept] * area / math.pi)
    return tuple(zip(*(part.tolist() for part in (*places, radii)), strict=True))
