"""Errors of places by a lens whose blur was not given: one number, common to all pixels."""

import numpy as np
import scipy.ndimage

from optolever.decode import Correspondence

from ..arrays import Floats, Mask, Pair

__all__ = ["lens_errors"]

_CLEAN = np.ones((5, 5), np.bool_)  # as the decoder asks before it takes the aperture off
_LEAST, _MOST = 1e-6, 1e6


def lens_errors(seen: Correspondence, rest: Correspondence | None) -> Pair | None:
    """Errors of u and v (H, W) by one standard deviation of the lens, less those that the rest capture has
    in common; None: the lens was given, or the code's places are cells."""
    noise = seen.shared_noise
    if noise is None or not (noise.lens_u or noise.lens_v):
        return None
    of_u, of_v = (
        size * (_bracket(seen, axis) - (0.0 if rest is None else _bracket(rest, axis)))
        for axis, size in (("u", noise.lens_u), ("v", noise.lens_v))
    )
    return of_u, of_v


def _bracket(seen: Correspondence, axis: str) -> Floats:
    """laplace u + 2 grad u . grad ln A (H, W), a place's shift over half the aperture's second moment: the
    mean of 3 x 3 pixels; 0 beside pixels that are not good."""
    at = np.asarray(getattr(seen, axis), np.float64)
    usable: Mask = seen.good & np.isfinite(at)
    light = np.ones(at.shape) if seen.amplitude is None else np.nan_to_num(seen.amplitude)
    # of a damaged file both may be anything
    light, at = np.clip(light, _LEAST, 2.0**16), np.clip(at, -_MOST, _MOST)
    place, log = (np.where(usable, one, 0.0) for one in (at, np.log(light)))
    shift = scipy.ndimage.laplace(place, mode="nearest")
    for rise, fall in zip(np.gradient(place), np.gradient(log), strict=True):
        shift += 2 * rise * fall
    good = scipy.ndimage.binary_erosion(usable, _CLEAN)
    return np.asarray(scipy.ndimage.uniform_filter(np.where(good, shift, 0.0), 3))
