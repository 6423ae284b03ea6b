"""Do the slopes contradict each other beyond their noise? A surface's slopes sum to zero around any block.

Around four pixels (the curl) more than noise is a wrong pixel. The mean over neighbouring blocks is zero,
too: independent noise of variance v per slope leaves in that over B x B blocks of B x B pixels the variance
8/3 v (1 + 1/(2 B^2)), whatever B. A smooth contradiction (a camera that looks elsewhere, a pitch
that is wrong) adds up over a block's area, and errors that neighbours share leave more, the larger the
block, until it holds them all: blocks of 4, 8, 16, ... pixels are looked at. What chi2 exceeds its degrees of
freedom by multiplies the height's variance (Birge's ratio, doi:10.1103/PhysRev.40.207): in two dimensions
every octave of wavelengths adds the same to a height, and what has a curl has a part without one as large.
"""

import math

import numpy as np
import scipy.ndimage
import scipy.special

from optolever.notices import Notice

from ..arrays import Floats, Mask
from ..measured import Measured
from ..solver.edges import curl, increments
from ..solver.newton import State

__all__ = [
    "chi2_limit",
    "circulation_chi2",
    "circulations",
    "contradiction",
    "curl_scale",
    "curl_score",
    "outliers",
]

_SUSPECT = 0.01  # chance of a right image to hold a suspect
_ROUNDS = 8  # of a suspect beside another
_CALM = 0.3  # quantile of the pixels around that other wrong pixels nearby leave alone
_STANDS_OUT = 30.0  # times that quantile
_SMALLEST = 4  # pixels: below it an edge's four slopes overlap
_MOST = 1e6  # of the median variance: the cap
_LARGEST = 512  # rows or columns: of larger images the middle is looked at
_CHANCE = 1e-4  # of right geometry to be called wrong, by each size of blocks
_TRUST = 1.15  # error over sigma that the decoder may have
_CURE = (
    "likely the scene (pose of camera or pattern, pitch, lens): calibrate it, or give a capture of the "
    "mirror at rest (--rest); else the mirror moved between frames, or sigma is too small"
)
_CURE_BESIDE_RIG = (
    "errors of the rig within its accuracy do not explain it: the mirror moved between frames, the medium is "
    "not even (take a rest capture: --rest), or sigma is too small"
)


def curl_score(p: Floats, q: Floats, var_p: Floats, var_q: Floats, mask: Mask) -> Floats:
    """Curl of the square (i, j) .. (i + 1, j + 1) over its standard deviation, (H, W);
    NaN where a corner is masked.
    """
    total = var_p + var_q
    around = np.full(total.shape, np.nan)
    around[:-1, :-1] = 0.25 * (total[:-1, :-1] + total[1:, :-1] + total[:-1, 1:] + total[1:, 1:])
    score: Floats = curl(p, q, mask) / np.sqrt(around)
    return score


def curl_scale(score: Floats) -> float:
    """Robust standard deviation of the score (1 for noise as announced), from at most a million squares."""
    sample = np.abs(score[:: max(1, score.shape[0] // 512)])
    sample = sample[np.isfinite(sample)]
    return 1.4826 * float(np.median(sample)) if sample.size else float("nan")


def outliers(score: Floats, scale: float, data: Measured, bridged: Mask) -> Mask:
    """Wrong pixels, (H, W), by the scores of scale `scale`; bridged: pixels that cannot be to blame.

    A wrong pixel spoils the four squares around it: their sum of squares is over what one image of a hundred
    holds by chance. The scores of two squares that share a corner alone are correlated by -1/4, of two that
    share a side not at all: the four add up to 1.25 chi2(2) + 0.75 chi2(2), whose tail is 2.5 exp(-x / 2.5).
    Of neighbours it is the one that a cubic through the others misses most. Found ones clear their squares,
    and what remains is looked at again.
    """
    seen = np.isfinite(score)
    least = 2.5 * math.log(2.5 * max(int(np.count_nonzero(seen)), 1) / _SUSPECT)
    least *= max(1.0, scale) ** 2 if math.isfinite(scale) else 1.0
    evidence = np.minimum(np.square(np.nan_to_num(score, nan=0.0, posinf=1e6, neginf=-1e6)), 1e12)
    # on a border a pixel has two squares: as much evidence in these as an inner pixel has in four
    share = 4.0 / np.maximum(_around(seen.astype(np.float64)), 1.0)
    found: Mask = np.zeros(score.shape, dtype=np.bool_)
    rough = None
    for _ in range(_ROUNDS):
        total = np.where(bridged | found, 0.0, _around(evidence) * share)
        more = total > least
        if not more.any():
            break
        if rough is None:
            rough = np.maximum(_missed(data.u) / data.sigma_u, _missed(data.v) / data.sigma_v)
        rank = np.where(more, np.nan_to_num(rough), 0.0)
        found |= more & (rank >= scipy.ndimage.maximum_filter(rank, 3))
        touched = scipy.ndimage.maximum_filter(found, 2, origin=-1)
        evidence[touched] = 0.0
    return found if rough is None else _lone(found & data.mask, rough)


def _around(evidence: Floats) -> Floats:
    """Sum over the four squares that hold a pixel."""
    total = evidence.copy()
    total[1:] += evidence[:-1]
    total[:, 1:] += evidence[:, :-1]
    total[1:, 1:] += evidence[:-1, :-1]
    return total


def _lone(suspects: Mask, rough: Floats) -> Mask:
    """Suspects that are out of line with smooth surroundings: wrong pixels, not a cusp, a crease or a fold,
    (H, W).

    rough (H, W): what a cubic through the neighbours misses, over sigma: many times the calmer third of the 5
    x 5 pixels around. A feature of the surface is missed by as much all along.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(rough, 2, constant_values=np.nan), (5, 5))
    around = windows[suspects].reshape(-1, 25)
    around[np.isnan(around).all(axis=1)] = 0.0
    single = np.zeros_like(suspects)
    single[suspects] = around[:, 12] > _STANDS_OUT * np.nanquantile(around, _CALM, axis=1)
    return single


def _missed(field: Floats) -> Floats:
    """|value - cubic through its neighbours|, (H, W): the mean of both axes, or the one that is known."""
    fourth = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
    one, other = (scipy.ndimage.correlate1d(field, fourth, k, mode="constant", cval=np.nan) for k in (0, 1))
    both = 0.5 * (np.where(np.isnan(one), other, one) + np.where(np.isnan(other), one, other))
    return np.asarray(np.abs(both))


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
    worst = max(found[1:], key=lambda one: one[0] / chi2_limit(one[1]), default=found[0])
    return worst if contradiction(*worst) else found[:2][-1]


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
    # sums are differences of cumulative sums: they must exceed the rounding of these
    spread = np.minimum(variance[window], _MOST * float(np.median(variance[mask])))
    found, block = [], _SMALLEST
    while block <= min(inside.shape) // 4:
        wide = 2 * block
        mean = _boxes(_boxes(squares, block), block) / block**2
        here = slice(mean.shape[0]), slice(mean.shape[1])
        limits, holes = (_boxes(part, wide)[here] for part in (spread, (~inside).astype(np.float64)))
        mean = mean[: len(limits), : limits.shape[1]]
        score = mean / np.sqrt(limits / wide**2 * 2.0 * (2.0 * block**2 + 1.0) / (3.0 * block**2))
        found.append((block, score[holes < 0.5]))
        block = wide
    return found


def _boxes(values: Floats, size: int) -> Floats:
    """Sums over all squares of size x size."""
    total = np.pad(values, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    boxes: Floats = total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
    return boxes


def chi2_limit(freedom: int) -> float:
    """Limit of chi2 over its degrees of freedom by chance, for errors up to _TRUST times sigma."""
    if freedom == 0:
        return math.inf
    return _TRUST**2 * float(scipy.special.chdtri(freedom, _CHANCE)) / freedom


def contradiction(chi2: float | None, freedom: int, rig: bool = False) -> tuple[Notice, ...]:
    """The notice that noise does not explain the slopes, if that is so; rig: nor errors of the rig, which
    chi2 holds."""
    if chi2 is None or not chi2 > chi2_limit(freedom):
        return ()
    name = f"slopes contradict each other beyond noise, chi2 per degree of freedom ({freedom})"
    return (Notice(name, chi2, chi2_limit(freedom), _CURE_BESIDE_RIG if rig else _CURE),)
