"""What a pixel sees of every bit of a code: the levels of its cells behind the blur of display and optics.

A Gaussian blur (deviation s cells) leaves of the fine bits less than of the coarse ones. Between two centres
of cells levels are interpolated. The blur is the one that explains the bits of pixels that see the pattern
best; what it does not explain (light that comes by way of the scene, other blurs) is a misfit of the levels.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

__all__ = ["blurred_levels", "fitted_levels"]

F32 = NDArray[np.float32]
#: Blurs that are tried, cells: a Gray code's finest bit keeps 3 % of its contrast behind the last one.
_BLURS = np.arange(0.0, 1.8, 0.2)
#: Pixels that tell a blur; fewer tell none.
_FEWEST = 64


def blurred_levels(words: NDArray[np.int32], bits: int, blur: float) -> F32:
    """Levels (cells, bits) at the centres of cells, black -1, white 1; words (cells,); blur in cells."""
    sharp = np.where((words[:, None] >> np.arange(bits)) & 1, 1.0, -1.0)
    if blur == 0:
        return sharp.astype(np.float32)
    reach = int(np.ceil(4 * blur))
    edges = norm.cdf((np.arange(-reach, reach + 2) - 0.5) / blur)
    around = np.pad(sharp, ((reach, reach), (0, 0)), mode="edge")
    weights = np.diff(edges) / (edges[-1] - edges[0])
    return np.asarray(sum(w * around[i : i + len(sharp)] for i, w in enumerate(weights)), np.float32)


def fitted_levels(words: NDArray[np.int32], margin: F32, variance: F32, factor: F32) -> tuple[F32, float]:
    """Levels behind the blur that fits best, and the variance that they leave unexplained.

    margin (bits, K) differences of bits over the amplitude, variance (K,) of a sample in the same unit,
    factor (bits,) of a difference over that of a sample.
    """
    bits, count = margin.shape
    sharp = blurred_levels(words, bits, 0.0)
    if count < _FEWEST or len(words) < 2:
        return sharp, 0.0
    cells = np.empty(len(words), np.int64)
    cells[words] = np.arange(len(words))
    cell = cells[((margin > 0) << np.arange(bits)[:, None]).sum(axis=0)]
    expected = float(np.median(variance)) * max(bits - 1, 1)
    tried = [blurred_levels(words, bits, float(blur)) for blur in _BLURS]
    left = [float(np.median(_least_misfit(levels, cell, margin, factor))) for levels in tried]
    best = int(np.argmin(left))
    return tried[best], max(left[best] - expected, 0.0) / bits


def _least_misfit(levels: F32, cell: NDArray[np.int64], margin: F32, factor: F32) -> Any:
    """Squared misfit (K,), over the factor, of the best mixture of a cell and one beside it."""
    least = np.full(len(cell), np.inf)
    for before in (0, 1):
        at = np.clip(cell - before, 0, len(levels) - 2)
        first, step = levels[at].T, (levels[at + 1] - levels[at]).T
        weight = step / factor[:, None]
        share = (weight * (margin - first)).sum(axis=0) / np.maximum((weight * step).sum(axis=0), 1e-12)
        left = margin - first - np.clip(share, 0, 1) * step
        least = np.minimum(least, (np.square(left) / factor[:, None]).sum(axis=0))
    return least
