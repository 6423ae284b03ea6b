"""From camera pixels to a regular grid in the mirror's plane, with conserved sigma.

Between three neighbouring pixels the height is that of their three tangent planes, half of each plane's rise
taken: z(X) = sum_k b_k (z_k + g_k . (X - X_k) / 2), b_k barycentric weights; quadratics come back exactly.

An error moves a mirror point along its camera's ray: by dz upward and by dz l sideways, l = (d_x, d_y)/d_z
the ray's lean. At a fixed (x, y) the height therefore changes by dz (1 - g . l), g the surface's gradient:
this factor belongs to sigma. Neighbouring errors are correlated, so that interpolation does not shrink sigma.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.errors import InputError
from optolever.files import save_arrays
from optolever.kernels import exact
from optolever.maps import REGULAR, chosen
from optolever.records import Axes, Comparable, plot_maps, span
from optolever.schema import load_record

__all__ = ["GRID_FORMATS", "Grid", "Lean", "gradients", "natural_pitch", "resample"]

Lean = NDArray[np.floating[Any]]

#: Suffixes of the files that a grid is written to.
GRID_FORMATS = (".npz", *REGULAR)
_LIMIT = 64_000_000  # grid points


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Grid(Comparable):
    """Heights on a regular grid: z[i, j] and sigma[i, j] at x = x0 + j pitch, y = y0 + i pitch, all in mm.

    NaN where no good points surround the grid point.
    """

    z: Annotated[Floats, "rows cols"]
    sigma: Annotated[Floats, "rows cols"]
    x0: float
    y0: float
    pitch: float

    def __repr__(self) -> str:
        (rows, cols), known = self.z.shape, np.isfinite(self.z)
        lines = [f"Grid: {rows} x {cols} points, pitch {self.pitch:.5g} mm, {100 * known.mean():.4g} % known"]
        lines.append(f"  z {span(self.z)} mm, sigma {span(self.sigma)} mm")
        return "\n".join([*lines, f"  x {span(self.x)}, y {span(self.y)} mm"])

    def plot(self, axes: Any = None) -> Axes:
        """Draw z and its standard deviation with matplotlib; the axes."""
        return plot_maps({"z [mm]": self.z, "sigma [mm]": self.sigma}, axes)

    @property
    def x(self) -> Floats:
        """Positions along x, (cols,)."""
        return self.x0 + self.pitch * np.arange(self.z.shape[1], dtype=np.float64)

    @property
    def y(self) -> Floats:
        """Positions along y, (rows,)."""
        return self.y0 + self.pitch * np.arange(self.z.shape[0], dtype=np.float64)

    def save(self, path: str | Path) -> None:
        """Write an .npz: z, sigma (rows, cols), x0, y0, pitch."""
        names = ("z", "sigma", "x0", "y0", "pitch")
        save_arrays(path, {name: getattr(self, name) for name in names})

    @classmethod
    def load(cls, path: str | Path) -> "Grid":
        """Read what save() wrote; InputError names the file and the field."""
        return load_record(cls, path)

    def export(self, path: str | Path) -> None:
        """Write in the format of the suffix, one of GRID_FORMATS; InputError names these. Formats other than
        NPZ have no place for sigma, SDF and DAT none for the origin."""
        suffix = chosen(path, GRID_FORMATS)
        if suffix == ".npz":
            self.save(path)
        else:
            REGULAR[suffix](path, self.z, self.pitch, self.x0, self.y0)


def natural_pitch(x: Floats, y: Floats, good: Mask) -> float:
    """Side of a square as large as the median patch between four good pixels, mm. InputError without one."""
    a, b, c = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1]
    whole = good[a] & good[b] & good[c]
    area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    if not whole.any():
        raise InputError("height map: no three good pixels side by side; name a pitch")
    return float(np.sqrt(np.median(np.abs(area[whole]))))


def resample(
    x: Floats, y: Floats, z: Floats, sigma: Floats, good: Mask, pitch_mm: float, lean: Lean | None = None
) -> Grid:
    """Heights at multiples of the pitch, from the triangles between neighbouring good pixels.

    x, y, z, sigma, good: (H, W); sigma: of z at the pixel, whose point moves along its ray; lean: (2, H, W)
    or (2, 1, 1), x and y per z along the rays (None: upright rays). Raises InputError for a pitch that is not
    positive or makes too large a grid, and where there is no good pixel.
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
    leaning = np.zeros((2, 1, 1)) if lean is None else np.asarray(lean, dtype=np.float64)
    across, up = (x - x0) / pitch_mm, (y - y0) / pitch_mm
    gradient = gradients(across, up, z, good)
    _raster(across, up, z, sigma, good, gradient, np.ascontiguousarray(leaning) / pitch_mm, *out)
    return Grid(*out, x0=x0, y0=y0, pitch=pitch_mm)


@exact
def gradients(x, y, z, good):  # type: ignore[no-untyped-def]
    """dz/dx, dz/dy (2, H, W) from the good pixels along both image axes; NaN where an axis has none."""
    rows, cols = z.shape
    out = np.full((2, rows, cols), np.nan)
    for i in range(rows):
        for j in range(cols):
            if not good[i, j]:
                continue
            ax, bx = _rise(x, good, i, j, 0, 1), _rise(x, good, i, j, 1, 0)
            ay, by = _rise(y, good, i, j, 0, 1), _rise(y, good, i, j, 1, 0)
            az, bz = _rise(z, good, i, j, 0, 1), _rise(z, good, i, j, 1, 0)
            area = ax * by - ay * bx
            if area != 0.0:
                out[0, i, j] = (az * by - bz * ay) / area
                out[1, i, j] = (ax * bz - bx * az) / area
    return out


@exact
def _rise(f, good, i, j, di, dj):  # type: ignore[no-untyped-def]
    """Change of f per pixel along an axis: by both neighbours, by the parabola through two on one side, by
    one; 0 by none."""
    before, after = _inside(good, i - di, j - dj), _inside(good, i + di, j + dj)
    if before and after:
        return 0.5 * (f[i + di, j + dj] - f[i - di, j - dj])
    if not (before or after):
        return 0.0
    side = 1 if after else -1
    first = f[i + side * di, j + side * dj] - f[i, j]
    if not _inside(good, i + 2 * side * di, j + 2 * side * dj):
        return side * first
    return side * (2.0 * first - 0.5 * (f[i + 2 * side * di, j + 2 * side * dj] - f[i, j]))


@exact
def _inside(good, i, j):  # type: ignore[no-untyped-def]
    return 0 <= i < good.shape[0] and 0 <= j < good.shape[1] and good[i, j]


@exact
def _raster(x, y, z, sigma, good, gradient, lean, z_out, sigma_out):  # type: ignore[no-untyped-def]
    """Fill every triangle of good pixels; x, y in grid steps, gradient and lean per grid step."""
    everywhere = lean.shape[1] == 1 and lean.shape[2] == 1
    tx, ty, tz, ts = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    gx, gy, b = np.empty(3), np.empty(3), np.empty(3)
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            for half in range(2):
                bi, bj = (i, j + 1) if half == 0 else (i + 1, j + 1)
                ci, cj = (i + 1, j + 1) if half == 0 else (i + 1, j)
                if not (good[i, j] and good[bi, bj] and good[ci, cj]):
                    continue
                for k in range(3):
                    r, c = (i, j) if k == 0 else ((bi, bj) if k == 1 else (ci, cj))
                    tx[k], ty[k], tz[k] = x[r, c], y[r, c], z[r, c]
                    gx[k], gy[k] = gradient[0, r, c], gradient[1, r, c]
                ux, uy, vx, vy = tx[1] - tx[0], ty[1] - ty[0], tx[2] - tx[0], ty[2] - ty[0]
                area = ux * vy - uy * vx
                if area == 0.0:
                    continue
                slope_x = ((tz[1] - tz[0]) * vy - (tz[2] - tz[0]) * uy) / area
                slope_y = (ux * (tz[2] - tz[0]) - vx * (tz[1] - tz[0])) / area
                for k in range(3):
                    r, c = (i, j) if k == 0 else ((bi, bj) if k == 1 else (ci, cj))
                    lx = lean[0, 0, 0] if everywhere else lean[0, r, c]
                    ly = lean[1, 0, 0] if everywhere else lean[1, r, c]
                    ts[k] = sigma[r, c] * abs(1.0 - slope_x * lx - slope_y * ly)
                    if np.isnan(gx[k] + gy[k]):
                        gx[k], gy[k] = slope_x, slope_y
                first_row = max(int(np.ceil(ty.min() - 1e-9)), 0)
                last_row = min(int(np.floor(ty.max() + 1e-9)), z_out.shape[0] - 1)
                first_col = max(int(np.ceil(tx.min() - 1e-9)), 0)
                last_col = min(int(np.floor(tx.max() + 1e-9)), z_out.shape[1] - 1)
                for r in range(first_row, last_row + 1):
                    for c in range(first_col, last_col + 1):
                        px, py = c - tx[0], r - ty[0]
                        b[1] = (px * vy - py * vx) / area
                        b[2] = (ux * py - uy * px) / area
                        b[0] = 1.0 - b[1] - b[2]
                        if b.min() < -1e-9:
                            continue
                        height, spread = 0.0, 0.0
                        for k in range(3):
                            rise = gx[k] * (c - tx[k]) + gy[k] * (r - ty[k])
                            height += b[k] * (tz[k] + 0.5 * rise)
                            spread += b[k] * ts[k]
                        z_out[r, c] = height
                        sigma_out[r, c] = spread
