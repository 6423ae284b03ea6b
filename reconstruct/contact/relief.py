"""The height map in which dents are looked for: enclosed holes interpolated, errors of the rig taken off.

Most of a map rests, but for the tails of dents. So its heights are A c + t + noise, c ~ N(0, 1) the
coefficients of the rig's modes A, t the tails. Given samples of them, robustly weighted, c has a smaller
covariance: errors that dents have in common with the rest of the map cancel. Where the modes are smaller than
any tail (a calibrated rig, a map against a rest capture), heights hardly change.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from ..arrays import Floats, Mask
from ..heightmap import HeightFlag, HeightMap
from ..judgement.holes import interpolation
from ..outputs.resampling import gradients, natural_pitch
from ..outputs.slope_map import SlopeMap

__all__ = ["Relief"]

_LARGEST = 20_000  # pixels of all holes: more are not interpolated
_SAMPLES = 4000  # pixels
# samples of them by rounds of Cauchy's weights, which keep dents out. In the last round tails share
# their errors, of which residuals show half; a second such round would take for tails what the first gives
# back to the modes
_INDEPENDENT = (*12 * (36.0,), 0.5)
_SPREAD = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True, slots=True)
class Relief:
    """(H, W) each: x, y, z, sigma in mm; slopes, slope_sigmas (2, H, W), inf where interpolated; modes (r, H,
    W), slope_modes (r, 2, H, W) and displacement (m, 2, 3), m >= r: one standard deviation of every remaining
    error of the rig, see `HeightMap`.

    measured: pixels of the map; known: these and the interpolated ones; error: of the interpolation, mm;
    cell: area of a pixel on the mirror, mm^2; pitch: its side, mm.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    slopes: Floats
    slope_sigmas: Floats
    modes: NDArray[np.floating[Any]]
    slope_modes: NDArray[np.floating[Any]]
    displacement: Floats
    measured: Mask
    known: Mask
    error: Floats
    cell: Floats
    pitch: float

    @classmethod
    def of(cls, height: HeightMap, slopes: SlopeMap) -> "Relief | None":
        """Of pixels unflagged or STEEP alone; None without three at (i, j), (i + 1, j) and (i, j + 1)."""
        measured = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
        spread = np.stack([slopes.sigma_x, slopes.sigma_y])
        measured &= (
            np.isfinite(height.z) & np.isfinite(height.sigma + spread.sum(axis=0)) & (spread > 0).all(axis=0)
        )
        if not (measured[:-1, :-1] & measured[1:, :-1] & measured[:-1, 1:]).any():
            return None
        modes = height.calibration
        modes = np.zeros((0, *measured.shape), np.float32) if modes is None else np.nan_to_num(modes)
        x, y, z, sigma, error = height.x, height.y, height.z, height.sigma, np.zeros(measured.shape)
        slope = np.stack([slopes.slope_x, slopes.slope_y])
        holes = scipy.ndimage.binary_fill_holes(measured) & ~measured
        if 0 < np.count_nonzero(holes) <= _LARGEST:
            fill = interpolation(measured, holes)
            nearest = scipy.ndimage.distance_transform_edt(
                ~measured, return_distances=False, return_indices=True
            )
            modes, sigma = modes[:, *nearest], sigma[*nearest]  # smooth
            (rough, z), (_, x), (_, y) = fill(height.z), fill(height.x), fill(height.y)
            error[holes] = np.abs(z - rough)[holes]
            slope = np.where(measured, slope, gradients(x, y, z, measured | holes))
        else:
            holes = np.zeros_like(measured)
        slope_modes = slopes.calibration
        if slope_modes is None or not len(modes):
            slope_modes = np.zeros((len(modes), 2, *measured.shape), np.float32)
        moved = height.displacement
        known = cls(
            *(x, y, z, sigma),
            slopes=np.nan_to_num(slope),
            slope_sigmas=np.where(measured, spread, np.inf),
            modes=modes,
            slope_modes=np.nan_to_num(slope_modes),
            displacement=np.zeros((len(modes), 2, 3)) if moved is None else moved,
            measured=measured,
            known=measured | holes,
            error=error,
            cell=_cells(x, y),
            pitch=natural_pitch(height.x, height.y, measured),
        )
        return known._levelled() if len(modes) else known

    def _levelled(self) -> "Relief":
        """Less the errors of the rig that most of the map shows."""
        count = len(self.modes)
        mean, root = _posterior(self)
        moved = np.tensordot(mean, self.displacement[:count], 1)
        shift = np.tensordot(moved, np.stack([np.ones_like(self.x), self.x, self.y]), 1)
        rest = np.tensordot(root.T, self.displacement[:count], 1)
        return replace(
            self,
            x=self.x - shift[0],
            y=self.y - shift[1],
            z=self.z - np.tensordot(mean, self.modes, 1),
            slopes=self.slopes - np.tensordot(mean, self.slope_modes, 1),
            modes=np.tensordot(root.T, self.modes, 1),
            slope_modes=np.tensordot(root.T, self.slope_modes, 1),
            displacement=np.concatenate([rest, self.displacement[count:]]),
        )


def _posterior(relief: Relief) -> tuple[Floats, Floats]:
    """Coefficients of the rig's modes given the map: mean (r,), and a root (r, r) of their covariance."""
    places = np.flatnonzero(relief.measured)
    places = places[:: max(1, places.size // _SAMPLES)]
    terms = relief.modes.reshape(len(relief.modes), -1)[:, places].astype(np.float64)
    z, noise = relief.z.ravel()[places], relief.sigma.ravel()[places]
    mean = np.zeros(len(terms))
    for independent in _INDEPENDENT:
        residual = z - mean @ terms
        spread = np.maximum(noise, _SPREAD * np.median(np.abs(residual)))
        weight = min(1.0, independent / places.size) / (spread**2 + residual**2)
        normal = (terms * weight) @ terms.T + np.eye(len(terms))
        mean = np.linalg.solve(normal, (terms * weight) @ z)
    inverse, vectors = np.linalg.eigh(normal)
    return mean, vectors / np.sqrt(inverse)


def _cells(x: Floats, y: Floats) -> Floats:
    """Area of the mirror (in x and y) that belongs to every pixel, mm^2."""
    x0, x1 = np.gradient(x)
    y0, y1 = np.gradient(y)
    area = np.abs(x0 * y1 - x1 * y0)
    areas: Floats = np.where(np.isfinite(area), area, np.nanmedian(area))
    return areas
