"""Corners of the paper's lattice: sub-pixel in the rest frame, tracked into a deformed one."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.patterns import Sequence, lattice_lines
from optolever.records import Comparable

from .corners import Corners, refined
from .crossed import displaced
from .prior import PatternMap, frame_pair, prior_map

__all__ = ["Crossings", "lattice"]

F64 = NDArray[np.float64]
#: Change of the displacement in its last pass, cycles: a line's number needs no more.
_SETTLED = 0.1
#: From its expected place, periods: half a period away the next line is as near.
_FARTHEST = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Crossings(Comparable):
    """K crossings found at rest; `now` is NaN and `sigma` inf where one was not found again.

    index  (K, 2) numbers of the lines along u and v      pattern  (K, 2) their u, v, pattern pixels
    rest   (K, 2) row, col at rest, camera pixels          now      (K, 2) row, col in the deformed frame
    sigma, sigma_rest  (K, 2) standard deviations of row, col, camera pixels
    """

    index: NDArray[np.int64]
    pattern: F64
    rest: F64
    now: F64
    sigma: F64
    sigma_rest: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where the crossing was found in both frames, (K,)."""
        return np.asarray(np.isfinite(self.now).all(axis=1))

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> "Crossings":
        """Read what save() wrote."""
        names = [field.name for field in fields(cls)]
        arrays = load_arrays(path, names)
        return cls(**{name: arrays[name] for name in names})


def lattice(
    frames: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Crossings:
    """Crossings of the lattice in `frames`, each matched to the same one in `rest`.

    frames, rest  (N, H, W) as the sequence describes them, or the lattice frame alone, (H, W)
    prior         where the camera looked at rest, to a quarter of the lattice's period (a trace, a decoded
                  capture); default: the surface fills the frame, u along columns, v along rows

    A crossing is matched by the displacement of the lattice's first harmonic, which is a crossed fringe: its
    median in each connected part of the mirror must be within half a period (see crossed).
    """
    frame, image, still = frame_pair(frames, rest, sequence, "lattice")
    lines = lattice_lines(frame, sequence.cols), lattice_lines(frame, sequence.rows)
    pattern = np.stack(np.meshgrid(*lines), axis=-1)
    period, width = frame.period_px or 1.0, frame.width_px or 1.0
    u, v = prior_map(prior, sequence, still.shape)
    at_rest = refined(still.astype(np.float32), *_inverse(u, v, pattern), period, width)
    if not at_rest.found.any():
        raise InputError("lattice: no crossing was found in the rest frame; is the prior that frame's?")
    moved = displaced(image, still, (u, v), (sequence.rows, sequence.cols), period, _SETTLED)
    du, dv = (np.where(moved.good, part, np.nan) for part in (moved.du, moved.dv))
    start, steps = _inverse(u + du, v + dv, pattern)
    now = refined(image.astype(np.float32), start, steps, period, width)
    size = period * np.sqrt(np.abs(np.linalg.det(np.where(now.found[..., None, None], steps, 0))))
    far = np.hypot(*np.moveaxis(now.point - start, -1, 0)) > _FARTHEST * size
    now.point[far], now.sigma[far] = np.nan, np.inf
    at_rest, now = (_without_curvature(corners, width / period) for corners in (at_rest, now))
    keep = at_rest.found
    index = np.argwhere(keep)[:, ::-1]
    return Crossings(
        index, pattern[keep], at_rest.point[keep], now.point[keep], now.sigma[keep], at_rest.sigma[keep]
    )


def _inverse(u: F64, v: F64, points: F64) -> tuple[F64, F64]:
    """Camera places (J, I, 2), row and column, of pattern coordinates (J, I, 2), and camera steps per pattern
    pixel of u, v there (J, I, 2, 2); NaN outside the map.

    From the nearest of about 40,000 pixels three Newton steps lead there: a map is smooth.
    """
    pattern = points.reshape(-1, 2)
    thin = max(2, int(np.sqrt(u.size / 40000)))
    gradient = np.stack([np.stack([*np.gradient(part)], axis=-1) for part in (u, v)], axis=-2)
    row, col = (axis.ravel() for axis in np.mgrid[1 : u.shape[0] - 1 : thin, 1 : u.shape[1] - 1 : thin])
    area = np.abs(np.linalg.det(np.nan_to_num(gradient[row, col])))
    good = np.isfinite(u[row, col] + v[row, col]) & (area > 1e-6)
    if not good.any():
        return np.full(points.shape, np.nan), np.full((*points.shape, 2), np.nan)
    row, col = row[good], col[good]
    nearest = cKDTree(np.stack([u[row, col], v[row, col]], axis=1)).query(pattern)[1]
    place = np.stack([row[nearest], col[nearest]], axis=1).astype(np.float64)
    for _ in range(3):
        at = tuple(np.clip(np.rint(place[:, k]), 0, u.shape[k] - 1).astype(int) for k in (0, 1))
        jacobian = gradient[at]
        usable = np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 1e-6
        inverse = np.full(jacobian.shape, np.nan)
        inverse[usable] = np.linalg.inv(jacobian[usable])
        missing = pattern - np.stack([u[at], v[at]], axis=1)
        place = np.stack(at, axis=1) + np.einsum("kij,kj->ki", inverse, missing)
        place[~np.isfinite(place)] = -1.0
    beside = np.abs(place - np.stack(at, axis=1)) > 1.5
    place[(beside | (place < 0) | (place > np.array(u.shape) - 1)).any(axis=1)] = np.nan
    return place.reshape(points.shape), inverse.transpose(0, 2, 1).reshape(*points.shape, 2)


def _without_curvature(corners: Corners, share: float) -> Corners:
    """Less the shift that the map's curvature gives to the centroid of a line that is `share` periods wide.

    Where the place x of pattern coordinate q curves, a line's darkness spreads as x'(q) dq, and its centroid
    lies at x + 3/2 x'' m2, m2 = width^2 / 12. x'' from the neighbours; a third of the shift goes into sigma.
    """
    point, sigma = corners.point.copy(), corners.sigma.copy()
    for axis in (0, 1):
        own, inner = (np.moveaxis(part, 1 - axis, 0)[1:-1] for part in (corners.point, point))
        ahead, behind = (np.moveaxis(corners.point, 1 - axis, 0)[cut] for cut in (np.s_[2:], np.s_[:-2]))
        along = ahead - behind
        along /= np.sqrt((along**2).sum(axis=-1, keepdims=True))
        bend = ((ahead - 2 * own + behind) * along).sum(axis=-1, keepdims=True)
        shift = np.nan_to_num(1.5 * share**2 / 12 * bend * along)
        inner -= shift
        spread = np.moveaxis(sigma, 1 - axis, 0)[1:-1]
        spread[:] = np.hypot(spread, shift / 3)
    return replace(corners, point=point, sigma=sigma)
