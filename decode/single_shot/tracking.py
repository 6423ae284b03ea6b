"""Corners of a lattice followed from the rest frame into a deformed one, in waves of neighbours.

Arrays (J, I, ...) hold the crossing of line j along v and line i along u, NaN where it is not found.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .corners import Corners, refined

__all__ = ["tracked"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: How often a crossing is looked for in a round, once from each side.
_TRIES = 4
#: Of the local period: how far from its expected place a crossing may lie, in rounds. Half a period away the
#: next line is as near.
_LIMITS = (0.12, 0.25, 0.5)
#: How strongly slopes of the displacement are held near 0 until neighbours on several sides settle them.
_HELD = 0.3


def tracked(image: F32, still: F32, rest: Corners, steps: F64, period: float, width: float) -> Corners:
    """Corners (J, I) in `image`, from those that did not move since `still`.

    Crossings far from their expected places wait until more of their neighbours are found.
    """
    point, sigma = np.full(rest.point.shape, np.nan), np.full(rest.point.shape, np.inf)
    front, expected = _unmoved(image, still, rest), rest.point.copy()
    local = steps.copy()
    for limit in _LIMITS:
        tried = np.zeros(front.shape, int)
        while front.any():
            found = refined(image, expected[front], local[front], period, width)
            reach = limit * period * np.sqrt(np.abs(np.linalg.det(local[front])))
            accepted = found.found & (np.hypot(*(found.point - expected[front]).T) < reach)
            tried[front] += 1
            fresh = np.zeros(front.shape, bool)
            fresh[front] = accepted
            point[fresh], sigma[fresh] = found.point[accepted], found.sigma[accepted]
            missing = rest.found & np.isnan(point[..., 0])
            front = _beside(fresh) & missing & (tried < _TRIES)
            local = _local_steps(point, local, period)
            expected[front] = rest.point[front] + _predicted(point - rest.point, front)
        front = _beside(np.isfinite(point[..., 0])) & missing
        expected[front] = rest.point[front] + _predicted(point - rest.point, front)
    doubtful = _doubtful(point, rest.point, period * np.sqrt(np.abs(np.linalg.det(local))))
    point[doubtful], sigma[doubtful] = np.nan, np.inf
    return Corners(point, sigma)


def _unmoved(image: F32, still: F32, rest: Corners) -> Mask:
    """Crossings around which, 9 x 9 pixels, the two frames differ least: at least one, at most all."""
    change = np.sqrt(np.maximum(cv2.blur((image - still) ** 2, (9, 9)), 0))
    row, col = (np.rint(np.where(rest.found, rest.point[..., k], 0)).astype(int) for k in (0, 1))
    size = np.where(rest.found, change[row, col], np.inf)
    return np.asarray(size <= 1.5 * size.min() + 1e-6)


def _beside(mask: Mask) -> Mask:
    """The four neighbours of what is set."""
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), cross) > 0)


def _predicted(shift: F64, front: Mask) -> F64:
    """Displacement (K, 2) of the front by planes through those found among 5 x 5, weights 1 / distance^2."""
    j, i = (axis.ravel() for axis in np.mgrid[-2:3, -2:3])
    around = np.pad(shift, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    near = np.lib.stride_tricks.sliding_window_view(around, (5, 5), (0, 1))[front].reshape(-1, 2, 25)
    known = np.isfinite(near[:, 0]) & ((j != 0) | (i != 0))
    weight = np.where(known, 1 / np.maximum(i**2 + j**2, 1.0) ** 2, 0.0)
    design = np.stack([np.ones(25), i, j], axis=1)
    matrix = np.einsum("kn,np,nq->kpq", weight, design, design)
    matrix += np.diag([1e-12, _HELD**2, _HELD**2])
    right = np.einsum("kn,np,kcn->kpc", weight, design, np.where(known[:, None], near, 0.0))
    return np.asarray(np.linalg.solve(matrix, right)[:, 0])


def _local_steps(point: F64, before: F64, period: float) -> F64:
    """Camera steps per pattern pixel (J, I, 2, 2): from found neighbours, else those of crossings beside."""
    steps = before.copy()
    for axis in (0, 1):
        along = 1 - axis
        pad = [(0, 0)] * 3
        pad[along] = (1, 1)
        framed = np.pad(point, pad, constant_values=np.nan)
        ahead, behind = (np.take(framed, np.arange(k, k + point.shape[along]), along) - point for k in (2, 0))
        step = np.where(np.isnan(behind), ahead, np.where(np.isnan(ahead), -behind, (ahead - behind) / 2))
        known = np.isfinite(step)
        steps[..., axis, :][known] = step[known] / period
    return _from_neighbours(steps, np.isfinite(point[..., 0]))


def _from_neighbours(steps: F64, found: Mask) -> F64:
    """Steps that are means over found neighbours where a crossing is not found itself."""
    framed = np.pad(np.where(found[..., None, None], steps, 0.0), ((1, 1), (1, 1), (0, 0), (0, 0)))
    count = np.pad(found, 1).astype(float)
    sides = ((slice(2, None), np.s_[1:-1]), (slice(-2), np.s_[1:-1]), (np.s_[1:-1], slice(2, None)))
    total, number = framed[1:-1, :-2].copy(), count[1:-1, :-2].copy()
    for side in sides:
        total, number = total + framed[side], number + count[side]
    mean = total / np.maximum(number, 1.0)[..., None, None]
    return np.where((~found & (number > 0))[..., None, None], mean, steps)


def _doubtful(point: F64, rest: F64, size: F64) -> Mask:
    """Crossings within 0.3 periods of each other, and those whose neighbours' line bends by a period."""
    found = np.argwhere(np.isfinite(point[..., 0]))
    drop = np.zeros(size.shape, bool)
    if len(found) == 0:
        return drop
    places = tuple(found.T)
    twins = cKDTree(point[places]).query_pairs(0.3 * float(np.median(size[places])), output_type="ndarray")
    drop[tuple(found[twins.ravel()].T)] = True
    shift = point - rest
    for axis in (0, 1):
        part = np.moveaxis(shift, axis, 0)
        bend = np.sqrt(((part[2:] - 2 * part[1:-1] + part[:-2]) ** 2).sum(axis=-1))
        broken = bend > np.moveaxis(size, axis, 0)[1:-1]
        lines = np.moveaxis(drop, axis, 0)
        for cut in (np.s_[2:], np.s_[1:-1], np.s_[:-2]):
            lines[cut] |= broken
    return drop
