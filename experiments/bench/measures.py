"""The metrics of a bench's row: errors, flags, and silent (unflagged) errors."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

from ..arrays import Mask
from ..metrics import height_metrics, unflagged

SIGMAS = 5.0  # beyond which an unflagged value is a silent error


def far_from_visible(visible: Mask) -> Mask:
    """Pixels that view no mirror, with all neighbours: their footprints miss the mirror."""
    return np.asarray(~ndimage.binary_dilation(visible, np.ones((3, 3), np.bool_)))


def measures(truth: Trace, seen: Correspondence, height: HeightMap) -> dict[str, float]:
    """`metrics.height_metrics`, and:

    height_p95_rel: 95 % quantile of the error of unflagged pixels, over the peak depth; flagged_share: of the
    pixels that view the pattern; silent_share: of the unflagged pixels, share with an error above 5 sigma or
    without any mirror in view (0 if sigma is unknown); decode_silent_share: likewise of u and v.
    """
    known = height_metrics(truth, seen, height)
    error = np.abs(height.z - truth.z)[unflagged(truth, height)]
    peak = known["peak_depth_mm"]
    has_sigma = bool(np.isfinite(height.sigma[height.good]).any())
    wrong_height = _beyond(height.z - truth.z, height.sigma)
    wrong_place = _beyond(seen.u - truth.u, seen.sigma_u) | _beyond(seen.v - truth.v, seen.sigma_v)
    return known | {
        "height_p95_rel": float(np.quantile(error, 0.95)) / peak if error.size and peak else math.nan,
        "flagged_share": 1.0 - known["unflagged_share"],
        "silent_share": has_sigma * _silent_share(wrong_height, truth.visible, height.good),
        "decode_silent_share": _silent_share(wrong_place, truth.visible, seen.good),
    }


def _beyond(error: NDArray[np.floating[Any]], sigma: NDArray[np.floating[Any]]) -> Mask:
    """Pixels with an error above SIGMAS sigma, or with an unknown error."""
    return np.asarray(~(np.abs(error) <= SIGMAS * sigma))


def _silent_share(wrong: Mask, visible: Mask, good: Mask) -> float:
    """Share of the good pixels that are wrong, or view no mirror."""
    count = int(good.sum())
    silent = good & ((wrong & visible) | far_from_visible(visible))
    return float(silent.sum()) / count if count else math.nan
