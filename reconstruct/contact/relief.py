"""The height map in which dents are looked for: enclosed holes interpolated, errors of the rig levelled."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from ..arrays import Floats, Mask
from ..heightmap import HeightFlag, HeightMap
from ..judgement.holes import interpolation
from ..outputs.resampling import natural_pitch
from ..outputs.slope_map import SlopeMap

__all__ = ["Relief", "flat", "levelled"]

_LARGEST = 20_000  # pixels of all holes: more are not interpolated
_SAMPLES = 4000  # pixels that level the map
_INDEPENDENT = 36  # samples of them
_ROUNDS = 12  # of reweighting
_SPREAD = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True, slots=True)
class Relief:
    """(H, W) each: x, y, z, sigma and modes (r, H, W) in mm, with holes interpolated.

    measured: pixels of the map; known: these and the interpolated ones; error: of the interpolation, mm, 0
    where measured; cell: area of a pixel on the mirror, mm^2; pitch: its side, mm.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    modes: NDArray[np.float32]
    measured: Mask
    known: Mask
    error: Floats
    cell: Floats
    pitch: float

    @classmethod
    def of(cls, height: HeightMap, slopes: SlopeMap) -> "Relief | None":
        """Of pixels unflagged or STEEP alone; None without three at (i, j), (i + 1, j) and (i, j + 1)."""
        measured = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
        spread = height.sigma + slopes.sigma_x + slopes.sigma_y
        measured &= np.isfinite(height.z) & np.isfinite(spread) & (slopes.sigma_x > 0) & (slopes.sigma_y > 0)
        if not (measured[:-1, :-1] & measured[1:, :-1] & measured[:-1, 1:]).any():
            return None
        modes = height.calibration
        if modes is None:
            modes = np.zeros((0, *measured.shape), np.float32)
        fields = np.stack([height.x, height.y, height.z, height.sigma])
        holes = scipy.ndimage.binary_fill_holes(measured) & ~measured
        error = np.zeros(measured.shape)
        if 0 < np.count_nonzero(holes) <= _LARGEST:
            fill = interpolation(measured, holes)
            nearest = scipy.ndimage.distance_transform_edt(
                ~measured, return_distances=False, return_indices=True
            )
            modes = modes[:, *nearest]  # smooth
            rough, z = fill(height.z)
            error[holes] = np.abs(z - rough)[holes]
            fields = np.stack([fill(height.x)[1], fill(height.y)[1], z, height.sigma[*nearest]])
        else:
            holes = np.zeros_like(measured)
        x, y, z, sigma = fields
        pitch = natural_pitch(height.x, height.y, measured)
        return cls(x, y, z, sigma, modes, measured, measured | holes, error, _cells(x, y), pitch)


def flat(field: NDArray[np.floating[Any]]) -> Floats:
    """A field (..., H, W) with its pixels in one axis."""
    pixels: Floats = np.asarray(field).reshape(*field.shape[:-2], field.shape[-2] * field.shape[-1])
    return pixels


def _cells(x: Floats, y: Floats) -> Floats:
    """Area of the mirror (in x and y) that belongs to every pixel, mm^2."""
    x0, x1 = np.gradient(x)
    y0, y1 = np.gradient(y)
    area = np.abs(x0 * y1 - x1 * y0)
    areas: Floats = np.where(np.isfinite(area), area, np.nanmedian(area))
    return areas


def levelled(relief: Relief) -> Floats:
    """Heights (H, W) less the quadratic part of the rig's errors that most of the map shows, for detection.

    The coefficients of the modes have prior variance 1; Cauchy's weights keep dents out. Samples count as
    _INDEPENDENT of them, as dents and their tails are as wide.
    """
    if not len(relief.modes):
        return relief.z
    places = np.flatnonzero(relief.measured)
    places = places[:: max(1, places.size // _SAMPLES)]
    basis = _quadratic(relief)
    forms = flat(basis)[:, places]
    parts = np.linalg.lstsq(forms.T, flat(relief.modes)[:, places].T.astype(np.float64), rcond=None)[0]
    terms = parts.T @ forms
    z, noise = relief.z.ravel()[places], relief.sigma.ravel()[places]
    share = min(1.0, _INDEPENDENT / places.size)
    found = np.zeros(len(terms))
    for _ in range(_ROUNDS):
        residual = z - found @ terms
        weight = share / (np.maximum(noise, _SPREAD * np.median(np.abs(residual))) ** 2 + residual**2)
        normal = (terms * weight) @ terms.T + np.eye(len(terms))
        found = np.linalg.solve(normal, (terms * weight) @ z)
    levels: Floats = relief.z - np.tensordot(parts @ found, basis, 1)
    return levels


def _quadratic(relief: Relief) -> Floats:
    """1, x, y, x^2, x y, y^2 over the map, (6, H, W)."""
    x, y = (
        (part - np.nanmean(part)) / max(float(np.nanstd(part)), relief.pitch) for part in (relief.x, relief.y)
    )
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
