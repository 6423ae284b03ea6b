"""What a display or a camera does that no sequence says, told by what fringes cannot look like: a display so
slow that a frame still holds a share of the one before it, and what samples contradict each other by."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .frames import Light
from .noise import Noise, Sample, product, trimmed_variance
from .plan import Fringe, Plan

__all__ = ["misfit_within", "noisier", "share_before", "without_before"]

F64 = NDArray[np.float64]
#: Pixels that are asked at most, and at least.
_ASKED, _FEWEST = 512, 64
#: Share of the noise's variance that a misfit has at least; deviations by which a share before is sure, and
#: rounds until it and the noise are told apart.
_BEYOND, _SURE, _ROUNDS = 0.2, 5.0, 5
_FAINT = 1e-9


def misfit_within(fringe: Fringe, lit: Sample, noise: Noise) -> float:
    """Variance of a fringe's samples beyond noise, of the bulk of pixels, over its squared amplitude.

    What harmonics of a response leave there is no part of it (they do a phase no harm unless they alias), nor
    is what chance may be; of three samples nothing is known.
    """
    design, few = fringe.design(), _whole(lit, fringe.index)
    freedom, (count, pixels) = len(design) - 3, (len(design), few.levels.shape[1])
    if freedom < 1 or pixels < _FEWEST:
        return 0.0
    levels = few.levels[list(fringe.index)].astype(np.float64)
    fit, waves = _harmonics(design, levels)
    left = _apart(levels - product(design, fit), waves)
    own = few.variance(noise) * (freedom / count)
    times = trimmed_variance((left / np.sqrt(own)).ravel())
    chance = max(_BEYOND, 3 * float(np.sqrt(2 / (freedom * pixels))))
    power = np.square(fit[1:]).sum(axis=0) + _FAINT
    return (times - 1) * float(np.median(few.variance(noise) / power)) if times > 1 + chance else 0.0


def share_before(plan: Plan, lit: Sample) -> float:
    """Share s of the frame before in every frame, I_i = (1 - s) L_i + s I_(i-1); below 0: overdriven.

    What no fringe of L looks like is s times as large of the frames before as of the frames themselves, in
    all fringes of more than three samples but that with the first frame. 0 where they do not agree, or where
    exposures differ.
    """
    every = [fringe for axis in plan.axes for fringe in axis.fringes]
    fringes = [f for f in every if len(f.index) > 3 and min(f.index) > 0]
    alike = all((fringe.exposure == 1).all() for fringe in every)
    told = np.array([_share_of(fringe, lit) for fringe in fringes if alike]).reshape(-1, 2)
    told = told[np.isfinite(told).all(axis=1)]
    if not len(told):
        return 0.0
    shares, deviation = told.T
    weights = deviation**-2 / np.sum(deviation**-2)
    share = float(weights @ shares)
    agree = (np.abs(shares - share) < np.maximum(_SURE * deviation, 0.5 * abs(share))).all()
    return share if agree and _SURE * float(np.sum(deviation**-2)) ** -0.5 < abs(share) < 0.5 else 0.0


def _share_of(fringe: Fringe, lit: Sample) -> tuple[float, float]:
    """The share that one fringe tells, and its deviation; NaN where the frames before it are its own, or
    where too few pixels are whole in these."""
    design, index = fringe.design(), np.array(fringe.index)
    levels = _whole(lit, np.union1d(index, index - 1)).levels.astype(np.float64)
    if levels.shape[1] < _FEWEST:
        return np.nan, np.nan
    fit, waves = _harmonics(design, levels[index])
    waves = np.concatenate([fit, waves])
    rows = np.linalg.qr(design, mode="complete")[0][:, 3:].T
    found = _apart(product(rows, levels[index]), waves)
    before = _apart(product(rows, levels[index - 1]), waves)
    # noise is in both, and a frame's is in what stands before the next one
    shared = float((rows[:, 1:] * rows[:, :-1])[:, np.diff(index) == 1].sum()) * levels.shape[1]
    own = float(found.size)
    both, square = float(np.sum(found * before)), float(np.sum(before * before))
    share, noise = 0.0, 0.0
    for _ in range(_ROUNDS):
        share = (both - noise * shared) / max(square - noise * own, _FAINT)
        left = float(np.sum(np.square(found - share * before)))
        noise = left / (own * (1 + share**2) - 2 * share * shared)
    seen = square - noise * own
    sure = seen > _SURE * noise * np.sqrt(2 * own)
    return (share, float(np.sqrt(noise / seen))) if sure else (np.nan, np.nan)


def without_before(light: Light, plan: Plan, share: float) -> Light:
    """Frames without what they hold of the one before; of fringes, saturated where either is."""
    raw, clipped = light.raw.astype(np.float32), light.raw >= light.clip
    mended = raw.copy()
    mended[1:] -= np.float32(share) * raw[:-1]
    mended[1:] /= np.float32(1 - share)
    # bits are compared: what a saturated frame leaves in them changes no sign
    fringes = [fringe for axis in plan.axes for fringe in (*axis.fringes, *axis.singles)]
    for i in {i for fringe in fringes for i in fringe.index if i > 0}:
        clipped[i] |= raw[i - 1] >= light.clip
    highest = float(light.clip / (1 - max(share, 0.0)))
    mended[clipped] = highest
    return replace(light, raw=mended, clip=highest, rounding=light.rounding * noisier(share))


def noisier(share: float) -> float:
    """Variance of a sample without its share of the one before, over that of a sample."""
    return (1 + share**2) / (1 - share) ** 2


def _whole(lit: Sample, frames: Any) -> Sample:
    """Some of the pixels that are not saturated in any of these frames."""
    whole = np.flatnonzero((lit.levels[list(frames)] < lit.white).all(axis=0))
    return lit.only(whole[:: max(1, len(whole) // _ASKED)])


def _harmonics(design: F64, levels: F64) -> tuple[F64, F64]:
    """Offset, c and s (3, K); cos and sin of 2 psi and 3 psi, times the amplitude (4, K)."""
    fit = product(np.linalg.pinv(design), levels)
    wave = fit[1] + 1j * fit[2]
    unit = wave / (np.abs(wave) + _FAINT)
    return fit, np.stack([part for one in (wave * unit, wave * unit**2) for part in (one.real, one.imag)])


def _apart(residuals: F64, waves: F64) -> F64:
    """Residuals (M, K) without what the waves (W, K) explain of them."""
    shares = product(product(residuals, waves.T), np.linalg.pinv(product(waves, waves.T), hermitian=True))
    left: F64 = residuals - product(shares, waves)
    return left
