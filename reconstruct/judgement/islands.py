"""Islands: regions that doubtful edges (`discontinuities`) and missing pixels separate from the anchors."""

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.csgraph

from ..arrays import Floats, Ints, Mask
from ..solver.edges import Doubt

__all__ = ["cut_off"]

_BY_LINE = 2  # pixels from a line of doubts to one that is missing along it
_MISSING = 0.02  # of the line, at least
_CHANCE = 5.0  # standard deviations of a count: no more are missing along a line by chance


def cut_off(doubt: Doubt, limit: tuple[Floats, Floats], mask: Mask, anchors: Ints, lost: Mask) -> Mask:
    """Pixels that doubts beyond the limits (H, W) and missing pixels together part from every anchor.

    Where pixels are missing along a line of doubts, slopes may exceed the range, and a step of any height
    may hide between two pixels: no doubt is large enough. Where none is missing, sigma contains the doubts. A
    gap lies between an island and the anchored part: pixels missing at an island's other rim separate
    nothing. lost: pixels without a measurement.
    """
    index = np.arange(mask.size).reshape(mask.shape)
    inner = (mask[:, :-1] & mask[:, 1:], mask[:-1] & mask[1:])
    open_x, open_y = inner[0] & (doubt[0] <= limit[0])[:, :-1], inner[1] & (doubt[1] <= limit[1])[:-1]
    tail = np.concatenate([index[:, :-1][open_x], index[:-1][open_y]])
    head = np.concatenate([index[:, 1:][open_x], index[1:][open_y]])
    graph = scipy.sparse.coo_array((np.ones(tail.size), (tail, head)), shape=(mask.size, mask.size))
    parts = scipy.sparse.csgraph.connected_components(graph, directed=False)[1].reshape(mask.shape)
    held = np.zeros(parts.max() + 1, dtype=np.bool_)
    held[parts.ravel()[anchors]] = True
    islands, count = scipy.ndimage.label(mask & ~held[parts])
    if count == 0:
        return np.zeros(mask.shape, dtype=np.bool_)
    line = np.zeros(mask.shape, dtype=np.bool_)
    for closed, apart, ends in (
        (inner[0] & ~open_x, parts[:, 1:] != parts[:, :-1], (line[:, :-1], line[:, 1:])),
        (inner[1] & ~open_y, parts[1:] != parts[:-1], (line[:-1], line[1:])),
    ):
        for end in ends:
            end |= closed & apart
    along = np.where(line, islands, 0)
    near, sides = (
        scipy.ndimage.maximum_filter(part, 2 * _BY_LINE + 1) for part in (along, mask & held[parts])
    )
    missing, area, length = (
        np.bincount(part.ravel(), minlength=count + 1) for part in (near[lost & sides], near[sides], along)
    )
    usual = area * (missing[0] / max(area[0], 1))
    torn = (missing > usual + _CHANCE * np.sqrt(usual)) & (missing >= _MISSING * length)
    torn[0] = False
    away: Mask = torn[islands]
    return away
