"""Phase unwrapping by quality, and the connected parts that its whole periods hold for."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["islands_of", "largest_parts", "unwrapped"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]


def unwrapped(cycles: F64, usable: Mask) -> F64:
    """A phase (H, W) without jumps; the median of every connected usable part is within half a cycle of 0.

    Usable pixels by reliability (H. Lei et al., Optik 126, 1640, 2015), so that steep ones are crossed last;
    the others follow the nearest of these.
    """
    wrapped = cycles - np.rint(cycles)
    options = cv2.phase_unwrapping_HistogramPhaseUnwrapping_Params()  # type: ignore[attr-defined]
    options.height, options.width = wrapped.shape
    by_quality = cv2.phase_unwrapping.HistogramPhaseUnwrapping_create(options)  # type: ignore[attr-defined]
    turns = by_quality.unwrapPhaseMap(np.float32(2 * np.pi * wrapped), None, 255 * usable.astype(np.uint8))
    turns = wrapped + np.rint(turns / (2 * np.pi) - wrapped)
    for part, cut in _parts(usable):
        turns[cut] -= np.where(part, np.rint(np.median(turns[cut][part])), 0.0)
    if not usable.any():
        return wrapped
    near = distance_transform_edt(~usable, return_distances=False, return_indices=True)
    return np.asarray(wrapped + np.rint(turns[tuple(near)] - wrapped))


def islands_of(lit: Mask) -> Labels:
    """Labels (H, W) of the connected parts of lit, 0 elsewhere."""
    return np.asarray(cv2.connectedComponents(lit.astype(np.uint8), connectivity=4)[1])


def largest_parts(good: Mask, islands: Labels, least: float) -> Mask:
    """Of every island the largest connected part of good pixels, if it has `least` pixels."""
    parts = islands_of(good)
    area = np.bincount(parts.ravel())
    owner = np.zeros(len(area), np.int64)
    owner[parts[good]] = islands[good]
    ascending = np.lexsort((area, owner))
    last = np.flatnonzero(np.diff(owner[ascending], append=-1))
    keep = np.zeros(len(area), bool)
    keep[ascending[last]] = True
    keep &= (owner > 0) & (area >= least)
    return np.asarray(keep[parts])


def _parts(usable: Mask) -> list[tuple[Mask, tuple[slice, slice]]]:
    """Connected parts, each within its bounding box."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(usable.astype(np.uint8), connectivity=4)
    cuts = [(slice(y, y + h), slice(x, x + w)) for x, y, w, h, _ in boxes[1:count].tolist()]
    return [(np.asarray(labels[cut] == k), cut) for k, cut in enumerate(cuts, start=1)]
