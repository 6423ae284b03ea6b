"""From camera pixels to a regular grid in the mirror's plane, with conserved sigma."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["Grid", "resample"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIMIT = 64_000_000  # grid points


@dataclass(frozen=True, slots=True)
class Grid:
    """Heights on a regular grid: z[i, j] and sigma[i, j] at x = x0 + j pitch, y = y0 + i pitch, all in mm.

    NaN where no good points surround the grid point.
    """

    z: Floats
    sigma: Floats
    x0: float
    y0: float
    pitch: float

    @property
    def x(self) -> Floats:
        """Positions along x, (cols,)."""
        return self.x0 + self.pitch * np.arange(self.z.shape[1], dtype=np.float64)

    @property
    def y(self) -> Floats:
        """Positions along y, (rows,)."""
        return self.y0 + self.pitch * np.arange(self.z.shape[0], dtype=np.float64)


def resample(x: Floats, y: Floats, z: Floats, sigma: Floats, good: Mask, pitch_mm: float) -> Grid:
    """Linear interpolation over the triangles between neighbouring good pixels, at multiples of the pitch.

    x, y, z, sigma, good: (H, W). Neighbouring errors are correlated, so that interpolation does not shrink
    sigma:
    it is interpolated like z. Raises InputError for a pitch that is not positive or makes too large a grid,
    and where there is no good pixel.
    """
    if not np.isfinite(pitch_mm) or pitch_mm <= 0:
        raise InputError(f"pitch = {pitch_mm} mm: must be greater than 0")
    if not good.any():
        raise InputError("height map: no good pixel to resample")
    low = [int(np.ceil(axis[good].min() / pitch_mm - 1e-9)) for axis in (x, y)]
    high = [int(np.floor(axis[good].max() / pitch_mm + 1e-9)) for axis in (x, y)]
    cols, rows = (max(b - a + 1, 1) for a, b in zip(low, high, strict=True))
    if rows * cols > _LIMIT:
        raise InputError(
            f"pitch = {pitch_mm} mm: a grid of {rows} x {cols} points, at most {_LIMIT} are made"
        )
    x0, y0 = low[0] * pitch_mm, low[1] * pitch_mm
    out = np.full((rows, cols), np.nan), np.full((rows, cols), np.nan)
    _raster((x - x0) / pitch_mm, (y - y0) / pitch_mm, z, sigma, good, *out)
    return Grid(*out, x0=x0, y0=y0, pitch=pitch_mm)


@njit(cache=True, nogil=True)
def _raster(x, y, z, sigma, good, z_out, sigma_out):  # type: ignore[no-untyped-def]
    """Fill every triangle of good pixels; x, y in grid steps."""
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            for half in range(2):
                bi, bj = (i, j + 1) if half == 0 else (i + 1, j + 1)
                ci, cj = (i + 1, j + 1) if half == 0 else (i + 1, j)
                if not (good[i, j] and good[bi, bj] and good[ci, cj]):
                    continue
                ax, ay = x[i, j], y[i, j]
                bx, by = x[bi, bj] - ax, y[bi, bj] - ay
                cx, cy = x[ci, cj] - ax, y[ci, cj] - ay
                area = bx * cy - by * cx
                if area == 0.0:
                    continue
                first_row = max(int(np.ceil(ay + min(0.0, by, cy) - 1e-9)), 0)
                last_row = min(int(np.floor(ay + max(0.0, by, cy) + 1e-9)), z_out.shape[0] - 1)
                first_col = max(int(np.ceil(ax + min(0.0, bx, cx) - 1e-9)), 0)
                last_col = min(int(np.floor(ax + max(0.0, bx, cx) + 1e-9)), z_out.shape[1] - 1)
                for r in range(first_row, last_row + 1):
                    for c in range(first_col, last_col + 1):
                        b = ((c - ax) * cy - (r - ay) * cx) / area
                        g = (bx * (r - ay) - by * (c - ax)) / area
                        a = 1.0 - b - g
                        if a < -1e-9 or b < -1e-9 or g < -1e-9:
                            continue
                        z_out[r, c] = a * z[i, j] + b * z[bi, bj] + g * z[ci, cj]
                        sigma_out[r, c] = a * sigma[i, j] + b * sigma[bi, bj] + g * sigma[ci, cj]
