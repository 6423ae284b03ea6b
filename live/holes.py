"""Cells without a height: a dent too steep for one, or a speck of dust on a mirror at rest."""

from typing import NamedTuple

import cv2
import numpy as np

from optolever.arrays import Cells, Mask

__all__ = ["Holes", "holes_of"]

_CLOSED = 11  # cells between parts of one hole, at most
_FEWEST = 3  # cells
_BESIDE = 7  # cells around a hole
_RISING = 30.0  # sigma at rest: median height beside a hole of a dent


class Holes(NamedTuple):
    """steep: whether a flank rises to cells without a height; dust (R, C): cells of holes to which none
    rises."""

    steep: bool
    dust: Mask


def holes_of(z: Cells, sigma: Cells, good: Mask, lit: Mask, rim: Mask) -> Holes:
    """z, sigma (R, C): height and its noise at rest, mm; good: measured; lit, rim: see `Rig`."""
    lost = (lit & ~good).astype(np.uint8)
    steep, dust = False, np.zeros_like(good)
    if lost.any():
        closed = cv2.morphologyEx(lost, cv2.MORPH_CLOSE, np.ones((_CLOSED, _CLOSED), np.uint8))
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
        for label, (x, y, width, height, cells) in enumerate(boxes[1:].tolist(), start=1):
            reach = _BESIDE // 2
            cut = slice(max(y - reach, 0), y + height + reach), slice(max(x - reach, 0), x + width + reach)
            hole = labels[cut] == label
            grown = cv2.dilate(hole.astype(np.uint8), np.ones((_BESIDE, _BESIDE), np.uint8)) > 0
            beside = good[cut] & grown & ~hole
            if cells < _FEWEST or not beside.any() or (hole & rim[cut]).any():
                continue
            if np.median(np.abs(z[cut][beside]) / sigma[cut][beside]) > _RISING:
                steep = True
            else:
                dust[cut] |= hole & (lost[cut] > 0)
    return Holes(steep, dust)
