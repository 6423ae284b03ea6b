"""Found: what a case gave beside the truth; errors of places and of heights, and which of them are silent."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Displacement
from optolever.experiments.arrays import Floats, Mask
from optolever.experiments.bench.measures import SIGMAS, far_from_visible
from optolever.patterns import Sequence
from optolever.projector import AreaTrace
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

DISCRETE = 1.5  # px, up to which a code of cells alone is right at any sigma


@dataclass(frozen=True, slots=True)
class FrameVerdict:
    """What was said about whole frames, or the scene.

    fault: what was done to them ('': nothing); moves: whether it changes enough pixels; hidden: whether
    nobody could tell, as the frames are perfect ones of another scene, or are not told where a mirror fills
    the image; named: whether it was; accused: pixels flagged WRONG_FRAME and nothing else, notices of a right
    scene; findings: what the check says.
    """

    fault: str
    moves: bool
    hidden: bool
    named: bool
    accused: int = 0
    findings: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """True if the fault has to be named."""
        return self.moves and not self.hidden


@dataclass(frozen=True, slots=True)
class Found:
    """What a case gave, (H, W) each.

    error: signed, of one coordinate or of the height (the worse one in units of its limit), NaN where the
    value is; limit: error beyond which an unflagged value is a silent one; expected: pixels that see the
    pattern; beside: pixels from which no light of the pattern can come; flags; unit: of the errors; scale:
    what the rms is divided by; reference: what the same pixels gave under better conditions, if the verdict
    is relative to that; frames: what was said about whole frames, where that is judged; width: median sigma
    over the rms error, at most width_limit; notices: how many there are, where there must be one.
    """

    error: Floats
    limit: Floats
    expected: Mask
    beside: Mask
    flags: NDArray[np.integer[Any]]
    unit: str
    scale: float = 1.0
    reference: "Found | None" = None
    frames: FrameVerdict | None = None
    width: float = math.nan
    width_limit: float = math.inf
    notices: int | None = None


def found_height(height: HeightMap, truth: Trace, peak: float) -> Found:
    """What a height map is worth beside the true mirror, errors over a peak (mm)."""
    visible, limit = truth.visible, np.asarray(SIGMAS * height.sigma)
    return Found(
        height.z - truth.z, limit, visible, far_from_visible(visible), height.flags, "peak", scale=peak
    )


def found_places(
    seen: Correspondence | Displacement,
    truth: Iterable[tuple[Any, Any]],
    expected: Mask,
    beside: Mask,
    least: float = 0.0,
) -> Found:
    """Errors (px) of u or v, whichever is worse in units of its limit: 5 sigma, and at least `least`.

    truth: of u and of v, between what and what (H, W each) it lies.
    """
    places = (seen.du, seen.dv) if isinstance(seen, Displacement) else (seen.u, seen.v)
    errors, limits, ratios = [], [], []
    for place, sigma, (low, high) in zip(places, (seen.sigma_u, seen.sigma_v), truth, strict=True):
        errors.append(np.asarray(place - np.clip(place, low, high), np.float64))
        limits.append(np.maximum(np.asarray(SIGMAS * sigma, np.float64), least))
        with np.errstate(invalid="ignore", divide="ignore"):
            ratios.append(np.nan_to_num(np.abs(errors[-1]) / limits[-1], nan=np.inf))
    worse = ratios[1] > ratios[0]
    error, limit = (np.asarray(np.where(worse, of_v, of_u)) for of_u, of_v in (errors, limits))
    return Found(error, limit, expected, beside, seen.flags, "px")


def found_area(seen: Correspondence, area: AreaTrace, sequence: Sequence) -> Found:
    """Errors of u or v (px) against what the rays of every pixel's area met.

    The truth is the place that a pixel's centre sees. A pixel part of which sees no pattern need not be
    decoded, but where it is (unflagged) the truth is the mean over the part that sees it, known to within
    half the distance of its rays, which the error is allowed.
    """
    lit, partly = area.visible, area.partly
    truth = []
    for mean, at, extent in zip(area.mean(), (area.centre.u, area.centre.v), area.extent(), strict=True):
        allowed, middle = np.where(partly, _half_spacing(extent, area), 0.0), np.where(partly, mean, at)
        truth.append((middle - allowed, middle + allowed))
    found = found_places(seen, truth, lit, far_from_visible(lit | partly), least_limit(sequence))
    return replace(found, beside=found.beside | (partly & beyond(found)))


def _half_spacing(extent: Floats, area: AreaTrace) -> Floats:
    """Half the distance of neighbouring rays (H, W), cells; at least that of the usual pixel."""
    lit = area.visible
    usual = float(np.median(extent[lit])) if lit.any() else 0.0
    return np.asarray(0.5 * np.maximum(extent, usual) / np.sqrt(area.hit.shape[2]))


def least_limit(shown: Sequence) -> float:
    """Errors (px) that a sequence may have at any sigma: of one that tells cells only, DISCRETE."""
    within = ("phase", "stripe", "crossed", "levels")
    return 0.0 if any(frame.kind in within for frame in shown.frames) else DISCRETE


def beyond(found: Found) -> Mask:
    """Pixels that are off by more than their limit, flagged or not."""
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(found.error) <= found.limit))


def silent_mask(found: Found) -> Mask:
    """Unflagged pixels that are off by more than their limit, or see nothing at all."""
    return np.asarray((found.flags == 0) & ((beyond(found) & found.expected) | found.beside))
