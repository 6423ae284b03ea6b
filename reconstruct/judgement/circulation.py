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
from numpy.typing import NDArray

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
    "curl_limit",
    "curl_scale",
    "curl_score",
    "curl_suspects",
    "lone",
]

_SUSPECT = 0.01  # chance of a right image to hold a suspect
_NEAR, _SHARE = 4, 0.7  # reach of what lies around, and the share of it that wrong pixels leave alone
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


def curl_limit(score: Floats) -> float:
    """What the root of the evidence against a pixel (see `curl_suspects`) exceeds by chance in one image of a
    hundred.

    The scores of two squares that share a corner alone are correlated by -1/4, of two that share a side not
    at all: the four around a pixel add up to 1.25 chi2(2) + 0.75 chi2(2), whose tail is 2.5 exp(-x / 2.5).
    """
    squares = int(np.count_nonzero(np.isfinite(score)))
    return math.sqrt(2.5 * math.log(2.5 * max(squares, 1) / _SUSPECT))


def curl_suspects(score: Floats, limit: float, cleared: Mask) -> Mask:
    """Pixels to which the large curls point, (H, W).

    An outlier spoils the four squares around it, its neighbours share two of them or one; so a pixel is
    suspected if the sum of the squares' evidence is over limit^2 and largest among its neighbours, and far
    above that of the squares around: along a rim all have a curl. Suspects clear their squares, and what
    remains is looked at again. cleared (H, W): pixels that are interpolated and cannot be to blame.
    """
    evidence = np.square(np.nan_to_num(score, nan=0.0, posinf=1e150, neginf=-1e150))
    evidence = np.minimum(evidence, 1e12)
    # On a border a pixel has two squares: as much evidence in these as an inner pixel has in four.
    share = 4.0 / np.maximum(_around(np.isfinite(score).astype(np.float64)), 1.0)
    suspects: Mask = np.zeros(score.shape, dtype=np.bool_)
    dismissed = suspects.copy()
    for _ in range(8):
        total = np.where(cleared | dismissed, 0.0, _around(evidence) * share)
        over = total > limit**2
        if not over.any():
            break
        at = np.argwhere(over & (total >= scipy.ndimage.maximum_filter(total, 3)))
        alone = np.sqrt(total[tuple(at.T)]) > limit * np.maximum(1.0, _scale_around(score, at))
        suspects[tuple(at[alone].T)] = True
        dismissed[tuple(at[~alone].T)] = True
        evidence[_touched(suspects)] = 0.0
    return suspects


def _scale_around(score: Floats, at: NDArray[np.intp]) -> Floats:
    """Robust deviation of the scores around pixels (M, 2), but for the four that hold each."""
    near = np.arange(-_NEAR, _NEAR)
    rows, cols = at[:, 0, None, None] + near[:, None], at[:, 1, None, None] + near
    inside = (rows >= 0) & (rows < score.shape[0]) & (cols >= 0) & (cols < score.shape[1])
    inside[:, _NEAR - 1 : _NEAR + 1, _NEAR - 1 : _NEAR + 1] = False
    sizes = np.abs(np.where(inside, score[rows % score.shape[0], cols % score.shape[1]], np.nan))
    sizes = sizes.reshape(len(at), -1)
    sizes[np.isnan(sizes).all(axis=1)] = 0.0
    scale: Floats = np.nanquantile(sizes, _SHARE, axis=1) / scipy.special.ndtri(0.5 + 0.5 * _SHARE)
    return scale


def lone(suspects: Mask, data: Measured) -> Mask:
    """Suspects that are out of line with smooth surroundings: wrong pixels, not a cusp, a crease or a fold,
    (H, W).

    Measured by what a cubic through the neighbours misses, over sigma: many times the calmer third of the 5 x
    5 pixels around. A feature of the surface is missed by as much all along.
    """
    single = np.zeros_like(suspects)
    at = np.argwhere(suspects)
    if at.size:
        rough = np.maximum(_missed(data.u, data.sigma_u, at), _missed(data.v, data.sigma_v, at))
        around = rough.reshape(len(at), -1)
        around[np.isnan(around).all(axis=1)] = 0.0
        with np.errstate(invalid="ignore"):
            stands_out = around[:, around.shape[1] // 2] > _STANDS_OUT * np.nanquantile(around, _CALM, axis=1)
        single[tuple(at[stands_out].T)] = True
    return single


def _missed(field: Floats, sigma: Floats, at: NDArray[np.intp]) -> Floats:
    """|value - cubic through its neighbours| / sigma in the 5 x 5 pixels around each place, (M, 5, 5).

    The mean of the predictions along the row and along the column, or the one that the image's border leaves.
    """
    reach = np.arange(-4, 5)
    rows, cols = at[:, 0, None, None] + reach[:, None], at[:, 1, None, None] + reach
    inside = (rows >= 0) & (rows < field.shape[0]) & (cols >= 0) & (cols < field.shape[1])
    rows, cols = np.clip(rows, 0, field.shape[0] - 1), np.clip(cols, 0, field.shape[1] - 1)
    patch = np.where(inside, field[rows, cols], np.nan)
    middle = slice(2, 7)
    along, across = (_cubic(turned)[:, middle] for turned in (patch.transpose(0, 2, 1), patch))
    along = along.transpose(0, 2, 1)[:, middle]
    across = across[:, :, middle]
    one = np.where(np.isnan(along), across, along)
    other = np.where(np.isnan(across), along, across)
    missed: Floats = np.abs(patch[:, middle, middle] - 0.5 * (one + other))
    missed /= sigma[rows, cols][:, middle, middle]
    return missed


def _cubic(patch: Floats) -> Floats:
    """Prediction of rows 2 .. -3 from the two rows on either side (M, n, n); NaN in the others."""
    out = np.full(patch.shape, np.nan)
    near, far = patch[:, 1:-3] + patch[:, 3:-1], patch[:, :-4] + patch[:, 4:]
    out[:, 2:-2] = (4.0 * near - far) / 6.0
    return out


def _around(evidence: Floats) -> Floats:
    """Sum over the four squares that hold a pixel."""
    total = evidence.copy()
    total[1:] += evidence[:-1]
    total[:, 1:] += evidence[:, :-1]
    total[1:, 1:] += evidence[:-1, :-1]
    return total


def _touched(pixels: Mask) -> Mask:
    """Squares that hold one of the pixels."""
    squares = pixels.copy()
    squares[:-1] |= pixels[1:]
    squares[:, :-1] |= pixels[:, 1:]
    squares[:-1, :-1] |= pixels[1:, 1:]
    return squares


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
    # block sums are differences of cumulative sums: they must exceed the rounding of these
    both = np.minimum(variance[window], _MOST * float(np.median(variance[mask])))
    sums, spread, holes = (_sums(gx, 1), _sums(gy, 0)), _area(both), _area((~inside).astype(np.float64))
    found, block = [], _SMALLEST
    while block <= min(inside.shape) // 4:
        found.append((block, _scores(sums, spread, holes, block)))
        block *= 2
    return found


def _scores(sums: tuple[Floats, Floats], variance: Floats, holes: Floats, block: int) -> Floats:
    """Mean circulations over their standard deviation, where there is no hole."""
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
    whole: Floats = score[_boxes(holes, wide)[here] < 0.5]
    return whole


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
