"""The numbers of a row: errors, error bars, what is flagged, and what is wrong without a flag."""

import math

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

from ..metrics import height_metrics, unflagged
from .found import far_from_visible, found_height, found_places, silent_mask

__all__ = ["measures", "silent_heights"]

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
    visible = truth.visible
    true = (truth.u, truth.u), (truth.v, truth.v)
    places = found_places(seen, true, visible, far_from_visible(visible))
    return known | {
        "height_p95_rel": float(np.quantile(error, 0.95)) / peak if error.size and peak else math.nan,
        "flagged_share": 1.0 - known["unflagged_share"],
        "silent_share": _share(silent_heights(truth, height), height.good),
        "decode_silent_share": _share(silent_mask(places), seen.good),
    }


def silent_heights(truth: Trace, height: HeightMap) -> Mask:
    """Unflagged heights off by more than 5 sigma, or where nothing is; all False if sigma is unknown."""
    known = bool(np.isfinite(height.sigma[height.good]).any())
    return silent_mask(found_height(height, truth, 1.0)) & known


def _share(wrong: Mask, among: Mask) -> float:
    count = int(among.sum())
    return float(wrong.sum()) / count if count else math.nan
