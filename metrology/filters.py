"""Gaussian filters of a residual: areal, linear (ISO 16610-61), divided by the filtered mask at borders."""

from dataclasses import replace
from typing import Literal

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.errors import InputError

from .fit import FormFit, differences

__all__ = ["gaussian_filter"]

Floats = NDArray[np.float64]
#: Standard deviation of the weighting function over the cutoff, where half of the amplitude passes:
#: exp(-pi (r / (alpha cutoff))^2) with alpha = sqrt(ln 2 / pi).
_SIGMA = float(np.sqrt(np.log(2) / np.pi) / np.sqrt(2 * np.pi))
_LEAST = 4.0  # grid steps of a cutoff
_REACH = 4.0  # sigma of the kernel
_WAVES = 256  # points a side of the integrals over spatial frequencies


def gaussian_filter(fit: FormFit, cutoff: float, kept: Literal["low", "high"]) -> FormFit:
    """The residual's wavelengths above (low) or below (high) the cutoff (mm), with the sigma of what is kept.

    The filter works on a regular grid about as fine as the pixels. A wavelength of the cutoff keeps half of
    its amplitude. InputError for a cutoff below four grid steps, or one that is wider than the map.
    """
    grid = fit.grid()
    known = np.isfinite(grid.z)
    size = grid.pitch * max(np.ptp(index) for index in np.nonzero(known))
    least = _LEAST * grid.pitch
    if not least <= cutoff <= size:
        raise InputError(f"filter: cutoff is {cutoff:g} mm, must be {least:.3g} to {size:.4g} mm")
    scale = _SIGMA * cutoff / grid.pitch
    at = np.stack([(fit.y - grid.y0) / grid.pitch, (fit.x - grid.x0) / grid.pitch])
    there = np.isfinite(fit.residual)

    def kept_of(values: Floats, regular: Floats) -> Floats:
        low = _smooth(regular, scale)
        smooth = scipy.ndimage.map_coordinates(low, at[:, there], order=3, mode="nearest")
        found = np.full(there.shape, np.nan)
        found[there] = smooth if kept == "low" else values[there] - smooth
        return found

    residual = kept_of(fit.residual, grid.z)
    modes = None
    if fit.modes is not None:
        bent = (replace(fit, residual=np.where(there, mode, np.nan)) for mode in fit.modes)
        modes = np.stack([kept_of(one.residual, one.grid(grid.pitch).z) for one in bent])
    rms = float(np.nanstd(residual))
    noise, square = _kept_noise(fit, grid.z - _smooth(grid.z, scale), scale, kept)
    if kept == "low":  # of long waves, whose noise a low pass keeps
        square = (2 * rms * fit.rms_sigma * rms / max(fit.rms, 1e-30)) ** 2
    rig = np.where(there, 0.0, np.nan)
    if modes is not None:
        rig = np.sqrt(np.sum(modes**2, axis=0))
        if kept == "high":
            square += 4 * float(np.sum(np.nanmean(modes * residual, axis=(1, 2)) ** 2))
    slope_x, slope_y = differences(fit.x, fit.y, residual)
    return replace(
        fit,
        residual=residual,
        slope_x=slope_x,
        slope_y=slope_y,
        noise=np.where(there, noise, np.nan),
        rig=rig,
        rms_sigma=float(np.sqrt(square)) / max(2 * rms, 1e-30),
        modes=None if modes is None else modes.astype(np.float32),
    )


def _smooth(z: Floats, scale: float) -> Floats:
    """Weighted mean of the known points; NaN is unknown. Where none is near: the nearest weighted mean."""
    known = np.isfinite(z)
    weight, total = (
        scipy.ndimage.gaussian_filter(part, scale, mode="constant", truncate=_REACH)
        for part in (known.astype(np.float64), np.where(known, z, 0.0))
    )
    some = weight > 1e-6
    mean = np.where(some, total / np.where(some, weight, 1.0), 0.0)
    if some.all():
        return mean
    nearest = scipy.ndimage.distance_transform_edt(~some, return_distances=False, return_indices=True)
    return np.asarray(mean[tuple(nearest)])


def _kept_noise(
    fit: FormFit, regular: Floats, scale: float, kept: Literal["low", "high"]
) -> tuple[Floats, float]:
    """Standard deviation (H, W) of the noise that a filter keeps, and the variance of the mean square, mm^4,
    of a kept residual (rows, cols).

    The spectrum of slope noise that is integrated by least squares on a square lattice: v / d, with
    d = 4 - 2 cos k - 2 cos l. Increments are the means of the slopes at both ends, which damps short waves.
    """
    sizes = np.maximum(regular.shape, _WAVES)
    waves = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(size) for size in sizes), indexing="ij")
    steps = [2 - 2 * np.cos(each) for each in waves]
    steps[0][0, 0] = np.inf
    low = np.exp(-0.5 * scale**2 * (waves[0] ** 2 + waves[1] ** 2))
    if kept == "low":
        taken = float(np.mean((1 - low**2) * fit.step_variance / (steps[0] + steps[1])))
        return np.sqrt(np.maximum(fit.noise**2 - taken, 0.0)), np.nan
    averaged = sum(
        np.where(np.isfinite(each), each, 0.0) * np.cos(0.5 * wave) ** 2
        for each, wave in zip(steps, waves, strict=True)
    )
    spectrum = (1 - low) ** 2 * fit.step_variance * averaged / (steps[0] + steps[1]) ** 2
    known = np.isfinite(regular)
    power = np.abs(np.fft.fft2(np.where(known, regular, 0.0), spectrum.shape)) ** 2
    square = 4 * float(np.mean(power * spectrum)) + 2 * float(known.sum() * np.mean(spectrum**2))
    noise = np.where(np.isfinite(fit.residual), np.sqrt(np.mean(spectrum)), np.nan)
    return noise, square / float(known.sum()) ** 2
