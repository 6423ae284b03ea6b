"""Profiles along lines, and power spectral densities, of a map on a regular grid."""

from dataclasses import dataclass

import numpy as np
import scipy

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.numbers import listed
from optolever.reconstruct import Grid

from .fit import FormFit

__all__ = ["Profile", "Spectrum", "profile", "profile_of", "spectrum"]

_KNOWN = 0.999  # minimum share of known points in the rectangle of a spectrum
_LEAST = 16  # minimum number of points along the axis of a spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Heights z along a line (n,), mm: s from its start, at x, y; NaN where unknown."""

    s: Floats
    x: Floats
    y: Floats
    z: Floats

    @property
    def rms(self) -> float:
        """Rms about the mean, mm."""
        return float(np.nanstd(self.z)) if np.isfinite(self.z).any() else float("nan")

    @property
    def pv(self) -> float:
        """Largest less smallest height, mm."""
        return float(np.nanmax(self.z) - np.nanmin(self.z)) if np.isfinite(self.z).any() else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """One-sided power spectral density (n,) in mm^3 over spatial frequency (n,) in 1/mm. Its integral is the
    mean square of the heights about straight lines."""

    frequency: Floats
    density: Floats


def profile(grid: Grid, start: tuple[float, float], end: tuple[float, float]) -> Profile:
    """Heights on the straight line between two points (mm), a grid step apart, linear between grid points."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    if not 0 < length < np.inf:
        raise InputError(f"profile from {start} to {end}: {length:g} mm long, must be above 0")
    s = np.linspace(0.0, length, max(2, round(length / grid.pitch) + 1))
    x, y = (a + (b - a) * s / length for a, b in zip(start, end, strict=True))
    at = np.stack([(y - grid.y0) / grid.pitch, (x - grid.x0) / grid.pitch])
    return Profile(s, x, y, scipy.ndimage.map_coordinates(grid.z, at, order=1, cval=np.nan))


def profile_of(fit: FormFit, line: str) -> Profile:
    """Residual of a fit along a line X0,Y0,X1,Y1 (mm), or x or y: all of the map, through its middle."""
    grid = fit.grid()
    known = np.isfinite(grid.z)
    x, y = grid.x[known.any(axis=0)], grid.y[known.any(axis=1)]
    ends = {
        "x": (x[0], fit.middle[1], x[-1], fit.middle[1]),
        "y": (fit.middle[0], y[0], fit.middle[0], y[-1]),
    }
    x0, y0, x1, y1 = ends.get(line) or listed("profile", line, "x, y or X0,Y0,X1,Y1 (mm)", 4)
    found = profile(grid, (x0, y0), (x1, y1))
    if not np.isfinite(found.rms):
        part = f"x {x[0]:.4g} to {x[-1]:.4g}, y {y[0]:.4g} to {y[-1]:.4g} mm"
        raise InputError(f"profile {line}: meets no height, must lie in {part}")
    return found


def spectrum(grid: Grid, axis: str) -> Spectrum:
    """Spectrum along 'x' or 'y', mean over the lines of the largest known rectangle about the middle.

    Periodograms with a Hann window after subtraction of each line's best straight line (E. L. Church and
    P. Z. Takacs, Opt. Eng. 34 (1995) 353). InputError without a known rectangle of 16 points.
    """
    if axis not in ("x", "y"):
        raise InputError(f"spectrum: axis is {axis!r}, must be x or y")
    z = _rectangle(grid.z if axis == "x" else grid.z.T)
    frequency, density = scipy.signal.periodogram(z, 1 / grid.pitch, "hann", detrend="linear")
    return Spectrum(frequency[1:], density[:, 1:].mean(axis=0))


def _rectangle(z: Floats) -> Floats:
    """The largest known rectangle about the middle; its remaining gaps are filled with the mean."""
    known = np.isfinite(z)
    rows, cols = np.nonzero(known)
    for share in np.linspace(1.0, 0.1, 91) if rows.size else ():
        part = []
        for index in (rows, cols):
            middle, half = 0.5 * (index.min() + index.max()), 0.5 * share * (index.max() - index.min())
            part.append(slice(int(np.ceil(middle - half)), int(np.floor(middle + half)) + 1))
        inside = known[part[0], part[1]]
        if inside.mean() >= _KNOWN and inside.shape[1] >= _LEAST:
            found = z[part[0], part[1]]
            return np.where(inside, found, found[inside].mean())
    few = f"no known rectangle of at least {_LEAST} points about the middle"
    raise InputError(f"spectrum: {few}; the map is too small, or has gaps there")
