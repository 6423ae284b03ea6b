"""The surroundings of a dent, and what they say of the rig's errors.

Around a dent the surface rests, but for the tails of dents. So the heights d of points around it are

    d = A c + t + noise,   c ~ N(0, 1) the coefficients of the rig's modes, A their values there,

t the tails. An elastic half-space outside a contact of radius a lies between 0 and T = (2/pi) asin(a/r) of
the depth (the flat punch; K. L. Johnson, Contact Mechanics, 1985, eq. 3.38). The rms over that range,
T/sqrt 3, is the standard deviation of t. Directions share most of it: the k-th harmonic of a tail falls as
r^-(k+1), and is (a/r)^k of its mean where the surroundings lie. Given d, c has a smaller covariance: errors
that the dent and its surroundings have in common cancel. Where the modes are smaller than any tail (a
calibrated rig, a map against a rest capture), heights hardly change; where they are much larger, the rim
becomes the reference.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Mask
from .relief import Relief, flat

__all__ = ["Posterior", "Rim", "posterior"]

SECTORS = 24
_REACH = 3.5  # half-depth radii: where surroundings end
_WIDTH = 0.3  # of a sector's reach: their width
_LEAST = 1.3  # half-depth radii: nearer pixels are of the dent
_FEWEST = 5  # sectors that say what is around
_SHARED = 1 / 3  # Poisson kernel, of the tails over the directions: a/r at the surroundings, 1/4 to 1/3
_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Rim:
    """Surroundings of one dent: the flat pixels (`groups`, one array a sector); peak: flat pixel; radius:
    where its depth is halved, mm; depth: of the peak over the plane of the sectors' means, mm; weights
    (n,): depth = z_peak - weights @ means.
    """

    peak: int
    radius: float
    depth: float
    groups: tuple[Floats, ...]
    weights: Floats

    def means(self, field: NDArray[np.floating[Any]]) -> Floats:
        """Mean of a field (..., H, W) in every sector, (..., n)."""
        pixels = flat(field)
        return np.stack([pixels[..., group].mean(axis=-1) for group in self.groups], axis=-1)

    def rise(self, field: NDArray[np.floating[Any]]) -> Floats:
        """A field at the peak less that of the surroundings there, (...)."""
        rise: Floats = flat(field)[..., self.peak] - self.means(field) @ self.weights
        return rise

    @classmethod
    def of(cls, relief: Relief, z: Floats, basin: Mask, peak: int) -> "Rim | None":
        """Around the peak of a basin on heights z; None where nothing surrounds it."""
        places = np.flatnonzero(basin)
        heights = z.ravel()[places]
        dx, dy = (part.ravel()[places] - part.ravel()[peak] for part in (relief.x, relief.y))
        r, phi = np.hypot(dx, dy), np.arctan2(dy, dx)
        cell = relief.cell.ravel()[places]
        sector = ((phi + np.pi) / (2 * np.pi) * SECTORS).astype(np.intp) % SECTORS
        reach = np.zeros(SECTORS)
        np.maximum.at(reach, sector, r)
        top, base = float(z.ravel()[peak]), float(heights.min())
        found = None
        for _ in range(_ROUNDS):
            half = heights > 0.5 * (top + base)
            radius = max(float(np.sqrt(cell[half].sum() / np.pi)), relief.pitch)
            ends = np.minimum(reach, _REACH * radius)[sector]
            ring = (r > (1 - _WIDTH) * ends) & (r <= ends) & (r > _LEAST * radius)
            groups = tuple(places[ring & (sector == k)] for k in range(SECTORS))
            groups = tuple(group for group in groups if group.size)
            if len(groups) < _FEWEST:
                break
            weights = _plane(relief, groups, peak)
            base = float(np.array([z.ravel()[group].mean() for group in groups]) @ weights)
            found = cls(peak, radius, top - base, groups, weights)
        return found


def _plane(relief: Relief, groups: tuple[Floats, ...], peak: int) -> Floats:
    """Weights (n,) that give the plane through the groups' heights at the peak; their mean where directions
    are missing, so that the plane is no extrapolation."""
    offsets = np.array(
        [
            [part.ravel()[group].mean() - part.ravel()[peak] for part in (relief.x, relief.y)]
            for group in groups
        ]
    )
    terms = np.column_stack([np.ones(len(groups)), offsets])
    weights: Floats = np.linalg.pinv(terms)[0]
    if np.linalg.norm(weights) > 2.0 / np.sqrt(len(groups)):
        return np.full(len(groups), 1.0 / len(groups))
    return weights


@dataclass(frozen=True, slots=True)
class Posterior:
    """Coefficients of the rig's modes given the surroundings: mean (r,) and a root (r, r) of their
    covariance, root @ root.T."""

    mean: Floats
    root: Floats


def posterior(relief: Relief, rim: Rim, others: list[Rim]) -> Posterior:
    """Of the modes by one dent's surroundings; others: every dent of the map, this one included."""
    count = len(relief.modes)
    if not count:
        return Posterior(np.zeros(0), np.zeros((0, 0)))
    terms = rim.means(relief.modes).T
    x, y = rim.means(relief.x), rim.means(relief.y)
    shared = np.diag(rim.means(relief.sigma) ** 2)
    for each in others:
        dx, dy = x - relief.x.ravel()[each.peak], y - relief.y.ravel()[each.peak]
        share = 2 / np.pi * np.arcsin(np.minimum(each.radius / np.hypot(dx, dy), 1.0))
        size = max(each.depth, 0.0) * share / np.sqrt(3)
        phi = np.arctan2(dy, dx)
        cosine = np.cos(phi[:, None] - phi)
        kernel = (1 - _SHARED) ** 2 / (1 - 2 * _SHARED * cosine + _SHARED**2)
        shared += np.outer(size, size) * kernel
    gain = np.linalg.solve(terms @ terms.T + shared, terms).T
    mean = gain @ rim.means(relief.z)
    shares, vectors = np.linalg.eigh(np.eye(count) - gain @ terms)
    return Posterior(mean, vectors * np.sqrt(np.maximum(shares, 0.0)))
