"""Accuracy of a reconstruction and of its error bars: pure functions on truth and result."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Mask
from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

Array = NDArray[np.floating[Any]]


def rms(values: Array) -> float:
    """Root mean square; NaN of nothing."""
    return math.sqrt(float(np.mean(np.square(values)))) if values.size else math.nan


def sigma_ratio(value: Array, truth: Array, sigma: Array, where: Mask) -> float:
    """Rms of error over sigma where `where` holds and sigma is finite: 1 if the error bars are right."""
    use = where & np.isfinite(sigma) & (sigma > 0)
    return rms((value[use] - truth[use]) / sigma[use])


def unflagged(truth: Trace, height: HeightMap) -> Mask:
    """Pixels with an unflagged height and a true mirror point."""
    return np.asarray(height.good & truth.visible)


def relative_error(height: HeightMap, truth: Trace) -> float:
    """Rms height error over the unflagged pixels, over the largest true height."""
    stands = unflagged(truth, height)
    return rms((height.z - truth.z)[stands]) / float(np.nanmax(np.abs(truth.z)))


def height_metrics(truth: Trace, correspondence: Correspondence, height: HeightMap) -> dict[str, float]:
    """The main metrics; their names are part of the interface.

    height_rms_rel: rms height error over unflagged pixels / peak depth; unflagged_share: of the truth-visible
    pixels; unflagged_invisible: unflagged pixels without a mirror point in view, as a share of all pixels;
    sigma_ratio_u, _v, _height: rms(error / sigma by noise) over unflagged pixels, sigma_ratio_total: of the
    height, by noise and rig; height_sigma_mm: rms of that sigma; height_median_mm: median absolute error. NaN
    for a divisor of zero.
    """
    decoded = correspondence.good & truth.visible
    stands = unflagged(truth, height)
    error = height.z[stands] - truth.z[stands]
    visible = int(truth.visible.sum())
    peak = float(np.max(np.abs(truth.z[truth.visible]))) if visible else math.nan
    height_rms = rms(error)
    return {
        "height_rms_rel": height_rms / peak if peak else math.nan,
        "height_max_rel": float(np.max(np.abs(error))) / peak if error.size and peak else math.nan,
        "height_rms_mm": height_rms,
        "peak_depth_mm": peak,
        "unflagged_share": float(stands.sum()) / visible if visible else math.nan,
        "decoded_share": float(decoded.sum()) / visible if visible else math.nan,
        "unflagged_invisible": float((height.good & ~truth.visible).mean()),
        "u_rms_px": rms((correspondence.u - truth.u)[decoded]),
        "v_rms_px": rms((correspondence.v - truth.v)[decoded]),
        "sigma_ratio_u": sigma_ratio(correspondence.u, truth.u, correspondence.sigma_u, decoded),
        "sigma_ratio_v": sigma_ratio(correspondence.v, truth.v, correspondence.sigma_v, decoded),
        "sigma_ratio_height": sigma_ratio(height.z, truth.z, height.sigma, stands),
        "sigma_ratio_total": sigma_ratio(height.z, truth.z, height.total_sigma, stands),
        "height_sigma_mm": rms(height.total_sigma[stands]),
        "height_median_mm": float(np.median(np.abs(error))) if error.size else math.nan,
    }
