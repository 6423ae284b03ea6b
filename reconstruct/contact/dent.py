"""One dent of a height map as flat arrays, in polar coordinates from its middle, and its deepest point."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from .relief import Relief

__all__ = ["Deepest", "Dent", "deepest"]

INSIDE = 0.4  # of the depth: pixels of the dent
CORE = 0.7  # of the depth: the dent's middle is that of the deeper pixels
_RADII = (3.2, 2.3)  # pixels of the paraboloid; the smaller one bounds its shape error
_FEWEST = 12  # pixels


@dataclass(frozen=True, slots=True)
class Dent:
    """Known pixels around one dent as flat arrays (N,), fields as those of `Relief`.

    inside: pixels of the dent; border: neighbours of pixels where nothing is known (the image's edge, flags);
    saddle: neighbours of another dent's basin; peak: the number of the deepest within its sigma; middle:
    where r, phi start; radius: where the depth is halved, mm.
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

    @classmethod
    def of(cls, relief: Relief, basin: Mask, peak: int) -> "Dent":
        """The pixels of a basin up to twice as far from the middle as the dent reaches."""
        depth = float(relief.z.ravel()[peak])
        labels, _ = scipy.ndimage.label(basin & (relief.z > INSIDE * depth))
        inside = labels == labels.ravel()[peak]
        core = scipy.ndimage.binary_fill_holes(inside & (relief.z > CORE * depth)) & relief.known
        middle = float(relief.x[core].mean()), float(relief.y[core].mean())
        r = np.hypot(relief.x - middle[0], relief.y - middle[1])
        near = basin & (r < 2.0 * r[inside].max())
        fields = ("x", "y", "z", "sigma", "slopes", "slope_sigmas", "cell", "measured", "error")
        return cls(
            **{name: getattr(relief, name)[..., near] for name in fields},
            modes=relief.modes[:, near].astype(np.float64),
            slope_modes=relief.slope_modes[..., near].astype(np.float64),
            displacement=relief.displacement,
            inside=inside[near],
            border=_beside(relief.known)[near],
            saddle=_beside(basin | ~relief.known, beyond=True)[near],
            peak=int(np.count_nonzero(near.ravel()[:peak])),
            pitch=relief.pitch,
            middle=middle,
            radius=float(np.sqrt(relief.cell[inside & (relief.z > 0.5 * depth)].sum() / np.pi)),
        )

    def thinned(self, most: int) -> "Dent":
        """About so many of its pixels, without `peak`."""
        every, names = self.x.size // most + 1, set(self.__slots__) - {"displacement", "middle"}
        fields: dict[str, Any] = {name: getattr(self, name) for name in names}
        return replace(self, **{name: part[..., ::every] for name, part in fields.items() if np.ndim(part)})

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


class Deepest(NamedTuple):
    """x, y, depth in mm with standard deviations; depth_noise: the part that is noise."""

    x: float
    y: float
    x_sigma: float
    y_sigma: float
    depth: float
    depth_sigma: float
    depth_noise: float


def deepest(dent: Dent) -> Deepest:
    """The top of a paraboloid; the deepest pixel of a plateau, or of a tip, in which it may be anywhere."""
    at, here = dent.peak, np.array([dent.x[dent.peak], dent.y[dent.peak]])
    away = np.hypot(dent.x - here[0], dent.y - here[1])
    near = away < _RADII[0] * dent.pitch
    first, other = (_top(dent, away < radius * dent.pitch) for radius in _RADII)
    z, sigma = float(dent.z[at]), float(dent.sigma[at])
    moves = dent.moved(*here)
    if first is None:
        steep = float(np.median(np.hypot(*dent.slopes[:, near])))
        top, noise = (here, z), float(np.hypot(sigma, 0.25 * steep * dent.pitch))
        spread = np.full(2, dent.pitch if steep * dent.radius > 0.3 * z else 0.5 * dent.radius)
    else:
        depth, place, shift = first
        lower, beside = (z, np.zeros(2)) if other is None else other[:2]
        tilt = np.median(dent.slope_sigmas[:, near], axis=1) / np.sqrt(np.count_nonzero(near))
        spread = np.minimum(np.hypot(np.linalg.norm(shift * tilt, axis=1), place - beside), dent.radius)
        moves[: len(dent.slope_modes)] += dent.slope_modes[:, :, near].mean(axis=2) @ shift
        top, noise = (here + place, depth), float(np.hypot(sigma, depth - lower))
    x_sigma, y_sigma = np.hypot(spread, np.linalg.norm(moves, axis=0)).tolist()
    if not dent.measured[at]:  # at most a cone that continues the flank around the hole
        reach = float(away[dent.measured].min())
        rim = dent.measured & (away < reach + 1.5 * dent.pitch)
        noise = float(np.hypot(noise, reach * np.median(np.hypot(*dent.slopes[:, rim]))))
    (x, y), depth = top
    whole = float(np.linalg.norm([noise, *dent.modes[:, at]]))
    return Deepest(float(x), float(y), x_sigma, y_sigma, depth, whole, noise)


def _top(dent: Dent, near: Floats) -> tuple[float, Floats, Floats] | None:
    """Height of the top of a paraboloid through the pixels `near`, its place from the deepest pixel (mm) and
    its shift (2, 2) by slopes that are added; None where none fits."""
    dx, dy, heights = (part[near] - part[dent.peak] for part in (dent.x, dent.y, dent.z))
    if dx.size < _FEWEST:
        return None
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    c = np.linalg.lstsq(terms, heights, rcond=None)[0]
    bent = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    z = float(dent.z[dent.peak])
    if abs(c[0]) > max(float(dent.sigma[dent.peak]), 1e-3 * z) or not np.all(np.linalg.eigvalsh(bent) < 0):
        return None
    top = -np.linalg.solve(bent, c[1:3])
    if np.hypot(*top) > float(np.hypot(dx, dy).max()):
        return None
    return z + float(c[0] + 0.5 * c[1:3] @ top), top, -np.linalg.inv(bent)


def _beside(mask: Mask, beyond: bool = False) -> Mask:
    """Pixels of a mask that have a neighbour outside of it; beyond: whether what lies beyond the image is of
    the mask."""
    within = scipy.ndimage.binary_erosion(mask, np.ones((3, 3)), border_value=int(beyond))
    return np.asarray(mask & ~within)
