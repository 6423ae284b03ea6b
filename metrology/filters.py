"""Gaussian filters of a residual: areal, linear (ISO 16610-61), divided by the filtered mask at borders."""

from dataclasses import replace
from typing import Literal

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.reconstruct import Grid

from .fit import FormFit
from .functionals import mean_square_variance, modes_variance, noise_covariance

__all__ = ["gaussian_filter", "kept_variance", "transfer"]

#: Standard deviation of the weighting function over the cutoff, where half of the amplitude passes:
#: exp(-pi (r / (alpha cutoff))^2) with alpha = sqrt(ln 2 / pi).
_SIGMA = float(np.sqrt(np.log(2) / np.pi) / np.sqrt(2 * np.pi))
_LEAST = 4.0  # grid steps of a cutoff
_REACH = 4.0  # sigma of the kernel
_SOME = 1e-6  # least share of known points in a weighted mean
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

    passed = replace(fit, residual=kept_of(fit.residual, grid.z), passes=(*fit.passes, (cutoff, kept)))
    residual, kept_modes = passed.residual, None
    left = residual[there] - residual[there].mean()
    variance, trace = _kept_noise(passed, grid)
    linear = 4 * float(kept_variance(passed, left[:, None] / len(left))[0])
    square, by_rig = mean_square_variance(linear, trace), 0.0
    rig = np.where(there, 0.0, np.nan)
    if fit.modes is not None:
        bent = (replace(fit, residual=np.where(there, mode, np.nan)) for mode in fit.modes)
        modes = np.stack([kept_of(one.residual, one.grid(grid.pitch).z) for one in bent])
        rig = np.sqrt(np.sum(modes**2, axis=0))
        by_rig = modes_variance(modes[:, there], left)
        kept_modes = np.asarray(modes, np.float32)
    both = square, by_rig
    return replace(passed, noise=np.sqrt(variance), rig=rig, variance=both, trace=trace, modes=kept_modes)


def kept_variance(fit: FormFit, weights: Floats) -> Floats:
    """Variances (m,) by slope noise of sums of the residual with weights (n, m) over its known pixels: less
    its part in the form, and behind the filters. NaN where the noise is unknown.

    Filters and fit are applied to the weights, in reverse. Short waves do not feel the map's border: behind a
    high pass the variance is an integral over spatial frequencies.
    """
    grid, there = fit.grid(), np.isfinite(fit.residual)
    if fit.slope_noise is None:
        return np.full(weights.shape[1], np.nan)
    at = np.stack([(fit.y - grid.y0) / grid.pitch, (fit.x - grid.x0) / grid.pitch])[:, there]
    (xr, xc), (yr, yc) = np.gradient(fit.x), np.gradient(fit.y)
    area = np.abs(xc * yr - xr * yc)[there] / grid.pitch**2
    for cutoff, kept in fit.passes[::-1]:
        scale = _SIGMA * cutoff / grid.pitch
        share = np.maximum(_blurred(np.isfinite(grid.z).astype(np.float64), scale), _SOME)
        lows = (_blurred(_scattered(each, at, grid) / share, scale) for each in weights.T)
        low = np.stack([area * scipy.ndimage.map_coordinates(each, at, order=1, mode="nearest")
                        for each in lows], axis=1)  # fmt: skip
        weights = low if kept == "low" else weights - low
    weights = weights - fit.basis @ (fit.basis.T @ weights)
    if all(kept == "low" for _, kept in fit.passes):
        return np.asarray(np.diag(noise_covariance(weights, fit.x, fit.y, there, fit.slope_noise)))
    spectrum = _spectrum(replace(fit, passes=()), grid)
    power = (np.abs(np.fft.fft2(_scattered(each, at, grid), spectrum.shape)) ** 2 for each in weights.T)
    return np.array([float(np.mean(each * spectrum)) for each in power])


def _scattered(weights: Floats, at: Floats, grid: Grid) -> Floats:
    """Weights (n,) of points at rows and columns (2, n) of a grid, shared by its four nearest points."""
    low = np.clip(np.floor(at).astype(np.intp), 0, np.array(grid.z.shape)[:, None] - 2)
    part, total = at - low, np.zeros(grid.z.size)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        share = np.abs(1 - i - part[0]) * np.abs(1 - j - part[1])
        place = (low[0] + i) * grid.z.shape[1] + low[1] + j
        total += np.bincount(place, share * weights, grid.z.size)
    return total.reshape(grid.z.shape)


def _blurred(values: Floats, scale: float) -> Floats:
    return np.asarray(scipy.ndimage.gaussian_filter(values, scale, mode="constant", truncate=_REACH))


def _smooth(z: Floats, scale: float) -> Floats:
    """Weighted mean of the known points; NaN is unknown. Where none is near: the nearest weighted mean."""
    known = np.isfinite(z)
    weight, total = (_blurred(part, scale) for part in (known.astype(np.float64), np.where(known, z, 0.0)))
    some = weight > _SOME
    mean = np.where(some, total / np.where(some, weight, 1.0), 0.0)
    if some.all():
        return mean
    nearest = scipy.ndimage.distance_transform_edt(~some, return_distances=False, return_indices=True)
    return np.asarray(mean[tuple(nearest)])


def _waves(grid: Grid) -> tuple[Floats, Floats]:
    """Spatial frequencies k, l and d = 4 - 2 cos k - 2 cos l of a square lattice, at least a grid's."""
    sizes = np.maximum(grid.z.shape, _WAVES)
    ways = (2 * np.pi * np.fft.fftfreq(size) for size in sizes)
    waves = np.stack(np.meshgrid(*ways, indexing="ij"))
    steps = np.asarray(4 - 2 * np.cos(waves[0]) - 2 * np.cos(waves[1]))
    steps[0, 0] = np.inf
    return waves, steps


def transfer(passes: tuple[tuple[float, str], ...], k: Floats, m: Floats) -> Floats:
    """Amplitude that filters (cutoff in mm, 'low' or 'high') pass at the waves k, m, radians per mm."""
    passed: Floats = np.ones(k.shape)
    for cutoff, kept in passes:
        low = np.exp(-0.5 * (_SIGMA * cutoff) ** 2 * (k**2 + m**2))
        passed *= low if kept == "low" else 1 - low
    return passed


def _spectrum(fit: FormFit, grid: Grid) -> Floats:
    """Power of the noise behind the filters. Slope noise that is integrated by least squares on a square
    lattice has v / d. Increments are the means of the slopes at both ends, which damps short waves."""
    waves, steps = _waves(grid)
    averaged: Floats = np.sum((2 - 2 * np.cos(waves)) * np.cos(0.5 * waves) ** 2, axis=0)
    return np.asarray(
        transfer(fit.passes, *waves / grid.pitch) ** 2 * fit.step_variance * averaged / steps**2
    )


def _kept_noise(fit: FormFit, grid: Grid) -> tuple[Floats, float]:
    """Variance of the pixels' noise (H, W) behind all filters, mm^2, and that of its mean square, mm^4;
    fit: with the noise before the last one."""
    count = float(np.isfinite(grid.z).sum())
    if any(kept == "high" for _, kept in fit.passes):
        spectrum = _spectrum(fit, grid)
        there = np.isfinite(fit.residual)
        return np.where(there, np.mean(spectrum), np.nan), 2 * float(np.mean(spectrum**2)) / count
    waves, steps = _waves(grid)
    before = transfer(fit.passes[:-1], *waves / grid.pitch) ** 2
    after = transfer(fit.passes, *waves / grid.pitch) ** 2
    # of long waves, which a low pass keeps but for this share
    share = float(np.sum((after / steps) ** 2) / np.sum((before / steps) ** 2))
    taken = np.mean((before - after) * fit.step_variance / steps)
    return np.maximum(fit.noise**2 - taken, 0.0), share * fit.trace
