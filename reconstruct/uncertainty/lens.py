"""Errors of places by a lens whose blur was not given: one number, common to all pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.blocks import on_cores
from optolever.decode import Correspondence

from ..arrays import Floats, Pair

__all__ = ["lens_errors"]

_CLEAN = np.ones((5, 5), np.uint8)  # as the decoder asks before it takes the aperture off
_LEAST, _MOST = 1e-6, 1e6


def lens_errors(seen: Correspondence, rest: Correspondence | None) -> Pair | None:
    """Errors of u and v (H, W) by one standard deviation of the lens, less those that the rest capture has
    in common; None: the lens was given, or the code's places are cells."""
    noise = seen.shared_noise
    if noise is None or not (noise.lens_u or noise.lens_v):
        return None
    errors = _brackets(seen)
    if rest is not None:
        errors = errors - _brackets(rest)
    return noise.lens_u * errors[0], noise.lens_v * errors[1]


def _brackets(seen: Correspondence) -> Floats:
    """laplace u + 2 grad u . grad ln A, of v likewise (2, H, W), a place's shift over half the aperture's
    second moment: the mean of 3 x 3 pixels; 0 beside pixels that are not good."""
    usable = seen.good & np.isfinite(seen.u) & np.isfinite(seen.v)
    light = np.ones(usable.shape) if seen.amplitude is None else np.nan_to_num(seen.amplitude)
    # of a damaged file both may be anything
    log = np.where(usable, np.log(np.clip(light, _LEAST, 2.0**16)), 0.0).astype(np.float64)
    falls = _slopes(log)
    good = cv2.erode(usable.view(np.uint8), _CLEAN, borderType=cv2.BORDER_CONSTANT, borderValue=0)

    def bracket(at: NDArray[np.floating]) -> Floats:
        place = np.where(usable, np.clip(at, -_MOST, _MOST), 0.0).astype(np.float64)
        shift: Floats = np.asarray(cv2.Laplacian(place, cv2.CV_64F), np.float64)
        for rise, fall in zip(_slopes(place), falls, strict=True):
            shift += 2.0 * rise * fall
        shift *= good
        return np.asarray(cv2.blur(shift, (3, 3)))

    return np.stack(on_cores(bracket, (seen.u, seen.v)))


def _slopes(values: Floats) -> Pair:
    """By the neighbours on either side, along columns and rows (H, W)."""
    difference = np.array([[-0.5, 0.0, 0.5]])
    along, down = (cv2.filter2D(values, cv2.CV_64F, part) for part in (difference, difference.T))
    return np.asarray(along), np.asarray(down)
