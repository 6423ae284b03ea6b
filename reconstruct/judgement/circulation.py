"""Do the slopes contradict each other beyond their noise? A surface's slopes sum to zero around any block.

So does their mean over neighbouring blocks: independent noise of variance v per slope leaves in that over
B x B blocks of B x B pixels the variance 8/3 v (1 + 1/(2 B^2)), whatever B. A smooth contradiction (a camera
that looks elsewhere, a pitch that is wrong) adds up over a block's area, and errors that neighbours share
leave more, the larger the block, until it holds them all: blocks of 4, 8, 16, ... pixels are compared.
"""

import math

import cv2
import numpy as np
import scipy.special

from optolever.arrays import Floats, Mask, middle
from optolever.notices import Judged

from ..measured import Measured
from ..solver.edges import increments
from ..solver.newton import State

__all__ = ["circulation_chi2", "circulation_test", "circulations", "contradicted"]

_SMALLEST = 4  # pixels: below it an edge's four slopes overlap
_MOST = 1e6  # of the median variance: the cap
_LARGEST = 512  # rows or columns: of larger images the middle is looked at
_CHANCE = 1e-4  # of right geometry to be called wrong, by each size of blocks
_TRUST = 1.15  # error over sigma that the decoder may have
_CURE = (
    "heights err by more than sigma; most likely the scene is wrong (pose of camera or pattern, a pitch): "
    "optolever calibrate, or reconstruct --rest with a capture of the mirror at rest"
)
_CURE_BESIDE_RIG = (
    "heights err by more than total_sigma; most likely the mirror moved between frames (hold it still), or "
    "the light's path is not even: reconstruct --rest with a capture of the mirror at rest"
)
_CURE_AGAINST_REST = (
    "heights err by more than total_sigma; most likely the mirror moved between frames, or press and rest "
    "are not of one rig: hold it still, capture both again"
)


def circulation_chi2(data: Measured, state: State, gain: Floats) -> tuple[float, int]:
    """chi2 over its degrees of freedom, and how many there are, by the smallest blocks; by larger ones where
    these most exceed their limit (NaN, 0: no block is complete). gain (rows, cols): on the slopes' variances,
    see `holes.noise_gain`.
    """
    found = [(math.nan, 0)]
    variance = gain * (state.variances[0] + state.variances[1])
    if state.doubt is not None:
        variance += state.doubt.x**2 + state.doubt.y**2
    for block, scores in circulations(data.mask, state.slopes, variance):
        freedom = scores.size // (2 * block) ** 2
        if freedom > 1:
            found.append((float(np.mean(scores**2)), freedom))
    worst = max(found[1:], key=lambda one: one[0] / _limit(one[1]), default=found[0])
    return worst if contradicted(*worst) else found[:2][-1]


def circulations(mask: Mask, slopes: tuple[Floats, Floats], variance: Floats) -> list[tuple[int, Floats]]:
    """Mean circulations over their standard deviation, (n,), of blocks of 4, 8, ... pixels without a hole.
    variance (rows, cols): of both slopes together."""
    window = tuple(
        slice((size - min(size, _LARGEST)) // 2, (size + min(size, _LARGEST)) // 2) for size in mask.shape
    )
    inside = np.ascontiguousarray(mask[window])
    p, q = (np.ascontiguousarray(part[window]) for part in slopes)
    gx, gy = increments(p, q, inside)
    squares = gx[:-1, :-1] - gx[1:, :-1] + gy[:-1, 1:] - gy[:-1, :-1]
    # running sums must exceed the rounding of what went through them
    spread = np.minimum(variance[window], _MOST * middle(variance, mask))
    found, block, lost = [], _SMALLEST, None if inside.all() else (~inside).astype(np.float64)
    while block <= min(inside.shape) // 4:
        wide = 2 * block
        mean, limits = _boxes(_boxes(squares, block), block), _boxes(spread, wide)
        here = slice(min(len(mean), len(limits))), slice(min(mean.shape[1], limits.shape[1]))
        limits *= 2.0 * (2.0 * block**2 + 1.0) / (3.0 * block**2) * block**4 / wide**2
        score = mean[here] / np.sqrt(limits, out=limits)[here]
        found.append((block, score.ravel() if lost is None else score[_boxes(lost, wide)[here] < 0.5]))
        block = wide
    return found


def _boxes(values: Floats, size: int) -> Floats:
    """Sums over all squares of size x size."""
    sums = cv2.boxFilter(values, cv2.CV_64F, (size, size), anchor=(0, 0), normalize=False)
    rows, cols = values.shape
    return np.ascontiguousarray(sums[: rows - size + 1, : cols - size + 1])


def _limit(freedom: int) -> float:
    """Of chi2 over its degrees of freedom by chance, for errors up to _TRUST times sigma."""
    if freedom == 0:
        return math.inf
    return _TRUST**2 * float(scipy.special.chdtri(freedom, _CHANCE)) / freedom


def contradicted(chi2: float, freedom: int) -> bool:
    """Whether noise does not explain the slopes."""
    return chi2 > _limit(freedom)


def circulation_test(chi2: float | None, freedom: int, rig: bool, rest: bool, likely: bool) -> Judged | None:
    """Whether noise explains the slopes; rig: or errors of the rig, which chi2 is without; rest: of heights
    against a rest capture; likely: such a rig is, so that heights lie within total sigma whatever is left."""
    if chi2 is None:
        return None
    words = f"The slopes contradict each other; chi2 over its {freedom} degrees of freedom"
    cure = _CURE_AGAINST_REST if rest else _CURE_BESIDE_RIG if rig else _CURE
    return Judged("circulation", chi2, math.inf if likely else _limit(freedom), words, cure)
