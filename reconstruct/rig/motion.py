"""The motion of a rig between two captures, estimated from the part of the mirror that nothing presses.

Block means y of press minus rest are modelled as

    y = F theta + S s + G c + noise

theta: rigid motions of camera, image and pattern, in units of their priors, F their fields; s: sag of the
body under load; c: a dent's skirt, a smooth random height. F, S and G are differences of the exact
geometry at rest. Only blocks below a threshold of activity enter: the others belong to the contact. The
skirt's amplitude and length and the prior's width are averaged over by their evidence (marginal likelihood),
so that a motion which a skirt could mimic keeps its prior. A field that is no slope of any height, or that a
skirt as large as the quiet blocks allow cannot make, is the motion's.

MacKay, Bayesian interpolation, Neural Computation 4 (1992); Hoeting et al., Bayesian model averaging,
Statistical Science 14 (1999).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy import ndimage, stats

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.scene import Scene

from ..arrays import Floats, Pair
from .motion_fields import (
    MotionPrior,
    bump_heights,
    filled,
    height_fields,
    height_sensitivity,
    interpolated,
    mirror_place,
    rigid_sensitivity,
    sag_heights,
)

__all__ = ["Motion", "fit_motion", "same_capture"]

_NODES = 13  # of the fields along rows and columns, which are smooth: cubic splines lie between them
_BLOCKS = 20  # along the image's longer side
_SMALLEST = 3  # pixels on a side of a block
_KEPT = 1e-3  # of the noise of the mean of all blocks: weaker combinations of parameters have no field
_SKIRTS = (0.15, 0.3, 0.6, 1.2)  # lengths of a skirt's bumps, of the mirror's shorter side
_FIRST = 2  # of these lengths may be the shortest of a skirt
_AMPLITUDES = 3.0 ** np.arange(-3, 8)  # of a skirt, of the noise of a block
_WIDER = ((1.0, 0.97), (5.0, 0.02), (30.0, 0.01))  # of the prior, and how likely: rigs are knocked
_SHARES = (1.0, 0.85, 0.7, 0.5, 0.35, 0.25)  # of the blocks that are taken as quiet
_ROUNDS = 40  # of the robust fit, whose scale falls from the largest residual to the noise
_LIMIT = 3.0  # prior standard deviations
_GAIN = 0.1  # of the field's variance
_CHANCE = 4.0  # standard deviations of a mean square
_MISFIT = 0.1  # of the activity: second-order effects of a dent, and details below the bumps' length
_UNKNOWN = 1e-3  # of the prior's variance: combinations that the captures do not determine
_WEAK = 1e-3  # of the largest mode
_SAME = 0.02  # standard deviations of the noise


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """names (p,), values (p,) and covariance (p, p) of the rigid motions, px, mm and rad; prior (p,): their
    standard deviations before. chi2: mean square of the quiet blocks' residuals over their noise; NaN where
    no block is quiet. quiet: share of the blocks. notices: of a motion beyond its prior.
    sensitivity (p, 4, rows, cols): d(u, v, row, col)/d(parameter) on nodes of the image, of the pattern's
    coordinates at rest and of the place where a pixel looks at the mirror. gradient (2, 2, H, W): of press
    minus rest, d(u, v)/d(row, col); 0 where it is unknown.
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    prior: Floats
    chi2: float
    quiet: float
    notices: tuple[Notice, ...]
    sensitivity: Floats
    gradient: Floats

    def field(self) -> Pair:
        """Change (du, dv) of the pressed correspondence by the motion, (H, W) pattern pixels.

        The sag is no part of it: it is a height of the mirror.
        """
        du, dv = self._fields(self.values[None], 1)[0]
        return du, dv

    def modes(self, step: int = 1) -> Floats:
        """Independent errors (k, 2, rows, cols) of `field` on every step-th pixel, of variance 1, the largest
        first."""
        variances, vectors = np.linalg.eigh(self.covariance / np.outer(self.prior, self.prior))
        roots = (np.sqrt(np.maximum(variances, 0.0)) * vectors * self.prior[:, None]).T
        lever = np.ones(4)
        lever[2:] = np.sqrt(np.mean(self.gradient**2))
        effects = np.tensordot(roots, self.sensitivity * lever[:, None, None], 1).reshape(len(roots), -1)
        turn, sizes, _ = np.linalg.svd(effects, full_matrices=False)
        some = sizes > _WEAK * sizes.max(initial=0.0)
        return self._fields(turn[:, some].T @ roots, step)

    def drift(self) -> tuple[float, float]:
        """Distance of the values from 0 by the noise of their estimate alone, and the limit that chance
        passes once in 370 captures of a rig that stands still."""
        scale = np.outer(self.prior, self.prior)
        variances, vectors = np.linalg.eigh(self.covariance / scale)
        measured = variances < 1.0 - _UNKNOWN
        estimate = ((self.values / self.prior) @ vectors)[measured]
        # a posterior of variance c about a prior of variance 1 has a mean of variance c (1 - c) by noise
        noise = variances[measured] * (1.0 - variances[measured])
        size = float(np.sqrt(np.sum(estimate**2 / np.maximum(noise, 1e-300))))
        return size, _chance(float(len(estimate)))

    def _fields(self, values: Floats, step: int) -> Floats:
        """Fields (k, 2, rows, cols) of motions (k, p)."""
        shape = (self.gradient.shape[2], self.gradient.shape[3])
        at = tuple(np.arange(0.0, size, step) for size in shape)
        moved = interpolated(np.tensordot(values, self.sensitivity, 1), shape, at)  # type: ignore[arg-type]
        gradient = self.gradient[:, :, ::step, ::step]
        field: Floats = moved[:, :2] + moved[:, 2:3] * gradient[0] + moved[:, 3:] * gradient[1]
        return field


class _Blocks(NamedTuple):
    """Means (2, rows, cols) of press minus rest over blocks of pixels, their standard deviations (inf where
    a block has no mean), and the blocks' centres along rows and columns, pixels."""

    mean: Floats
    sigma: Floats
    row: Floats
    col: Floats


class _Posterior(NamedTuple):
    mean: Floats
    covariance: Floats
    chi2: float


def fit_motion(
    pressed: Correspondence, rest: Correspondence, scene: Scene, accuracy: MotionPrior | None = None
) -> Motion:
    """The rig's motion between the capture of the mirror at rest and the one of the pressed mirror.

    The prior is the answer (values 0) where the mirror is pressed all over.
    """
    prior = MotionPrior() if accuracy is None else accuracy
    shape = (scene.camera.rows, scene.camera.cols)
    for name, each in (("pressed", pressed), ("rest", rest)):
        if each.u.shape != shape:
            size = f"{each.u.shape[0]} x {each.u.shape[1]} pixels"
            raise InputError(f"{name}: {size}, the scene's camera has {shape[0]} x {shape[1]}")
    nodes = tuple(np.linspace(0.0, size - 1.0, min(size, _NODES)) for size in shape)
    row, col = np.meshgrid(*nodes, indexing="ij")
    names, scales, sensitivity = rigid_sensitivity(scene, row, col, prior)
    blocks = _block_means(pressed, rest)

    def at_blocks(fields: Floats) -> Floats:
        return interpolated(fields, shape, (blocks.row, blocks.col))

    fields = at_blocks(sensitivity[:, :2] * scales[:, None, None, None])
    basis = _combinations(fields, blocks)
    reduced = np.tensordot(basis, fields, 1)
    (x, y), by_height = (
        at_blocks(filled(part(scene, row, col))) for part in (mirror_place, height_sensitivity)
    )
    sag = prior.sag * height_fields(by_height, sag_heights(scene, x, y))
    side = float(min(np.ptp(x), np.ptp(y)))
    skirts = [height_fields(by_height, bump_heights(x, y, share * side)) for share in _SKIRTS]
    found, quiet = _estimate(blocks, reduced, sag, skirts)
    unit = np.eye(len(names)) - basis.T @ (np.eye(len(basis)) - found.covariance) @ basis
    values = scales * (found.mean @ basis)
    return Motion(
        names,
        values,
        unit * np.outer(scales, scales),
        scales,
        found.chi2,
        quiet,
        _notices(found, reduced, by_height, side),
        sensitivity,
        _gradient(pressed, rest),
    )


def same_capture(pressed: Correspondence, rest: Correspondence) -> bool:
    """Whether both are one capture: they differ by less than a fiftieth of their noise, so that no second
    exposure can have made them."""
    both = pressed.good & rest.good
    if pressed.u.shape != rest.u.shape or not both.any():
        return False
    squares = [
        (getattr(pressed, axis)[both] - getattr(rest, axis)[both]).astype(np.float64) ** 2
        / (getattr(pressed, f"sigma_{axis}")[both] ** 2 + getattr(rest, f"sigma_{axis}")[both] ** 2)
        for axis in ("u", "v")
    ]
    known = [each[np.isfinite(each)] for each in squares]
    return all(float(np.mean(each)) < _SAME**2 for each in known if each.size)


def _gradient(pressed: Correspondence, rest: Correspondence) -> Floats:
    """d(u, v)/d(row, col) (2, 2, H, W) of press minus rest, where it stands out of the noise."""
    both = pressed.good & rest.good
    parts: list[Floats] = []
    for axis in ("u", "v"):
        change = np.where(both, getattr(pressed, axis) - getattr(rest, axis), np.nan)
        variance = 0.5 * (getattr(pressed, f"sigma_{axis}") ** 2 + getattr(rest, f"sigma_{axis}") ** 2)
        slopes = np.stack([np.gradient(change, axis=along) for along in (0, 1)])
        with np.errstate(invalid="ignore"):
            parts.append(np.where(slopes**2 > _LIMIT**2 * variance, slopes, 0.0))
    return np.stack(parts, axis=1)


def _block_means(pressed: Correspondence, rest: Correspondence) -> _Blocks:
    """Over the pixels that are good in both; other blocks, of fewer than half good pixels, have none."""
    rows, cols = pressed.u.shape
    size = max(_SMALLEST, -(-max(rows, cols) // _BLOCKS))
    starts = [np.arange(0, max(1, length - size // 2), size) for length in (rows, cols)]
    ends = [np.append(start[1:], length) for start, length in zip(starts, (rows, cols), strict=True)]
    both = pressed.good & rest.good
    area = np.outer(*(end - start for start, end in zip(starts, ends, strict=True)))

    def sums(values: Floats) -> Floats:
        total: Floats = np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1)
        return total

    means, sigmas = [], []
    for axis in ("u", "v"):
        with np.errstate(invalid="ignore"):
            change = getattr(pressed, axis).astype(np.float64) - getattr(rest, axis)
            variance = getattr(pressed, f"sigma_{axis}").astype(np.float64) ** 2
            variance = variance + getattr(rest, f"sigma_{axis}").astype(np.float64) ** 2
        known = both & np.isfinite(change) & np.isfinite(variance)
        count = sums(known.astype(np.float64))
        enough = count >= 0.5 * area
        with np.errstate(invalid="ignore", divide="ignore"):
            means.append(np.where(enough, sums(np.where(known, change, 0.0)) / count, 0.0))
            noise = np.sqrt(sums(np.where(known, variance, 0.0))) / count
        sigmas.append(np.where(enough & (noise > 0), noise, np.inf))
    centres = [0.5 * (start + end - 1) for start, end in zip(starts, ends, strict=True)]
    return _Blocks(np.stack(means), np.stack(sigmas), centres[0], centres[1])


def _combinations(fields: Floats, blocks: _Blocks) -> Floats:
    """Combinations (k, p) of parameters in units of their priors whose fields stand out of the noise, by
    singular values."""
    whitened = (fields / blocks.sigma).reshape(len(fields), -1)
    if not len(fields) or not np.isfinite(blocks.sigma).any():
        return np.zeros((0, len(fields)))
    vectors, sizes, _ = np.linalg.svd(whitened, full_matrices=False)
    return vectors[:, sizes > max(_KEPT, 1e-9 * sizes.max(initial=0.0))].T


def _estimate(blocks: _Blocks, fields: Floats, sag: Floats, skirts: list[Floats]) -> tuple[_Posterior, float]:
    """The motion's posterior in units of its prior, and the share of the blocks that are quiet.

    fields (k, 2, rows, cols), sag and each of the skirts likewise. A smaller share is taken where it lowers
    the variance by far: the least of several variances is small by chance as well.
    """
    size = len(fields)
    best, quiet = _Posterior(np.zeros(size), np.eye(size), float("nan")), 0.0
    known = np.isfinite(blocks.sigma)
    if not size or not known.any():
        return best, quiet
    noise = blocks.sigma[known].mean()
    heights = np.concatenate([sag, *(noise * skirt / _rms(skirt[:, known]) for skirt in skirts)])
    lengths = np.repeat(np.arange(-1, len(skirts)), [len(sag), *map(len, skirts)])
    priors = [
        np.where(lengths < 0, 1.0, np.where(lengths >= first, amplitude, 0.0))
        for first in range(_FIRST)
        for amplitude in _AMPLITUDES
    ]
    gram = np.tensordot(fields[:, known], fields[:, known], (1, 1))
    least = float(np.trace(gram))
    activity = _activity(blocks, fields)
    order = np.sort(activity[np.isfinite(activity)])
    for share in _SHARES:
        used = known & (activity <= order[max(0, int(share * len(order)) - 1)])
        sigma = (blocks.sigma * np.hypot(1.0, _MISFIT * activity))[used]
        found = _averaged(
            blocks.mean[used] / sigma, fields[:, used] / sigma, heights[:, used] / sigma, priors
        )
        fits = found.chi2 < 1.0 + _CHANCE * np.sqrt(2.0 / sigma.size)
        variance = float(np.sum(found.covariance * gram))
        if fits and variance < (_GAIN if quiet else 1.0) * least:
            best, quiet, least = found, share, variance
    return best, quiet


def _rms(fields: Floats) -> float:
    """Of the sum of fields (k, n) with independent factors of variance 1."""
    return max(float(np.sqrt((fields * fields).sum(axis=0).mean())), 1e-300)


def _activity(blocks: _Blocks, fields: Floats) -> Floats:
    """Residual (rows, cols) of a robust fit of the motion over the noise, the largest of 3 x 3 blocks; NaN
    where no block is."""
    known = np.isfinite(blocks.sigma)
    design = (fields[:, known] / blocks.sigma[known]).T
    y = blocks.mean[known] / blocks.sigma[known]
    widest = np.eye(len(fields)) / _WIDER[-1][0] ** 2
    motion = np.zeros(len(fields))
    for scale in np.geomspace(max(3.0, float(np.abs(y).max())), 3.0, _ROUNDS):
        weight = 1.0 / (1.0 + ((y - design @ motion) / scale) ** 2)
        motion = np.linalg.solve((design.T * weight) @ design + widest, (design.T * weight) @ y)
    left = np.zeros(blocks.mean.shape)
    left[known] = np.abs(y - design @ motion)
    worst = ndimage.maximum_filter(left.max(axis=0), 3)
    return np.where(known.any(axis=0), worst, np.nan)


def _averaged(y: Floats, fields: Floats, heights: Floats, priors: list[Floats]) -> _Posterior:
    """Mean and covariance of the motion, averaged over skirts and widths of the prior by their evidence.

    All in units of the blocks' noise: y (n,), fields (k, n), fields of sag and skirts heights (q, n); their
    prior standard deviations, (q,) each, of which one applies.
    """
    motion, others = fields @ fields.T, heights @ heights.T
    mixed, right_m, right_h = heights @ fields.T, fields @ y, heights @ y
    logs: list[float] = []
    means: list[Floats] = []
    covariances: list[Floats] = []
    for prior in priors:
        active = prior > 0
        scale = prior[active]
        factor = scipy.linalg.cholesky(
            np.eye(len(scale)) + others[np.ix_(active, active)] * np.outer(scale, scale), lower=True
        )
        scaled = scale[:, None] * np.column_stack([mixed[active], right_h[active]])
        root = scipy.linalg.solve_triangular(factor, scaled, lower=True)
        normal, right = motion - root[:, :-1].T @ root[:, :-1], right_m - root[:, :-1].T @ root[:, -1]
        explained = 0.5 * root[:, -1] @ root[:, -1] - np.log(np.diag(factor)).sum()
        for width, likely in _WIDER:
            covariance = np.linalg.inv(normal + np.eye(len(normal)) / width**2)
            mean = covariance @ right
            determinant = 0.5 * np.linalg.slogdet(covariance / width**2)[1]
            logs.append(explained + 0.5 * right @ mean + determinant + np.log(likely))
            means.append(mean)
            covariances.append(covariance)
    weight = np.exp(np.array(logs) - max(logs))
    weight /= weight.sum()
    mean = weight @ np.stack(means)
    apart = np.stack(means) - mean
    covariance = np.tensordot(weight, np.stack(covariances), 1) + (apart.T * weight) @ apart
    likeliest = int(np.argmax(weight))
    scale = priors[likeliest // len(_WIDER)]
    left = y - means[likeliest] @ fields
    height = scale * np.linalg.solve(
        np.eye(len(scale)) + others * np.outer(scale, scale), scale * (heights @ left)
    )
    return _Posterior(mean, covariance, float(np.mean((left - height @ heights) ** 2)))


def _chance(freedom: float) -> float:
    """Length that a vector of so many normal components exceeds as rarely as one exceeds 3."""
    return float(np.sqrt(stats.chi2.isf(2 * stats.norm.sf(_LIMIT), max(1.0, freedom))))


def _notices(found: _Posterior, fields: Floats, by_height: Floats, side: float) -> tuple[Notice, ...]:
    """Of a motion beyond three standard deviations of its prior."""
    size = float(np.sqrt(found.mean @ found.mean))
    determined = float(np.trace(np.eye(len(found.mean)) - found.covariance))  # degrees of freedom
    limit = _chance(determined)
    if not size > limit:
        return ()
    field = np.tensordot(found.mean, fields, 1)
    px = float(np.sqrt(np.nanmean(field**2)))
    lever = float(np.sqrt(np.nanmean(by_height[1:] ** 2)))  # px per slope
    height = 1e3 * px / lever * 0.5 * side
    name = (
        f"The rig moved between the rest capture and the press, by {px:.2g} pattern pixels (rms); "
        f"uncorrected, heights change by about {height:.2g} um; prior standard deviations"
    )
    cure = (
        "the motion is removed, its uncertainty is in the total sigma; clamp the rig, capture at rest again"
    )
    return (Notice(name, size, limit, cure),)
