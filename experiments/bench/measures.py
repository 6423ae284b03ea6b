"""The numbers of a row: errors, error bars, what is flagged, and what is wrong without a flag."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

from ..metrics import height_metrics, unflagged
from .hard_case import SIGMAS

__all__ = ["far_from_visible", "measures", "silent_heights"]

Mask = NDArray[np.bool_]


def measures(truth: Trace, seen: Correspondence, height: HeightMap) -> dict[str, float]:
    """`metrics.height_metrics`, and:

    height_p95_rel: 95 % of the unflagged pixels are off by less, over the peak depth; flagged_share: of the
    pixels that see the pattern; silent_share: of the unflagged pixels, off by more than 5 sigma or seeing no
    mirror at all; decode_silent_share: likewise of u and v.
    """
    known = height_metrics(truth, seen, height)
    stands = unflagged(truth, height)
    error = np.abs(height.z - truth.z)[stands]
    peak = known["peak_depth_mm"]
    return known | {
        "height_p95_rel": float(np.quantile(error, 0.95)) / peak if error.size and peak else math.nan,
        "flagged_share": 1.0 - known["unflagged_share"],
        "silent_share": _share(silent_heights(truth, height), height.good),
        "decode_silent_share": _share(_silent_coordinates(truth, seen), seen.good),
    }


def silent_heights(truth: Trace, height: HeightMap) -> Mask:
    """Unflagged heights off by more than 5 sigma, or where nothing is; all False if sigma is unknown."""
    if not np.isfinite(height.sigma[height.good]).any():
        return np.zeros(height.z.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        off = ~(np.abs(height.z - truth.z) <= SIGMAS * height.sigma)
    return np.asarray(height.good & ((off & truth.visible) | far_from_visible(truth.visible)))


def far_from_visible(visible: Mask) -> Mask:
    """Pixels that see nothing, nor do their neighbours: no footprint of theirs touches the mirror."""
    return np.asarray(~ndimage.binary_dilation(visible, np.ones((3, 3), np.bool_)))


def _silent_coordinates(truth: Trace, seen: Correspondence) -> Mask:
    off = np.zeros(seen.u.shape, np.bool_)
    for value, true, sigma in ((seen.u, truth.u, seen.sigma_u), (seen.v, truth.v, seen.sigma_v)):
        if np.isfinite(value).any():
            with np.errstate(invalid="ignore"):
                off |= ~(np.abs(value - true) <= SIGMAS * sigma)
    return np.asarray(seen.good & ((off & truth.visible) | far_from_visible(truth.visible)))


def _share(wrong: Mask, among: Mask) -> float:
    count = int(among.sum())
    return float(wrong.sum()) / count if count else math.nan
