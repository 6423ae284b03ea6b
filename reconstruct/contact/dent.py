"""One dent of a height map as flat arrays, in polar coordinates from its middle."""

from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from ..heightmap import HeightMap
from ..outputs.resampling import gradients
from ..outputs.slope_map import SlopeMap
from .relief import Relief
from .rim import Posterior, Rim

__all__ = ["Dent"]

INSIDE = 0.4  # of the depth: pixels of the dent
CORE = 0.7  # of the depth: the dent's middle is that of the deeper pixels


@dataclass(frozen=True, slots=True)
class Dent:
    """Known pixels around one dent as flat arrays (N,), heights and positions corrected for the
    errors of the rig by the surroundings.

    modes (r, N), slope_modes (r, 2, N): of the rig's remaining errors; displacement (m, 2, 3): see
    `HeightMap`; cell: area of a pixel, mm^2; inside: pixels of the dent; measured: not interpolated; error:
    of the interpolation, mm; border: neighbours of pixels where nothing is known (the image's edge, flags);
    saddle: neighbours of another dent's basin; peak: the number of the deepest within its sigma; pitch: size
    of a pixel, mm; middle: where r, phi start; radius: where the depth is halved; rim_depth and its sigma: of
    the peak over the surroundings.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    slopes: Floats
    slope_sigmas: Floats
    modes: Floats
    slope_modes: Floats
    displacement: Floats
    cell: Floats
    inside: Mask
    measured: Mask
    error: Floats
    border: Mask
    saddle: Mask
    peak: int
    pitch: float
    middle: tuple[float, float]
    radius: float
    rim_depth: float
    rim_depth_sigma: float

    @classmethod
    def of(
        cls, height: HeightMap, slopes: SlopeMap, relief: Relief, basin: Mask, rim: Rim, known: Posterior
    ) -> "Dent | None":
        """The pixels of a basin up to twice as far from the middle as the dent reaches; None where no height
        is above the surface at rest."""
        z = relief.z - np.tensordot(known.mean, relief.modes, 1)
        close = np.hypot(relief.x - relief.x.ravel()[rim.peak], relief.y - relief.y.ravel()[rim.peak])
        top = np.where(basin & (close <= rim.radius), z - relief.sigma, -np.inf)
        peak = int(np.argmax(top))
        depth = float(z.ravel()[peak])
        if not depth > 0:
            return None
        labels, _ = scipy.ndimage.label(basin & (z > INSIDE * depth))
        inside = labels == labels.ravel()[peak]
        core = scipy.ndimage.binary_fill_holes(inside & (z > CORE * depth)) & relief.known
        middle = float(relief.x[core].mean()), float(relief.y[core].mean())
        r = np.hypot(relief.x - middle[0], relief.y - middle[1])
        near = basin & (r < 2.0 * r[inside].max())
        slope_modes = slopes.calibration
        if slope_modes is None or not len(relief.modes):
            slope_modes = np.zeros((len(relief.modes), 2, *near.shape), np.float32)
        count = len(relief.modes)
        displacement = np.zeros((count, 2, 3)) if height.displacement is None else height.displacement
        moved = known.mean @ displacement[:count].reshape(count, 6)
        shift = moved.reshape(2, 3) @ np.stack(
            [np.ones(np.count_nonzero(near)), relief.x[near], relief.y[near]]
        )
        rest = np.einsum("rs,rij->sij", known.root, displacement[:count])
        noise = np.hypot(relief.sigma.ravel()[peak], np.linalg.norm(rim.means(relief.sigma) * rim.weights))
        modes = relief.modes[:, near].astype(np.float64)
        slope_modes = np.nan_to_num(slope_modes[:, :, near].astype(np.float64))
        slope = np.stack([slopes.slope_x, slopes.slope_y])
        if not relief.measured[near].all():
            slope = np.where(relief.measured, slope, gradients(relief.x, relief.y, relief.z, relief.known))
        slope = np.nan_to_num(slope[:, near])
        spread = np.stack([slopes.sigma_x[near], slopes.sigma_y[near]])
        return cls(
            x=relief.x[near] - shift[0],
            y=relief.y[near] - shift[1],
            z=z[near],
            sigma=relief.sigma[near],
            slopes=slope - np.tensordot(known.mean, slope_modes, 1),
            slope_sigmas=np.where(relief.measured[near], spread, np.inf),
            modes=known.root.T @ modes,
            slope_modes=np.einsum("rs,rkn->skn", known.root, slope_modes),
            displacement=np.concatenate([rest, displacement[count:]]),
            cell=relief.cell[near],
            inside=inside[near],
            measured=relief.measured[near],
            error=relief.error[near],
            border=_beside(relief.known)[near],
            saddle=_beside(basin | ~relief.known, beyond=True)[near],
            peak=int(np.count_nonzero(near.ravel()[:peak])),
            pitch=relief.pitch,
            middle=(middle[0] - float(shift[0].mean()), middle[1] - float(shift[1].mean())),
            radius=rim.radius,
            rim_depth=float(rim.rise(z)),
            rim_depth_sigma=float(np.hypot(noise, np.linalg.norm(rim.rise(relief.modes) @ known.root))),
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
        """Slope away from the middle and its sigma, inf where interpolated."""
        ray = self.direction
        return (self.slopes * ray).sum(axis=0), np.hypot(
            *(self.slope_sigmas * np.where(ray == 0, 1e-12, ray))
        )

    def moved(self, x: float, y: float) -> Floats:
        """Change of the point (x, y) by one standard deviation of every error of the rig, (m, 2)."""
        changes: Floats = self.displacement @ np.array([1.0, x, y])
        return changes

    @property
    def stretch(self) -> Floats:
        """Relative change of areas by every error of the rig, (m,)."""
        stretches: Floats = self.displacement[:, 0, 1] + self.displacement[:, 1, 2]
        return stretches


def _beside(mask: Mask, beyond: bool = False) -> Mask:
    """Pixels of a mask that have a neighbour outside of it; beyond: whether what lies beyond the image is of
    the mask."""
    within = scipy.ndimage.binary_erosion(mask, np.ones((3, 3)), border_value=int(beyond))
    return np.asarray(mask & ~within)
