"""Statistics of sample pixels of a capture: they test whether a profile of the rig still holds."""

import numpy as np
from numpy.typing import NDArray

from optolever.notices import Notice

from .axis import Setup
from .correspondence import Correspondence
from .frames import Light, sample_places
from .plan import AxisPlan, Plan, constraints
from .profile.noise import Sample, modulation, product, residuals, sample_at, trimmed_variance, unsaturated
from .rig_profile import Sampled

__all__ = ["NOTHING", "changes", "sampled"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: No statistics.
NOTHING = Sampled(0.0, 0, float("nan"), 0.0, 0.0, np.zeros(0))
#: Runs of 64 pixels in the sample; fewest good pixels for statistics.
_RUNS, _FEWEST = 16, 64
#: Limits beyond which a profile no longer holds: logarithm of the ratio of two variances, change of light
#: over the amplitude, relative change of a contrast, share of lost pixels.
_VARIANCE, _LIGHT, _CONTRAST, _LOST = 0.3, 0.15, 0.06, 0.1
#: Standard deviations of chance on top of these limits.
_SURE = 4.0


def sampled(light: Light, setup: Setup, found: Correspondence) -> Sampled:
    """Statistics of a capture decoded by a setup; light: with the variances of its levels."""
    places = sample_places(light.raw.shape[1:], _RUNS)
    at = tuple(places.T)
    good = found.flags[at] == 0
    count = int(np.count_nonzero(good))
    if count < _FEWEST or found.amplitude is None or found.offset is None:
        return NOTHING._replace(good=float(good.mean()), pixels=count)
    sample = sample_at(light, places[good])
    amplitude, offset = (float(np.median(one[at][good])) for one in (found.amplitude, found.offset))
    residual2 = _residual2(setup, sample)
    return Sampled(float(good.mean()), count, residual2, amplitude, offset, _contrasts(setup.plan, sample))


def changes(before: Sampled, now: Sampled) -> tuple[Notice, ...]:
    """Notices of differences beyond chance that change sigma or places: the profile no longer holds."""
    if before.pixels < _FEWEST:
        return ()
    found = [("share of pixels that are lost, of the profile's good ones", 1 - now.good / before.good, _LOST)]
    if now.pixels >= _FEWEST:
        chance = _SURE * float(np.sqrt(2 / now.pixels + 2 / before.pixels))
        beyond, scale = _VARIANCE + chance, max(before.amplitude, 1e-6)
        times = abs(float(np.log(now.residual2 / before.residual2)))
        dimmed = max(abs(now.amplitude - before.amplitude), abs(now.offset - before.offset)) / scale
        blurred = np.abs(now.contrast / np.maximum(before.contrast, 1e-6) - 1).max(initial=0.0)
        found += [
            (
                "noise, times the profile's or less by as much",
                float(np.exp(times / 2)),
                float(np.exp(beyond / 2)),
            ),
            ("light, relative change", dimmed, _LIGHT),
            ("contrast of fringes or bits, relative change", float(blurred), _CONTRAST + chance),
        ]
    return tuple(_told(what, size, limit) for what, size, limit in found if size > limit)


def _told(what: str, size: float, limit: float) -> Notice:
    cure = "estimated anew from this capture; save that profile if the rig stays so"
    return Notice(f"the rig's profile no longer holds: {what}", size, limit, cure)


def _residual2(setup: Setup, sample: Sample) -> float:
    """Variance of the constraints' residuals over that by noise and misfit."""
    noise, groups = setup.noise, constraints(setup.plan, len(setup.sequence))
    if not groups:
        level, residual = residuals(setup.plan, sample, groups)
        return trimmed_variance(residual / np.sqrt(noise.variance(level))) if residual.size else float("nan")
    rows = groups[-1].astype(np.float32)
    power = noise.misfit2 * np.square(modulation(setup.plan, sample.levels)[0])
    whole = unsaturated(rows, sample.levels, sample.white)
    off = product(rows, sample.levels) / np.sqrt(sample.variances(rows, noise) + power)
    return trimmed_variance(off[whole]) if whole.any() else float("nan")


def _contrasts(plan: Plan, sample: Sample) -> F64:
    """Contrasts of each axis' bits and fringes, relative to white and black, or else to the coarsest."""
    found = [one for axis in plan.axes for one in _of_axis(plan, axis, sample.levels)]
    return np.asarray(found, np.float64)


def _of_axis(plan: Plan, axis: AxisPlan, levels: F32) -> list[float]:
    """Ratios of rms over the pixels."""
    ends = plan.white >= 0 and plan.black >= 0
    fringes = [
        np.hypot(*(one.inverse[1:].astype(np.float32) @ levels[list(one.index)])) for one in axis.fringes
    ]
    bits = []
    if axis.code is not None:
        mean = 0.5 * (levels[plan.white] + levels[plan.black]) if ends else None
        for plain, inverse in zip(axis.code.plain.tolist(), axis.code.inverse.tolist(), strict=True):
            if min(plain, inverse) >= 0:
                bits.append(0.5 * np.abs(levels[plain] - levels[inverse]))
            elif mean is not None:
                bits.append(np.abs(levels[max(plain, inverse)] - mean))
    every = [0.5 * np.abs(levels[plan.white] - levels[plan.black])] if ends else []
    every += [*bits[::-1], *fringes]
    sizes = [float(np.sqrt(np.mean(np.square(one, dtype=np.float64)))) for one in every]
    return [one / max(sizes[0], 1e-6) for one in sizes[1:]]
