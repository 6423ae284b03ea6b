"""Slope error of a residual: rms of its slopes, less their noise, with sigma.

Slopes are central differences of heights. Slopes of a slope map are mostly noise, which the integration to
heights removes. Heights that are integrated by least squares from white slopes, with increments of variance
v_c, v_r along columns and rows, each of the cubic through four slopes in a row, have the power
(g(c) / v_c + g(r) / v_r) / d^2 at the waves c, r (per pixel), g(c) = 4 sin^2(c/2) ((13 cos(c/2) -
cos(3c/2)) / 12)^2, d = (2 - 2 cos c) / v_c + (2 - 2 cos r) / v_r; filters pass a part of it.
"""

import math
from dataclasses import dataclass

import numpy as np

from optolever.arrays import Floats

from .figures import rms_less_noise
from .filters import transfer
from .fit import FormFit, differences
from .functionals import SlopeNoise, mean_square_variance, modes_variance, root_sigma

__all__ = ["SlopeError", "slope_errors"]


@dataclass(frozen=True, slots=True)
class SlopeError:
    """Of the slopes of a residual along an axis, mm per mm: rms as measured; less_noise: of the surface
    alone, and its standard deviations by noise and rig (NaN: the noise is unknown)."""

    rms: float
    less_noise: float = math.nan
    noise: float = math.nan
    rig: float = math.nan

    @property
    def sigma(self) -> float:
        """Noise and rig combined."""
        return math.hypot(self.noise, self.rig)

    @property
    def known(self) -> tuple[float, float, float]:
        """The value to judge, by noise and rig: less its noise, where that is known."""
        value = self.less_noise if math.isfinite(self.less_noise) else self.rms
        return value, self.noise, self.rig


def slope_errors(fit: FormFit) -> tuple[SlopeError, SlopeError]:
    """Along x and along y."""
    if fit.slope_noise is None:
        along_x, along_y = map(SlopeError, fit.slope_rms)
        return along_x, along_y
    spectra = _difference_noise(fit, fit.slope_noise)
    modes = () if fit.modes is None else fit.modes.astype(np.float64)
    rig = zip(*(differences(fit.x, fit.y, mode) for mode in modes), strict=True) if len(modes) else ((), ())
    along_x, along_y = (_one(*each) for each in zip(fit.slopes, spectra, rig, strict=True))
    return along_x, along_y


def _one(slope: Floats, spectrum: Floats, modes: tuple[Floats, ...]) -> SlopeError:
    """spectrum (H, W): power of the noise, at an FFT's waves; modes: slopes (H, W) by the rig's errors."""
    there = np.isfinite(slope)
    values, count = slope[there], int(there.sum())
    rms, noise = float(np.sqrt(np.mean(values**2))), float(np.sqrt(np.mean(spectrum)))
    waves = np.abs(np.fft.fft2(np.where(there, slope, 0.0))) ** 2
    linear = 4 * float(np.mean(waves * spectrum)) / count**2
    square = mean_square_variance(linear, 2 * float(np.mean(spectrum**2)) / count)
    bent = np.reshape([np.nan_to_num(mode[there]) for mode in modes], (len(modes), count))
    less = rms_less_noise(rms, noise)
    return SlopeError(rms, less, root_sigma(less, square), root_sigma(less, modes_variance(bent, values)))


def _difference_noise(fit: FormFit, noise: SlopeNoise) -> tuple[Floats, Floats]:
    """Power of the noise of dz/dx and dz/dy by central differences between pixels, (H, W) each."""
    there = np.isfinite(fit.residual)
    gradients = (
        np.gradient(np.asarray(place, np.float64), axis=axis) for place in (fit.x, fit.y) for axis in (0, 1)
    )
    xr, xc, yr, yc = (float(np.nanmedian(each[there])) for each in gradients)
    variance_x, variance_y = (
        float(np.mean(np.broadcast_to(np.square(each), there.shape)[there])) for each in (noise.x, noise.y)
    )
    v_c, v_r = (max(x * x * variance_x + y * y * variance_y, 1e-30) for x, y in ((xc, yc), (xr, yr)))
    rows, cols = (2 * np.pi * np.fft.fftfreq(size) for size in there.shape)
    r, c = np.meshgrid(rows, cols, indexing="ij")
    d = (2 - 2 * np.cos(c)) / v_c + (2 - 2 * np.cos(r)) / v_r
    d[0, 0] = np.inf
    area = xc * yr - xr * yc
    passed = transfer(fit.passes, (yr * c - yc * r) / area, (xc * r - xr * c) / area)
    heights = passed**2 * (_increments(c) / v_c + _increments(r) / v_r) / d**2
    along_x = heights * ((np.sin(c) * yr - np.sin(r) * yc) / area) ** 2
    along_y = heights * ((np.sin(r) * xc - np.sin(c) * xr) / area) ** 2
    return along_x, along_y


def _increments(wave: Floats) -> Floats:
    """Power of the increments over a pixel's difference, of white slopes."""
    half = 0.5 * wave
    return np.asarray(4 * np.sin(half) ** 2 * ((13 * np.cos(half) - np.cos(3 * half)) / 12) ** 2)
