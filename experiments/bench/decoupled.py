"""Deflectometry as most codes do it: slopes as if the mirror were at rest, then one integration of them.

The depth that the slopes depend on is taken as zero. What that costs is what the coupled solver saves.
"""

from collections.abc import Callable

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.reconstruct import HeightMap
from optolever.scene import Scene

__all__ = ["decoupled", "frankot_chellappa", "rest_slopes"]

Floats = NDArray[np.float64]
Integrator = Callable[[Floats, Floats], Floats]


def decoupled(seen: Correspondence, scene: Scene, integrate: Integrator) -> HeightMap:
    """Height by one integration of the slopes at rest; no sigma (inf), flags of the correspondence.

    integrate: (height per row, height per column), (H, W) each -> height up to a constant. Flagged pixels
    have no slope. The constant is set so that the pixels along the edge x = L0 are at rest on average.
    """
    x, y, slope_x, slope_y = rest_slopes(seen, scene)
    known = seen.good & np.isfinite(slope_x) & np.isfinite(slope_y)
    steps = [
        np.where(known, slope_x * np.gradient(x, axis=axis) + slope_y * np.gradient(y, axis=axis), 0.0)
        for axis in (0, 1)
    ]
    z = np.asarray(integrate(steps[0], steps[1]), dtype=np.float64)
    pixel = max(np.abs(np.gradient(x, axis=axis)).max() for axis in (0, 1))
    edge = x > x.max() - 0.75 * pixel
    z = z - z[edge].mean()
    flags = np.where(known | (seen.flags != 0), seen.flags, int(Flag.INVALID)).astype(np.uint16)
    return HeightMap(x, y, np.where(known, z, np.nan), np.full(z.shape, np.inf), flags)


def rest_slopes(seen: Correspondence, scene: Scene) -> tuple[Floats, Floats, Floats, Floats]:
    """x, y (mm) where every ray meets the mirror at rest, and dz/dx, dz/dy there: the normal bisects the
    rays.
    """
    origins, directions = scene.camera.rays()
    points = origins - (origins[..., 2] / directions[..., 2])[..., None] * directions
    away: Floats = points - scene.pattern.point(
        np.asarray(seen.u, np.float64), np.asarray(seen.v, np.float64)
    )
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    normal = away + directions
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            points[..., 0],
            points[..., 1],
            -normal[..., 0] / normal[..., 2],
            -normal[..., 1] / normal[..., 2],
        )


def frankot_chellappa(per_row: Floats, per_col: Floats) -> Floats:
    """The periodic field whose gradient is nearest to the given one in the mean square.

    Frankot and Chellappa 1988, eq. 21 (doi:10.1109/34.3909).
    """
    rows, cols = per_row.shape
    along_rows = 2j * np.pi * scipy.fft.fftfreq(rows)[:, None]
    along_cols = 2j * np.pi * scipy.fft.rfftfreq(cols)[None, :]
    energy = np.abs(along_rows) ** 2 + np.abs(along_cols) ** 2
    energy[0, 0] = 1.0
    modes = -(along_rows * scipy.fft.rfft2(per_row) + along_cols * scipy.fft.rfft2(per_col)) / energy
    modes[0, 0] = 0.0
    return np.asarray(scipy.fft.irfft2(modes, s=(rows, cols)), dtype=np.float64)
