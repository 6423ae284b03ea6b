"""Errors of a Correspondence against what the rays of every pixel's area met."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.patterns import Sequence
from optolever.projector import AreaTrace

from .hard_case import SIGMAS, Found, worse_of
from .hard_decode import DISCRETE, discrete
from .measures import far_from_visible

__all__ = ["area_errors"]

Float = NDArray[np.float64]


def area_errors(seen: Correspondence, area: AreaTrace, sequence: Sequence) -> Found:
    """Errors of u or v (px), whichever is worse in units of its limit of 5 sigma (of a discrete code at least
    1.5 px).

    The truth is the place that a pixel's centre sees. A pixel part of which sees no pattern need not be
    decoded, but where it is (unflagged) the truth is the mean over the part that sees it, known to within
    half the distance of its rays, which the error is allowed.
    """
    lit, partly = area.visible, area.partly
    centres = area.centre.u, area.centre.v
    truths = (np.where(partly, mean, at) for mean, at in zip(area.mean(), centres, strict=True))
    errors, limits = [], []
    for name, truth, extent in zip("uv", truths, area.extent(), strict=True):
        value = np.asarray(getattr(seen, name), np.float64)
        sigma = np.asarray(getattr(seen, f"sigma_{name}"), np.float64)
        error = value - truth
        allowed = np.where(partly, _half_spacing(extent, area), 0.0)
        errors.append(np.sign(error) * np.maximum(np.abs(error) - allowed, 0.0))
        limits.append(np.maximum(SIGMAS * sigma, DISCRETE if discrete(sequence) else 0.0))
    found = worse_of(errors, limits, lit, far_from_visible(lit | partly), seen.flags)
    with np.errstate(invalid="ignore"):
        wrong_part = partly & ~(np.abs(found.error) <= found.limit)
    return replace(found, beside=np.asarray(found.beside | wrong_part))


def _half_spacing(extent: Float, area: AreaTrace) -> Float:
    """Half the distance of neighbouring rays (H, W), cells; at least that of the usual pixel."""
    side = np.sqrt(area.hit.shape[2])
    lit = area.visible
    usual = float(np.median(extent[lit])) if lit.any() else 0.0
    spacing: Float = 0.5 * np.maximum(extent, usual) / side
    return spacing
