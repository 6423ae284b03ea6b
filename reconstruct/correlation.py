"""Noise that is correlated over pixels (quantised codes, calibration) and what it does to the height.

A surface's slopes sum to zero around any block of pixels, and so does the mean of that over neighbouring
blocks. Independent noise of variance v per slope leaves in the mean over B x B blocks of B x B pixels the
variance 8/3 v (1 + 1/(2 B^2)), whatever B; errors that neighbours share leave more, the larger the block,
until it holds them all. The largest such excess multiplies the height's variance: in two dimensions every
octave of wavelengths adds the same to a height, and what has a curl has a part without one as large.
"""

import math

import numpy as np

from .arrays import Floats, Mask
from .edges import Doubt, increments

__all__ = ["correlation_excess"]

_SMALLEST = 4  # pixels: below it an edge's four slopes overlap
_LEAST = 1.5  # excess below which noise counts as independent
_SIGNIFICANT = 5.0  # standard deviations of the excess's own scatter
_MOST = 1e6  # of the usual variance: what such a block sums to is anything
_LARGEST = 512  # rows or columns: larger images are looked at in part


def correlation_excess(
    p: Floats, q: Floats, variances: tuple[Floats, Floats], mask: Mask, doubt: Doubt | None
) -> float:
    """Factor (1 or more) on the height's variance; p, q: slopes; doubt: of edges, added to their variance."""
    window = tuple(
        slice((size - min(size, _LARGEST)) // 2, (size + min(size, _LARGEST)) // 2) for size in p.shape
    )
    inside = np.ascontiguousarray(mask[window])
    if not inside.any():
        return 1.0
    gx, gy = increments(np.ascontiguousarray(p[window]), np.ascontiguousarray(q[window]), inside)
    vx, vy = (variance[window].copy() for variance in variances)
    if doubt is not None:
        vx += doubt[0][window] ** 2
        vy += doubt[1][window] ** 2
    # sums of blocks are differences of sums over the image, of which they must be more than the rounding
    both = np.minimum(vx + vy, _MOST * float(np.median((vx + vy)[inside])))
    sums, variance = (_sums(gx, 1), _sums(gy, 0)), _area(both)
    holes = _area((~inside).astype(np.float64))
    excess, block = 1.0, _SMALLEST
    while block <= min(inside.shape) // 4:
        scores, count = _scores(sums, variance, holes, block)
        if count >= 2:
            found = float(np.mean(scores**2))
            if found > max(_LEAST, 1.0 + _SIGNIFICANT * math.sqrt(2.0 / count)):
                excess = max(excess, found)
        block *= 2
    return excess


def _scores(sums: tuple[Floats, Floats], variance: Floats, holes: Floats, block: int) -> tuple[Floats, float]:
    """Mean circulations over their standard deviation, where there is no hole; how many are independent."""
    gx, gy = sums
    rows, cols = variance.shape[0] - 1, variance.shape[1] - 1
    along = gx[: rows - 1, block:] - gx[: rows - 1, :-block]
    down = gy[block:, : cols - 1] - gy[:-block, : cols - 1]
    across, below = along[:-block] - along[block:], down[:, block:] - down[:, :-block]
    r, c = min(across.shape[0], below.shape[0]), min(across.shape[1], below.shape[1])
    mean = _boxes(_area(across[:r, :c] + below[:r, :c]), block) / block**2
    wide = 2 * block
    here = slice(mean.shape[0]), slice(mean.shape[1])
    spread = _boxes(variance, wide)[here] / wide**2
    mean = mean[: spread.shape[0], : spread.shape[1]]
    score = mean / np.sqrt(spread * 2.0 * (2.0 * block**2 + 1.0) / (3.0 * block**2))
    score = score[_boxes(holes, wide)[here] < 0.5]
    return score, score.size / wide**2


def _area(values: Floats) -> Floats:
    """Sums over the rectangles from the corner, one row and column larger."""
    return _sums(_sums(values, 0), 1)


def _boxes(area: Floats, size: int) -> Floats:
    """Sums over all squares of size x size."""
    boxes: Floats = area[size:, size:] - area[:-size, size:] - area[size:, :-size] + area[:-size, :-size]
    return boxes


def _sums(values: Floats, axis: int) -> Floats:
    """Running sums along an axis, from zero."""
    shape = list(values.shape)
    shape[axis] = 1
    return np.concatenate([np.zeros(shape), np.cumsum(values, axis=axis)], axis=axis)
