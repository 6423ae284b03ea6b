"""Do the slopes contradict each other beyond their noise? The circulation around blocks of pixels as a chi2.

Along lines of pixels, some apart, the edges' defects are summed from crossing to crossing of the lines: N
sums with independent noise, whose variances are the sums of the edges'. A mirror makes any of them a
difference of two heights, so that the K sums around the blocks between the lines hold noise alone. With their
covariance C (a block's four variances; minus the shared side's for two neighbours)

    chi2 = circulations . C^-1 circulations

has K degrees of freedom; it is what the least-squares heights of the crossings leave. Pixels share noise
where lines cross and at the ends of sums only. A smooth contradiction (a camera that looks elsewhere, a pitch
that is wrong) adds up over a block's area, noise over its rim: blocks tell what single pixels do not, few
large blocks most clearly what is the same all over the image, so that lines twice as far apart are looked at,
too, and so on. The
defects are those of the solution, in units of its integrating factor, in which its own errors drop out to
first order.
"""

import math

import numpy as np
import scipy.linalg
import scipy.special

from optolever.notices import Notice

from .arrays import Floats, Ints
from .edges import defects, edge_weights
from .measured import Measured
from .newton import State

__all__ = ["chi2_limit", "circulation_chi2", "contradiction"]

_LINES = 24  # along the longer side: a dense covariance of (24 - 1)^2 blocks at most
_LEAST = 8  # pixels apart: the ends of sums share what is 0.3 pixels' noise
_CHANCE = 1e-4  # of right geometry to be called wrong, by each distance of lines
_TRUST = 1.15  # error over sigma that the decoder may have
_CURE = (
    "likely the scene (pose of camera or pattern, pitch, lens): calibrate it, or give a capture of the "
    "mirror at rest (--rest); else the mirror moved between frames, or sigma is too small"
)


def circulation_chi2(data: Measured, state: State) -> tuple[float, int]:
    """chi2 over its degrees of freedom, and how many there are, by the finest lines; by coarser ones where
    these alone, or these most, exceed their limit (NaN, 0: no block is whole).
    """
    mask = data.mask
    p, q = data.slopes(state.w)[:2]
    edges = (
        *defects(p, q, state.w, state.root, mask),
        *edge_weights(*state.variances, state.root, mask, state.doubt),
    )
    step = max(_LEAST, math.ceil(max(mask.shape) / _LINES))
    found = []
    while step < min(mask.shape):
        found.append(_between_lines(edges, step))
        step *= 2
    found = [one for one in found if one[1] > 0] or [(math.nan, 0)]
    worst = max(found, key=lambda one: one[0] / chi2_limit(one[1]))
    return worst if contradiction(*worst) else found[0]


def _between_lines(edges: tuple[Floats, ...], step: int) -> tuple[float, int]:
    """chi2 over its degrees of freedom, and these, of blocks between lines `step` pixels apart; edges:
    defects and weights along columns and rows."""
    gx, gy, wx, wy = edges
    rows, cols = (np.arange((size - 1) % step // 2, size, step) for size in gx.shape)
    along, along_variance = _sums(gx[rows], wx[rows], cols)
    down, down_variance = (part.T for part in _sums(gy[:, cols].T, wy[:, cols].T, rows))
    around = along[:-1] + down[:, 1:] - along[1:] - down[:, :-1]
    total = along_variance[:-1] + along_variance[1:] + down_variance[:, :-1] + down_variance[:, 1:]
    whole = np.isfinite(around)
    count = int(np.count_nonzero(whole))
    if count == 0:
        return math.nan, 0
    index = np.full(whole.shape, -1)
    index[whole] = np.arange(count)
    covariance = np.diag(total[whole])
    for first, second, shared in (
        (index[:-1], index[1:], along_variance[1:-1]),
        (index[:, :-1], index[:, 1:], down_variance[:, 1:-1]),
    ):
        both = (first >= 0) & (second >= 0)
        a, b = first[both], second[both]
        covariance[a, b] = covariance[b, a] = -shared[both]
    scale = 1.0 / np.sqrt(total[whole])
    factor = scipy.linalg.cho_factor(covariance * scale[:, None] * scale)
    score = around[whole] * scale
    return float(score @ scipy.linalg.cho_solve(factor, score)) / count, count


def chi2_limit(freedom: int) -> float:
    """What chi2 over its degrees of freedom stays below by chance, if sigma is what the decoder promises."""
    if freedom == 0:
        return math.inf
    return _TRUST**2 * float(scipy.special.chdtri(freedom, _CHANCE)) / freedom


def contradiction(chi2: float | None, freedom: int) -> tuple[Notice, ...]:
    """The notice that noise does not explain the slopes, if that is so."""
    if chi2 is None or not chi2 > chi2_limit(freedom):
        return ()
    name = f"slopes contradict each other beyond noise, chi2 per degree of freedom ({freedom})"
    return (Notice(name, chi2, chi2_limit(freedom), _CURE),)


def _sums(g: Floats, weight: Floats, ends: Ints) -> tuple[Floats, Floats]:
    """Sums of edge data (lines, pixels) from end to end, and of the edges' variances; NaN where one is
    missing.
    """
    variance = np.divide(1.0, weight, out=np.full(weight.shape, np.nan), where=weight > 0)
    total, spread = (
        np.add.reduceat(part, ends, axis=1)[:, :-1] for part in (np.where(weight > 0, g, np.nan), variance)
    )
    return total, spread
