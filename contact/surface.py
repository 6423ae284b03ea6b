"""Surface: a map less rest as arrays, whichever part measured it; LoadFit: what is taken off it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Ints, Map, Mask

__all__ = ["LoadFit", "Surface", "filled", "spread"]

_DEGREE, _CELLS = 4, 1000  # of the polynomials of `index`; cells that they are fitted to


@dataclass(frozen=True, slots=True, eq=False)
class LoadFit:
    """Fit of the mirror's sinking and of the rig's motion to the heights outside the contacts. c: amplitude
    of the free mode, sigma: its standard deviation; misfit: rms residual over the median noise, beyond: over
    noise and the rig's errors; motion (k,): of the motion's modes; root (1 + k, 1 + k): of the covariance of
    motion and c; rig (1 + k, m): motion and c that the fit finds in each of the other modes; kept (m, m): the
    root of these modes' second moments after it; noise (1 + k, 1 + k): the part of the columns' unit
    covariance that is noise of the map."""

    c: float
    sigma: float
    misfit: float
    beyond: float
    motion: Floats
    root: Floats
    rig: Floats
    kept: Floats
    noise: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Heights less rest on the cells of a camera, (R, C); lengths in mm, z above 0 where it is pressed in.

    sigma: noise of z; good: where z is measured; free: z's free mode, which the anchor settles; modes
    (m, r, c) on every step-th cell: one standard deviation of each error that all heights have in common, the
    last ones, `motions` in number, of the rig's motion since rest, which are there without a dent;
    displacement (k, 2, 3), k at least m: see `reconstruct.HeightMap`;
    anchors (n, 2): x and y of what counts as at rest.
    """

    x: Map
    y: Map
    z: Map
    sigma: Map
    good: Mask
    free: Map | None = None
    modes: Map | None = None
    step: int = 1
    motions: int = 0
    displacement: Floats | None = None
    anchors: Floats | None = None

    @property
    def common(self) -> Map:
        """The modes, of a surface without any none."""
        few = slice(None, None, self.step)
        return np.zeros((0, *self.z[few, few].shape)) if self.modes is None else self.modes

    def index(self) -> Callable[[Floats], Floats]:
        """Rows and columns (2, n) of places (n, 2), by polynomials of the cells' x and y."""
        every = max(1, round(math.sqrt(self.z.size / _CELLS)))
        known = np.isfinite(self.x[::every, ::every] + self.y[::every, ::every])
        row, col = (every * part for part in np.nonzero(known))
        at = np.stack([self.x[row, col], self.y[row, col]], axis=-1).astype(np.float64)
        middle, extent = at.mean(axis=0), max(float(np.ptp(at, axis=0).max()), 1e-6)

        def basis(places: Floats) -> Floats:
            a, b = ((places - middle) / extent).T
            powers = [a**i * b**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
            return np.stack(powers, axis=-1)

        ways = np.linalg.lstsq(basis(at), np.stack([row, col], axis=-1).astype(np.float64), rcond=None)[0]
        return lambda places: np.asarray((basis(places) @ ways).T)

    @property
    def unsettled(self) -> Floats:
        """Standard deviation of z (R, C) where nothing presses, by the motion's modes; the other errors of a
        rig change a map less rest by a share of its dents."""
        if self.modes is None or not self.motions:
            return np.zeros(self.z.shape)
        own = self.modes[-self.motions :]
        return np.sqrt(spread(np.einsum("mrc,mrc->rc", own, own), self.step, *map(np.arange, self.z.shape)))

    def thinned(self, every: int) -> Surface:
        """Every so many cells, with the motion's modes alone."""
        few, places = (slice(None, None, every),) * 2, [np.arange(0, size, every) for size in self.z.shape]
        own = self.common[len(self.common) - self.motions :]
        modes = [spread(one, self.step, *places) for one in own]
        x, y, z, sigma = (part[few] for part in (self.x, self.y, self.z, self.sigma))
        free = None if self.free is None else self.free[few]
        motion = np.reshape(modes, (-1, *z.shape))
        return Surface(x, y, z, sigma, self.good[few], free, modes=motion, motions=len(motion))

    def less(self, fit: LoadFit) -> Surface:
        """The surface without the fitted sag and motion; their standard deviations replace the motion's
        modes."""
        few = slice(None, None, self.step), slice(None, None, self.step)
        own = np.asarray(self.common, np.float64)
        rig, motion = own[: len(own) - self.motions], own[len(own) - self.motions :]
        z = self.z - spread(np.tensordot(fit.motion, motion, 1), self.step, *map(np.arange, self.z.shape))
        left = np.tensordot(fit.root[:-1].T, motion, 1)
        found = np.tensordot(fit.rig[:-1].T, motion, 1)
        if self.free is not None:
            free = np.nan_to_num(self.free[few])
            z = z - fit.c * self.free
            left += np.multiply.outer(fit.root[-1], free)
            found += np.multiply.outer(fit.rig[-1], free)
        rig = np.tensordot(fit.kept, rig - found, 1)
        modes = np.concatenate([rig, left]).astype(np.float32)
        displacement = self.displacement
        if displacement is not None:  # motion moves no point along the mirror
            still = np.zeros((len(left), 2, 3))
            mixed = np.tensordot(fit.kept, displacement[: len(rig)], 1)
            displacement = np.concatenate([mixed, still, displacement[len(own) :]])
        return replace(self, z=z, modes=modes, motions=len(left), displacement=displacement)


def spread(coarse: Map, step: int, rows: Ints, cols: Ints) -> Floats:
    """A field on every step-th cell at rows (n,) and columns (m,) of all, linear between."""
    if step == 1:
        whole = (rows.size, cols.size) == coarse.shape
        return np.asarray(coarse if whole else coarse[rows[:, None], cols], np.float64)
    (row, down), (col, along) = (
        _between(at / step, last - 1) for at, last in zip((rows, cols), coarse.shape, strict=True)
    )
    far, last = np.minimum(col + 1, coarse.shape[1] - 1), np.minimum(row + 1, len(coarse) - 1)
    lines = (1 - along) * coarse[:, col] + along * coarse[:, far]
    field, below = lines[row], lines[last]
    field *= (1 - down)[:, None]
    below *= down[:, None]
    field += below
    return np.asarray(field)


def _between(at: Floats, last: int) -> tuple[Ints, Floats]:
    """Lines of the coarse grid before places, and how far these are from it; constant beyond the last."""
    low = np.minimum(at.astype(np.int64), max(last - 1, 0))
    return low, np.minimum(at, last) - low


def filled(z: Map, good: Mask) -> tuple[Map, Mask, Mask]:
    """Heights with enclosed holes: as the equations bridged them, at most the deepest of the cells beside
    each; else as the nearest measured cell; what is known then; the holes."""
    if good.all():
        return z, good, ~good
    count, labels, boxes, _ = cv2.connectedComponentsWithStats((~good).astype(np.uint8), connectivity=4)
    left, top, width, height = boxes.T[:4]
    enclosed = (left > 0) & (top > 0) & (left + width < z.shape[1]) & (top + height < z.shape[0])
    enclosed[0] = False
    holes = np.asarray(enclosed[labels])
    if not enclosed.any():
        return np.where(good, z, 0), good, holes
    low, high = left[enclosed].min() - 1, (left + width)[enclosed].max() + 1
    box = slice(top[enclosed].min() - 1, (top + height)[enclosed].max() + 1), slice(low, high)
    beside = scipy.ndimage.maximum_filter(np.where(good[box], z[box], -np.inf), 3)
    deepest = np.asarray(scipy.ndimage.maximum(beside, labels[box], np.arange(count)))
    out, known = np.where(holes, np.minimum(z, deepest[labels]), np.where(good, z, 0)), good | holes
    places = np.flatnonzero(holes & ~np.isfinite(z))
    if not places.size:
        return out, known, holes
    nearest = scipy.ndimage.distance_transform_edt(~good, return_distances=False, return_indices=True)
    out.flat[places] = z[tuple(nearest.reshape(2, -1)[:, places])]
    return out, known, holes
