"""One dent of a height map as flat arrays, seen in polar coordinates from its middle."""

from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from ..heightmap import HeightMap
from ..slope_map import SlopeMap

__all__ = ["Dent", "cells"]

CORE = 0.7  # of the depth: the dent's middle is that of what is deeper


@dataclass(frozen=True, slots=True)
class Dent:
    """Known pixels around one dent as flat arrays; modes (r, N), slope_modes (r, 2, N): of the rig's errors,
    r = 0 without a covariance; cell: their area, mm^2; inside: those of the dent; peak:
    the number of the deepest; pitch: size of a pixel, mm; middle: where r, phi start.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    slopes: Floats
    slope_sigmas: Floats
    modes: Floats
    slope_modes: Floats
    cell: Floats
    inside: Mask
    peak: int
    pitch: float
    middle: tuple[float, float]

    @classmethod
    def of(
        cls, height: HeightMap, slopes: SlopeMap, usable: Mask, inside: Mask, cell: Floats, pitch: float
    ) -> "Dent":
        """The pixels up to twice as far from the middle as the dent reaches."""
        deepest = np.max(height.z[inside])
        core = inside & (height.z > CORE * deepest)
        whole = scipy.ndimage.binary_fill_holes(core) & np.isfinite(height.x)
        middle = float(height.x[whole].mean()), float(height.y[whole].mean())
        r = np.hypot(height.x - middle[0], height.y - middle[1])
        near = usable & (r < 2.0 * r[inside].max())
        height_modes, slope_modes = height.calibration, slopes.calibration
        if height_modes is None or slope_modes is None:
            height_modes, slope_modes = np.zeros((0, *near.shape)), np.zeros((0, 2, *near.shape))
        return cls(
            height.x[near],
            height.y[near],
            height.z[near],
            height.sigma[near],
            np.stack([slopes.slope_x[near], slopes.slope_y[near]]),
            np.stack([slopes.sigma_x[near], slopes.sigma_y[near]]),
            height_modes[:, near].astype(np.float64),
            np.nan_to_num(slope_modes[:, :, near].astype(np.float64)),
            cell[near],
            inside[near],
            int(np.argmax(np.where(inside[near], height.z[near], -np.inf))),
            pitch,
            middle,
        )

    @property
    def r(self) -> Floats:
        """Distance from the middle, mm."""
        r: Floats = np.hypot(self.x - self.middle[0], self.y - self.middle[1])
        return r

    @property
    def phi(self) -> Floats:
        """Direction from the middle, rad."""
        phi: Floats = np.arctan2(self.y - self.middle[1], self.x - self.middle[0])
        return phi

    @property
    def direction(self) -> Floats:
        """Unit vectors (2, N) away from the middle."""
        return np.stack([np.cos(self.phi), np.sin(self.phi)])

    @property
    def radial(self) -> tuple[Floats, Floats]:
        """Slope away from the middle and its sigma."""
        ray = self.direction
        return (self.slopes * ray).sum(axis=0), np.hypot(*(self.slope_sigmas * ray))


def cells(height: HeightMap) -> Floats:
    """Area of the mirror (in x and y) that belongs to every pixel, mm^2."""
    x0, x1 = np.gradient(height.x)
    y0, y1 = np.gradient(height.y)
    area = np.abs(x0 * y1 - x1 * y0)
    areas: Floats = np.where(np.isfinite(area), area, np.nanmedian(area))
    return areas
